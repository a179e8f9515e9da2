"""The order of the gallery, and descriptions of its pictures."""

from __future__ import annotations

import re
from typing import Any

from sphinx_gallery.scrapers import matplotlib_scraper

ORDER = [
    "particle", "own_system", "falling_disc", "snakeboard_gait", "roller_racer",
    "reversing_trailers", "ball_on_turntable", "bouncing_sleigh", "driven_robot", "environment",
    "which_wall", "uncertain_car", "swept_step", "many_skates", "killed_run",
    "order", "kept_nodes", "order_lost", "long_runs", "two_maps",
    "embedding", "deformed", "exact_constraints", "charts", "poincare_sections",
]  # fmt: skip


def place(name: str) -> int:
    """Return the place of a script; one that is not listed is an error."""
    return ORDER.index(name.removesuffix(".py"))


SHOWN = {
    "ball_on_turntable": [
        "Left, the ball moves in a circle; middle and right, its track on the turning table is a "
        "closed curve of loops. The table makes seven turns for a homogeneous ball, five for a "
        "hollow one.",
    ],
    "bouncing_sleigh": [
        "The sleigh at several instants in its box, its path in arcs from wall to wall, bent "
        "down by the incline.",
    ],
    "charts": [
        "Left, the residual between the rows of a run: run(t) stays near roundoff, a cubic "
        "interpolation rises to 1e-4 between any two rows; right, the path with the stored "
        "states, and a curve in D.",
    ],
    "deformed": [
        "Left, the energy rises to a limit that grows with delta, and stays constant for delta "
        "= 0; right, the power of the reaction, on which the differences of the energy lie.",
        "Two surfaces in the space of v_x, v_y and v_z - y v_x: D is a plane, D_delta a saddle; "
        "on each of them is the line of a run.",
    ],
    "driven_robot": [
        "The robot at several instants on a curved way to the right, until it touches the wall "
        "before the target.",
        "Above, the torques of the left and the right wheel over time, in steps; below, the "
        "energy and the work of the torques, which coincide.",
    ],
    "embedding": [
        "Points of leapfrog with a large step on an arc; the perturbed flow passes through "
        "them, the exact motion passes beside them.",
        "Left, the size of g over a period for three steps, nearly the same curve; right, its "
        "maximum against h: constant for p = 2, falling for p = 1, rising for p = 3.",
    ],
    "environment": [
        "Five carts at several instants, each on its way from another place to the origin, "
        "where all end.",
    ],
    "exact_constraints": [
        "Curves of places through the centre of the sleigh, one for each turn of -1.6 to 1.6 "
        "radians; exact ones are solid and bend, those of the discrete constraint are dashed "
        "and straight.",
        "Two panels of distances against the step: slope 1 for beta = 0 and 1, slope 2 for beta "
        "= 1/2.",
    ],
    "falling_disc": [
        "Above, the disc at several instants as it rolls round a curve and leans; below, its "
        "lean over time, a wave on which the points from Newton's and Euler's equations lie.",
    ],
    "kept_nodes": [
        "Two panels, h = 0.1 and 0.05: states of moved nodes on the vertical axis, off D_ε "
        "alone; states of kept nodes on the horizontal axis, off D alone; half as far for half "
        "the step.",
        "Residuals over time: at moved nodes roundoff for D and near 0.1 for D_ε; "
        "at kept nodes the two have changed places.",
    ],
    "killed_run": [
        "The robot at several instants between wall and turn; a mark on the path shows where "
        "the run was killed, and the path continues from there.",
    ],
    "long_runs": [
        "Above, paths early and late: the same region in the reversible case, a larger one late "
        "in the gyroscopic case; below, the energy errors of four schemes: level for "
        "compositions on the left, rising on the right.",
    ],
    "many_skates": [
        "Twelve skates at several instants, each on a path that curves to the left, with "
        "springs between neighbours.",
    ],
    "order": [
        "Left, a path downhill and up again by three steps, the smaller the nearer to the exact "
        "one; right, errors of q, v and the multiplier against h, all with slope 2.",
    ],
    "order_lost": [
        "Left, the sleigh at moved and at kept nodes with a large step; right, errors against "
        "h: slope 2 for moved nodes, and for kept ones half a step back, slope 1 for the "
        "others.",
    ],
    "own_system": [
        "The cart from above at several instants of a turn, the two wheels at its axle, on a "
        "path of arcs sideways on the incline.",
    ],
    "particle": [
        "The path of the particle in space, which climbs ever more steeply. At several instants "
        "it shows the velocity and the disc of velocities that the constraint allows.",
        "Residuals of a run of midpoint over time: roundoff for D, between 1e-2 and 1e-4 for "
        "D_ε.",
    ],
    "poincare_sections": [
        "Left, a section of the contact oscillator: islands around periodic orbits in a sea of "
        "chaotic points. Right, a section of the rattleback: a cloud of points, dense along an "
        "arc.",
    ],
    "reversing_trailers": [
        "A car pushes a trailer; above, with straight wheels, they fold up after a few metres; "
        "below, steered by the law, they reach the lane and follow it.",
    ],
    "roller_racer": [
        "The roller racer at several instants: above, with a short handle, nearly straight "
        "ahead; below, with a long handle, along a wave.",
    ],
    "snakeboard_gait": [
        "Three gaits of the snakeboard at several instants: drive goes along a wave, rotate "
        "turns about a point, park moves sideways by small arcs.",
    ],
    "swept_step": [
        "Above, the path between two cusps for the exact motion and two step sizes; below, "
        "errors of three schemes against the step, with slopes 2, 4 and 6.",
    ],
    "two_maps": [
        "Left, the path in the plane, a rosette of ellipses; right, the change of the energy "
        "over time: bands if D_d uses the midpoint map, a drift if it uses a one-sided map.",
    ],
    "uncertain_car": [
        "Left, the car at several instants in a left bend, 200 paths around it, and all last "
        "positions as a cloud; right, median and bands of y over time.",
    ],
    "which_wall": [
        "Left, a map of the first wall over the speed and the rate of turning, in four colours; "
        "right, the paths of the runs of the dots, in the colours of the walls that they hit.",
    ],
}  # fmt: skip


def described(block: Any, variables: dict[str, Any], options: Any) -> str:
    """Return the pictures of a block as Sphinx-Gallery does, with their descriptions."""

    def words(found: re.Match[str]) -> str:
        return f"{found[1]}{SHOWN[found[2]][int(found[3]) - 1]}"

    text = matplotlib_scraper(block, variables, options)
    return re.sub(r"(sphx_glr_(\w+)_(\d+)\.png\n +:alt: ).*", words, text)
