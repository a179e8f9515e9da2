"""Studies: against the exact particle and a closed form of the scheme in NumPy."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import re
import signal
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from conftest import Page

import dalembert as dal
from dalembert.core import extras
from dalembert.show import table
from dalembert.study import refinement

Q0, V0 = np.array([0.5, 0.3, -0.2]), np.array([1.0, 0.7, 0.3])
STEPS = (10, 15, 20, 30, 40)
U = 2.0**-53


def exact_particle(t, q, v):
    """State of the particle a time t after (q, v): w = v_y, c = v_x sqrt(1 + y^2) are constant."""
    (x, y, z), (vx, w, _) = q, v
    y1 = y + w * t
    s, s1 = np.hypot(1, y), np.hypot(1, y1)
    c = vx * s
    return (
        np.array([x + c / w * (np.arcsinh(y1) - np.arcsinh(y)), y1, z + c / w * (s1 - s)]),
        np.array([c / s1, w, y1 * c / s1]),
    )


def midpoint_particle(t, steps, q, v):
    """The midpoint scheme with moved nodes, solved by hand: v_y' = v_y and v' in D."""
    h = t / steps
    for _ in range(steps):
        y, w = q[1], v[1]
        yk, y1 = y + h / 2 * w, y + h * w
        vx = v[0] * (1 + y * yk) / (1 + y1 * yk)
        new = np.array([vx, w, y1 * vx])
        q, v = q + h / 2 * (v + new), new
    return q, v


def multiplier(q, v):
    return v[0] * v[1] / (1 + q[1] ** 2)


@pytest.fixture(scope="module")
def midpoint():
    return dal.convergence(dal.systems.particle(), "midpoint", Q0, V0, t_end=1, steps=STEPS)


def test_errors_are_those_of_the_scheme_solved_by_hand(midpoint):
    q, v = exact_particle(1, Q0, V0)
    # Both sides carry the roundoff of at most 40 steps, each of some u times states below 2.
    noise = 64 * max(STEPS) * U
    for i, steps in enumerate(STEPS):
        qs, vs = midpoint_particle(1, steps, Q0, V0)
        assert midpoint.h[i] == 1 / steps
        assert midpoint.q_error[i] == pytest.approx(np.abs(qs - q).max(), rel=0, abs=noise)
        assert midpoint.v_error[i] == pytest.approx(np.abs(vs - v).max(), rel=0, abs=noise)
        assert midpoint.multiplier_error[i] == pytest.approx(
            abs(multiplier(qs, vs) - multiplier(q, v)), rel=0, abs=noise
        )
        q1, v1 = exact_particle(1 / steps, Q0, V0)
        qs, vs = midpoint_particle(1 / steps, 1, Q0, V0)
        assert midpoint.local_error[i] == pytest.approx(
            max(np.abs(qs - q1).max(), np.abs(vs - v1).max()), rel=0, abs=noise
        )


def test_fits_are_least_squares_lines(midpoint):
    # The two computations differ by roundoff of sums of a few logarithms below 20.
    for key, errors in (
        ("global_state", midpoint.state_error),
        ("global_q", midpoint.q_error),
        ("global_v", midpoint.v_error),
        ("global_multipliers", midpoint.multiplier_error),
        ("state", midpoint.local_error),
        ("multipliers", midpoint.local_multiplier_error),
        ("midpoint", midpoint.local_midpoint_error),
    ):
        assert (errors > 100 * midpoint.floor).all()
        slope = np.polyfit(np.log(midpoint.h), np.log(errors), 1)[0]
        assert midpoint.fits[key].slope == pytest.approx(slope, abs=1e-10)
        assert midpoint.fits[key].points == len(STEPS)
    # The reactions, with their h^2 term at any order, over the finer half of the steps.
    slope = np.polyfit(np.log(midpoint.h[2:]), np.log(midpoint.local_reaction_error[2:]), 1)[0]
    assert midpoint.fits["reaction"].slope == pytest.approx(slope, abs=1e-10)
    assert midpoint.fits["reaction"].points == 3
    assert midpoint.p == midpoint.fits["state"].slope - 1
    assert midpoint.s == midpoint.fits["reaction"].slope - 1


FINE_STEPS = (50, 100, 200, 400, 800, 1600, 3200, 6400, 12800)


def test_one_order_everywhere():
    """The fine runs end in roundoff, which counts nowhere: in words, tables, pictures, numbers."""
    study = dal.convergence(
        dal.systems.particle(), "leapfrog-suzuki4", t_end=2, steps=FINE_STEPS
    )
    fit = study.fits["global_state"]
    at_end = re.search(r"order (\S+) at t_end", study.text)[1]
    assert at_end == "4.00" and fit.points == 3
    assert {key: sum(fit.counted) for key, fit in study.fits.items()} == {
        key: fit.points for key, fit in study.fits.items()
    }
    assert study.fits["reaction"].points == 4  # the finer half
    overview = table.overview(dal.study.Studies([study]))
    row = dict(zip(overview.titles, overview.rows[0]))
    assert row["at end"] == at_end
    html = dal.study.Studies([study])._repr_html_()
    assert f"<td>{at_end}</td>" in html
    ax = dal.plot.convergence(study)
    (label,) = (text.get_text() for text in ax.get_legend().get_texts())
    assert label == f"leapfrog-suzuki4: {at_end}"
    line, hollow = ax.lines
    np.testing.assert_array_equal(line.get_ydata(), study.state_error[:3])
    np.testing.assert_array_equal(hollow.get_ydata(), study.state_error[3:])
    told = study.to_dict()["fits"]["global_state"]
    assert told["slope"] == fit.slope and list(told["counted"]) == [True] * 3 + [False] * 6
    assert np.isfinite(study.q_orders[1:3]).all() and np.isnan(study.q_orders[3:]).all()


def test_exact_to_roundoff_is_a_verdict():
    straight = dal.System(mass=[1.0, 1.0], q0=[0, 0], v0=[1, 1])
    study = dal.convergence(straight, "leapfrog", steps=STEPS)
    assert study.holds is True and study.verdict == "exact"
    assert study.text == (
        "Exact to roundoff. Order (p, s) = (exact, exact) over 0 points, promised (2, 0), "
        "order exact at t_end."
    )
    disk = dal.convergence(dal.systems.disk(), "midpoint", steps=STEPS)  # v is, q is not
    assert disk.fits["global_v"].exact and disk.verdict == "holds"


def particle_with(potential):
    x, y, z = dal.coordinates("x y z")
    kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
    return dal.System.from_sympy(kinetic - potential(x, y, z), [z.d - y * x.d], (x, y, z))


def half_line(x, y, z):
    return 50 * sp.Max(0, x - sp.Rational(1, 2)) ** 2


@pytest.mark.parametrize(
    "potential, scheme, order_at_end",
    [
        (lambda x, y, z: abs(x - sp.Rational(1, 2)), "leapfrog-suzuki4", 1),
        (half_line, "leapfrog-suzuki4", 2),
    ],
)
def test_an_order_that_is_lost_on_the_way_is_not_settled(potential, scheme, order_at_end):
    study = dal.convergence(particle_with(potential), scheme, [0, 1, 0], [1, 1, 1], t_end=1)
    assert abs(study.p - study.scheme.order) < 0.2
    assert abs(study.fits["global_state"].slope - order_at_end) < 0.2
    assert study.holds is None and study.verdict == "undecided"
    assert "errors at t_end do not have the order of one step" in study.text
    assert dal.convergence(particle_with(potential), scheme, [0, 1, 0], [1, 1, 1], t_end=0.4).holds


@pytest.mark.parametrize(
    "potential, scheme, given",
    [
        *((lambda x, y, z: 10**6 * x**2 / 2, name, {"q0": [0.1, 1, 0], "v0": [1, 1, 1]})
          for name in ("explicit", "leapfrog-kl6")),
        *((lambda x, y, z: -1 / sp.sqrt(x**2 + y**2 + z**2), name,
           {"q0": [0, 0.05, 0], "v0": [1, 0.1, 0.05]}) for name in ("leapfrog", "leapfrog-kl6")),
        (None, "leapfrog-suzuki4", {"q0": [0, 1e-3, 0], "v0": [1e3, 1e3, 1]}),
        (None, "midpoint", {"t_end": 1e4, "steps": [1, 2, 4, 8]}),
    ],
)  # fmt: skip
def test_runs_that_do_not_resolve_the_motion_settle_nothing(potential, scheme, given):
    system = particle_with(potential) if potential else dal.systems.particle()
    study = dal.convergence(system, scheme, **given)
    assert study.holds is None and "as large as the solution" in study.text
    assert "gradient" not in study.text  # the energy has every reason


def test_an_order_that_still_changes_is_not_settled():
    study = dal.convergence(dal.systems.particle(), "midpoint", steps=[1, 2, 3])
    assert study.holds is None and "order still changes with h" in study.text  # s = -0.23
    e = sp.exp
    x, y, z = dal.coordinates("x y z")
    system = dal.System.from_sympy(
        (1.26 * x.d**2 + 2.01 * y.d**2 + 0.36 * z.d**2 - 2.74 * x**2 - 0.82 * y**2 - 1.48 * z**2)
        / 2,
        [(1 + 0.46 * e(-0.187 * (x - 0.46) ** 2)) * x.d + 0.76 * e(-1.647 * (y - 0.76) ** 2) * z.d],
    )
    q0 = [-0.1, 1.7, 1.2]
    v0 = system.project(q0, [0.3, -1.5, -2.8])
    coarse = dal.convergence(system, "leapfrog", q0, v0, t_end=100, steps=[800, 1000, 1200, 1600])
    assert coarse.s < -0.2 and coarse.holds is None and "order still changes" in coarse.text
    assert dal.convergence(system, "leapfrog", q0, v0, steps=[80, 160, 320]).holds is True


@pytest.mark.parametrize("t_end", [1e-8, 1e-6, 1e-3, 1])
@pytest.mark.parametrize("order", [2, 4])
def test_no_false_promise_holds_over_a_short_interval(t_end, order):
    first = dal.Scheme([(0.0, 1.0)], name="first", order=order)
    study = dal.convergence(dal.systems.particle(), first, t_end=t_end)
    assert study.holds is False if t_end >= 1e-3 else not study.holds, study.text
    second = dal.Scheme([(0.5, 1.0)], name="second", order=4)
    assert not dal.convergence(dal.systems.particle(), second, t_end=t_end).holds


def test_steps_of_roundoff_tell_no_order():
    study = dal.convergence(
        dal.systems.n_trailer(), "leapfrog", steps=[40_000, 80_000, 160_000], max_steps=10**6
    )
    assert study.fits["state"].points == 0
    assert study.verdict == "not measurable" and "take larger h" in study.text
    assert study.holds is None and study.measurable is study.to_dict()["measurable"] is False


def test_an_order_that_roundoff_hides_is_not_measurable():
    particle = dal.systems.particle_oscillator()
    high = dal.Scheme.find("leapfrog-ss10")
    studies = dal.studies(particle, [high, "leapfrog"], t_end=1)
    assert [study.verdict for study in studies] == ["not measurable", "holds"]
    assert studies[0].text.startswith("Not measurable in double") and studies.holds is True
    assert studies.sentence().endswith(" is not measurable in double precision.")
    assert studies[:1].holds is None and "not measurable" in studies[:1].sentence()
    # A reference that is not accurate enough hides it as well, but not in double.
    rough = dal.convergence(dal.systems.chaotic(), high, t_end=1, tolerance=1e-6)
    assert rough.measurable and "take a smaller tolerance" in rough.text


def test_steps_between_those_too_large_and_roundoff_are_counted():
    wide, fine = [3, 5, 400, 800, 1200], [10, 15, 20, 30, 40]
    contact = dal.systems.contact_oscillator()
    few, many = (dal.convergence(contact, "leapfrog-kl8", t_end=10, steps=steps)
                 for steps in (wide, sorted(wide + fine)))  # fmt: skip
    assert few.state_error[0] > 10 and few.state_error[-1] < 1e-13
    assert few.verdict == "not measurable" and "fewer than three errors" in few.text
    assert many.verdict == "undecided" and "as large as the solution" in many.text


SOME = ("knife_edge", "heisenberg", "rolling_disc", "n_trailer")


@pytest.mark.parametrize("system", SOME)
@pytest.mark.parametrize(
    "base, order", [("leapfrog-kl8", 10), ("leapfrog-suzuki4", 10), ("bm6", 8)]
)
def test_roundoff_hides_no_lower_order(system, base, order):
    claim = dal.Scheme(dal.Scheme.find(base).substeps, name="claim", order=order)
    assert dal.convergence(dal.systems.get(system), claim).holds is False


def test_a_study_where_every_run_fails_says_why():
    system = dal.System(
        mass=[1.0, 1.0], mu=lambda q: [[np.nan if q[0] > 0.01 else 1.0, -1.0]],
        q0=[0, 0], v0=[1, 1], mu_v_q=lambda q, v: [[0, 0]],
    )  # fmt: skip
    with pytest.raises(dal.DomainError):
        dal.convergence(system, "leapfrog", steps=[1, 2, 4])
    blade = dal.convergence(
        dal.systems.particle(), "endpoint", [0, -1, 0], [1, 1, -1], t_end=2, steps=[1]
    )
    assert blade.holds is None and "; 1 of 1 runs failed (" in blade.text
    assert "singular" in blade.text and "violated" not in blade.text


def test_a_gradient_of_something_else_is_told_by_the_energy():
    def system(slope):
        return dal.System(
            mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]],
            potential=lambda q: np.cos(q[0]) + q[2] ** 2,
            gradient=lambda q: [-np.sin(q[0]), 0, slope * q[2]],
        )  # fmt: skip

    wrong = dal.convergence(system(1), "leapfrog", [0, 1, 0], [1, 1, 1])
    assert "gradient may not belong to potential, see check" in wrong.text
    right = dal.convergence(system(2), "leapfrog", [0, 1, 0], [1, 1, 1])
    assert right.holds is True and "gradient" not in right.text
    for name in ("midpoint-nodes", "explicit"):
        start = "D_eps" if name.endswith("nodes") else None
        study = dal.convergence(system(2), name, [0, 1, 0], [1, 1, 1], initial=start)
        assert study.holds is True and "gradient" not in study.text


class Alarm(Exception):
    pass


@contextlib.contextmanager
def alarm(seconds):
    """Raise Alarm after some time as Ctrl-C raises KeyboardInterrupt; it has to come at once."""
    rang = []

    def ring(*_):
        rang.append(time.perf_counter())
        raise Alarm

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    start = time.perf_counter()
    try:
        with pytest.raises(Alarm) as caught:
            yield caught
        # It takes 0.05 s where nothing else runs.
        assert time.perf_counter() - start < seconds + 5
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_ctrl_c_ends_a_study():
    particle = dal.systems.particle()
    for call in (
        lambda: dal.convergence(particle, "leapfrog", steps=[10**8]),
        lambda: dal.convergence(particle, "leapfrog-kl8", t_end=1e5),
        lambda: dal.convergence(dal.systems.chaotic(), "leapfrog", t_end=1e6, steps=[10]),
        lambda: dal.convergence(dal.systems.n_trailer(trailers=50), "leapfrog", steps=[10**6]),
    ):
        with alarm(0.2):
            call()


def test_what_was_finished_is_not_lost():
    def stop(done, total):
        if done > 2.5:
            raise Alarm

    with pytest.raises(Alarm) as caught:
        dal.studies(
            dal.systems.particle(), ["explicit", "midpoint", "leapfrog"], steps=STEPS, progress=stop
        )
    assert [x.scheme.name for x in caught.value.partial] == ["midpoint", "leapfrog"]


def test_progress_is_in_steps():
    told = []
    dal.convergence(
        dal.systems.particle(), "leapfrog", steps=[100_000, 200_000],
        progress=lambda *x: told.append(x),
    )  # fmt: skip
    assert told == sorted(told) and told[-1] == (300_000, 300_000)
    assert all(total == 300_000 for _, total in told) and len(told) > 1


def test_more_steps_are_to_be_had_when_they_are_asked_for():
    with pytest.raises(ValueError, match="max_steps=115"):
        dal.convergence(dal.systems.particle(), "midpoint", steps=STEPS, max_steps=114)
    assert dal.convergence(dal.systems.particle(), "midpoint", steps=STEPS, max_steps=115).holds
    both = ["midpoint", "leapfrog"]
    with pytest.raises(ValueError, match="max_steps=230"):
        dal.studies(dal.systems.particle(), both, steps=STEPS, max_steps=229)
    assert dal.studies(dal.systems.particle(), both, steps=STEPS, max_steps=230).holds


@pytest.mark.parametrize(
    "schemes, t_end", [(["leapfrog-kl8"], 1), (["midpoint", "leapfrog-kl6"], 7.5)]
)
def test_what_is_said_to_go_on_is_enough(schemes, t_end):
    def study(max_steps):
        return dal.studies(dal.systems.particle(), schemes, t_end=t_end, max_steps=max_steps)

    with pytest.raises(ValueError) as caught:
        study(100)
    enough = int(re.search(r"max_steps=(\d+)", str(caught.value))[1])
    assert study(enough).holds
    with pytest.raises(ValueError, match=f"max_steps={enough}"):
        study(enough - 1)


def test_widths_and_axes_that_are_none(midpoint):
    for width in (float("nan"), float("inf"), 0, -5, "wide", 60.5, None):
        for item in (midpoint, dal.study.Studies([midpoint])):
            with pytest.raises(ValueError, match="^width = "):
                item.table(width=width)
    for ax in (..., 3, "axes", [1]):
        with pytest.raises(ValueError, match="^ax is "):
            midpoint.plot(ax=ax)


def test_local_orders_are_those_between_neighbours(midpoint):
    e, h = midpoint.q_error, midpoint.h
    assert np.isnan(midpoint.q_orders[0])
    for i in range(1, len(STEPS)):
        assert midpoint.q_orders[i] == pytest.approx(
            np.log(e[i - 1] / e[i]) / np.log(h[i - 1] / h[i]), rel=1e-12
        )
    assert (abs(midpoint.v_orders[1:] - 2) < 0.2).all()
    assert (abs(midpoint.multiplier_orders[1:] - 2) < 0.2).all()


def test_what_midpoint_promises_holds(midpoint):
    assert midpoint.holds is True
    assert midpoint.verdict == "holds"
    assert midpoint.keeps == "D" and midpoint.keeps_D and not midpoint.keeps_D_eps
    assert midpoint.reference == 0  # the particle carries its exact solution
    assert (midpoint.residual <= 4 * 3 * U).all()
    assert (midpoint.residual_eps > 1e-4).all()  # h/2 v_x v_y does not vanish
    assert (midpoint.failed == 0).all()


def test_kept_nodes_keep_the_other_set_and_lose_an_order():
    study = dal.convergence(
        dal.systems.particle(), "midpoint-nodes", Q0, V0, steps=STEPS, initial="D_eps"
    )
    assert study.keeps == "D_eps" and study.holds is True
    assert round(study.p) == 1 and round(study.fits["global_state"].slope) == 1
    np.testing.assert_array_equal(study.state_error, np.maximum(study.q_error, study.v_error))


@pytest.mark.parametrize(
    "scheme, steps, holds, verdict",
    [
        (dal.Scheme([(0.5, 1.0)], name="claims-3", order=3, multiplier_order=0), STEPS, False,
         "fails"),
        (dal.Scheme([(0.5, 1.0)], name="claims-s", order=2, multiplier_order=1), STEPS, False,
         "fails"),
        (dal.Scheme([(0.3, 1.0)]), STEPS, None, "no promise"),
        (0.3, STEPS, True, "holds"),  # beta by number is a named record
        ("midpoint", (10, 11), None, "undecided"),
    ],
)  # fmt: skip
def test_verdicts_on_promises(scheme, steps, holds, verdict):
    study = dal.convergence(dal.systems.particle(), scheme, Q0, V0, steps=steps)
    assert study.holds is holds and study.verdict == verdict
    promise = {"claims-3": "promised (3, 0)", "claims-s": "promised (2, 1)"}
    assert promise.get(study.scheme.name, "") in study.text
    assert (study.promise == "nothing") == (verdict == "no promise")


def test_a_run_that_fails_is_an_entry_and_not_the_end():
    # y = -1, h v_y = 2: S = 1 + y y' = 0 exactly for beta = 1 (the first of these steps only).
    study = dal.convergence(
        dal.systems.particle(), "endpoint", [0, -1, 0], [1, 1, -1], t_end=2, steps=(1, 40, 60, 80)
    )
    assert study.failed[0] < 0 and np.isnan(study.q_error[0])
    assert (study.failed[1:] == 0).all() and np.isfinite(study.q_error[1:]).all()
    assert "-" in str(study) and study.to_dict()["q_error"][0] is None


@pytest.mark.parametrize(
    "name, t_end",
    [
        ("explicit", 1.0), ("midpoint", -1.0), ("leapfrog-yoshida4", 5.0), ("midpoint-kl6", -1.0),
        ("leapfrog-kl8", 1.0),
    ],
)  # fmt: skip
def test_default_steps_tell_the_order(name, t_end):
    study = dal.convergence(dal.systems.knife_edge(), name, t_end=t_end)
    clear = study.local_error > 100 * study.floor
    assert clear.sum() >= 3 and study.h[clear][0] / study.h[clear][-1] >= 2
    assert any(int(steps) & (int(steps) - 1) for steps in study.steps)
    assert list(study.steps) == sorted(set(study.steps)) and study.holds is True


@pytest.mark.parametrize(
    "above, window",
    [
        (48, [24, 28, 30, 32, 36, 40, 42, 48]),
        (7, [3, 4, 5, 6, 7]),
        (3, [1, 2, 3]),
        (2, [1, 2]),
        (0, [3, 6, 9]),
    ],
)
def test_default_steps_are_the_finest_above_the_floor(above, window):
    # The errors of steps longer than 3.2 / above are clear of the floor.
    asked = []

    def probe(duration, steps):
        asked.append(duration)
        return SimpleNamespace(
            steps=np.array(steps),
            h=3.2 / np.array(steps),
            floor=1e-15,
            local_error=np.array([1.1e-13 if count <= above else 0.9e-13 for count in steps]),
        )

    steps = refinement._default_steps(6, 3.2, probe)
    assert steps == [*window, *(3 * count for count in refinement.FINE)]
    assert asked == [3.2]


def test_the_default_steps_are_fine_enough_for_reactions_that_change_sign():
    # c1 h + c2 h^2 has a zero near h = 0.05 here: coarser steps say s = -0.2 and less.
    studies = dal.studies(dal.systems.chaotic())  # order 10 too
    assert {study.verdict for study in studies} == {"holds"}
    errors = dal.convergence(
        dal.systems.chaotic(), "leapfrog-kl6", steps=(10, 12, 14, 16, 20)
    ).local_reaction_error
    assert np.abs(np.diff(np.log(errors))).max() > 0.5


@pytest.mark.parametrize("system", SOME)
def test_every_named_scheme_has_a_verdict_with_the_default_steps(system):
    studies = dal.studies(dal.systems.get(system))
    promised = [scheme.name for scheme in dal.schemes() if scheme.order > 0]
    assert [study.scheme.name for study in studies] == promised
    # The errors of orders 8 and 10 can reach roundoff before they are a power of h.
    for study in studies:
        hidden = study.verdict == "not measurable" and study.scheme.order >= 8
        assert study.verdict == "holds" or hidden, study.text
    assert studies.holds is True
    assert {study.initial for study in studies if study.scheme.nodes == "kept"} == {"D_eps"}
    assert {study.initial for study in studies if study.scheme.nodes == "moved"} == {None}


def test_small_errors_take_a_longer_interval_unless_one_is_given():
    # One step of h = 1 is the only one whose error, 2e-10, is clear of roundoff.
    disk = dal.systems.disk()
    over_one = dal.convergence(disk, "leapfrog-kl8", t_end=1)
    assert over_one.verdict == "not measurable" and "a longer interval" in flat(str(over_one))
    for t_end in (2, 4, -4, 30):
        study = dal.convergence(disk, "leapfrog-kl8", t_end=t_end)
        assert study.holds is True and study.fits["state"].points >= 3
    assert dal.convergence(disk, "leapfrog-kl8", t0=3).t_end == 5
    assert dal.convergence(disk, "leapfrog").t_end == 1
    assert {study.t_end for study in dal.studies(disk, ["leapfrog", "leapfrog-kl8"])} == {2}
    straight = dal.System(mass=[1.0, 1.0], q0=[0, 0], v0=[1, 1])  # every scheme is exact
    assert dal.convergence(straight, "leapfrog-kl8").t_end == 1


def test_the_promise_is_that_for_the_start():
    particle = dal.systems.particle()
    for name, start, promise in (
        ("midpoint-nodes", "D", (0, -1)),
        ("midpoint-nodes", "D_eps", (1, 0)),
        ("endpoint-nodes", "D", (1, 0)),  # beta = 1: D_eps is D
        ("midpoint", None, (2, 0)),
    ):
        study = dal.convergence(particle, name, Q0, V0, steps=STEPS, initial=start)
        assert study.promised == promise and f"promised {promise}" in study.text
        assert study.to_dict()["promised"] == {"p": promise[0], "s": promise[1]}
        assert study.holds is True and (round(study.p), round(study.s)) == promise
    overview = table.overview(dal.study.Studies([study]))
    row = dict(zip(overview.titles, overview.rows[0]))
    assert row["promised"] == "(2, 0)"
    assert row["at end"] == f"{study.fits['global_state'].slope:.2f}"


def test_orders_have_no_negative_zero():
    study = dal.convergence(
        dal.systems.particle(), "midpoint-nodes", Q0, V0, steps=STEPS, initial="D_eps"
    )
    assert "s = -0.00" not in repr(dataclasses.replace(study, s=-1e-3))
    assert table.order(-1e-3) == "0.00"


def test_a_collection_is_a_sequence_and_fails_with_its_worst():
    claim = dal.Scheme([(0.5, 1.0)], name="claims-3", order=3)
    studies = dal.studies(dal.systems.particle(), ["midpoint", claim, 0.25], Q0, V0, steps=STEPS)
    assert len(studies) == 3 and studies[1].scheme is claim and len(studies[:2]) == 2
    assert studies.holds is False
    assert "claims-3" in studies.sentence() and studies.sentence() in flat(str(studies))
    assert studies[:1].holds is True and dal.study.Studies([]).holds is None
    own = dal.studies(dal.systems.particle(), [dal.Scheme([(0.3, 1.0)])], Q0, V0, steps=STEPS)
    assert own.holds is None and "no verdict on own" in own.sentence()


def flat(text):
    return " ".join(text.split())


def test_one_scheme_is_a_collection_of_one_and_progress_is_told():
    told = []
    studies = dal.studies(
        dal.systems.particle(), "midpoint", Q0, V0, steps=STEPS, progress=lambda *x: told.append(x)
    )
    assert [study.scheme.name for study in studies] == ["midpoint"]
    assert told == sorted(told) and told[-1] == (1, 1) and {total for _, total in told} == {1}
    with pytest.raises(ValueError, match="progress = 3"):
        dal.studies(dal.systems.particle(), "midpoint", steps=STEPS, progress=3)


def test_a_system_of_the_users_own_is_measured_against_the_flow():
    own = dal.System(
        mass=[1, 1, 1],
        mu=lambda q: [[-q[1], 0, 1]],
        mu_v_q=lambda q, v: [[0, -v[0], 0]],
        q0=Q0,
        v0=V0,
    )
    study = dal.convergence(own, "midpoint", steps=(10, 15, 20))
    assert study.reference > 0 and study.holds is True
    with_exact = dal.convergence(dal.systems.particle(), "midpoint", Q0, V0, steps=(10, 15, 20))
    # The references differ by the accuracy of the flow, the runs not at all.
    np.testing.assert_allclose(
        study.q_error, with_exact.q_error, rtol=0, atol=10 * study.reference + 64 * U
    )


def test_the_table_is_complete_and_fits(midpoint):
    text = str(midpoint)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[0] == "midpoint on particle, t = 0 to 1"
    assert len([line for line in lines if line.split()[0] in ("0.1", "0.06667", "0.05")]) == 3
    first = next(line for line in lines if line.split()[0] == "0.1").split()
    assert first[1] == f"{midpoint.q_error[0]:.1e}"
    assert first[3] == f"{midpoint.v_error[0]:.1e}"
    assert flat(text).startswith(f"{lines[0]} {midpoint.text} h q error")
    assert "p over 5 points, s over 3 points" in flat(text)


def test_several_studies_begin_with_the_verdict_and_the_overview():
    studies = dal.studies(dal.systems.particle(), ["midpoint", "endpoint"], Q0, V0, steps=STEPS)
    lines = str(studies).splitlines()
    assert lines[0] == studies.sentence() and lines[1].split()[:2] == ["scheme", "verdict"]
    assert [line.split()[-1] for line in lines[2:4]] == ["D", "both"]
    assert lines[4:6] == ["", "midpoint on particle, t = 0 to 1"]


@pytest.mark.parametrize("width", [24, 37, 38, 39, 40, 60, 79])
def test_every_cell_is_seen_on_a_narrow_terminal(midpoint, width):
    wide, narrow = (
        table.text(table.of_study(midpoint).lines(x)).splitlines() for x in (100, width)
    )
    assert max(map(len, narrow)) <= width
    assert {*" ".join(wide).split()} == {*" ".join(narrow).split()}


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_show_is_rich_on_a_terminal_and_plain_elsewhere(midpoint, monkeypatch):
    plain = io.StringIO()
    midpoint.show(plain)
    assert plain.getvalue() == str(midpoint) + "\n"

    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "100")
    terminal = Terminal()
    midpoint.show(terminal)
    assert "\x1b[" in terminal.getvalue() and f"{midpoint.q_error[0]:.1e}" in terminal.getvalue()

    monkeypatch.setitem(sys.modules, "rich.console", None)
    bare = Terminal()
    midpoint.show(bare)
    assert bare.getvalue() == plain.getvalue()


def test_to_dict_is_json_without_nan(midpoint):
    kl8 = dal.convergence(dal.systems.particle(), "leapfrog-kl8", Q0, V0)
    assert np.isnan(kl8.residual_eps).all()
    back = json.loads(json.dumps(kl8.to_dict(), allow_nan=False))
    assert back["residual_eps"] == [None] * len(kl8.h) and back["q_orders"][0] is None
    assert back["scheme"] == "leapfrog-kl8" and back["holds"] is True
    assert back["promised"] == {"p": 8, "s": kl8.scheme.multiplier_order}
    assert json.loads(json.dumps(midpoint.to_dict()))["q_error"] == midpoint.q_error.tolist()


def test_html_representation_has_the_table(midpoint, monkeypatch):
    """And what the plain text has; the plain text stands alone where Jinja2 is not installed."""
    page = Page(midpoint._repr_html_())
    assert page.rows[1][1].split()[0] == f"{midpoint.q_error[0]:.1e}"
    words = [*page.words.split()]
    assert sorted(words) == sorted(str(midpoint).split())
    monkeypatch.setattr(extras, "is_there", lambda name: name != "jinja2")
    assert midpoint._repr_html_() is None


@pytest.mark.parametrize(
    "wrong, message",
    [
        (dict(scheme="trapezoid"), "trapezoid"),
        (dict(steps=()), "steps is empty"),
        (dict(steps=(10, 0)), r"steps\[1\] = 0"),
        (dict(steps=(10, 1.5)), r"steps\[1\] = 1.5"),
        (dict(steps=10), "steps = 10: expected several"),
        (dict(steps=(10, True)), r"steps\[1\] = True: expected an integer"),
        (dict(steps=(10, "20")), r"steps\[1\] = '20': expected an integer"),
        (dict(steps=(10, 10**30)), rf"steps\[1\] = {10**30}: expected at most"),
        (dict(steps=(10, 20, 10)), r"steps\[2\] = 10: steps\[0\] has the same value"),
        (dict(steps=[1] * 100_000), r"steps\[1\] = 1: steps\[0\] has the same value"),
        (dict(steps=(10, 991), max_steps=1000), "1001 steps in total.*max_steps=1001"),
        (dict(t_end=1e9), "2040000000000 steps in total.*--max-steps 2040000000000"),
        (dict(t_end=1e300, scheme="leapfrog-kl8"), f"in total, more than max_steps = {10**9}"),
        (dict(t0=-1e308, t_end=1e308), "t_end - t0 = inf: expected a finite interval"),
        (dict(max_steps=0), "max_steps = 0: expected at least 1"),
        (dict(progress=3), "progress = 3"),
        (dict(system="particle"), "system = 'particle': expected a dalembert.System"),
        (dict(scheme=[]), r"scheme = \[\]: expected a Scheme, the name of a scheme"),
        (dict(t_end=0.0), "t_end"),
        (dict(t_end=np.nan), "t_end"),
        *(
            (dict(system=dal.systems.chaotic(), tolerance=x), r"tolerance = .*: expected a number")
            for x in (-1.0, 0, 1e-300, 4.4e-16, 0.2)
        ),
        (dict(q0=[1, 2]), "q0"),
        (dict(initial="D"), "initial = 'D'.*moved nodes"),
        (dict(scheme="midpoint-nodes"), "initial is missing.*'D_eps'"),
        (dict(scheme="midpoint-nodes", initial="E"), "initial = 'E': expected one of 'D', 'D_eps'"),
    ],
)
def test_bad_arguments_are_named(wrong, message):
    given = {"system": dal.systems.particle(), "scheme": "midpoint", **wrong}
    with pytest.raises(ValueError, match=message):
        dal.convergence(**given)


def test_data_off_D_and_missing_data_are_refused():
    with pytest.raises(dal.NotOnConstraintError, match="^the initial velocity violates"):
        dal.convergence(dal.systems.particle(), "midpoint", [0, 1, 0], [1, 1, 0])
    with pytest.raises(ValueError, match="q0"):
        dal.convergence(dal.System(mass=[1.0]), "midpoint")


def test_an_exception_of_the_users_own_comes_back():
    class Broken(Exception):
        pass

    calls = []

    def forms(q):
        calls.append(q)
        if len(calls) > 200:
            raise Broken("at call 201")
        return [[-q[1], 0, 1]]

    own = dal.System(mass=[1, 1, 1], mu=forms, q0=Q0, v0=V0)
    with pytest.raises(Broken, match="at call 201"):
        dal.convergence(own, "midpoint")
