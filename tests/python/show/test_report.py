"""The report: one page that stands alone, with the verdict first, the same bytes every time."""

from __future__ import annotations

import hashlib
import html
import json
import math
import os
import re
import resource
import shlex
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from conftest import Page
from matplotlib import pyplot

import dalembert as dal
from dalembert import cli
from dalembert.show import palette, table
from dalembert.core import files

STEPS = (10, 15, 20, 30)


@pytest.fixture(scope="module")
def studies():
    return dal.studies(
        dal.systems.particle(), ["midpoint", "explicit", "midpoint-nodes", "leapfrog-suzuki4"]
    )


def written(studies, folder):
    path = folder / "report.html"
    assert dal.report.write(studies, path) == path
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text(studies, tmp_path_factory):
    return written(studies, tmp_path_factory.mktemp("report"))


def test_the_page_stands_alone(text):
    page = Page(text)
    assert "script" not in page.tags and "link" not in page.tags and "img" not in page.tags
    assert page.tags.count("svg") == 5  # the path, errors, energies, D, D_eps
    # Names of XML vocabularies and of the maker of the pictures are no addresses that are fetched.
    assert not re.search(r"(?:src|action)\s*=|@import|url\((?!#)", text)
    assert all(ref.startswith("#") for ref in re.findall(r'href="([^"]*)"', text))


def test_ids_are_unique_and_references_resolve(text):
    ids = Page(text).ids
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used and used <= set(ids)


def test_the_verdict_comes_first_then_the_equations_and_a_path(studies, text):
    sentence = f'<p class="verdict holds">{studies.sentence()}</p>'
    found = ["<h1>particle</h1>", sentence, "<math", 'aria-label="Path', 'aria-label="Errors']
    places = [text.index(x) for x in found]
    assert places == sorted(places)


def test_what_runs_are_compared_with(text):
    assert "and are compared with the exact solution." in " ".join(Page(text).words.split())


def test_the_parts_stand_in_order(text):
    places = [
        text.index(f'aria-label="{word}')
        for word in ("Errors", "Relative error", "Relative residual of D ",
                     "Relative residual of D_ε")
    ]
    folded = [text.index(f"<summary>{word}") for word in ("Tables", "How to reproduce")]
    places += folded
    assert places == sorted(places)
    assert text.index("<caption>") > folded[0]


def said(text, what):
    """What the pictures of a kind say to those who do not see them."""
    return [html.unescape(x) for x in re.findall(rf'aria-label="({what}[^"]*)"', text)]


def test_what_is_seen_is_said(studies, text):
    """Slopes, errors, residuals and energies in words, computed another way."""
    (errors,), (in_D,), (in_D_eps,) = (
        said(text, x) for x in ("Errors", "Relative residual of D ", "Relative residual of D_ε")
    )
    (energy,) = said(text, "Relative error of the energy")
    for study in studies:
        name = study.scheme.name
        counted = np.array(study.fits["global_state"].counted)
        h, error = study.h[counted], study.state_error[counted]
        line = rf"{name} falls with slope (\S+) from (\S+) at h = (\S+) to (\S+) at h = ([\d.]+\d)"
        slope, *numbers = re.search(line, errors).groups()
        assert float(slope) == pytest.approx(np.polyfit(np.log(h), np.log(error), 1)[0], abs=0.006)
        expected = [error[0], h[0], error[-1], h[-1]]
        np.testing.assert_allclose([*map(float, numbers)], expected, rtol=0.06)
        run = dal.integrate(
            study.system, study.scheme, study.q0, study.v0, h=0.05, steps=400,
            initial="project" if study.initial else None,
        )  # fmt: skip
        largest = study.system.relative_residual(run.q, run.v).max()
        found = re.search(rf"{name} (\S+) at most", in_D)[1]
        assert float(found) == pytest.approx(largest, rel=0.06)
        change = (run.energy - run.energy[0]) / max(abs(run.energy[0]), 1)
        found = re.search(rf"{name} between (\S+) and (\S+), (\S+) at the end", energy)
        expected = change.min(), change.max(), change[-1]
        np.testing.assert_allclose([*map(float, found.groups())], expected, rtol=0.06)
    assert "; the others are at roundoff" in errors.partition("leapfrog-suzuki4")[2]
    names = re.findall(r"([\w-]+) \S+ at most", in_D_eps)
    assert names == ["midpoint", "explicit", "midpoint-nodes"]


def test_pictures_follow_the_colours_of_the_page(text):
    assert "prefers-color-scheme: dark" in text and "color-scheme: light dark" in text
    pictures = re.findall(r"<svg .*?</svg>", text, re.S)
    for picture in pictures:
        assert not re.search(r"(?:fill|stroke): (?:#000000|#ffffff|black|white)", picture)
        assert 'fill="currentColor"' in picture and "stroke: currentColor" in picture
        assert float(re.search(r'width="([\d.]+)pt"', picture)[1]) < 320
        assert not re.search(rf"(?<!, ){'|(?<!, )'.join(palette.LINES.values())}", picture)
    everything = "".join(pictures)
    assert "var(--paper, #ffffff)" in everything  # hollow markers
    assert "var(--blue, #0072b2)" in everything and "var(--vermilion, #d55e00)" in everything


@pytest.mark.usefixtures("undrawn")
def test_four_schemes_at_most_in_a_picture(tmp_path):
    """What fails first, and one of each kind; each scheme once."""
    claims = [dal.Scheme([(0.3, 1.0)], name=f"claim{k}", order=2) for k in range(2)]
    names = ["midpoint", "leapfrog", "explicit", "endpoint", "midpoint-nodes"]
    studies = dal.studies(dal.systems.particle(), [*names, *claims], steps=STEPS[:3])
    text = written(studies, tmp_path)
    Page(text)
    every = [re.findall(r"[:;] ([\w.-]+) (?:falls|goes|has|is)", x) for x in said(text, "Errors")]
    assert every[0] == ["midpoint", "explicit", "claim0", "claim1"]
    assert max(map(len, every)) <= 4
    assert sorted(sum(every, [])) == sorted(study.scheme.name for study in studies)
    assert re.findall(r"<summary>(.*?)</summary>", text)[:3] == [
        "Order 2: leapfrog", "Order 1 or none: endpoint", "Kept nodes: midpoint-nodes",
    ]  # fmt: skip
    ids = Page(text).ids
    assert len(ids) == len(set(ids))


def test_many_schemes_of_a_kind_are_several_pictures():
    names = [scheme.name for scheme in dal.schemes() if scheme.order > 0]
    some = [SimpleNamespace(scheme=dal.Scheme.find(name), holds=True) for name in names]
    found = [[x.scheme.name for x in four] for four in dal.report._in_fours(some)]
    assert sorted(sum(found, [])) == sorted(names) and max(map(len, found)) == 4
    kinds = {dal.report._kind(x) for x in some if x.scheme.name in found[0]}
    assert len(kinds) == 4
    for four in found[1:]:
        assert len({dal.report._kind(x) for x in some if x.scheme.name in four}) == 1


def test_every_number_of_the_tables_is_there(studies, text):
    for study in studies:
        assert study.text in text
        for row in table.of_study(study).rows:
            assert all(f"<td>{cell}</td>" in text for cell in row)


def test_the_same_studies_give_the_same_bytes(studies, text, tmp_path):
    again = dal.report.write(list(studies), tmp_path / "again.html")
    assert again.read_bytes().decode("utf-8") == text


def test_how_to_reproduce(studies, text):
    pre = [html.unescape(part) for part in re.findall(r"<pre>(.*?)</pre>", text, re.S)]
    command = shlex.split(pre[0])
    assert command[:3] == ["dalembert", "study", "particle"]
    assert [command[i + 1] for i, word in enumerate(command) if word == "--scheme"] == [
        study.scheme.name for study in studies
    ]
    def option(name):
        (value,) = [word for word in command if word.startswith(f"{name}=")] or [
            f"{name}={command[command.index(name) + 1]}"
        ]
        return value.partition("=")[2]

    assert option("--q0") == "0.5,0.3,-0.2" and option("--v0") == "1.0,0.7,0.3"
    assert float(option("--t-end")) == 1 and option("--initial") == "D_eps"
    assert "--steps" not in command  # each scheme has its own
    again = cli._parser().parse_args(command[1:])
    back = dal.studies(
        dal.systems.particle(), again.scheme, again.q0, again.v0, t_end=again.t_end,
        steps=again.steps, initial=again.initial,
    )  # fmt: skip
    assert [study.to_dict() for study in back] == [study.to_dict() for study in studies]
    assert dal.__version__ in text
    data = json.loads(pre[1])
    assert data["q0"] == studies[0].q0.tolist() and data["t_end"] == 1
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
    assert Page(text).cell("SHA-256") == digest


@pytest.mark.usefixtures("undrawn")
def test_other_options_are_said(tmp_path):
    """Each as it was given; what the runs are compared with is said too."""
    knife = dal.systems.knife_edge(m=3)
    q0, v0 = [-1, 0, 0.5], [math.cos(0.5), math.sin(0.5), 1]
    studies = dal.studies(knife, ["midpoint", "leapfrog"], q0, v0, t_end=0.5, steps=STEPS)
    line = shlex.split(dal.report.command(studies))
    parameters = [f"{key}={value!r}" for key, value in knife.parameters.items()]
    assert "m=3.0" in parameters
    assert line == [
        "dalembert", "study", "knife_edge",
        *(word for x in parameters for word in ("--parameter", x)),
        "--q0=-1.0,0.0,0.5", f"--v0={v0[0]!r},{v0[1]!r},1.0", "--t-end", "0.5",
        "--scheme", "midpoint", "--scheme", "leapfrog", "--steps", "10,15,20,30",
    ]  # fmt: skip
    generic = dal.studies(dal.systems.chaotic(), ["midpoint"], t_end=1, steps=STEPS)
    text = written(generic, tmp_path)
    words = " ".join(Page(text).words.split())
    good = f"compared with a reference flow good to {generic[0].reference:.1e}."
    assert generic[0].reference > 0 and good in words


def test_orders_are_those_of_the_fits(studies, text):
    """The numbers of the overview, read from the page, are slopes of the errors by NumPy."""
    rows = {row[0]: row for row in Page(text).rows if row}
    for study in studies:
        counted = np.array(study.fits["global_state"].counted)
        slope = np.polyfit(np.log(study.h[counted]), np.log(study.state_error[counted]), 1)[0]
        assert float(rows[study.scheme.name][5]) == pytest.approx(slope, abs=0.006)


# ---- files ---------------------------------------------------------------------------------------


@pytest.fixture
def full_disk():
    """Files may have 1 kB at most, as on a disk that is full then."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("undrawn", "full_disk")
def test_a_full_disk_leaves_the_old_files(studies, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("report.html", "out.json"):
        (tmp_path / name).write_text("old")
    with pytest.raises(OSError, match="File too large: 'report.html'"):
        dal.report.write(studies, "report.html")
    words = ["study", "particle", "--scheme", "midpoint", "--json", "out.json", "--no-report"]
    assert cli.main(words) == 1
    shown = capsys.readouterr()
    assert "out.json: File too large" in shown.err
    assert "midpoint has" in shown.out  # what was computed is shown
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "report.html": "old", "out.json": "old",
    }  # fmt: skip


def test_a_device_is_written_to():
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        files.write("/dev/full", "text")
    assert os.path.exists("/dev/full")
    files.write(os.devnull, "text")
    assert not os.path.isfile(os.devnull)


def test_a_report_is_a_file_as_any_other(tmp_path):
    """New ones have the permissions of the user, old ones keep theirs; links are followed."""
    path = tmp_path / "new.html"
    mask = os.umask(0o027)
    try:
        files.write(path, "new")
    finally:
        os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o640
    path.chmod(0o604)
    (tmp_path / "link.html").symlink_to("new.html")
    files.write(tmp_path / "link.html", "newer")
    assert (tmp_path / "link.html").is_symlink() and path.stat().st_mode & 0o777 == 0o604
    assert path.read_text() == "newer"
    assert {x.name for x in tmp_path.iterdir()} == {"new.html", "link.html"}  # no drafts
    files.write(tmp_path / ("x" * 250 + ".html"), "a long name")


@pytest.mark.usefixtures("undrawn")
def test_a_failure_is_said_first(tmp_path):
    claim = dal.Scheme([(0.5, 1.0)], name="<claims> 3", order=3)
    studies = dal.studies(dal.systems.particle(), [claim, "midpoint"], steps=STEPS)
    text = written(studies, tmp_path)
    Page(text)
    assert "&lt;claims&gt; 3 fails" in text
    verdict = text.index('<p class="verdict fails">')
    assert verdict < text.index("Does not hold") < text.index("<h2>")
    assert '<td class="left fails">fails</td>' in text and "<claims>" not in text


@pytest.mark.usefixtures("undrawn")
def test_a_system_of_the_users_own(tmp_path):
    """With the name of one of the library."""
    own = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], q0=[0, 1, 0], v0=[1, 1, 1], name="particle"
    )
    studies = dal.studies(own, ["midpoint"], steps=STEPS)
    text = written(studies, tmp_path)
    words = Page(text).words
    assert "a user-defined system" in words and "dalembert study particle" not in words
    assert "The system has no formulas, because it is defined by a constant mass, mu." in words
    assert "constraints: 1 linear constraint." in words and "<math" in text


def test_dollars_are_drawn_letter_by_letter(tmp_path):
    """Between dollars a name would be a formula that is none."""
    x, y = dal.coordinates([r"$\foo$", "a$b$"])
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - x**2, [y.d - x * x.d], name="$x_$", q0=[1, 0.5], v0=[1, 1]
    )
    scheme = dal.Scheme([(0.5, 1.0)], name=r"$\beta_$")
    run = dal.integrate(system, scheme, h=0.1, steps=5)
    study = dal.convergence(system, scheme, t_end=1)
    drawn = [dal.plot.path(run), dal.plot.energy(run), study.plot()]
    for ax in drawn:
        ax.figure.canvas.draw()
    assert [ax.get_title().startswith(r"\$x_\$: ") for ax in drawn] == [True] * 3
    assert r"\$\foo\$" in drawn[0].get_xlabel()
    pyplot.close("all")
    dal.report.write([study], tmp_path / "report.html")
    assert "$x_$" in (tmp_path / "report.html").read_text()
    assert "$x_$" in dal.pages.page(system)


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_breaks_off_is_named(tmp_path):
    """And the path is that of another run."""
    # y = -1, h v_y = 2 makes the step of beta = 1 singular: here h = t_end/20 = 2 of the pictures.
    claim = dal.Scheme([(1.0, 1.0)], name="claim", order=3)
    studies = dal.studies(
        dal.systems.particle(), [claim, "midpoint"], [0, -1, 0], [1, 1, -1], t_end=40,
        steps=(4000, 6000, 8000),
    )  # fmt: skip
    text = written(studies, tmp_path)
    assert "ended early: claim" in text
    assert "A run: midpoint, 400 steps of h = 2." in text


def test_bad_arguments_are_named(studies, tmp_path):
    with pytest.raises(ValueError, match="studies is empty"):
        dal.report.write([], tmp_path / "report.html")
    with pytest.raises(ValueError, match="studies is a System; expected a dalembert.Study or"):
        dal.report.write(dal.systems.sleigh(), tmp_path / "report.html")
    other = dal.convergence(dal.systems.knife_edge(), "midpoint")
    with pytest.raises(ValueError, match="knife_edge, particle: expected one system"):
        dal.report.write([studies[0], other], tmp_path / "report.html")
    with pytest.raises(OSError):
        dal.report.write(studies, tmp_path / "nowhere" / "report.html")
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("undrawn")
def test_one_study_is_enough(studies, tmp_path):
    one = dal.report.write(studies[0], tmp_path / "one.html")
    same = dal.report.write([studies[0]], tmp_path / "same.html")
    assert one.read_bytes() == same.read_bytes()
