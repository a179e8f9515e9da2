"""What a run says of itself: where constraints lose rank, where it no longer advances."""

import signal
import time
import warnings

import numpy as np
import pytest
import sympy

import dalembert as dal

AUTO = {"h": "auto"}


A, B = np.array([-np.sin(1), np.cos(1)]), np.array([-np.sin(2), np.cos(2)])
AHEAD = np.array([A[1], -A[0]])
x, y = dal.coordinates("x y")

# Two lines through 0, g = (A.q) (B.q) = 0, by dg/dt = 0: a point on the first, which has the
# direction AHEAD, goes straight on through 0 with its speed, and there mu is 0.
_a, _b = A[0] * x + A[1] * y, B[0] * x + B[1] * y
CROSSING = dal.System.from_sympy(
    (x.d**2 + y.d**2) / 2, [sum((_a * _b).diff(z) * z.d for z in (x, y))], [x, y]
)


def run_of(system, *start, **how):
    """A run, and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run = dal.integrate(system, *start, throw=False, **how)
    return run, [str(warning.message) for warning in said]


@pytest.mark.parametrize("scheme, how", [
    (None, AUTO), ("bm6", AUTO | {"tolerance": 1e-6}), ("reference", {"h": 0.1}),
    ("midpoint", {"h": 0.1}), ("pair:0.5:0.5", {"h": 0.1}),
])  # fmt: skip
def test_a_dead_centre_is_passed_warned_of_or_refused(scheme, how):
    for x0 in (-0.53, -0.71, -0.97):
        run, said = run_of(CROSSING, scheme, x0 * AHEAD, AHEAD, t_end=2, **how)
        if not run.success:
            continue
        assert any("constraints[0] nearly lost rank" in text for text in said)
        assert run.stats.least_pivot < 1e-6 and run.stats.least_pivot_rows == (0,)
        assert abs(run.stats.least_pivot_t + x0) < 1e-3  # it comes to 0 at t = -x0


def beside_the_crossing():
    """A start on the hyperbola g = 1e-4, whose vertex is 1e-2 from 0: the pivot there is 1e-4."""
    w = 1e-4 / (0.7 * B @ AHEAD)
    q0 = 0.7 * AHEAD + w * A
    slope = (B @ q0) * A + (A @ q0) * B
    v0 = np.array([slope[1], -slope[0]]) / np.hypot(*slope)
    return q0, -np.sign(v0 @ q0) * v0


def test_a_motion_beside_a_dead_centre_is_not_doubted():
    q0, v0 = beside_the_crossing()
    run, said = run_of(CROSSING, None, q0, v0, t_end=1.5, **AUTO)
    assert run.success and not said
    assert abs((A @ run.q[-1]) * (B @ run.q[-1]) - (A @ q0) * (B @ q0)) < 1e-8
    assert np.hypot(*run.q[-1]) > 0.5  # it is beyond
    assert 1e-5 < run.stats.least_pivot < 1e-2 and run.stats.rank_doubts == 0


# The curve y = 0.6 x^2, on which a free point keeps its speed, crosses a line at 0.
_curve = (y - 3 * x**2 / 5) * (x + 3 * y / 10)
CURVED = dal.System.from_sympy(
    (x.d**2 + y.d**2) / 2, [sum(_curve.diff(z) * z.d for z in (x, y))], [x, y]
)


def on_the_curve(x0):
    return [x0, 0.6 * x0**2], [1.3, 1.3 * 1.2 * x0]


@pytest.mark.parametrize("scheme", [
    "explicit", "endpoint", "0.3", "explicit-nodes", "midpoint-nodes", "midpoint", "leapfrog",
    "leapfrog-mirror", "leapfrog-kl8", "leapfrog-ss10", "bm6", "pair:0.5:0.5",
])  # fmt: skip
def test_fixed_steps_through_a_curved_dead_centre_are_warned_of_or_refused(scheme):
    how = {"initial": "project"} if "nodes" in scheme else {}
    for x0, h in ((-0.53, 0.01), (-0.71, 0.003), (-0.97, 0.03), (-0.3, 0.001)):
        steps = int(1.4 * abs(x0) / 1.3 / h)
        run, said = run_of(CURVED, scheme, *on_the_curve(x0), h=h, steps=steps, **how)
        assert run.stats.rank_doubts > 0 and run.stats.least_pivot_rows == (0,)
        assert not run.success or any("constraints[0] nearly lost rank" in text for text in said)


@pytest.mark.parametrize("scheme, h", [
    ("explicit", 1e-5), ("endpoint", 1e-5), ("leapfrog", 2e-3), ("midpoint", 2e-3),
    ("leapfrog-kl8", 2e-3), ("pair:0.5:0.5", 2e-3),
])  # fmt: skip
def test_fixed_steps_that_resolve_a_motion_beside_a_dead_centre_are_not_doubted(scheme, h):
    q0, v0 = beside_the_crossing()
    steps = round(1.5 / h)
    run, said = run_of(CROSSING, scheme, q0, v0, h=h, steps=steps, stride=steps)
    assert run.success and not said
    assert abs((A @ run.q[-1]) * (B @ run.q[-1]) - 1e-4) < 2e-5  # the hyperbola
    assert np.hypot(*run.q[-1]) > 0.5
    assert 1e-5 < run.stats.least_pivot < 1e-2


def test_longer_steps_that_estimate_the_error_leave_no_doubt():
    """Those of 4h come nearer to the crossing, or jump over it; the run does not."""
    for n in (150, 200, 300, 1200, 2000, 4000):
        runs = [
            run_of(CROSSING, "midpoint", *beside_the_crossing(), h=1.5 / n, steps=n, check_h=check)
            for check in (True, False)
        ]
        (checked, said), (plain, _) = runs
        assert checked.stats.remade > 0 and not said
        assert checked.stats == plain.stats  # but for what the estimate says


def test_steps_that_turn_a_blade_by_any_angle_are_not_doubted():
    for h in (0.7, 1.3, 2.0):
        for scheme in ("leapfrog", "explicit", "midpoint"):
            run, _ = run_of(dal.systems.sleigh(), scheme, h=h, steps=40)
            assert run.stats.rank_doubts == 0


def test_rows_of_a_sparse_constraint_are_looked_at():
    def forms(q):
        x, y, X, Y = q
        a, b = x + 0.3 * y, y - 0.6 * x**2
        return [-1.2 * x * a + b, a + 0.3 * b, Y, X + 3]

    # small masses make large pivots
    system = dal.System(mass=[1e-6] * 4, mu=forms, sparsity=[[1, 1, 0, 0], [0, 0, 1, 1]])
    (x0, y0), (u0, w0) = on_the_curve(-0.71)
    start = [x0, y0, 1, 0], [u0, w0, 0.3, 0]
    for scheme, how in (("explicit", {"h": 0.01}), ("reference", {"h": 1.0})):
        run, said = run_of(system, scheme, *start, steps=100 if scheme == "explicit" else 1, **how)
        assert run.success and "constraints[0] nearly lost rank" in said[0]
        assert run.stats.least_pivot_rows == (0,) and run.stats.least_pivot < 0.1


def test_constraints_that_are_nearly_dependent_all_the_time_are_not_doubted():
    def forms(q):
        s, c = np.sin(q[0]), np.cos(q[0])
        return [[0, s, -c, 0], [0, 1e4 * s, -1e4 * c, 1e-1]]  # 1e-5 from the same direction

    system = dal.System(mass=[1, 1, 1, 1], mu=forms)
    for scheme, how in (("leapfrog", {"h": 0.1}), (None, AUTO)):
        run, said = run_of(system, scheme, [0] * 4, [1, 1, 0, 0], t_end=10, **how)
        assert run.success and not said
        assert run.stats.least_pivot > 0.1


def test_the_least_pivot_survives_a_journal_and_a_saved_stepper(tmp_path):
    system, ahead = CROSSING, AHEAD
    path = tmp_path / "run.dal"
    half, _ = run_of(system, None, -0.5 * ahead, ahead, t_end=0.8, journal=path, **AUTO)
    whole, _ = run_of(system, None, -0.5 * ahead, ahead, t_end=1, **AUTO)
    with pytest.warns(dal.DalembertWarning, match="nearly lost rank"):
        longer = dal.resume(path, system, t_end=1)
    assert longer.stats.least_pivot == half.stats.least_pivot == whole.stats.least_pivot < 1e-9
    assert longer.stats.least_step == whole.stats.least_step < 1e-3
    assert longer.stats.least_pivot_rows == (0,)

    first = dal.Stepper(system, "reference", -0.5 * ahead, ahead, h=0.25)
    first.step(steps=3)
    second = dal.Stepper(system, "reference", -0.5 * ahead, ahead, h=0.25)
    second.restore(first.save())
    assert second.stats == first.stats
    assert first.stats.least_pivot < 1e-12 and abs(first.stats.least_pivot_t - 0.5) < 1e-3
    second.step()
    assert second.stats.least_pivot == first.stats.least_pivot


def test_members_of_an_ensemble_know_their_least_pivot():
    starts = np.array([-0.5, 1.0])[:, None] * AHEAD
    found = dal.ensemble(CROSSING, "reference", q0=starts, v0=AHEAD, h=1.0, t_end=1)
    assert found.doubtful.tolist() == [True, False]
    assert found.least_pivot[0] < 1e-6 < found.least_pivot[1] == 1

    q, v = map(np.array, zip(*map(on_the_curve, np.linspace(-0.9, 0.3, 20))))
    for lanes in (True, False):
        found = dal.ensemble(CURVED, "explicit", q0=q, v0=v, h=0.01, steps=60, lanes=lanes)
        for k in range(len(q)):
            run, said = run_of(CURVED, "explicit", q[k], v[k], h=0.01, steps=60)
            assert found.least_pivot[k] == run.stats.least_pivot
            assert found.doubtful[k] == bool(said)
    assert 5 < found.doubtful.sum() < 18


def test_a_stepper_restored_before_a_dead_centre_looks_where_the_first_would():
    first = dal.Stepper(CURVED, "explicit", *on_the_curve(-0.53), h=0.01)
    first.step(steps=35)
    second = dal.Stepper(CURVED, "explicit", *on_the_curve(-0.53), h=0.01)
    second.restore(first.save())
    for stepper in (first, second):
        stepper.step(steps=30)
    assert second.stats == first.stats and first.stats.rank_doubts > 0


def test_reference_warns_of_a_dead_centre():
    with pytest.warns(dal.DalembertWarning, match=r"near t = 0.5 constraints\[0\] nearly lost"):
        dal.reference(CROSSING, -0.5 * AHEAD, AHEAD, t=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dal.reference(CROSSING, -0.5 * AHEAD, AHEAD, t=0.4)


def test_a_collision_is_said():
    # x'' = -1/x^2 in a plane with angular momentum l: the pericentre is l^2/2 = 5e-7
    system = dal.System.from_sympy((x.d**2 + y.d**2) / 2 + (x**2 + y**2) ** sympy.Rational(-1, 2))
    run, said = run_of(system, None, [1, 0], [0, 1e-3], t_end=1.2, **AUTO)
    assert any("the steps shrank to" in x for x in said)
    t = np.pi / 2**1.5  # half a period of the fall from rest at 1
    assert run.stats.least_step < 1e-6 and abs(run.stats.least_step_t - t) < 1e-4


BELT = dal.System.from_sympy(
    x.d**2 / 2 - x**2 / 2, force={x: 5 * sympy.sign(1 - x.d)}, q0=[0], v0=[0], name="belt"
)
STICKS = np.arcsin(0.2)  # x'' = 5 - x from rest: x' = 5 sin t is 1


@pytest.mark.parametrize("scheme, how", [
    (None, AUTO), ("bm6", AUTO), ("reference", {"h": 0.5}),
    ("reference", {"h": 0.5, "method": "rodas"}), ("reference", {"h": 3.0, "method": "msadams"}),
])  # fmt: skip
def test_a_run_that_no_longer_advances_ends(scheme, how):
    with pytest.raises(dal.ConvergenceError, match=r"sign\(1 - x.d\) in the force on x") as info:
        dal.integrate(BELT, scheme, t_end=3, **how)
    error = info.value
    text = str(error)
    assert "tanh(v/eps) for sign(v)" in text and "terminal event" in text
    where = float(text.split("to t = ")[1].split(",")[0])
    assert abs(where - STICKS) < 1e-3
    assert error.partial.t[-1] == error.t <= where
    assert len(error.partial.t) < 25000


def test_many_short_steps_that_advance_are_not_stopped():
    # a spring at rest takes steps of 0.1 and more, and then, pushed, 1e4 times shorter ones
    u = sympy.Symbol("u")
    system = dal.System.from_sympy(x.d**2 / 2 - 5e8 * x**2, force={x: 1e8 * u}, inputs=[u])
    run, said = run_of(
        system, "bm6", [0], [0], t_end=2.2, inputs=[[0.0], [1.0]], hold=2.0, **AUTO
    )
    assert run.success and not said and run.stats.steps > 2e4


@pytest.mark.parametrize("method", ["rk8pd", "msadams", "rodas"])
def test_progress_and_interrupts_within_an_interval(method):
    shown = []

    def show(done, total):
        shown.append(done)
        if len(shown) == 4:
            signal.raise_signal(signal.SIGINT)

    system = dal.systems.chaotic()
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        dal.integrate(system, "reference", h=1e6, t_end=1e6, progress=show, method=method)
    assert time.perf_counter() - began < 30  # of hours
    assert 0 <= shown[0] < shown[3] < 1  # of the only step
