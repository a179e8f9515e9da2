"""Films: what is drawn is the run, and a file is whole or not there."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from conftest import refused
from matplotlib import pyplot
from matplotlib.colors import to_hex
from PIL import Image

import dalembert as dal
from dalembert.show import animation, bodies, film_page, scene
from dalembert.show.bodies import Shape, arrow, blade, circle, dot, line, polygon

pytestmark = pytest.mark.usefixtures("no_windows")
EVERY = (*dal.systems.names(), *dal.systems.names_in_sympy())
# Those whose constraints are blades, or wheels from above; and wheels in space.
BLADES = ("knife_edge", "sleigh", "sleigh_contact", "sleigh_with_rotor", "n_trailer", "snakeboard",
          "steered_car", "roller_racer", "two_wheeled_robot")  # fmt: skip
WHEELS = {"disk": "R", "robot": "R", "rolling_disc": "r"}


@functools.cache
def made(name, **options):
    return dal.integrate(dal.systems.get(name), "leapfrog", **{"h": 0.02, "t_end": 4, **options})


@pytest.fixture(scope="module")
def run():
    return made("sleigh")


def page_of(film):
    return film_page.html(film._scene, film.fps, film._trail)


def shapes_of(run, q, v, t=0.0):
    return list(bodies.of(run)(t, q, v))


def rates(run, q, v, t=0.0, d=1e-6):
    """The shapes at a state, and the velocity of their points as it moves on."""
    ahead, behind = (shapes_of(run, q + s * d * v, v, t + s * d) for s in (1, -1))
    now = shapes_of(run, q, v, t)
    return [(x, (a.points - b.points) / (2 * d)) for x, a, b in zip(now, ahead, behind)]


# ---- bodies --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BLADES)
def test_no_blade_slips(name):
    run = made(name)
    for q, v in zip(run.q[::40], run.v[::40]):
        seen = 0
        for shape, rate in rates(run, q, v):
            if shape.role == "blade":
                along = np.diff(shape.points, axis=0)[0]
                middle = rate.mean(axis=0)
                across = along[0] * middle[1] - along[1] * middle[0]
                assert abs(across) < 1e-8 * np.hypot(*along)
                seen += 1
        assert seen


@pytest.mark.parametrize("name", WHEELS)
def test_wheels_roll_on_the_plane_and_keep_their_size(name):
    run = made(name)
    r = run.system.parameters[WHEELS[name]]
    for q, v in zip(run.q[::40], run.v[::40]):
        disc, *_, foot = shapes_of(run, q, v)
        assert disc.points[:, 2].min() == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(disc.points[0], foot.points[0], atol=1e-12)
        distances = np.linalg.norm(disc.points - disc.middle, axis=1)
        np.testing.assert_allclose(distances, r, rtol=1e-12)
        assert disc.middle[2] > 0


@pytest.mark.parametrize("name", WHEELS)
def test_the_point_of_a_wheel_that_touches_the_plane_is_at_rest(name):
    run = made(name)
    roll = {"disk": 2, "robot": 3, "rolling_disc": 4}[name]
    q, v = run.q[70].copy(), run.v[70]
    q[roll] = 0.0  # which neither L nor D depends on, but for the torque on the robot
    (rim,) = (rate for shape, rate in rates(run, q, v) if shape.role == "blade")
    mark = rim[len(rim) // 2]
    assert np.abs(mark).max() < 1e-8
    assert np.linalg.norm(rim[0]) > 1e-2


def test_a_wheel_that_leans_has_its_centre_where_the_coordinates_say():
    run = made("rolling_disc")
    r = run.system.parameters["r"]
    q = np.array([1.0, 2.0, 0.7, 0.5, 0.3])
    disc = shapes_of(run, q, run.v[0])[0]
    np.testing.assert_allclose(disc.middle, [1.0, 2.0, r * np.cos(0.5)], atol=1e-12)
    # the start is a steady circle of radius 10 r about the origin, on which the contact runs
    feet = [shapes_of(run, q, v)[-1].middle for q, v in zip(run.q, run.v)]
    np.testing.assert_allclose(np.linalg.norm(feet, axis=1), 10 * r, rtol=1e-5)


def test_trailers_hang_at_their_distance():
    run = made("n_trailer")
    axles = [x.middle for x in shapes_of(run, run.q[-1], run.v[-1]) if x.role == "dot"]
    distances = np.linalg.norm(np.diff(axles, axis=0), axis=1)
    np.testing.assert_allclose(distances, run.system.parameters["d"])
    np.testing.assert_allclose(axles[0], run.q[-1, :2])
    assert len(axles) == 4


@pytest.mark.parametrize("a", [0.4, -0.4, 0.0])
def test_the_blade_of_a_sleigh_is_behind_its_centre_of_mass(a):
    run = dal.integrate(dal.systems.sleigh(a=a), "leapfrog", h=0.02, t_end=1,
                        consistent="project")  # fmt: skip
    hull, edge, centre = shapes_of(run, run.q[-1], run.v[-1])
    heading = np.array([np.cos(run.q[-1, 2]), np.sin(run.q[-1, 2])])
    np.testing.assert_allclose(centre.middle, run.q[-1, :2], atol=1e-14)
    np.testing.assert_allclose(centre.middle - edge.middle, a * heading, atol=1e-14)
    # the hull reaches to that side on which the centre of mass is
    assert np.sign((hull.middle - edge.middle) @ heading) == (-1 if a < 0 else 1)


def test_the_table_turns_under_the_ball():
    run = made("ball_on_table")
    turn = run.system.parameters["Omega"]
    (start, later) = (shapes_of(run, run.q[0], run.v[0], t)[1].points[1] for t in (0.0, 0.3))
    angle = np.arctan2(start[0] * later[1] - start[1] * later[0], start @ later)
    assert angle == pytest.approx(0.3 * turn)


def test_the_plane_at_a_particle_is_that_of_d():
    run = made("particle")
    plane = shapes_of(run, run.q[50], run.v[50])[0]
    assert plane.role == "plane"
    mu = np.array([-run.q[50, 1], 0, 1])
    np.testing.assert_allclose((plane.points - run.q[50]) @ mu, 0, atol=1e-10)
    assert np.linalg.matrix_rank(plane.points - run.q[50], tol=1e-6) == 2


@pytest.mark.parametrize("name", EVERY)
def test_every_system_has_a_film(name):
    film = dal.plot.animate(made(name), fps=5, seconds=1)
    assert len(film) == 5
    shapes = film._scene.frames[-1]
    assert {"dot", "blade"} & {x.role for x in shapes}
    assert (film.scale is None) == (name in ("chaotic", "disguised"))
    contacts = [x for x in shapes if x.constraints]
    assert sorted(k for x in contacts for k in x.constraints) in (
        list(range(film.run.system.m)), [])  # fmt: skip


def test_shapes_are_what_they_should_be():
    assert circle((1, 0), 2).points.max(axis=0) == pytest.approx([3, 2])
    assert dot((1, 2), 0).constraints == (0,)
    np.testing.assert_allclose(blade((1, 1), np.pi / 2, 2).points, [[1, 0], [1, 2]], atol=1e-15)
    assert arrow((1, 0, 0), (0, 1, 2)).points.tolist() == [[1, 0, 0], [1, 1, 2]]
    refused([
        (lambda: Shape("blob", [[0, 0]]), "role = 'blob': .*expected one of"),
        (lambda: polygon([(0, 0), (1, 1)]), "expected at least 3 for a body, got 2"),
        (lambda: line((0, 0)), "expected at least 2 for a bar, got 1"),
        (lambda: line((0, 0), (0, np.nan)), r"points\[1, 1\] = nan: expected finite numbers"),
        (lambda: dot((0, 0, 0, 0)), r"place: expected shape \(2,\) or \(3,\), got \(4,\)"),
        (lambda: circle((0, 0, 0), 1), r"centre: expected shape \(2,\), got \(3,\)"),
        (lambda: circle((0, 0), "a"), "radius = 'a': expected a finite number"),
        (lambda: blade((0, 0), None, 1), "heading = None: expected a finite number"),
        (lambda: blade(0, 0, 1), r"centre: expected shape \(2,\)"),
        (lambda: blade((0, 0), 0, "b"), "length = 'b': expected a finite number"),
        (lambda: arrow((0, 0), (0, 0, 0)), r"vector: expected shape \(2,\), got \(3,\)"),
        (lambda: dot((0, 0), -1), "constraints = -1: expected at least 0"),
    ])  # fmt: skip


# ---- reactions -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["knife_edge", "n_trailer", *WHEELS, "ball_on_table"])
def test_the_reactions_move_the_whole(name):
    """x and y move all bodies, so that the forces at the contacts add up to mu^T lambda there."""
    run = made(name)
    film = dal.plot.animate(run, fps=5, seconds=1)
    for t in film.t:
        state = run(t)
        drawn = sum(
            np.diff(x.points, axis=0)[0] * film.scale for x in reactions(run, state, t, film.scale)
        )
        # independently: (M a)_x = f_x + (mu^T lambda)_x by two accelerations
        system = run.system
        lambdas = system.multipliers(state.q, state.v, t=float(t))
        push = np.array([mu_of(system, state.q, k) for k in range(2)]) @ lambdas
        np.testing.assert_allclose(drawn[:2], push, rtol=1e-6, atol=1e-8)


def test_a_reaction_in_space_has_all_three_components():
    """Where the places have other names than x, y, z: M a - f of two accelerations."""
    run = made("genmass")
    film = dal.plot.animate(run, fps=5, seconds=1)
    assert film._scene.columns == (0, 1, 2)
    state = run(film.t[2])
    forces = scene.forces_at(run, film.t[2:3], np.append(state.q, state.v)[None], (0, 1, 2))[0]
    mu = [mu_of(run.system, state.q, k) for k in range(3)]
    push = np.array(mu) @ run.system.multipliers(state.q, state.v)
    (tail, tip) = next(
        x for x in scene.arrows(bodies.of(run)(0.0, state.q, state.v), forces, film.scale)
    ).points
    np.testing.assert_allclose((tip - tail) * film.scale, push, rtol=1e-6)


@pytest.mark.parametrize("c", [1.0, 1e-4, 1e-8])
def test_the_reaction_of_a_nonlinear_constraint_at_any_speed(c):
    """|v| = c under a force F of size c/2: what acts is -(F.u) u, u = v/|v|."""
    F = c * np.array([0.3, -0.4])
    system = dal.System(
        mass=[1, 1], coordinates="xy", potential=lambda q: -F @ q, gradient=lambda q: -F,
        constraint=lambda q, v: [np.hypot(*v) - c], constraint_v=lambda q, v: [v / np.hypot(*v)],
        constraint_q=lambda q, v: [[0, 0]],
    )  # fmt: skip
    run = dal.integrate(system, h=0.01, q0=[0, 0], v0=[c, 0], t_end=3)
    film = dal.plot.animate(run, fps=5, seconds=1)
    state = run(film.t[2])
    (arrow_,) = (x for x in film._scene.frames[2] if x.role == "reaction")
    u = state.v / np.hypot(*state.v)
    np.testing.assert_allclose(np.diff(arrow_.points, axis=0)[0] * film.scale, -(F @ u) * u,
                               rtol=1e-5)  # fmt: skip


def test_roundoff_of_a_fall_from_rest_has_no_arrow_and_a_force_on_a_hill_has_one():
    fall = made("knife_edge", q0=(0, 0, np.pi), v0=(0, 0, 0))
    assert abs(fall.multipliers).max() > 0 and dal.plot.animate(fall).scale is None
    hill = dal.System(
        mass=[1, 1, 1], coordinates=["x", "y", "theta"], potential=lambda q: 1e12,
        gradient=lambda q: 0 * q, mu=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0]],
    )  # fmt: skip
    run = dal.integrate(hill, q0=[0, 0, 0], v0=[1, 0, 1], h=0.02, t_end=4)
    assert dal.plot.animate(run).scale is not None
    twice = [dot((0, 0), (0, 0))]
    (one,) = scene.arrows(twice, np.array([[1.0, 0.0]]), 1.0)
    np.testing.assert_array_equal(one.points[1], [1, 0])


def reactions(run, state, t, scale):
    x = np.concatenate([state.q, state.v])
    force = scene.forces_at(run, np.array([t]), x[None], (0, 1))[0]
    return scene.arrows(bodies.of(run)(float(t), state.q, state.v), force, scale)


def mu_of(system, q, k):
    """A column of mu, which is phi(q, e_k) - phi(q, 0) where phi is affine in v."""
    e = np.zeros(system.n)
    e[k] = 1
    return dal.geometry.residual(system, q, e) - dal.geometry.residual(system, q, 0 * e)


def test_arrows_are_at_the_blade_across_it_and_of_a_size_that_is_said(run):
    film = dal.plot.animate(run)
    assert film.scale == 1.0
    ax = film.frame(2.0)
    words = [x.get_text() for x in ax.get_legend().get_texts()]
    assert words == ["reaction: length 1 is a force of 1"]
    _, shapes = film._scene.shapes(2.0)
    (force,) = (x for x in shapes if x.role == "reaction")
    (edge,) = (x for x in shapes if x.role == "blade")
    np.testing.assert_allclose(force.points[0], edge.middle)
    vector = np.diff(force.points, axis=0)[0]
    assert abs(vector @ np.diff(edge.points, axis=0)[0]) < 1e-9
    state = run(2.0)
    size = abs(run.system.multipliers(state.q, state.v)[0])
    assert np.hypot(*vector) * film.scale == pytest.approx(size)
    twice = dal.plot.animate(run, scale=2 * film.scale)._scene.shapes(2.0)[1]
    (short,) = (x for x in twice if x.role == "reaction")
    np.testing.assert_allclose(np.diff(short.points, axis=0)[0], vector / 2)
    assert dal.plot.animate(run, multipliers=False).scale is None


def test_reactions_that_are_roundoff_are_not_blown_up():
    free = dal.systems.heisenberg(k1=0.3, k2=0.3, k3=0)  # equal springs: lambda = 0 to roundoff
    run = dal.integrate(free, "leapfrog", [0.3, 0.7, 0], [0.1, 0.4, 0.05], h=0.02, t_end=4)
    assert 0 < abs(run.multipliers).max() < 1e-12
    film = dal.plot.animate(run)
    assert film.scale is None
    assert "reaction" not in {x.role for shapes in film._scene.frames for x in shapes}


def test_reactions_with_inputs_are_those_of_their_step():
    pushed = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-np.sin(q[2]), np.cos(q[2]), 0]],
        force=lambda t, q, v, u: [0, u[0], 0], inputs=["push"], coordinates=["x", "y", "theta"],
    )  # fmt: skip
    run = dal.integrate(pushed, "leapfrog", [0, 0, 0], [1, 0, 0], h=0.1, steps=20,
                        inputs=np.where(np.arange(20) < 10, 0.0, 3.0)[:, None])  # fmt: skip
    skate = lambda t, q, v: [blade(q[:2], q[2], 0.2, 0)]  # noqa: E731
    film = dal.plot.animate(run, skate, fps=4, seconds=1)
    sizes = []
    for shapes in film._scene.frames:
        (force,) = (x for x in shapes if x.role == "reaction")
        sizes.append(np.diff(force.points, axis=0)[0, 1] * film.scale)
    np.testing.assert_allclose(sizes, [0, 0, -3, -3], atol=1e-9)


def drawn_lines(ax, points):
    """The lines and outlines on axes that have so many points."""
    paths = [path for piece in ax.collections for path in piece.get_paths()]
    return [x.vertices for x in paths if len(x.vertices) == points]


def drawn(ax, points):
    return len(drawn_lines(ax, points))


# ---- frames --------------------------------------------------------------------------------------


def test_frames_are_states_of_the_run_at_even_times(run):
    film = dal.plot.animate(run, fps=7, seconds=2)
    np.testing.assert_allclose(film.t, np.linspace(0, 4, 14))
    assert len(film) == 14
    state = run(film.t[5])
    expected = shapes_of(run, state.q, state.v)
    for shape, wanted in zip(film._scene.frames[5], expected):
        np.testing.assert_allclose(shape.points, wanted.points, atol=1e-12)
    # the trail of frame 5 ends at its blade, and passes those of the frames before
    (trail,) = film._scene.trails
    each = film._scene.per_frame
    assert len(trail) == 13 * each + 1 >= 600
    np.testing.assert_allclose(trail[5 * each], expected[1].middle, atol=1e-12)
    ax = film.frame(film.t[5])
    assert drawn(ax, 5 * each + 1) == 1
    np.testing.assert_allclose(drawn_lines(ax, 5 * each + 1)[0], trail[: 5 * each + 1])
    film.frame(film.t[2])
    assert drawn(ax, 5 * each + 1) == 0  # it is taken away
    bare = dal.plot.animate(run, fps=7, seconds=2, trail=False).frame(4.0)
    assert drawn(bare, 13 * each + 1) == 0


def test_a_trail_has_at_least_the_stored_states():
    run = made("sleigh", h=0.002, t_end=4)
    (trail,) = dal.plot.animate(run, fps=5, seconds=1)._scene.trails
    assert len(trail) >= 2001


def test_an_instant_between_frames_and_none_outside(run):
    film = dal.plot.animate(run, fps=2, seconds=2)
    ax = film.frame(1.2345)
    assert ax is film.ax
    assert ax.get_title(loc="right") == "t = 1.2"
    hull = drawn_lines(ax, 8)[0][:-1]  # of 7 points, closed
    state = run(1.2345)
    np.testing.assert_allclose(hull, shapes_of(run, state.q, state.v)[0].points, atol=1e-12)
    for t in (-0.1, 4.1):
        with pytest.raises(ValueError, match="expected a time of the run, from 0 to 4"):
            film.frame(t)
    with pytest.raises(ValueError, match="t = nan: expected a finite number"):
        film.frame(float("nan"))


def test_backwards_in_time():
    run = made("sleigh", h=-0.02, t_end=-4)
    film = dal.plot.animate(run, fps=5, seconds=1)
    np.testing.assert_allclose(film.t, np.linspace(0, -4, 5))
    (trail,) = film._scene.trails
    assert drawn(film.frame(-2.0), 2 * film._scene.per_frame + 1) == 1
    np.testing.assert_allclose(
        film._scene.frames[-1][1].middle, shapes_of(run, run.q[-1], run.v[-1])[1].middle
    )
    np.testing.assert_allclose(trail[-1], film._scene.frames[-1][1].middle)


def test_rows_of_t_eval_are_drawn_with_their_own_times():
    t = (0.0, 0.1, 0.15, 2.0, 3.9, 4.0)
    run = made("sleigh", t_eval=t)
    film = dal.plot.animate(run, fps=9, seconds=1)
    assert set(film.t) <= set(t)
    np.testing.assert_array_equal(film.t, [t[k] for k in (0, 2, 2, 3, 3, 3, 4, 4, 5)])
    np.testing.assert_allclose(film._scene.frames[4][1].middle,
                               shapes_of(run, run.q[3], run.v[3])[1].middle)  # fmt: skip
    assert film.frame(1.2).get_title(loc="right") == "t = 2.0"
    back = made("sleigh", h=-0.02, t_end=-4, t_eval=tuple(-x for x in t))
    np.testing.assert_array_equal(dal.plot.animate(back, fps=9, seconds=1).t, -film.t)


def test_snapshots_are_shown_by_pyplot_and_films_are_not():
    run, plt = made("sleigh"), matplotlib.pyplot
    plt.close("all")
    dal.plot.animate(run)
    assert plt.get_fignums() == []
    ax = dal.plot.snapshots(run)
    assert plt.gcf() is ax.figure
    plt.close("all")


def test_resets_and_the_end_by_an_event_are_not_interpolated_across():
    wall = dal.Event(lambda t, q, v: q[0] - 0.5, reset=lambda q, v: (q, -v), direction=1)
    system = dal.systems.knife_edge(gs=1.0)
    run = dal.integrate(system, "leapfrog", [0, 0, 0], [1, 0, 0], h=0.3, t_end=3, events=[wall])
    assert len(run.t_events[0]) > 0
    film = dal.plot.animate(run, fps=30, seconds=2)
    apart = np.abs(film.t - np.linspace(0, 3, 60))
    assert 0 < apart.max() <= 0.3 and (apart == 0).mean() > 0.5
    stop = dal.Event(lambda t, q, v: q[0] - 0.5, terminal=True)
    run = dal.integrate(system, "leapfrog", [0, 0, 0], [1, 0, 0], h=0.3, t_end=3, events=[stop])
    film = dal.plot.animate(run)
    assert film.t[-1] == run.t[-1] == run.t_events[0][0]


def test_a_run_of_one_state_and_one_that_broke_off():
    one = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.1, steps=0)
    film = dal.plot.animate(one)
    assert len(film) == 1 and len(film._scene.trails[0]) == 1
    assert film.frame(0.0).get_title(loc="right") == "t = 0.00"

    def forms(q):
        return [[0, 1, -np.sqrt(1 - q[0]) if q[0] < 1 else np.nan]]

    bad = dal.System(mass=[1, 1, 1], mu=forms, coordinates="xyz")
    part = dal.integrate(bad, "midpoint", [0, 0, 0], [1, 1, 1], h=0.1, t_end=3, throw=False)
    assert not part.success
    film = dal.plot.animate(part)
    assert film.t[-1] == part.t[-1] < 1.1
    assert "it ended early: " in page_of(film)


def test_a_body_at_rest_and_a_path_along_an_axis():
    rest = dal.integrate(dal.systems.knife_edge(gs=0.0), "leapfrog", [0, 0, 0], [0, 0, 0],
                         h=0.1, steps=10)  # fmt: skip
    limits = dal.plot.animate(rest)._scene.limits
    assert np.isfinite(limits).all() and (np.diff(limits, axis=0) > 0).all()
    straight = dal.System(mass=[1.0], coordinates=["s"])
    run = dal.integrate(straight, "leapfrog", [0], [1], h=0.1, steps=10)
    film = dal.plot.animate(run)
    np.testing.assert_allclose(film._scene.frames[-1][0].points, [[1, 0]])


def test_a_system_of_ones_own_is_a_point():
    run = dal.integrate(
        dal.System(mass=np.eye(3), mu=lambda q: [[-q[1], 0, 1]], coordinates="xyz",
                   name="sleigh"),
        "leapfrog", [0, 0, 0], [1, 1, 0], h=0.05, t_end=2,
    )  # fmt: skip
    film = dal.plot.animate(run)
    assert [x.role for x in film._scene.frames[0]] == ["plane", "dot", "velocity", "reaction"]
    flat = dal.plot.animate(run, coordinates=(2, 0))
    np.testing.assert_allclose(flat._scene.trails[0][-1], run.q[-1, [2, 0]], atol=1e-12)
    velocity = flat._scene.frames[-1][1].points
    (x, y), (u, w) = np.diff(velocity, axis=0)[0], run.v[-1, [2, 0]]
    assert abs(x * w - y * u) < 1e-9 and x * u > 0


def test_coordinates_choose_the_point_also_for_the_library(run):
    film = dal.plot.animate(run, coordinates=[0, 1])
    assert {x.role for x in film._scene.frames[0]} == {"velocity", "dot", "reaction"}
    for wrong in ([0, 3], [0, 1, 2, 0], [], "xy", 1, [-1, 0]):
        with pytest.raises(ValueError, match="coordinates = .*expected up to three of 0 to 2"):
            dal.plot.animate(run, coordinates=wrong)


def test_a_body_of_ones_own(run):
    def skate(t, q, v):
        return [circle(q[:2], 0.1), blade(q[:2], q[2], 0.5, constraints=0)]

    film = dal.plot.animate(run, skate, fps=5, seconds=1)
    assert [x.role for x in film._scene.frames[0]] == ["body", "blade", "reaction"]
    bare = dal.plot.animate(run, lambda t, q, v: [circle(q[:2], 0.1)])
    assert bare._scene.trails == [] and bare.scale is None
    dotted = dal.plot.animate(run, lambda t, q, v: [dot(q[:2]), dot(q[:2] + 1)])
    assert len(dotted._scene.trails) == 2
    raised = dal.plot.animate(run, lambda t, q, v: [dot((*q[:2], 1.0), 0), circle(q[:2], 0.5)])
    assert raised._scene.in_space
    time, shapes = raised._scene.shapes(4.0)
    for shape, wanted in zip(shapes, raised._scene.frames[-1], strict=True):
        np.testing.assert_allclose(shape.points, wanted.points)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("sleigh", "body = 'sleigh': expected a function"),
        (lambda q: [], r"a function of \(t, q, v\)"),
        (lambda t, q, v: None, "body returned None: expected a list of shapes"),
        (lambda t, q, v: [(0, 0)], r"body returned \(0, 0\) in its list: expected shapes"),
        (lambda t, q, v: [], "returned no shapes"),
        (lambda t, q, v: [dot(q[:2], 1)], r"= \(1,\), but the system has 1 constraint, numbered"),
        (lambda t, q, v: [dot(q[:2] * np.nan)], "expected finite numbers"),
        (lambda t, q, v: [dot(q.__iadd__(1)[:2])], "read-only"),
    ],
)
def test_bodies_that_are_none(run, body, text):
    with pytest.raises(ValueError, match=text):
        dal.plot.animate(run, body)


def test_arguments_that_are_wrong(run):
    refused([
        *(
            (lambda options=options: dal.plot.animate(run, **options), words)
            for options, words in (
                ({"fps": 0}, "fps = 0, seconds = 5: expected positive numbers"),
                ({"seconds": -1}, "seconds = -1: expected positive"),
                ({"fps": 1e9}, "expected at most 5000 frames"),
                ({"fps": float("inf")}, "fps = inf: expected a finite number"),
                ({"scale": 0}, "scale = 0: expected a positive force"),
                ({"ax": 3}, "ax is a int; expected a matplotlib"),
            )
        ),
        (lambda: dal.plot.animate(run.system), "run is a System; expected a dalembert.Solution"),
        (lambda: dal.plot.snapshots(run, count=1), "count = 1: expected at least 2"),
    ])  # fmt: skip


def test_an_error_of_the_body_comes_out_as_it_is(run):
    def body(t, q, v):
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="^mine$"):
        dal.plot.animate(run, body)


# ---- pictures ------------------------------------------------------------------------------------


def test_the_axes_are_equal_and_hold_all_frames(run):
    ax = dal.plot.animate(run).ax
    assert ax.get_aspect() == 1
    assert ax.get_title(loc="left") == "sleigh"
    for q, v in zip(run.q, run.v):
        for shape in shapes_of(run, q, v):
            for axis, limits in enumerate((ax.get_xlim(), ax.get_ylim())):
                assert limits[0] < shape.points[:, axis].min()
                assert shape.points[:, axis].max() < limits[1]


def test_axes_of_ones_own_stay_in_their_figure(run, tmp_path):
    figure, (left, right) = pyplot.subplots(1, 2)
    right.plot([0, 1], [0, 1])
    canvas = figure.canvas
    film = dal.plot.animate(run, ax=left, fps=5, seconds=1)
    film.save(tmp_path / "two.gif")
    assert film.ax is left and figure.canvas is canvas and len(right.lines) == 1
    with Image.open(tmp_path / "two.gif") as image:
        assert image.size == tuple(figure.bbox.size)


def test_the_axes_have_names_where_they_are_known(run):
    def names(film):
        return [x.get_text() for x in film.ax.texts]

    assert names(dal.plot.animate(run)) == ["x", "y"]
    assert names(dal.plot.animate(run, coordinates=(2, 1))) == ["theta", "y"]
    assert names(dal.plot.animate(run, lambda t, q, v: [dot(q[1:])])) == []
    assert names(dal.plot.animate(made("chaotic"))) == ["y", "z"]
    assert names(dal.plot.animate(made("disk"))) == []
    assert data_of(dal.plot.animate(run, coordinates=(2, 1)))["names"] == ["theta", "y"]


def test_the_clock_tells_frames_apart():
    short = made("sleigh", h=1e-10, t_end=1e-9)
    film = dal.plot.animate(short, fps=5, seconds=1)
    assert len({film._clock(t) for t in film.t}) == 5
    assert film._clock(1e-9) == "t = 1e-09"
    few = made("sleigh", h=1e-3, t_end=2e-3, t_eval=(0, 1e-3, 1.7e-3, 2e-3))
    film = dal.plot.animate(few, fps=9, seconds=1)
    assert {film._clock(t) for t in film.t} == {f"t = {t}" for t in ("0.0000", "0.0010", "0.0017",
                                                                     "0.0020")}  # fmt: skip


def test_curves_of_a_run_at_a_late_time():
    late = made("sleigh", t0=1.7e9, t_end=1.7e9 + 4)
    data = data_of(dal.plot.animate(late, fps=5, seconds=1))
    assert data["t"] == pytest.approx(np.linspace(0, 4, 5), abs=1e-6)
    t = np.array(data["curves"][0]["points"])[:, 0]
    assert len(set(t)) == len(late.t) and t[-1] == pytest.approx(4, abs=1e-6)


def test_axes_that_are_no_plane(run):
    figure = pyplot.figure()
    for projection in ("3d", "polar"):
        with pytest.raises(ValueError, match=f"projection '{projection}': expected plane"):
            dal.plot.animate(run, ax=figure.add_subplot(projection=projection))
    part, _ = figure.subfigures(1, 2)
    dal.plot.snapshots(run, ax=part.subplots())


def test_units_stand_on_axes_clock_and_curves(run):
    units = {"x": "m", "y": "$k{0}m$", "t": "s", "energy": "J"}
    film = dal.plot.animate(
        dal.integrate(dal.systems.sleigh().with_units(**units), h=0.02, t_end=4), fps=5, seconds=1
    )
    assert [x.get_text() for x in film.ax.texts] == ["x (m)", r"y (\$k{0}m\$)"]
    assert film.frame(2).get_title(loc="right") == "t = 2.0 s"
    data = data_of(film)
    assert data["names"] == ["x (m)", "y ($k{0}m$)"] and data["clock"][-1] == "t = 4.0 s"
    assert data["curves"][0]["name"] == "E − E₀ (J)"
    assert dal.plot.snapshots(film.run).get_title(loc="right") == "t = 0.0 to 4.0 s"
    disk = dal.integrate(dal.systems.disk().with_units(x="m", y="m"), h=0.02, t_end=4)
    assert data_of(dal.plot.animate(disk))["squares"].endswith(" m")
    assert data_of(dal.plot.animate(run))["clock"][-1] == "t = 4.00"


def test_space_is_seen_from_above_with_the_near_larger():
    look = scene.Camera(np.zeros(3), 10.0)
    near, far, high = (look(np.array([x]))[0] for x in ([1.0, -2, 0], [-1.0, 2, 0], [0, 0, 1.0]))
    assert near[1] < 0 < far[1] and high[1] > 0 == high[0]
    assert np.hypot(*near) > np.hypot(*far)
    behind = look(np.array([[100.0, -200, 100]]))
    assert np.isfinite(behind).all()


def test_the_ground_is_white_whatever_the_style(run):
    with pyplot.style.context("dark_background"):
        film = dal.plot.animate(run)
        assert film.ax.figure.get_facecolor() == (1, 1, 1, 1)
        (words,) = film.ax.get_legend().get_texts()
        assert {to_hex(x.get_color()) for x in (words, film.ax.title)} == {"#000000"}


def test_snapshots_show_the_whole_trail_and_each_outline(run):
    ax = dal.plot.snapshots(run, count=7)
    outlines = [x for x in ax.collections if len(x.get_paths()[0].vertices) == 8]
    assert len(outlines) == 7
    times = np.linspace(0, 4, 7)
    for outline, t in zip(outlines, times):
        state = run(t)
        hull = shapes_of(run, state.q, state.v)[0].points
        np.testing.assert_allclose(outline.get_paths()[0].vertices[:-1], hull, atol=1e-12)
    shades = [x.get_edgecolor()[0, 3] for x in outlines]
    assert shades == sorted(shades) and shades[-1] == 1
    assert max(len(x.vertices) for piece in ax.collections for x in piece.get_paths()) >= 600
    assert ax.get_title(loc="right") == "t = 0.0 to 4.0"
    (force,) = dal.plot.snapshots(run, count=2, multipliers=True).get_legend().get_texts()
    assert force.get_text().startswith("reaction: length 1 is a force of ")
    table = dal.plot.snapshots(made("ball_on_table"), count=3)
    assert drawn(table, 41) == 1 + 3  # the table once, the ball three times


def test_axes_that_have_labels_get_no_other_names(run):
    def names(ax):
        return [x.get_text() for x in ax.texts]

    axes = matplotlib.figure.Figure().subplots(1, 2)
    axes[0].set(xlabel="x (m)")
    assert names(dal.plot.snapshots(run, ax=axes[0])) == ["y"]
    assert axes[0].get_xlabel() == "x (m)"
    assert names(dal.plot.snapshots(run, ax=axes[1])) == ["x", "y"]


def test_names_are_drawn_letter_by_letter():
    own = dal.System(mass=[1, 1], name="$x^$</script>")
    run = dal.integrate(own, "leapfrog", [0, 0], [1, 0], h=0.1, steps=5)
    film = dal.plot.animate(run)
    film.ax.figure.canvas.draw()
    assert film.ax.get_title(loc="left") == r"\$x^\$</script>"
    page = page_of(film)
    assert page.count("</script>") == 2 and "$x^$&lt;/script&gt;" in page


# ---- files ---------------------------------------------------------------------------------------


def test_a_gif_has_the_frames_and_lasts_as_long_as_said(run, tmp_path):
    file = tmp_path / "a.gif"
    shown = []
    film = dal.plot.animate(run, fps=30, seconds=0.2)
    film.save(file, progress=lambda done, total: shown.append((done, total)))
    assert shown == [(k, 6) for k in range(7)]
    with Image.open(file) as image:
        assert image.n_frames == len(film) == 6
        assert image.size == tuple(film.ax.figure.bbox.size)
        durations = []
        for k in range(6):
            image.seek(k)
            durations.append(image.info["duration"])
            assert image.convert("RGB").getpixel((1, 1)) == (255, 255, 255)
        drawn = np.asarray(image.convert("RGB")).reshape(-1, 3).tolist()
        assert [235, 235, 235] in drawn and [0, 114, 178] in drawn  # the grid, and an outline
        assert image.info["loop"] == 0
    assert sum(durations) == 200 and set(durations) == {30, 40}
    with pytest.raises(ValueError, match="fps = 60: expected 0.002 to 50 frames per second"):
        dal.plot.animate(run, fps=60).save(file)


def test_the_size_of_frames_does_not_depend_on_the_users_defaults(run, tmp_path):
    film = dal.plot.animate(run, fps=2, seconds=1)
    with matplotlib.rc_context({"savefig.bbox": "tight", "savefig.transparent": True,
                                "savefig.facecolor": "black", "savefig.dpi": 33}):  # fmt: skip
        film.save(tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as image:
        assert image.size == tuple(film.ax.figure.bbox.size)
        assert image.convert("RGB").getpixel((1, 1)) == (255, 255, 255)


@pytest.fixture
def ffmpeg(tmp_path_factory, monkeypatch):
    """One that takes what it is given as it is, so that no program has to be installed."""
    program = tmp_path_factory.mktemp("bin") / "ffmpeg"
    program.write_text('#!/bin/sh\nfor film; do :; done\necho "$@" >"$0.said"\ncat >"$film"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    return program


def test_a_film_that_ffmpeg_did_not_finish_is_none(run, tmp_path, ffmpeg):
    """It says so, and exits with 0."""
    ffmpeg.write_text(ffmpeg.read_text() + "echo no space left on device >&2\n")
    (tmp_path / "a.mp4").write_text("before")
    with pytest.raises(RuntimeError, match="ffmpeg failed: no space left"):
        dal.plot.animate(run, fps=5, seconds=1).save(tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_text() == "before"


@pytest.mark.usefixtures("ffmpeg")
def test_ctrl_c_leaves_what_was_there(run, tmp_path):
    film = dal.plot.animate(run, fps=5, seconds=1)

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    for ending in ("gif", "mp4", "html"):
        file = tmp_path / f"a.{ending}"
        file.write_text("before")
        if ending != "html":
            with pytest.raises(KeyboardInterrupt):
                film.save(file, progress=stop)
            assert file.read_text() == "before"
    assert sorted(x.name for x in tmp_path.iterdir()) == ["a.gif", "a.html", "a.mp4"]


def test_files_that_cannot_be(run, tmp_path):
    film = dal.plot.animate(run, fps=5, seconds=1)
    for name in ("a.avi", "a", "gif", ".gif"):
        with pytest.raises(ValueError, match="expected a name that ends in .gif, .mp4, .html"):
            film.save(tmp_path / name)
    with pytest.raises(OSError, match="there is no folder"):
        film.save(tmp_path / "no" / "a.gif")
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(OSError, match="this is a folder"):
        film.save(tmp_path / "folder.gif")


def test_mp4_is_made_by_ffmpeg(run, tmp_path, monkeypatch, ffmpeg):
    film = dal.plot.animate(run, fps=5, seconds=1)
    film.save(tmp_path / "a.MP4")
    width, height = (int(x) for x in film.ax.figure.bbox.size)
    content = (tmp_path / "a.MP4").read_bytes()
    assert len(content) == 5 * width * height * 4
    assert content[:4] == b"\xff\xff\xff\xff"
    said = Path(f"{ffmpeg}.said").read_text()
    assert f"-s {width}x{height} -framerate 5.0" in said
    ffmpeg.write_text("#!/bin/sh\necho no such codec >&2\nexit 3\n")
    (tmp_path / "a.MP4").write_text("before")
    with pytest.raises(RuntimeError, match="ffmpeg failed: no such codec"):
        film.save(tmp_path / "a.MP4")
    assert (tmp_path / "a.MP4").read_text() == "before"
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    with pytest.raises(RuntimeError, match=r"an .mp4 file needs the program ffmpeg"):
        film.save(tmp_path / "a.mp4")
    assert not (tmp_path / "a.mp4").exists()


# ---- pages ---------------------------------------------------------------------------------------


def data_of(film):
    return json.loads(re.search(r'type="application/json">(.*?)</script>', page_of(film))[1])


def test_a_page_has_the_frames_the_trail_and_the_curves(run, tmp_path):
    film = dal.plot.animate(run, fps=5, seconds=1)
    film.save(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert text == page_of(film)
    assert not re.search(r"https?://|src=|@import", text)
    assert "leapfrog, h = 0.02: 5 frames of 201 states" in text
    data = data_of(film)
    assert data["t"] == pytest.approx(film.t) and len(data["frames"]) == 5
    unit = 4000 / np.ptp(film._scene.limits, axis=0).max()
    for sent, shapes in zip(data["frames"], film._scene.frames):
        assert [data["roles"][x[0]] for x in sent] == [x.role for x in shapes]
        hull = (np.reshape(sent[0][1:], (-1, 2))) / unit + film._scene.limits[0]
        np.testing.assert_allclose(hull, shapes[0].points, atol=0.51 / unit)
    (trail,) = data["trails"]
    assert len(trail) == 2 * (4 * data["each"] + 1)
    energy, residual = data["curves"]
    np.testing.assert_allclose(
        energy["points"], np.column_stack([run.t, run.energy - run.energy[0]]), atol=1e-7
    )
    assert residual["bound"] == pytest.approx(np.log10(dal.core.residual_bound(3)))
    marks = {(axis, text): at for axis, at, text in data["grid"]}
    assert marks[0, "0"] == pytest.approx(-film._scene.limits[0, 0] * unit, abs=0.51)


def test_long_curves_are_thinned_to_what_they_reach(run):
    t = np.arange(100_000.0)
    y = np.sin(t)
    y[77_777] = 9.0
    points = np.array(film_page._curve("E", t, y)["points"])
    assert len(points) <= 400 and points[:, 1].max() == 9.0
    assert [77_777.0, 9.0] in points.tolist()
    assert (np.diff(points[:, 0]) > 0).all()
    holes = film_page._curve("E", t[:3], np.array([1.0, np.nan, 2.0]))["points"]
    assert holes == [[0.0, 1.0], [2.0, 2.0]]


def test_the_page_of_a_forced_run_calls_no_change_of_energy_an_error():
    damped = dal.System(mass=[1, 1], force=lambda t, q, v: -v / 2)
    run = dal.integrate(damped, "leapfrog", [0, 0], [1, 0], h=0.1, steps=5)
    assert data_of(dal.plot.animate(run))["curves"][0]["name"] == "E − E₀, no error here"


def test_a_notebook_shows_the_page_in_a_frame(run, monkeypatch):
    film = dal.plot.animate(run, fps=5, seconds=1)
    text = film._repr_html_()
    assert text.startswith("<iframe srcdoc=") and text.count('"') == 8
    monkeypatch.setattr(animation, "NOTEBOOK", 1000)
    assert "too much for a notebook" in film._repr_html_()
    monkeypatch.setattr(dal.core.extras, "is_there", lambda name: False)
    assert film._repr_html_() is None
