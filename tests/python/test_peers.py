"""The comparison with other codes: what it solves is the same, and what runs converges."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest

PEERS = Path(__file__).resolve().parents[2] / "benchmarks" / "peers"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A quick run on one problem, where heyoka is not installed."""
    folder = tmp_path_factory.mktemp("peers")
    (folder / "heyoka.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'heyoka'\", name='heyoka')\n"
    )
    path = [str(folder), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, str(PEERS / "run.py"), "--quick", "--problem", "springs",
         "--out", str(folder / "out")],
        capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path), "NUMBA_OPT": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    results = json.loads((folder / "out" / "peers.json").read_text())
    return done.stdout, results, folder / "out"


def test_what_is_not_installed_is_skipped_by_name(run):
    printed, results, out = run
    assert "skipped: heyoka is not installed" in printed
    assert results["missing"]["heyoka"] == "heyoka is not installed"
    page = (out / "peers.md").read_text()
    assert "Skipped: heyoka is not installed." in page
    assert not any(name.startswith("heyoka") for name in results["problems"]["springs"]["state"])


def test_every_method_converges_to_the_reference(run):
    methods = run[1]["problems"]["springs"]["state"]
    assert {"leapfrog", "midpoint", "bm6", "kl8", "ss10", "kl8 auto", "reference"} <= set(methods)
    for name, method in methods.items():
        points = method["points"]
        assert not any("failed" in p for p in points), name
        errors = [p["error"] for p in points]
        assert errors == sorted(errors, reverse=True), name
        (first, last), (e, f) = [p["setting"] for p in points[-2:]], errors[-2:]
        if method["kind"] == "steps":
            order = math.log(e / f) / math.log(last / first)
            assert method["order"] - 0.3 < order < method["order"] + 3, (name, order)
        else:
            assert f < 1e4 * last, name
        # Only the energy method leaves D by its order
        if method["kind"] == "steps" and name != "odelab energy":
            assert max(p["residual"] for p in points) < 1e-11, name


def test_the_same_scheme_by_two_formulas(run):
    methods = run[1]["problems"]["springs"]["state"]
    for ours, theirs in (("leapfrog", "McLachlan-Perlmutter"), ("SPARK 2", "reflecting leapfrog")):
        if {ours, theirs} <= set(methods):
            errors = [{p["setting"]: p["error"] for p in methods[x]["points"]}
                      for x in (ours, theirs)]  # fmt: skip
            both = set(errors[0]) & set(errors[1])
            assert both
            for setting in both:
                assert errors[0][setting] == pytest.approx(errors[1][setting], rel=2e-3)


def test_tables_and_pictures_are_made(run):
    _, results, out = run
    problem = results["problems"]["springs"]
    page = (out / "peers.md").read_text()
    for name in problem["state"]:
        assert re.search(rf"^\| `?{re.escape(name)}`? \|", page, re.MULTILINE), name
    assert all(len(x) <= 100 or x.startswith("|") for x in page.splitlines())
    for name in ("state", "energy"):
        assert (out / f"peers-{name}.png").stat().st_size > 10_000
    # Symmetric schemes keep the energy in a band, at about the cpu time that they were given
    energy = problem["energy"]["methods"]
    for name in ("leapfrog", "kl8"):
        first, *_, last = (p["error"] for p in energy[name]["points"])
        assert last < 2 * first + 1e-11


@pytest.fixture(scope="module")
def problems():
    sys.path.insert(0, str(PEERS))
    try:
        import peer_dalembert
        import problems

        yield problems, peer_dalembert
    finally:
        sys.path.remove(str(PEERS))


def test_all_equations_are_those_of_the_problem(problems):
    """What SymPy eliminates, what a basis of D gives, and what dalembert solves."""
    import sympy as sp

    import dalembert as dal

    digits = json.loads((PEERS / "references.json").read_text())
    given, ours = problems
    assert list(digits) == list(given.PROBLEMS)
    for name, make in given.PROBLEMS.items():
        problem = make()
        n, model = len(problem.q), ours.system(problem)
        start = np.array(problem.start)
        run = dal.integrate(model, "reference", h=100.0, steps=1)
        found = np.hstack([run.q[-1], run.v[-1]])
        end = np.array([float(x) for x in digits[name]])
        assert np.abs(found - end).max() < 2e-11 * problem.pace, name
        whole, in_D = problem.odes
        rates = [sp.lambdify([given.t, ode.symbols], list(ode.rates)) for ode in (whole, in_D)]
        y = in_D.into(end)  # a state like any other
        assert in_D.out_of(y[None])[0] == pytest.approx(end)
        # d/dt of (q, B(q) w), against (q, v)' = f
        direct = np.array(rates[0](0.5, end))
        step = 1e-5
        ahead, behind = (in_D.out_of((y + s * np.array(rates[1](0.5, y)))[None])[0]
                         for s in (step, -step))  # fmt: skip
        assert (ahead - behind) / (2 * step) == pytest.approx(direct, abs=1e-8)
        assert model.acceleration(end[:n], end[n:], 0.5) == pytest.approx(direct[n:])


def test_the_comet_ends_where_keplers_equation_says(problems):
    digits = json.loads((PEERS / "references.json").read_text())["comet"]
    problem = problems[0].PROBLEMS["comet"]()
    with mpmath.workdps(30):
        r, v = mpmath.mpf(3) / 32, mpmath.mpf(9) / 2
        assert problem.start == [r, 0, 0, 0, v, r * v]
        a = 1 / (2 / r - v**2)
        e, n = 1 - r / a, a ** mpmath.mpf(-1.5)
        angle = mpmath.findroot(lambda x: x - e * mpmath.sin(x) - 100 * n, 100 * n)
        cos, sin, b = mpmath.cos(angle), mpmath.sin(angle), a * mpmath.sqrt(1 - e**2)
        rate = n / (1 - e * cos)
        # The reaction of z' = x y' - y x' is 0, and z' a constant
        exact = [a * (cos - e), b * sin, 100 * r * v, -a * sin * rate, b * cos * rate, r * v]
        assert max(abs(mpmath.mpf(x) - y) for x, y in zip(digits, exact)) < 1e-19


def test_bars_are_computed_from_the_results(drawing):
    """Made up results, of which it is known what is reached."""

    def method(*points, kind="steps", **more):
        return {"kind": kind, "points": [{"setting": k, "median": s, "error": e} | more
                                         for k, (s, e) in enumerate(points)]}  # fmt: skip

    def long(error, rate=1.0):
        return {"rate": rate, "points": [{"T": T, "error": error} for T in (1e5, 1e7)]}

    def problem(title, state, ours, theirs, in_D=1e-15, **more):
        energy = {"target": 1.0, "methods": {
            "ss10": long(ours), "kl8": long(1e-20, rate=9.0),
            "heyoka": long(theirs), "heyoka in D": long(in_D),
        }}  # fmt: skip
        return {"title": title, "state": state, "energy": energy} | more

    state = {
        "ss10": method((1e-3, 1e-11), (2e-3, 1e-13)), "taylor": method((5e-5, 1e-12), bare=2e-5),
        "heyoka": method((1e-3, 1e-12)), "heyoka in D": method((1e-4, 1e-12), bare=8e-5),
    }  # fmt: skip
    slow = state | {"taylor": method((1.2e-4, 1e-12), bare=7.2e-5)}
    work = {"kl8": method((1e-3, 1e-6)), "kl8 keep": method((1e-4, 1e-14)),
            "reference": method((2e-3, 1e-6))}  # fmt: skip
    results = {"problems": {
        "springs": problem("A", state, 1e-13, 1e-10),
        "knife_edge": problem("B", slow, 1e-13, 1e-8),
        "contact": problem("C", state, 1e-13, 1e-10),
        "gyroscopic": problem("G", state, 1.0, 1.0, reversible=False, work=work),
    }}  # fmt: skip
    calls, bare, five, seven, level = drawing.bars(results)
    # four problems, five accuracies; the second problem is slower than heyoka in D
    assert "**missed**; it is faster in 15 of 20, and takes at most 1.20 times" in calls
    assert "at most 0.90 (B, 1e-9), in the mean 0.34." in bare  # (1/4)^(3/4) 0.9^(1/4)
    assert "reached, on 3." in five and "A 1000; B 1.0e5; C 1000." in five
    assert "A 0.01; B 0.01; C 0.01." in five
    assert "**missed**, on 1." in seven
    assert "controlled steps reached; 0.5 times as long at 1e-4 (kl8), 0.5 at 1e-6" in level


@pytest.fixture(scope="module")
def drawing():
    sys.path.insert(0, str(PEERS))
    try:
        import draw

        yield draw
    finally:
        sys.path.remove(str(PEERS))
