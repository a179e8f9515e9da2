"""Pictures: what is drawn where, and that they read in black and white."""

from __future__ import annotations

import itertools
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import refused
from matplotlib import pyplot
from matplotlib.colors import to_hex, to_rgb

import dalembert as dal
from dalembert.show import palette

pytestmark = pytest.mark.usefixtures("no_windows")

ROOT = Path(__file__).resolve().parents[3]
STEPS = (10, 15, 20, 30)
ROUNDOFF = 2.0**-53


@pytest.fixture(scope="module")
def studies():
    return dal.studies(
        dal.systems.particle(), ["midpoint", "explicit", "midpoint-nodes"], steps=STEPS
    )


@pytest.fixture(scope="module")
def rolling():
    """With steps so large that every quantity has a slope of its own."""
    return dal.convergence(dal.systems.sleigh(), "midpoint", steps=(2, 4, 6))


@pytest.fixture(scope="module")
def run():
    return dal.integrate(dal.systems.particle(), "midpoint", h=0.05, steps=40)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_convergence_draws_the_errors_and_says_the_orders(studies):
    ax = dal.plot.convergence(studies)
    assert ax.get_xscale() == ax.get_yscale() == "log"
    for study in studies:
        order = study.fits["global_state"].slope
        (line,) = (x for x in ax.lines if x.get_label() == f"{study.scheme.name}: {order:.2f}")
        np.testing.assert_array_equal(line.get_xdata(), study.h)
        np.testing.assert_array_equal(line.get_ydata(), np.maximum(study.q_error, study.v_error))
    assert ax.get_xlabel() == "step h"
    assert ax.get_ylabel() == "error of (q, v) at t = 1"
    assert ax.get_title() == "particle: convergence"
    assert ax.get_legend().get_title().get_text() == "scheme: fitted order"


def test_steps_backwards_and_several_systems():
    found = [
        dal.convergence(system, "midpoint", t_end=-0.5, steps=STEPS)
        for system in (dal.systems.particle(), dal.systems.heisenberg())
    ]
    ax = dal.plot.convergence(found)
    assert ax.get_title() == "particle, heisenberg: convergence"
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), 0.5 / np.array(STEPS))
    (triangle,) = ax.patches  # one for both, below the lower
    (x0, _), (x1, _), (_, top) = triangle.get_xy()[:3]
    assert 0.5 / 30 < x0 < x1 < 0.5 / 10
    assert top < min(np.interp(x1, abs(s.h[::-1]), s.state_error[::-1]) for s in found)
    # a factor 3 of steps: marks at 1, 2 and 5; a factor of 1000: at 1 only
    assert {0.02, 0.05} <= set(np.round(ax.xaxis.get_major_locator().tick_values(0.01, 0.1), 9))
    wide = dal.plot.convergence(dal.convergence(found[0].system, "midpoint", steps=(2, 999)))
    assert 0.02 not in np.round(wide.xaxis.get_major_locator().tick_values(0.001, 0.5), 9)


def test_triangles_have_the_whole_slopes_and_lie_below_their_curves(studies):
    ax = dal.plot.convergence(studies)
    slopes = []
    for patch in ax.patches:
        (x0, y0), (x1, y1), (x2, y2) = patch.get_xy()[:3]
        assert x1 == x2 and y0 == y1
        slopes.append(np.log(y2 / y1) / np.log(x1 / x0))
        errors = [
            np.exp(np.interp(np.log(x2), np.log(s.h[::-1]), np.log(s.state_error[::-1])))
            for s in studies
            if round(s.fits["global_state"].slope) == round(slopes[-1])
        ]
        # half of the lowest of the curves that have the slope
        np.testing.assert_allclose(y2, min(errors) / 2, rtol=1e-9)
    np.testing.assert_allclose(sorted(slopes), [1, 2], rtol=1e-12)
    assert {"1", "2"} <= {text.get_text() for text in ax.texts}


@pytest.mark.parametrize(
    "quantity, errors, key, loss, label",
    [
        ("q", "q_error", "global_q", 0, "q at t = 1"),
        ("v", "v_error", "global_v", 0, "v at t = 1"),
        ("multipliers", "multiplier_error", "global_multipliers", 0, "lambda at t = 1"),
        ("local", "local_error", "state", 1, "(q, v) after one step"),
        ("reactions", "local_reaction_error", "reaction", 1, "the scheme's multiplier after one s"),
    ],
)
def test_other_quantities(rolling, quantity, errors, key, loss, label):
    ax = dal.plot.convergence(rolling, quantity=quantity)
    counted = np.array(rolling.fits[key].counted)
    assert counted[-3:].all()
    for line, drawn in zip(ax.lines, (counted, ~counted)):  # full markers, and hollow ones
        np.testing.assert_array_equal(line.get_ydata(), getattr(rolling, errors)[drawn])
    orders = {name: f"{fit.slope:.2f}" for name, fit in rolling.fits.items()}
    assert len({orders[name] for name in ("global_q", "global_v", "global_multipliers")}) == 3
    assert texts(ax) == [f"midpoint: {rolling.fits[key].slope - loss:.2f}"]
    assert ax.get_ylabel().startswith(f"error of {label}")


def test_points_that_do_not_count_are_hollow():
    study = dal.convergence(dal.systems.particle(), "leapfrog-kl8", steps=(2, 3, 4, 40, 60))
    below = study.state_error <= 100 * study.floor
    assert below.any() and not below.all()
    ax = dal.plot.convergence(study)
    line, hollow = ax.lines
    np.testing.assert_array_equal(line.get_xdata(), study.h[~below])
    assert to_hex(hollow.get_markerfacecolor()) == "#ffffff"
    np.testing.assert_array_equal(hollow.get_xdata(), study.h[below])


def test_exact_results_are_named_and_drawn_at_the_floor():
    # The momentum v_y of the particle is exact, and so is everything where v_x = 0.
    study = dal.convergence(
        dal.systems.particle(), "midpoint", [0, 0.3, 0], [0, 0.5, 0], steps=STEPS
    )
    ax = dal.plot.convergence(study, quantity="v")
    assert texts(ax) == ["midpoint: exact"]
    line, hollow = ax.lines
    assert len(line.get_xdata()) == 0 and len(hollow.get_xdata()) == len(STEPS)
    assert min(hollow.get_ydata()) >= 1e-17


def test_styles_differ_without_colour():
    names = [f"scheme {i}" for i in range(16)]
    found = dal.plot.styles(names)
    for one, other in itertools.combinations(found.values(), 2):
        assert (one["marker"], one["linestyle"]) != (other["marker"], other["linestyle"])
    assert len({style["color"] for style in found.values()}) == 7
    okabe_ito = {"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"}
    assert {style["color"] for style in found.values()} == okabe_ito


def contrast(one, other):
    """Return the contrast of two colours as WCAG 2 defines it."""

    def luminance(colour):
        rgb = np.array(to_rgb(colour))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722] + 0.05

    low, high = sorted((luminance(one), luminance(other)))
    return high / low


def test_colours_are_readable_on_light_and_on_dark_pages():
    assert contrast("white", "black") == pytest.approx(21)
    assert palette.LIGHT.keys() == palette.DARK.keys()
    for colours in (palette.LIGHT, palette.DARK):
        for name in ("ink", "quiet", "good", "bad", "blue"):
            assert contrast(colours[name], colours["paper"]) > 4.5, name
    for name in palette.LINES:
        assert contrast(palette.DARK[name], palette.DARK["paper"]) > 4.5, name


def test_the_palette_is_the_only_place_of_colours():
    """No file has colours of its own, and style sheets use variables that are defined."""
    found = {}
    for folder in ("benchmarks", "docs/explanation", "examples", "experiments", "python/dalembert"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".css", ".html", ".js"):
                found[path.name] = path.read_text(encoding="utf-8")
    colour = r"#(?:[0-9a-fA-F]{6}|[0-9a-fA-F]{3})\b"
    assert [name for name in found if re.search(colour, found[name])] == ["palette.py"]
    sheets = "".join(text for name, text in found.items() if name.endswith((".css", ".html")))
    own = set(re.findall(r"--([a-z-]+):", sheets)) | {"jp-layout-color", "jp-error-color"}
    used = set(re.findall(r"var\(--([a-z-]+)", sheets)) - {"vscode-editor-background"}
    assert {"ink", "blade", "jp-layout-color"} <= used <= own | palette.LIGHT.keys()


def test_drift_has_both_sets_on_log_axes():
    system = dal.systems.particle()
    moved = dal.integrate(system, "midpoint", h=0.05, steps=40)
    kept = dal.integrate(system, "midpoint-nodes", h=0.05, steps=40, initial="project")
    composed = dal.integrate(system, "leapfrog-suzuki4", h=0.05, steps=40)
    left, right = dal.plot.drift([moved, kept, composed])
    assert left.get_yscale() == right.get_yscale() == "log"
    names = ["midpoint", "midpoint-nodes", "leapfrog-suzuki4"]
    assert texts(right) == names
    of = {name: np.asarray(line.get_ydata()) for name, line in zip(names, left.lines)}
    curves = [line for line in right.lines if len(line.get_xdata()) == 41]
    assert len(curves) == 2  # a composition has no D_eps
    of_eps = {name: np.asarray(line.get_ydata()) for name, line in zip(names, curves)}

    def residual(run, shift):
        """|v_z - node v_x| / ((1 + |node|) max_i |v_i| + |v_x| (|node| + |shift v_y|)).

        node = y - shift v_y; without a shift the last term is not there.
        """
        y, (vx, vy, vz) = run.q[:, 1], run.v.T
        node = y - shift * vy
        size = (1 + abs(node)) * abs(run.v).max(axis=1)
        if shift:
            size += abs(vx) * (abs(node) + abs(shift * vy))
        return np.maximum(abs(vz - node * vx) / size, 1e-17)

    # 2 n u: the residual of three terms, each with its roundoff.
    for found, expected in (
        (of["midpoint"], residual(moved, 0)),
        (of["midpoint-nodes"], residual(kept, 0)),
        (of_eps["midpoint"], residual(moved, 0.025)),
        (of_eps["midpoint-nodes"], residual(kept, 0.025)),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=6 * ROUNDOFF)
    assert of["midpoint"].max() < 1e-15 < 1e-4 < of["midpoint-nodes"].max()
    assert of_eps["midpoint-nodes"].max() < 1e-15 < 1e-4 < of_eps["midpoint"].max()
    for axis in (left, right):
        (dashed,) = (line for line in axis.lines if len(line.get_xdata()) == 2)
        assert list(dashed.get_ydata()) == [ROUNDOFF] * 2 and dashed.get_linestyle() == "--"
        assert axis.get_xlabel() == "time t"
        assert [(text.get_text(), text.xy) for text in axis.texts] == [("u", (1, ROUNDOFF))]
        lowest, highest = axis.get_ylim()  # roundoff looks small, and a zero is seen
        assert lowest <= 1e-17 / 4 and highest >= 1e-8
    assert left.get_ylabel() == "relative residual of the constraint"
    assert left.get_title() == r"$D$:  $\mu(q)\,v = 0$"
    assert right.get_title() == r"$D_\varepsilon$:  $\mu(q - (1-\beta) h v)\,v = 0$"
    assert min(map(np.min, [*of.values(), *of_eps.values()])) >= 1e-17


def test_drift_says_which_constraint():
    """Those that are not linear are no mu(q) v."""
    for system in (dal.systems.ball_on_table(), dal.systems.particle().at_kept_nodes(0.1)):
        run = dal.integrate(system, "midpoint", [0.1] * system.n, system.project(
            [0.1] * system.n, [0.5] * system.n), h=0.01, steps=5)  # fmt: skip
        titles = [axis.get_title() for axis in dal.plot.drift(run)]
        assert titles[0] == r"$D$:  $\varphi(q, v) = 0$"
        assert titles[1] == r"$D_\varepsilon$:  $\varphi(q - (1-\beta) h v, v) = 0$"


def test_drift_of_a_long_run_shows_the_largest_of_each_stretch():
    system = dal.systems.particle_oscillator()
    run = dal.integrate(system, "midpoint-nodes", h=0.05, steps=1000, initial="project")
    left, _ = dal.plot.drift(run)
    line = left.lines[0]
    relative = dal.geometry.relative_residual(run.system, run.q, run.v)
    # 1001 states in 50 stretches: of 20, and one of 21
    starts = [1001 * k // 50 for k in range(50)]
    np.testing.assert_array_equal(line.get_xdata(), run.t[starts])
    largest = [relative[a:b].max() for a, b in zip(starts, [*starts[1:], 1001])]
    np.testing.assert_array_equal(line.get_ydata(), largest)


def test_roundoff_looks_small_and_a_zero_is_seen(run):
    """On axes of its own, where no other curve makes room."""
    _, axes = pyplot.subplots(1, 2)
    left, _ = dal.plot.drift(run, axes)
    lowest, highest = left.get_ylim()
    assert lowest <= 1e-17 / 4 and highest >= 1e-8
    resting = dal.integrate(run.system, "midpoint", [0, 0, 0], [0, 1, 0], h=0.05, steps=4)
    left, _ = dal.plot.drift(resting, pyplot.subplots(1, 2)[1])
    assert set(left.lines[0].get_ydata()) == {1e-17} and left.get_ylim()[0] <= 1e-17 / 4


def test_a_start_off_D_eps_is_a_hollow_point():
    run = dal.integrate(dal.systems.particle(), "midpoint-nodes", h=0.05, steps=20, initial="D")
    _, right = dal.plot.drift(run)
    line, start = right.lines[:2]
    assert line.get_xdata()[0] == run.t[1] and max(line.get_ydata()) < 1e-15
    assert list(start.get_xdata()) == [0] and start.get_ydata()[0] > 1e-4


@pytest.mark.parametrize("height", [-90.0, 0.0, 90.0])
@pytest.mark.parametrize("speed", [1.0, 8.0])
def test_energy_is_relative_on_a_linear_axis(speed, height):
    """The particle under a constant force: E = v.v/2 + z, from -90 to 140."""
    system = dal.System(
        mass=[1, 1, 1],
        mu=lambda q: [[-q[1], 0, 1]],
        mu_v_q=lambda q, v: [[0, -v[0], 0]],
        potential=lambda q: q[2],
        gradient=lambda q: [0, 0, 1],
        name="falling",
    )
    v0 = np.array([1, 0.7, 0.3]) * speed
    run = dal.integrate(system, "midpoint", [0.5, 0.3, height], v0, h=0.05, steps=40)
    ax = dal.plot.energy(run)
    assert ax.get_yscale() == "linear"
    E = 0.5 * (run.v**2).sum(axis=1) + run.q[:, 2]
    expected = (E - E[0]) / max(abs(E[0]), 1)
    # Energies of some four terms, none larger than 200, divided by a scale of at least 1.
    np.testing.assert_allclose(
        ax.lines[0].get_ydata(), expected, rtol=0, atol=200 * 16 * ROUNDOFF / max(abs(E[0]), 1)
    )
    assert np.ptp(expected) > 1e-7
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run.t)
    assert list(ax.lines[1].get_ydata()) == [0, 0]
    assert ax.get_ylabel() == r"energy error  $(E - E_0) / \max(|E_0|, 1)$"
    assert ax.get_xlabel() == "time t" and texts(ax) == ["midpoint"]
    assert ax.get_title() == "falling: energy"


def test_a_dozen_markers_and_a_legend_beside_many_curves():
    system = dal.systems.particle()
    names = ["midpoint", "leapfrog", "explicit", "endpoint", "leapfrog-suzuki4"]
    runs = [dal.integrate(system, name, h=0.05, steps=240) for name in names]
    ax = dal.plot.energy(runs)
    assert {line.get_markevery() for line in ax.lines[:5]} == {241 // 12}
    few = dal.plot.energy(runs[:4])
    assert ax.get_legend().get_bbox_to_anchor().x0 > ax.bbox.x1
    assert few.get_legend().get_bbox_to_anchor().x0 == few.bbox.x0


def test_path_has_equal_axes_and_a_start(run):
    ax = dal.plot.path(run, coordinates=(0, 2))
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run.q[:, 0])
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), run.q[:, 2])
    assert (ax.lines[1].get_xdata()[0], ax.lines[1].get_ydata()[0]) == (run.q[0, 0], run.q[0, 2])
    assert ax.get_aspect() == 1 and texts(ax) == ["start"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x", "z")
    assert ax.get_title() == "particle: path, midpoint, h = 0.05"


def test_axes_that_are_given_are_used(studies, run):
    figure, axes = pyplot.subplots(1, 4)
    before = pyplot.get_fignums()
    assert dal.plot.convergence(studies, axes[0]) is axes[0]
    assert studies.plot(axes[0]) is axes[0] and studies[0].plot(axes[0]) is axes[0]
    assert dal.plot.energy(run, axes[1]) is axes[1]
    assert dal.plot.path(run, axes[1]) is axes[1]
    assert list(dal.plot.drift(run, axes[2:])) == list(axes[2:])
    assert pyplot.get_fignums() == before


def test_styles_of_the_caller_are_used(studies):
    ax = dal.plot.convergence(studies[0], styles={"midpoint": {"color": "black", "marker": "x"}})
    assert ax.lines[0].get_marker() == "x"
    ax = dal.plot.convergence(studies, styles={"explicit": {"color": "red"}})
    assert [line.get_color() for line in ax.lines[::2]] == ["#0072b2", "red", "#009e73"]


def test_bad_arguments_are_named(studies, run):
    draw, (first, *_) = dal.plot, studies
    no_axes = r"ax is a (list|int); expected a matplotlib\.Axes"
    refused([
        (lambda: draw.convergence(studies, quantity="p"), "quantity = 'p': expected one of state"),
        (lambda: draw.convergence([]), "study is empty"),
        (lambda: draw.energy([]), "solution is empty"),
        (lambda: draw.drift(run, pyplot.subplots(1, 3)[1]), "ax has 3 axes: expected two"),
        (lambda: draw.energy(run, []), no_axes),
        (lambda: draw.path(run, []), no_axes),
        (lambda: draw.drift(run, [5, []]), no_axes),
        (lambda: studies.plot(5), no_axes),
        (lambda: draw.convergence(run), "study is a Solution; expected a dalembert.Study or sev"),
        (lambda: draw.path([run]), "solution is a list; expected a dalembert.Solution$"),
        (lambda: draw.energy("x"), "solution is a str; expected a dalembert.Solution or"),
        (lambda: draw.drift("x"), "solution is a str; expected a dalembert.Solution or"),
        (lambda: draw.energy([run, first]), "solution is a Study; expected a dalembert.Solution"),
        (lambda: draw.drift([run, first]), "solution is a Study; expected a dalembert.Solution"),
        *(
            (lambda x=x: draw.path(run, coordinates=x), "coordinates = .*: expected two of 0 to 2")
            for x in ((0, 3), (0, -1), (0,), (0, 1, 2), ("x", "y"), (0, 1.5), 5, None)
        ),
    ])  # fmt: skip


def test_without_matplotlib_the_line_to_type_is_said(studies, run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for draw in (
        lambda: dal.plot.energy(run),
        studies.plot,
        lambda: dal.plot.drift(run),
        lambda: dal.report.write(studies, tmp_path / "report.html"),
    ):
        with pytest.raises(ImportError, match="pip install matplotlib$"):
            draw()
