"""Pictures: what is drawn where, and that they read in black and white."""

from __future__ import annotations

import itertools
import sys

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from matplotlib import pyplot  # noqa: E402
from matplotlib.colors import to_hex  # noqa: E402

import dalembert as dal  # noqa: E402

STEPS = (10, 15, 20, 30)
ROUNDOFF = 2.0**-53


@pytest.fixture(autouse=True)
def no_windows(monkeypatch):
    """Nothing is shown, and no figure is left open."""
    monkeypatch.setattr(pyplot, "show", lambda *_, **__: pytest.fail("a picture was shown"))
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def studies():
    return dal.studies(
        dal.systems.particle(), ["midpoint", "explicit", "midpoint-nodes"], steps=STEPS
    )


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
    assert "h" in ax.get_xlabel() and "units" in ax.get_xlabel()
    assert "(q, v) at t = 1" in ax.get_ylabel() and "units" in ax.get_ylabel()
    assert "particle" in ax.get_title()


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
        assert y2 < min(errors)
    np.testing.assert_allclose(sorted(slopes), [1, 2], rtol=1e-12)
    assert {"1", "2"} <= {text.get_text() for text in ax.texts}


@pytest.mark.parametrize(
    "quantity, errors, key, loss",
    [
        ("q", "q_error", "global_q", 0),
        ("v", "v_error", "global_v", 0),
        ("multipliers", "multiplier_error", "global_multipliers", 0),
        ("local", "local_error", "state", 1),
        ("reactions", "local_reaction_error", "reaction", 1),
    ],
)
def test_other_quantities(studies, quantity, errors, key, loss):
    ax = dal.plot.convergence(studies[0], quantity=quantity)
    counted = np.array(studies[0].fits[key].counted)
    assert counted[-3:].all()
    for line, drawn in zip(ax.lines, (counted, ~counted)):  # full markers, and hollow ones
        np.testing.assert_array_equal(line.get_ydata(), getattr(studies[0], errors)[drawn])
    assert texts(ax) == [f"midpoint: {studies[0].fits[key].slope - loss:.2f}"]


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
    okabe_ito = {"#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"}
    assert {style["color"] for style in found.values()} == okabe_ito


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
        """|v_z - (y - shift v_y) v_x| / (|v_z| + |(y - shift v_y) v_x|)."""
        y, (vx, vy, vz) = run.q[:, 1], run.v.T
        other = (y - shift * vy) * vx
        return np.maximum(abs(vz - other) / (abs(vz) + abs(other)), 1e-17)

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
        assert "units" in axis.get_xlabel()
    assert "residual" in left.get_ylabel()
    assert min(map(np.min, [*of.values(), *of_eps.values()])) >= 1e-17


def test_drift_of_a_long_run_shows_the_largest_of_each_stretch():
    run = dal.integrate(
        dal.systems.particle(), "midpoint-nodes", h=0.05, steps=1000, initial="project"
    )
    left, _ = dal.plot.drift(run)
    line = left.lines[0]
    relative = dal.geometry.relative_residual(run.system, run.q, run.v)
    assert len(line.get_xdata()) == 50 and max(line.get_ydata()) == relative.max()
    assert line.get_ydata()[-1] == relative[980:].max() and line.get_xdata()[-1] == run.t[980]


def test_a_start_off_D_eps_is_a_hollow_point():
    run = dal.integrate(dal.systems.particle(), "midpoint-nodes", h=0.05, steps=20, initial="D")
    _, right = dal.plot.drift(run)
    line, start = right.lines[:2]
    assert line.get_xdata()[0] == run.t[1] and max(line.get_ydata()) < 1e-15
    assert list(start.get_xdata()) == [0] and start.get_ydata()[0] > 1e-4


def test_energy_is_relative_on_a_linear_axis(run):
    ax = dal.plot.energy(run)
    assert ax.get_yscale() == "linear"
    E = 0.5 * (run.v**2).sum(axis=1)  # of the particle
    # Energies below 2 from some three terms, divided by a scale of at least 1.
    np.testing.assert_allclose(
        ax.lines[0].get_ydata(), (E - E[0]) / max(E[0], 1), rtol=0, atol=32 * ROUNDOFF
    )
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run.t)
    assert "E_0" in ax.get_ylabel() and "units" in ax.get_xlabel() and texts(ax) == ["midpoint"]


def test_path_has_equal_axes_and_a_start(run):
    ax = dal.plot.path(run, coordinates=(0, 2))
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run.q[:, 0])
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), run.q[:, 2])
    assert (ax.lines[1].get_xdata()[0], ax.lines[1].get_ydata()[0]) == (run.q[0, 0], run.q[0, 2])
    assert ax.get_aspect() == 1 and texts(ax) == ["start"]
    assert ax.get_xlabel().startswith("x ") and ax.get_ylabel().startswith("z ")


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


def test_bad_arguments_are_named(studies, run):
    with pytest.raises(ValueError, match="quantity is 'p'; expected one of state, q, v"):
        dal.plot.convergence(studies, quantity="p")
    with pytest.raises(ValueError, match="study is empty"):
        dal.plot.convergence([])
    with pytest.raises(ValueError, match="solution is empty"):
        dal.plot.energy([])
    with pytest.raises(ValueError, match=r"coordinates is \(0, 3\); expected two of 0 to 2"):
        dal.plot.path(run, coordinates=(0, 3))
    with pytest.raises(ValueError, match="ax has 3 axes; expected two"):
        dal.plot.drift(run, pyplot.subplots(1, 3)[1])
    with pytest.raises(ValueError, match="study is a Solution; expected a dalembert.Study or sev"):
        dal.plot.convergence(run)
    for draw in (dal.plot.energy, dal.plot.drift):
        with pytest.raises(ValueError, match="solution is a str; expected a dalembert.Solution or"):
            draw("x")
        with pytest.raises(ValueError, match="solution is a Study; expected a dalembert.Solution"):
            draw([run, studies[0]])
    with pytest.raises(ValueError, match="solution is a list; expected a dalembert.Solution$"):
        dal.plot.path([run])


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
