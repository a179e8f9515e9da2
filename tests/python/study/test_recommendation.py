"""Recommendations: what they promise, held against other solutions."""

import itertools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import dalembert as dal
from dalembert.study import recommendation


def error_of(system, found, end, q0=None, v0=None, **how):
    run = dal.integrate(system, q0=q0, v0=v0, **found.arguments, **how)
    x = np.concatenate(end)
    return (abs(run.x[-1] - x) / (1 + abs(x))).max()


@pytest.mark.parametrize(
    "name, t_end, accuracy",
    [
        ("knife_edge", 50, 1e-6), ("knife_edge", -20, 1e-3), ("particle", 300, 1e-9),
        ("sleigh", 40, 1e-8), ("disk", 20, 1e-5), ("heisenberg", 30, 1e-6),
    ],
)  # fmt: skip
def test_it_has_the_accuracy_it_promises(name, t_end, accuracy):
    system = getattr(dal.systems, name)()
    found = dal.recommend(system, t_end=t_end, accuracy=accuracy)
    assert found.error <= accuracy and found.tried[0].error == found.error
    if system.has_exact:
        end = system.exact(float(t_end))
    else:  # an independent way
        run = dal.integrate(system, "leapfrog-ss10", h=t_end / 2000, steps=2000)
        end = run.q[-1], run.v[-1]
    error = error_of(system, found, end)
    assert error <= 1.5 * accuracy
    assert error <= 3 * found.error + 1e-12


def test_a_time_too_long_to_try_is_extrapolated():
    system = dal.systems.knife_edge()
    found = dal.recommend(system, t_end=20000, accuracy=1e-4)
    assert "The trials ended at t = " in found.why and "errors grow like t^" in found.why
    error = error_of(system, found, system.exact(20000.0))
    assert error < 10 * found.error and error < 1e-3


def test_a_drift_that_does_not_show_yet_is_expected():
    # The trailers turn in circles: a drift of the energy moves the angle with t^2, after some time.
    train = dal.systems.n_trailer()
    found = dal.recommend(train, t_end=3000, accuracy=1e-4)
    exact = dal.integrate(train, "reference", h=3000, t_end=3000, tolerance=1e-14)
    assert error_of(train, found, (exact.q[-1], exact.v[-1])) < 2e-4


def test_errors_of_controlled_steps_are_expected_to_grow_with_the_square(monkeypatch):
    monkeypatch.setattr(recommendation, "GROWTH", 1.0)  # whatever is seen
    ball = dal.systems.ball_on_table()
    found = dal.recommend(ball, t_end=3000, accuracy=1e-4)
    end = float(re.search(r"The trials ended at t = (\S+)", found.why)[1])
    x = np.concatenate(ball.exact(end))
    for one in found.tried:
        if one.tolerance is not None:
            is_flow = one.scheme in ("reference", "taylor")
            h = end / math.ceil(end / one.h) if is_flow else one.h
            run = dal.integrate(ball, one.scheme, h=h, t_end=end, tolerance=one.tolerance)
            there = (abs(run.x[-1] - x) / (1 + abs(x))).max()
            assert one.error > 0.5 * there * (3000 / end) ** 2, one


def test_what_is_to_come_is_not_left_to_a_large_tolerance():
    # Nothing moves in the part that is tried, for Python is slow: every tolerance is good there.
    push = lambda t, q, v: np.exp(-(((t - 900) / 10) ** 2)) - q
    system = dal.System(mass=[1], force=push, q0=[0], v0=[0])
    found = dal.recommend(system, t_end=1000, accuracy=1e-6)
    assert "The trials ended at t = " in found.why
    assert all(one.tolerance is None or one.tolerance <= 1e-6 for one in found.tried)


def test_data_off_D_are_refused_as_in_a_run():
    with pytest.raises(dal.NotOnConstraintError):
        dal.recommend(dal.systems.knife_edge(), [0, 0, 0], [0, 1, 0], t_end=5)


def test_another_beginning():
    system = dal.System(
        mass=[1], force=lambda t, q, v: np.cos(t) + 0 * q, q0=[-np.cos(7)], v0=[np.sin(7)]
    )
    found = dal.recommend(system, t0=7, t_end=12, accuracy=1e-7)
    assert found.arguments["t0"] == 7
    assert error_of(system, found, ([-np.cos(12)], [np.sin(12)])) < 1.5e-7


def test_mass_that_depends_on_q_forces_and_inputs():
    system = dal.System(
        mass=[2], force=lambda t, q, v, u: u - 0.1 * v - q, inputs=["push"], q0=[0], v0=[1]
    )
    found = dal.recommend(system, t_end=3, accuracy=1e-6, inputs=[0.5])
    assert {one.scheme for one in found.tried} > {"midpoint", "midpoint-kl8", "reference"}
    # 2 x'' + 0.1 x' + x = 0.5
    b, w = 0.025, np.sqrt(0.5 - 0.025**2)
    x = lambda t: 0.5 + np.exp(-b * t) * (-0.5 * np.cos(w * t) + (1 - 0.5 * b) / w * np.sin(w * t))
    v = (x(3 + 1e-5) - x(3 - 1e-5)) / 2e-5
    assert error_of(system, found, ([x(3)], [v]), inputs=[0.5]) < 1.5e-6
    disc = dal.recommend(dal.systems.rolling_disc(), t_end=2, accuracy=1e-4)
    assert "midpoint" in {one.scheme for one in disc.tried}


def test_what_it_says():
    found = dal.recommend(dal.systems.knife_edge(), t_end=20, accuracy=1e-6)
    assert found.why.startswith("It is the fastest of ")
    accurate = [one for one in found.tried if one.error <= 1e-6]
    assert [one.seconds for one in accurate] == sorted(one.seconds for one in accurate)
    assert found.tried[0] is accurate[0]
    assert len({(one.scheme, one.h == "auto") for one in found.tried}) == len(found.tried)
    assert repr(found).count("\n") == len(found.tried) + 1
    assert found.arguments["t_end"] == 20 and found.seconds > 0


@pytest.mark.parametrize(
    "name, t_end, accuracy, only",
    [
        ("knife_edge", 2, 1e-3, ("reference",)),
        ("knife_edge", 0.5, 1e-3, ("leapfrog-kl8", "auto")),
        ("knife_edge", 0.5, 1e-3, ("leapfrog-ss10",)),
        ("heisenberg", 40_000, 1e-1, ("leapfrog",)),
        ("heisenberg", 100_000, 1e-1, ("reference",)),
    ],
)
def test_a_run_has_rows_that_can_be_plotted(name, t_end, accuracy, only, monkeypatch):
    """Whatever is the fastest, its run stores between 100 and 100 000 states."""
    every = recommendation._try_all

    def some(pilot, accuracy):
        for one in every(pilot, accuracy):
            if (one.scheme, *["auto"] * (one.h == "auto")) == only:
                yield one

    monkeypatch.setattr(recommendation, "_try_all", some)
    monkeypatch.setattr(recommendation, "GROWTH", 1.0)
    ticks = itertools.count()  # a busy machine would try a shorter part and give up earlier
    clock = SimpleNamespace(thread_time=lambda: 1e-3 * next(ticks))
    monkeypatch.setattr(recommendation, "time", clock)
    system = getattr(dal.systems, name)()
    found = dal.recommend(system, t_end=t_end, accuracy=accuracy)
    run = dal.integrate(system, **found.arguments)
    assert 100 <= len(run.t) - 1 <= 100_000
    assert run.t[0] == 0 and abs(run.t[-1] - t_end) < 1e-9 * t_end
    if name == "knife_edge":
        assert abs(run.q[-1] - system.exact(t_end)[0]).max() < accuracy
    else:  # the motion is resolved: a row for each tenth of a turn and more
        turns = np.count_nonzero(np.diff(np.sign(run.v[:, 0]))) / 2
        assert len(run.t) > 8 * turns or len(run.t) > 50_000


def test_the_printed_error_is_that_of_the_printed_step():
    """The steps of a short run are limited to a hundredth of it."""
    (x, y, z), (u, w, _) = [0.5, 0.3, -0.2], [1.0, 0.7, 0.3]
    high, s, top = y + 10 * w, math.hypot(1, y), math.hypot(1, y + 10 * w)
    c = u * s  # = x' sqrt(1 + y^2), which is constant, as y' is; z' = y x'
    end = [x + c * (math.asinh(high) - math.asinh(y)) / w, high, z + c * (top - s) / w]
    end = np.array([*end, c / top, w, c / top * high])
    particle = dal.systems.particle()
    for accuracy in (1e-8, 1e-4):
        found = dal.recommend(particle, t_end=10, accuracy=accuracy)
        limited = [one for one in found.tried if one.steps == 100 or one.h_max == 0.1]
        assert len(limited) > 3 and "|t_end - t0| / 100 = 0.1 long" in found.why
        for one in found.tried:
            given = {"tolerance": one.tolerance, "h_max": one.h_max}
            run = dal.integrate(particle, one.scheme, h=one.h, t_end=10, **given)
            error = (abs(run.x[-1] - end) / (1 + abs(end))).max()
            assert error / 1.5 - 1e-14 <= one.error <= 1.5 * error + 1e-13, one
            assert (one.h_max is not None) == ("h_max" in one.how)
            assert run.stats.steps == one.steps >= 100 or one.scheme == "reference"


def test_what_cannot_be_reached_is_said():
    with pytest.raises(ValueError, match="accuracy = 1e-13: no trial .* the smallest error is"):
        dal.recommend(dal.systems.knife_edge(), t_end=1e6, accuracy=1e-13)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"t_end": 0}, "t_end = 0.0: expected a time other than"),
        ({"t_end": np.nan}, "t_end = nan"),
        ({"t_end": 1, "accuracy": 0}, "accuracy = 0.0: expected 1e-13 to 0.1"),
        ({"t_end": 1, "accuracy": 1}, "accuracy = 1.0: expected"),
        ({"t_end": 1, "q0": [0, 0, 0]}, "q0 is given without v0"),
        ({"t_end": 1, "inputs": lambda t, q, v: [1]}, "inputs = .*: expected numbers, constant"),
    ],
)
def test_refused(given, words):
    with pytest.raises(ValueError, match=words):
        dal.recommend(dal.systems.knife_edge(), **given)
