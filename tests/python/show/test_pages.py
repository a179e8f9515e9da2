"""The pages of the catalogue: complete, self-contained, the same bytes every time, and true."""

from __future__ import annotations

import ast
import html
import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import Page
from test_compiler import compile_c

import dalembert as dal
from dalembert import cli, pages
from dalembert.symbolic import formula
from dalembert.core import extras

NAMES = (*dal.systems.names(), *dal.systems.names_in_sympy())
VOCABULARIES = {f"http://www.w3.org/{x}" for x in ("2000/svg", "1999/xlink", "1998/Math/MathML")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("book") / "catalogue"
    paths = dal.pages.write(place)
    assert [path.name for path in paths] == ["index.html", *(f"{name}.html" for name in NAMES)]
    assert sorted(place.iterdir()) == sorted(paths)
    return place


@pytest.fixture(scope="module", params=NAMES)
def subject(request, folder):
    """A system, the text of its page, and the page."""
    text = (folder / f"{request.param}.html").read_text(encoding="utf-8")
    return dal.systems.get(request.param), text, Page(text)


# ---- all pages -----------------------------------------------------------------------------------


def test_a_page_stands_alone(subject):
    system, text, page = subject
    assert not {"script", "link", "img", "object"} & set(page.tags)
    assert len(text) < 600_000
    (film,) = re.findall(r'<iframe srcdoc="([^"]*)"', text)
    assert not re.search(r"(?:src|href|action)\s*=|@import|url\(|http", film)
    text = text.replace(film, "").replace("srcdoc=", "")
    assert not re.search(r"(?:src|action)\s*=|@import|url\((?!#)", text)
    assert set(re.findall(r"http[^\s\"]*", text)) <= VOCABULARIES
    for address in re.findall(r'href="([^"]*)"', text):
        assert address.startswith("#") or re.fullmatch(r"\w+\.html", address), address
    assert len(page.ids) == len(set(page.ids))
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used and used <= set(page.ids)
    assert page.tags.count("svg") == (4 if {"x", "y"} <= {*system.coordinates} else 3)
    assert "prefers-color-scheme: dark" in text
    for picture in re.findall(r"<svg .*?</svg>", text, re.S):  # in the colours of the page
        assert not re.search(r"(?:fill|stroke): (?:#000000|#ffffff|black|white)", picture)
        width = float(re.search(r'width="([\d.]+)pt"', picture)[1])
        assert width < 320, "it is not readable on a telephone"


def test_the_film_of_a_page_is_that_of_its_run(subject):
    system, text, _ = subject
    film = html.unescape(re.search(r'<iframe srcdoc="([^"]*)"', text)[1])
    shown = json.loads(re.search(r'type="application/json">(.*?)</script>', film)[1])
    run = dal.integrate(system, "leapfrog", h=0.02, t_end=20)
    assert shown["t"] == pytest.approx(np.linspace(0, 20, 120))
    energy = np.array(shown["curves"][0]["points"])
    assert energy[:, 1].max() == pytest.approx((run.energy - run.energy[0]).max(), rel=1e-3)


def test_a_page_says_what_the_system_says(subject):
    system, text, page = subject
    assert f"<h1>{system.name}</h1>" in text
    assert system.help[1:].removesuffix(".") in page.words
    assert system.source[1:] in page.words
    assert all(part in page.words for part in system.description.split("`")[::2])
    assert page.cell("coordinates") == str(system.n)
    assert page.cell("constraints") == f"{system.m}, {system.kind}"
    assert ("constant" == page.cell("mass matrix")) == (system.mass is not None)
    assert page.cell("examination").startswith("passed: ")
    for line in system.formulas:
        assert formula.mathml(line.removeprefix("where "), system.coordinates) in text
    assert "<code>" not in re.sub(r"<code>system\.\w+\(\w?\)</code>", "", text)
    shown = [row for row in page.rows if len(row) == 3 and row[0]]
    for x, v in zip(system.q0, system.v0):
        assert any(row[1:] == [f"{x:.15g}", f"{v:.15g}"] for row in shown)
    for value in system.parameters.values():
        assert any(row[1:] == [f"{value:.15g}"] for row in page.rows)


def test_what_is_seen_is_said(subject):
    """The largest residual and the range of each coordinate, from another run."""
    system, text, _ = subject
    run = dal.integrate(system, "leapfrog", h=0.02, t_end=20)
    said = " ".join(re.findall(r'aria-label="([^"]*)"', text))
    found = re.search(r"Relative residual of D .*?: leapfrog (\S+) at most", said)[1]
    assert float(found) == pytest.approx(max(run.residual.max(), 1e-17), rel=0.06)
    for name, q in zip(system.coordinates, run.q.T):
        ends = re.search(rf"[:;] {name} from (\S+) to (\S+), between (\S+) and (\S+)", said)
        numbers = [float(x.rstrip(";.")) for x in ends.groups()]
        expected = [q[0], q[-1], q.min(), q.max()]
        np.testing.assert_allclose(numbers, expected, rtol=6e-3, atol=1e-12)


def test_equations_and_the_path_come_first_and_tables_are_folded(subject):
    _, text, page = subject
    places = [text.index(x) for x in ("<math", "<svg", "<h2>The run", "<details>")]
    assert places == sorted(places)
    folded = "".join(re.findall(r"<details>.*?</details>", text, re.S))
    assert folded.count("<table") == text.count("<table") - 1  # that of the formulas


GROWTH = {
    "particle": (2, 3), "particle_oscillator": (2, 3), "knife_edge": (2, 3), "sleigh": (2, 3),
    "sleigh_contact": (2, 3), "disk": (2, 3, 4), "heisenberg": (2, 3),
    "contact_oscillator": (2, 3), "robot": (2, 3, 4), "chaotic": (6, 7), "genmass": (2, 3),
    "rolling_disc": (3, 4, 5), "snakeboard": (3, 4, 5), "n_trailer": (2, 3, 4, 5, 6),
    "steered_car": (2, 3, 4), "roller_racer": (2, 3, 4), "two_wheeled_robot": (2, 3, 4, 4),
    "cvt": (2, 3), "sleigh_with_rotor": (3, 4), "disguised": (6, 6),
}  # fmt: skip


def test_growth(subject):
    """As in the literature: (2, 3) for contact structures and blades, (2, 3, 4) for wheels."""
    system, _, page = subject
    if system.kind != "linear":
        assert system.name not in GROWTH and "growth" not in page.words
        return
    cell = page.cell("growth vector")
    found = ast.literal_eval(cell.partition(":")[0])
    assert found == GROWTH[system.name]
    words = {
        "D is bracket generating; proved": found[-1] == system.n,
        f"D lies in a foliation by leaves of dimension {found[-1]};": found[-1] == found[-2],
    }
    assert {text for text, holds in words.items() if holds} == {x for x in words if x in cell}
    assert ("holonomic in disguise" in page.words) == (
        system.name in ("disguised", "two_wheeled_robot")
    )


def test_invariants_and_their_drift(subject):
    """The numbers are those of the runs that the page names."""
    system, _, page = subject
    runs = [
        dal.integrate(system, "leapfrog", h=0.02, t_end=20),
        dal.integrate(system, "leapfrog-kl8", h=0.05, t_end=20),
    ]
    drifts = [system.invariant(run.q, run.v) for run in runs]
    if system.kind == "linear":
        drifts = [{"energy": run.energy, **drift} for run, drift in zip(runs, drifts)]
    else:
        assert "The energy is not conserved: the constraints do work." in page.words
    rows = page.rows[next(k for k, row in enumerate(page.rows) if row[0] == "invariant") + 1 :]
    for row, name in zip(rows, drifts[0]):
        start = drifts[0][name][0]
        assert float(row[1]) == pytest.approx(start, rel=1e-9, abs=1e-12)
        for text, drift in zip(row[2:], drifts):
            found = np.abs(drift[name] - start).max()
            assert float(text) == pytest.approx(found, rel=0.06)
        assert float(row[3]) < 1e-10  # the scheme of order 8


def test_what_is_known_of_the_solution(subject):
    system, _, page = subject
    states = dal.systems.known_states(system.name)
    top = page.rows.index(["", *(f"t = {x.t:g}" for x in states)])
    digits = page.rows[top + 1 : top + 1 + 2 * system.n]
    for i in range(system.n):  # a coordinate, then its velocity, which has a dot
        assert digits[2 * i][1:] == [x.q[i] for x in states]
        assert digits[2 * i + 1][1:] == [x.v[i] for x in states]
        name, velocity = digits[2 * i][0], digits[2 * i + 1][0]
        assert velocity != name and velocity.replace("\N{DOT ABOVE}", "") == name
    last = np.array([*states[-1].q, *states[-1].v], dtype=float)
    run = dal.integrate(system, "leapfrog-kl8", h=0.05, steps=200)
    known = np.concatenate(system.exact(10.0)) if system.has_exact else last
    expected = np.abs(run.x[-1] - known).max()
    found = float(page.cell("leapfrog-kl8", 2))
    assert found == pytest.approx(expected, rel=0.06) and found < 1e-9
    assert ("There is an exact solution" in page.words) == system.has_exact


def program_of(text, k):
    """The k-th piece of code of a page."""
    return html.unescape(re.findall(r"<pre>(.*?)</pre>", text, re.S)[k])


def test_python_lines_make_the_run(subject, capsys):
    system, text, _ = subject
    names = {}
    exec(program_of(text, 0), names)
    capsys.readouterr()
    end = names["run"].x[-1]
    lines = program_of(text, 2).splitlines()
    assert [line.split()[0] for line in lines] == list(system.coordinates)
    shown = np.array([line.split()[1:] for line in lines], dtype=float)
    np.testing.assert_array_equal(shown.T.ravel(), end)


def run_c(directory, text, *sources):
    """Compile the C program of a page as a user does, and return the numbers that it prints."""
    library = Path(dal.__file__).parents[2] / "csrc" / "libdalembert.a"
    (directory / "main.c").write_text(program_of(text, 1))
    compile_c(
        directory, "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "main.c", *sources,
        "-o", "main", str(library), "-lgsl", "-lgslcblas", "-lm",
    )  # fmt: skip
    done = subprocess.run([str(directory / "main")], capture_output=True, text=True, check=True)
    return [float(x) for x in done.stdout.split()]


@pytest.mark.parametrize("parameters", [{}, {"a": -0.25, "m": 3.0}])
def test_c_lines_make_the_run(parameters, tmp_path):
    system = dal.systems.sleigh(**parameters)
    end = run_c(tmp_path, dal.pages.page(system))
    assert end == list(dal.integrate(system, "leapfrog", h=0.02, t_end=20).x[-1])


def test_c_lines_of_a_system_in_sympy(tmp_path):
    system = dal.systems.cvt(c=0.1)
    source = system.c_source()
    assert '.source = "K. Modin, O. Verdier' in source and '.formulas = "L = (v_x^2' in source
    (tmp_path / "cvt.c").write_text(source)
    end = run_c(tmp_path, dal.pages.page(system), "cvt.c")
    assert end == list(dal.integrate(system, "leapfrog", h=0.02, t_end=20).x[-1])


# ---- the index, and files ------------------------------------------------------------------------


def test_index(folder):
    text = (folder / "index.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.links == [f"{name}.html" for name in NAMES]
    assert len(page.ids) == len(set(page.ids)) and page.tags.count("svg") == len(NAMES)
    for name in NAMES:
        system = dal.systems.get(name)
        kind = "" if system.kind == "linear" else f"{system.kind} "
        sizes = f"{system.n} coordinates, {system.m} {kind}constraint{'s' * (system.m > 1)}."
        assert sizes in page.words
        assert system.help[1:].removesuffix(".") in page.words
    assert "script" not in page.tags and not re.search(r"http(?!://www.w3.org)", text)


def test_links_lead_somewhere(folder):
    for name in NAMES:
        page = Page((folder / f"{name}.html").read_text(encoding="utf-8"))
        assert "index.html" in page.links
        assert all((folder / link).is_file() for link in page.links)
    assert 'href="sleigh.html">sleigh</a>' in (folder / "sleigh_with_rotor.html").read_text("utf-8")


def test_the_same_bytes_again(folder, tmp_path):
    """In another process, whose sets are in another order; where only the links are others."""
    code = "import sys, dalembert as dal; dal.pages.write(sys.argv[1], sys.argv[2:])"
    some = ["sleigh", "two_wheeled_robot"]
    env = {**os.environ, "PYTHONHASHSEED": "1"}
    subprocess.run([sys.executable, "-c", code, str(tmp_path), *some], env=env, check=True)
    for name in some:
        one, other = (
            re.sub("(?s)<nav>.*</nav>", "", (place / f"{name}.html").read_text("utf-8"))
            for place in (folder, tmp_path)
        )
        assert one == other


def test_pages_are_replaced_and_others_left_alone(tmp_path):
    (tmp_path / "disk.html").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    seen = []
    dal.pages.write(tmp_path, ["disk"], progress=lambda *x: seen.append(x))
    assert (tmp_path / "disk.html").read_text("utf-8").startswith("<!DOCTYPE html>")
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert seen == [(0, 1), (1, 1)]


# ---- systems of users ----------------------------------------------------------------------------


def test_a_system_of_the_users_own(tmp_path):
    own = dal.System(
        mass=[1, 1, 1],
        mu=lambda q: [[-q[1], 0, 1]],
        coordinates=["x", "y", "$z<"],
        q0=[0, 1, 0],
        v0=[1, 1, 1],
        name="<mine> & yours",
        help="a thing",
        description="It has `x` and <b>.",
        source="nowhere",
        formulas=["L = T - V", "alert(1); = 0"],
    )
    index, path = dal.pages.write(tmp_path, [own])
    assert path.name == "_mine____yours.html"
    page = Page(path.read_text("utf-8"))
    Page(index.read_text("utf-8"))
    assert "A thing." in page.words and "Source: Nowhere." in page.words
    assert "The system has no formulas" not in page.words
    assert "It has x and <b>." in page.words and "alert(1); = 0" in page.words
    assert "a user-defined system" in page.words and "Reference" not in page.words
    cell = page.cell("growth vector")  # which the formulas do not say
    assert cell == "(2, 3): D is bracket generating; seen at random points, to 16 digits"


def test_a_library_system_with_other_parameters():
    short = dal.systems.steered_car(l=0.4)
    for system in (
        short,
        dal.systems.steered_car().with_parameters(l=0.4),
        pickle.loads(pickle.dumps(short)),
    ):
        page = Page(dal.pages.page(system))
        assert "dal.systems.steered_car(l=0.4)" in page.words
        assert "Reference to 30 digits" not in page.words  # it is for the default parameters


@pytest.mark.parametrize("kind", ["free", "forced", "nonlinear"])
def test_other_kinds(kind):
    more = {
        "free": {},
        "forced": {"force": lambda t, q, v: [np.cos(t), -v[1]]},
        "nonlinear": {
            "constraint": lambda q, v: [v[0] ** 2 + v[1] ** 2 - 2],
            "constraint_v": lambda q, v: [[2 * v[0], 2 * v[1]]],
        },
    }[kind]
    system = dal.System(mass=[1, 1], q0=[0, 0], v0=[1, 1], name=kind, **more)
    page = Page(dal.pages.page(system))
    assert page.cell("constraints") == ("1, nonlinear" if kind == "nonlinear" else "none")
    assert ("relative residual of the constraints" in page.words) == (kind == "nonlinear")
    reason = {"free": "", "forced": "there is a force", "nonlinear": "the constraints do work"}
    assert ("The energy is not conserved" in page.words) == bool(reason[kind])
    assert reason[kind] in page.words


def test_a_run_that_breaks_off():
    def forms(q):
        if q[0] > 5:
            raise dal.DomainError("too far")
        return [[-q[1], 0, 1]]

    system = dal.System(
        mass=[1, 1, 1], mu=forms, coordinates="xyz", q0=[0, 0, 0], v0=[1, 0, 0], name="wall"
    )
    assert "It ended early at t = " in Page(dal.pages.page(system)).words


# ---- what is refused -----------------------------------------------------------------------------


def test_refused(tmp_path, monkeypatch):
    target = tmp_path / "catalogue"
    bare = dal.System(mass=[1, 1], name="bare")
    for chosen, text in (
        (["pendulum"], "no system 'pendulum'; choose one of: particle, "),
        ([], "chosen is empty"),
        (["disk", "disk"], "chosen: disk occurs 2 times"),
        (["sleigh", dal.systems.sleigh()], "sleigh occurs 2 times"),
        ([bare], "'bare' has no default initial data"),
        ([dal.System(mass=[1], q0=[0], v0=[1], name="index")], "the name index is reserved"),
        (["disk", 3], "no system 3"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.pages.write(target, chosen)
    with pytest.raises(ValueError, match="'bare' has no default initial data"):
        dal.pages.page(bare)
    with pytest.raises(ValueError, match="system = 3"):
        dal.pages.page(3)
    assert not target.exists()
    target.write_text("a file")
    with pytest.raises(OSError):
        dal.pages.write(target, ["disk"])
    with pytest.raises(OSError):
        dal.pages.write(tmp_path / "no" / "where", ["disk"])


@pytest.mark.parametrize("package", ["matplotlib", "jinja2"])
def test_without_what_pages_need(package, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    for call in (
        lambda: dal.pages.write(tmp_path / "book", ["disk"]),
        lambda: dal.pages.page(dal.systems.disk()),
    ):
        with pytest.raises(ImportError, match=f"pip install {package}"):
            call()
    assert not (tmp_path / "book").exists()


def test_without_sympy(tmp_path, monkeypatch, capsys):
    there = extras.is_there
    monkeypatch.setattr(extras, "is_there", lambda name: name != "sympy" and there(name))
    assert pages.available() == dal.systems.names()
    with pytest.raises(ImportError, match="pip install sympy"):
        dal.pages.write(tmp_path / "book", ["disk", "cvt"])
    assert not (tmp_path / "book").exists()
    monkeypatch.setattr(dal.systems, "names", lambda: ("disk",))
    assert cli.main(["catalogue", str(tmp_path / "book")]) == 0
    assert "omitted, because SymPy is not installed: cvt, disguised" in capsys.readouterr().err
    page = Page((tmp_path / "book" / "disk.html").read_text("utf-8"))
    assert page.cell("growth vector").startswith("(2, 3, 4): D is bracket generating; seen")


# ---- the command ---------------------------------------------------------------------------------


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["catalogue", "--system", "knife-edge", "--system", "cvt"]) == 0
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.splitlines() == [
        "page 1 of 2: knife-edge", "page 2 of 2: cvt", "catalogue: catalogue/index.html",
    ]  # fmt: skip
    names = sorted(path.name for path in (tmp_path / "catalogue").iterdir())
    assert names == ["cvt.html", "index.html", "knife_edge.html"]
    assert cli.main(["catalogue", "elsewhere", "--system", "disk"]) == 0
    assert (tmp_path / "elsewhere" / "index.html").is_file()


def test_help_of_the_command(capsys):
    assert cli.main(["catalogue", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for word in ("DIR", "--system MODEL", "index.html", "default: catalogue", "formulas"):
        assert word in said


def test_a_page_is_the_same_whatever_the_users_style_is():
    from matplotlib import pyplot

    sleigh = dal.systems.sleigh()
    plain = dal.pages.page(sleigh)
    with pyplot.style.context("dark_background"), pyplot.rc_context({"font.size": 5}):
        assert dal.pages.page(sleigh) == plain


def test_a_page_says_what_is_doubtful():
    """A spring with h omega = 2.02, which leapfrog multiplies."""
    spring = dal.System(
        mass=[1, 1], coordinates="xy", potential=lambda q: 101**2 * q @ q / 2,
        gradient=lambda q: 101**2 * q, hessian=lambda q: 101**2 * np.eye(2), q0=[1, 0], v0=[0, 0],
    )  # fmt: skip
    assert "Doubtful: h is too large" in dal.pages.page(spring)
    assert "Doubtful" not in dal.pages.page(dal.systems.sleigh())
