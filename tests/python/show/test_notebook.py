"""What notebooks show: short, escaped, in the colours of the notebook, and never an error."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from conftest import Page

import dalembert as dal
from dalembert.core import extras
from dalembert.show import panels


def forms(q):
    return [[-q[1], 0, 1]]


@pytest.fixture(scope="module")
def sleigh():
    return dal.systems.sleigh().with_units(x="m", y="m", theta="rad", t="s", energy="J")


@pytest.fixture(scope="module")
def run(sleigh):
    return dal.integrate(sleigh, h=0.01, t_end=2)


@pytest.fixture(scope="module")
def shown(sleigh, run):
    """Each kind of object, by its class."""
    scheme = dal.Scheme.find("leapfrog-kl8")
    study = dal.convergence(sleigh, "midpoint", steps=(10, 15, 20))
    many = dal.ensemble(sleigh, parameters={"a": [0.1, 0.2]}, h=0.1, steps=5, progress=False)
    found = [sleigh, run, sleigh.check(), scheme, study, dal.Studies([study]), many]
    return {type(x).__name__: x._repr_html_() for x in found}


def test_all_have_one_look(shown):
    assert len(shown) == 7
    for text in shown.values():
        page = Page(text)
        assert text.startswith('<div class="dalembert">') and "--jp-" in text
        assert not {"script", "link", "img", "h1", "body"} & set(page.tags)
        assert not re.search(r"color: (?:black|white|#000|#fff)", text)
        assert len(page.ids) == len(set(page.ids)) and len(text) < 80_000


def test_a_system(shown, sleigh):
    page = Page(shown["System"])
    assert page.cell("coordinates") == "x (m), y (m), theta (rad)"
    assert page.cell("constraints") == "1, linear"
    assert page.cell("parameters") == "m = 1.5, J = 0.8, a = 0.4"
    assert page.cell("starts at") == "0, 0, 0.3" and page.tags.count("math") > 4
    bare = Page(dal.System(mass=[2], coordinates=["x"])._repr_html_())
    assert "defined by a constant mass" in bare.words and bare.cell("constraints") == "none"
    assert "starts at" not in bare.words and "parameters" not in bare.words
    many = dal.System(mass=1.0, n=30, force=lambda t, q, v, u: u[0] * v, inputs=["u"])
    page = Page(many._repr_html_())
    assert page.cell("coordinates").endswith("q7, ...") and page.cell("inputs") == "u"
    assert page.cell("has") == "force"


def test_a_long_formula_is_cut():
    terms = "".join(f" - {k} x^{k} y^{90 - k}" for k in range(1, 90))
    long = dal.System(
        mass=[1, 1], coordinates="xy", formulas=[f"L = (v_x^2 + v_y^2)/2{terms}"]
    )  # fmt: skip
    page = long._repr_html_()
    assert "letters in all)" in page and len(page) < 20_000


def test_a_run(shown, run):
    text = shown["Solution"]
    page = Page(text)
    assert page.cell("run") == "leapfrog, h = 0.01 s: 201 states at t = 0 .. 2 s"
    worst = f"{run.stats.worst_residual:.1e}"
    assert page.cell("D") == f"kept to roundoff: relative residual at most {worst} after every step"
    first, change = re.fullmatch(
        r"(\S+) J at the start, (\S+) J at the end", page.cell("energy")
    ).groups()
    assert float(first) == pytest.approx(run.energy[0], rel=1e-5)
    assert float(change) == pytest.approx(run.energy[-1] - run.energy[0], rel=0.06)
    assert page.cell("steps") == "200" and page.tags.count("svg") == 1
    assert int(page.cell("constraint calls")) == run.stats.constraint_calls
    assert 'aria-label="Path in the plane of x and y of sleigh' in text


@pytest.mark.usefixtures("undrawn")
def test_other_runs():
    """Kept nodes, no constraints, a reference, one that failed, one that keeps nothing."""
    particle = dal.systems.particle()
    nodes = dal.integrate(particle, "midpoint-nodes", h=0.1, steps=20, initial="shift")
    assert Page(nodes._repr_html_()).cell("D_ε").startswith("kept to roundoff")
    free = dal.System(mass=[1, 1], force=lambda t, q, v: -v, q0=[0, 0], v0=[1, 1], name="free")
    page = Page(dal.integrate(free, h=0.1, steps=20)._repr_html_())
    assert page.cell("D") == "no constraints"
    assert page.cell("energy").endswith(", where it is not conserved")
    flow = dal.integrate(particle, "reference", h=0.1, steps=20)
    cell = Page(flow._repr_html_()).cell("D")
    assert cell.startswith("kept to roundoff") and cell.endswith("at 21 of 21 states")
    off = dal.Solution(
        system=particle, scheme=dal.Scheme.find("midpoint"), x=np.array([[0, 1, 0, 1, 1, 2.0]] * 2),
        reactions=np.zeros((1, 1)), t0=0.0, h=0.1, stride=1, stats=flow.stats.__class__(
            worst_residual=float("nan")), status=0, message="by hand",
    )  # fmt: skip
    cell = Page(off._repr_html_()).cell("D")
    size = float(particle.relative_residual([0, 1, 0], [1, 1, 2]))
    assert cell == f"not kept to roundoff: relative residual at most {size:.1e} at 2 of 2 states"
    broken = dal.integrate(
        particle, "endpoint", [0, -1, 0], [1, 1, -1], h=2.0, steps=5, throw=False
    )
    assert "a run that failed" in broken._repr_html_()


@pytest.mark.usefixtures("undrawn")
def test_a_long_run_is_looked_at_in_places(monkeypatch):
    """Neither the picture nor the verdict takes all rows."""
    system = dal.System(mass=[1, 1, 1], mu=forms, q0=[0, 1, 0], v0=[1, 1, 1])
    run = dal.integrate(system, "reference", h=0.0075, steps=400)
    monkeypatch.setattr(panels, "ROWS", 100)
    text = run._repr_html_()
    assert "at 100 of 401 states" in text and len(text) < 60_000
    assert not run._computed.keys() - {"t"}
    (seen,) = re.findall('aria-label="([^"]*)"', text)
    assert "from t = 0 to 3:" in seen and f"q0 from 0 to {run.q[-1, 0]:.3g}, " in seen
    assert "The first" not in text


@pytest.mark.parametrize("names", ["xy", "ab"])
@pytest.mark.usefixtures("undrawn")
def test_a_fast_run_does_not_look_slow(names, monkeypatch):
    """A spring with some 160 oscillations: 100 rows all over would show others."""
    spring = dal.System(
        mass=[1, 1], potential=lambda q: 50 * q @ q, gradient=lambda q: 100 * q,
        coordinates=names, q0=[1, 0], v0=[0, 1],
    )  # fmt: skip
    run = dal.integrate(spring, h=0.02, t_end=100)
    monkeypatch.setattr(panels, "ROWS", 100)
    text = run._repr_html_()
    assert "The first 100 of 5001 states." in text and "from t = 0 to 1.98:" in text


@pytest.mark.usefixtures("undrawn")
def test_a_journal_of_kept_nodes(tmp_path):
    """Its statistics are not known, and its start lies in D, not in D_eps."""
    path = tmp_path / "run.dal"
    dal.integrate(
        dal.systems.particle(), "midpoint-nodes", h=0.1, steps=20, initial="D", journal=path
    )
    cell = Page(dal.load(path)._repr_html_()).cell("D_ε")
    assert cell.startswith("kept to roundoff") and cell.endswith("at 20 of 21 states")


def test_a_failing_picture_is_left_out(run, monkeypatch):
    monkeypatch.setattr(panels, "motion", lambda *_: 1 / 0)
    page = Page(run._repr_html_())
    assert "svg" not in page.tags and page.cell("steps") == "200"
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert "svg" not in Page(run._repr_html_()).tags


def test_a_check():
    wrong = dal.System(
        mass=[1, 1], potential=lambda q: q[0] ** 2, gradient=lambda q: [q[0], 0]
    ).check([1, 0], [0, 0])
    page = Page(wrong._repr_html_())
    assert page.cell("FAILED") == wrong.text
    rows = [row for row in page.rows if row]
    assert [f"{name:20} {value}" for name, value in rows[1:]] == str(wrong).splitlines()[1:]


def test_a_scheme(shown):
    page = Page(shown["Scheme"])
    assert page.cell("promises") == "p = 8, s = 0" and page.cell("keeps") == "D"
    assert page.cell("34 sub-steps").endswith(", ...") and "Kahan and Li" in page.cell("from")
    kept = Page(dal.Scheme.find("midpoint-nodes")._repr_html_())
    assert kept.cell("keeps") == "D_ε, at kept nodes"
    own = Page(dal.Scheme([(0.3, 1.0)], name="<own>", help="a & b")._repr_html_())
    assert own.cell("promises") == "nothing" and "<own>" in own.words and "A & b." in own.words
    assert "sub-steps" not in Page(dal.Scheme.pair()._repr_html_()).words


@pytest.mark.usefixtures("undrawn")
def test_hostile_names():
    system = dal.System(
        mass=[1, 1], coordinates=["<script>", "$`y`"], q0=[0, 0], v0=[1, 1], name="</div><b>&",
        help="`<i>`", units={"<script>": "<m>"},
    )  # fmt: skip
    run = dal.integrate(system, h=0.1, steps=5)
    for text in (system._repr_html_(), run._repr_html_(), system.check()._repr_html_()):
        Page(text)
        assert "<script" not in text and "<b>" not in text and "<i>" not in text
    assert "</div><b>&" in Page(run._repr_html_()).words


def test_without_jinja2(sleigh, run, monkeypatch):
    monkeypatch.setattr(extras, "is_there", lambda name: name != "jinja2")
    for one in (sleigh, run, sleigh.check(), dal.Scheme.find("leapfrog")):
        assert one._repr_html_() is None


def test_the_same_bytes_again(shown, sleigh):
    again = dal.integrate(sleigh, h=0.01, t_end=2)
    assert again._repr_html_() == shown["Solution"]
