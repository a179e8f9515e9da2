"""Chains of bodies: accelerations against Kane's method, and time against operations."""

import time

import pytest
from chains import acceleration, model, random_chain, state
from conftest import U

import dalembert as dal
from dalembert.symbolic.graph import Graph, below

PLANE, SPACE, ABSOLUTE, RELATIVE = True, False, True, False


def check_accelerations(chain, system):
    assert (system.n, system.m) == (chain.n, ["none", "knife", "rolling"].index(chain.constraint))
    for seed in range(3):
        q, v = state(chain, seed)
        exact, condition = acceleration(chain, q, v)
        error = abs(system.acceleration(q, v) - exact).max()
        assert error <= 4 * U * condition * abs(exact).max()


@pytest.mark.parametrize(
    "n, where, angles, constraint",
    [
        (7, PLANE, RELATIVE, "rolling"), (8, PLANE, ABSOLUTE, "knife"),
        (5, SPACE, RELATIVE, "none"), (6, SPACE, RELATIVE, "knife"),
    ],
)  # fmt: skip
def test_accelerations(n, where, angles, constraint):
    chain = random_chain(n, where, angles, constraint)
    check_accelerations(chain, dal.System.from_sympy(*model(chain)))


def test_time_in_proportion_to_operations(monkeypatch, tmp_path):
    """From formulas to C an operation takes for 20 and 30 coordinates at most 3 times as long as
    for 10, which are timed before and after, as other processes slow all; and the graph is asked
    for it at most twice as often.
    """
    calls, make = 0, Graph.make

    def counted(*given, **options):
        nonlocal calls
        calls += 1
        return make(*given, **options)

    monkeypatch.setattr(Graph, "make", counted)
    seconds, makes = {10: 0.0, 20: 0.0, 30: 0.0}, {}
    for i, n in enumerate((10, 20, 30, 10)):
        monkeypatch.setenv("DALEMBERT_CACHE", str(tmp_path / str(i)))  # where nothing is known
        chain = random_chain(n, SPACE, ABSOLUTE, "rolling")
        given = model(chain)
        begin, calls = time.process_time(), 0
        system = dal.System.from_sympy(*given)
        took = time.process_time() - begin
        outputs = [e for f in system._model.derived.functions for e in sum(f.outputs.values(), [])]
        count = len(below(outputs))
        assert count > 15 * n**2
        seconds[n], makes[n] = max(seconds[n], took / count), calls / count
        if n > 10:
            check_accelerations(chain, system)
    assert max(seconds.values()) <= 3 * seconds[10], seconds
    assert max(makes.values()) <= 2 * makes[10], makes
