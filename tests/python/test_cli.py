"""The command, as it is typed: what it prints, writes and returns."""

from __future__ import annotations

import json
import math
import os
import shlex
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import dalembert as dal
from dalembert import cli
from dalembert.study import refinement


COMMAND = [sys.executable, "-m", "dalembert"]


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """The command in a folder of its own: its status, and what it prints."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        status = cli.main(arguments)
        shown = capsys.readouterr()
        return SimpleNamespace(status=status, out=shown.out, err=shown.err)

    return call


def flat(text):
    return " ".join(text.split())


def test_study_prints_the_table_and_writes_the_report(run, tmp_path):
    done = run("study", "particle", "--scheme", "midpoint", "--scheme", "midpoint-nodes")
    assert done.status == 0, done.err
    found = dal.studies(dal.systems.particle(), ["midpoint", "midpoint-nodes"])
    first, titles, *rows = done.out.splitlines()
    assert first == found.sentence() and titles.split()[:2] == ["scheme", "verdict"]
    assert [row.split()[:2] for row in rows] == [["midpoint", "holds"], ["midpoint-nodes", "holds"]]
    assert max(map(len, done.out.splitlines())) <= 100
    assert "writing report.html" in done.err
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_options_reach_the_study(run, tmp_path):
    done = run(
        "study", "knife-edge", "--scheme", "0.5", "--parameter", "m=3", "--t-end", "0.5",
        "--steps", "10,15,20,30", "--q0=-1,0,0.5",
        "--v0", f"{math.cos(0.5)!r},{math.sin(0.5)!r},1", "--no-report", "--json", "out.json",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]
    data = json.loads((tmp_path / "out.json").read_text())
    (one,) = data["studies"]
    assert data["version"] == dal.__version__ and data["holds"] is True
    assert one["system"] == "knife_edge" and one["parameters"]["m"] == 3
    assert one["t_end"] == 0.5 and one["steps"] == [10, 15, 20, 30]
    assert one["h"] == [0.05, 0.5 / 15, 0.025, 0.5 / 30]
    assert one["q0"] == [-1, 0, 0.5]


def test_json_on_standard_output_stands_alone(run):
    kept = ["--scheme", "midpoint-nodes", "--initial", "shift"]
    done = run("study", "particle", *kept, "--json", "--no-report")
    assert done.status == 0
    (one,) = json.loads(done.out)["studies"]
    assert one["initial"] == "shift" and one["scheme"] == "midpoint-nodes"
    assert done.err.startswith("On particle, midpoint-nodes has its promised order")


@pytest.mark.parametrize(
    ("system", "options", "words"),
    [  # steps of 1 to 2.5 are far from where the error is a power of h; slopes that still rise
        ("knife_edge", ["--t-end", "5", "--steps", "2,3,4,5"], ""),
        ("particle", ["--t-end", "20", "--steps", "4,5,6,8,10", "--tables"], "take finer steps"),
    ],
)
def test_steps_that_are_too_coarse_have_no_verdict(run, system, options, words):
    done = run("study", system, "--scheme", "midpoint", *options, "--no-report")
    assert done.status == 0
    assert flat(done.out).startswith(f"On {system} there is no verdict on midpoint.")
    assert words in flat(done.out)


def test_a_wrong_promise_is_status_1(monkeypatch, capsys):
    claim = dal.Scheme([(0.5, 1.0)], name="claims-3", order=3)
    monkeypatch.setattr(refinement, "named_schemes", lambda: [claim])
    assert cli.main(["study", "particle", "--no-report"]) == 1
    assert "claims-3 fails" in flat(capsys.readouterr().out)
    true = dal.Scheme([(0.5, 1.0)], name="claims-2", order=2)
    monkeypatch.setattr(refinement, "named_schemes", lambda: [true])
    assert cli.main(["study", "particle", "--no-report"]) == 0


def test_systems_and_schemes_are_listed_one_line_each(run):
    done = run("systems")
    assert done.status == 0
    heading = "\n\nDefined in SymPy, which has to be installed:\n"
    in_c, in_sympy = (part.splitlines() for part in done.out.split(heading))
    assert [line.split()[0] for line in in_c] == list(dal.systems.names())
    assert [line.split()[0] for line in in_sympy] == list(dal.systems.names_in_sympy())
    done = run("schemes")
    assert done.status == 0
    lines, footer = (part.splitlines() for part in done.out.split("\n\nBesides these:\n"))
    assert [line.split()[0] for line in lines] == [scheme.name for scheme in dal.schemes()]
    assert [line.split()[0] for line in footer] == ["N", "N-nodes", "pair:A:B", "FILE.so:SYMBOL"]
    assert all(len(line.split()) > 2 for line in [*lines, *footer])


STUDY = ["study", "particle", "--scheme", "midpoint", "--no-report"]


def test_a_reader_that_leaves_is_no_error():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [*COMMAND, *STUDY], stdout=write, stderr=subprocess.PIPE, text=True, timeout=240
    )
    os.close(write)
    assert done.returncode == 141 and done.stderr == ""


def test_a_closed_standard_output(tmp_path):
    done = subprocess.run(
        shlex.join([*COMMAND, *STUDY, "--json", "a.json"]) + " >&-",
        shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert (tmp_path / "a.json").exists()


def test_version(run):
    assert run("--version").out == f"dalembert {dal.__version__}\n"


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((), "COMMAND"),
        (("study",), "MODEL"),
        (("stduy", "particle"), "no 'stduy'; did you mean 'study'? choose one of: study"),
        (("study", "pendulum"), "knife_edge"),
        (("study", "partcle"), "did you mean 'particle'"),
        (("study", "particle", "--scheme", "leapforg"), "did you mean 'leapfrog'"),
        (("study", "particle", "--initial", "D_esp"), "no 'D_esp'; did you mean 'D_eps'"),
        (("study", "knife_edge", "--parameter", "M=1"), "did you mean 'm'"),
        (("study", "particle", "--q0", "0,1,0", "--no-report"), "--q0 is given without --v0"),
        (("study", "particle", "--v0", "1,1,1", "--no-report"), "--v0 is given without --q0"),
        (("study", "particle", "--scheme", "trapezoid"), "leapfrog"),
        (("study", "particle", "--scheme", "no.so:x"), "no.so"),
        (("study", "knife_edge", "--parameter", "weight=3"), "weight"),
        (("study", "knife_edge", "--parameter", "m"), "expected NAME=NUMBER"),
        (("study", "knife_edge", "--parameter", "m=-1"), "m"),
        (("study", "particle", "--steps", "10,x"), "expected whole numbers"),
        (("study", "particle", "--steps", "0"), "steps[0] = 0"),
        (("study", "particle", "--q0", "0,1"), "q0"),
        (("study", "particle", "--q0", "0,1,0", "--v0", "1,1,0"), "violates the constraint"),
        (("study", "particle", "--initial", "E"), "D_eps"),
        (("study", "particle", "--t-end", "0"), "--t-end"),
        (("study", "disk", *["--parameter", "R=1"] * 2), "--parameter R is given more than once"),
        (("study", "disk", "--no-report", "--output", "x.html"), "not allowed with"),
        (("catalogue", "--system", "pendulum"), "no system 'pendulum'; choose one of: particle"),
        (("catalogue", "one", "two"), "unrecognized arguments: two"),
    ],
)
def test_usage_errors_are_status_2_and_say_what_there_is(arguments, message, run, tmp_path):
    done = run(*arguments)
    assert done.status == 2 and message in done.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("study", "particle", "--output", "/"), "/: "),
        (("study", "particle", "--output", "folder"), "folder: this is a folder; expected"),
        (("study", "particle", "--output", "file/a.html"), "file/a.html: "),
        (("study", "particle", "--json", "folder"), "folder: this is a folder; expected"),
        (("study", "particle", "--json", "nowhere/a.json"), "there is no folder nowhere"),
        (("study", "particle", "--output", "/proc/a.html"), "/proc/a.html: No such file"),
        (("study", "particle", "--json", "/proc/version"), "/proc/version: "),
        (("study", "particle", "--json", "a", "--output", "folder/../a"), "expected different"),
        (("catalogue", "file"), "file: this is a file; expected"),
        (("catalogue", "/proc/a"), "/proc/a: "),
        (("catalogue", "nowhere/a"), "there is no folder nowhere"),
    ],
)
def test_files_are_tried_before_the_work_begins(arguments, message, run, tmp_path, monkeypatch):
    def work(*given, **options):
        raise AssertionError("it began")

    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("here before")
    monkeypatch.setattr(cli, "studies", work)
    monkeypatch.setattr(cli.pages, "write", work)
    done = run(*arguments)
    assert done.status == 2 and message in done.err and not done.out
    assert done.err.startswith(f"dalembert {arguments[0]}: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "here before"


def test_warnings_and_failures_are_lines_without_tracebacks(monkeypatch, capsys):
    def doubtful(*given, **options):
        warnings.warn("this is doubtful", dal.DalembertWarning, stacklevel=2)
        raise failure

    monkeypatch.setattr(cli, "studies", doubtful)
    for failure, status in (
        (MemoryError("too large"), 1),
        (NotImplementedError("not yet"), 1),
        (dal.SingularError("mu has rank 0"), 1),
        (ValueError("no steps"), 2),
        (KeyboardInterrupt(), 130),
    ):
        assert cli.main(["study", "particle", "--no-report"]) == status
        said = capsys.readouterr().err.splitlines()
        told = [f"dalembert study: {failure}"] if status < 130 else []
        assert said == ["dalembert study: warning: this is doubtful", *told]


def test_without_matplotlib_the_tables_come_and_the_line_to_type(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main(["study", "particle", "--scheme", "midpoint"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("On particle, midpoint has") and "pip install matplotlib" in err
    assert cli.main(["study", "particle", "--scheme", "midpoint", "--output", "r.html"]) == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("undrawn")
def test_what_was_finished_before_ctrl_c_is_written(tmp_path, monkeypatch, capsys):
    finished = dal.studies(dal.systems.particle(), ["midpoint"], steps=[10, 20, 40])

    def interrupted(*_, **__):
        stop = KeyboardInterrupt()
        stop.partial = finished
        raise stop

    monkeypatch.setattr(cli, "studies", interrupted)
    report, numbers = tmp_path / "r.html", tmp_path / "n.json"
    words = ["study", "particle", "--scheme", "midpoint", "--scheme", "leapfrog"]
    assert cli.main([*words, "--output", str(report), "--json", str(numbers)]) == 130
    shown = capsys.readouterr()
    assert "interrupted: 1 of 2 schemes were studied" in shown.err
    assert shown.out.startswith(f"{finished.sentence()}\nscheme") and report.exists()
    assert json.loads(numbers.read_text())["studies"][0]["scheme"] == "midpoint"


# ---- single runs -----------------------------------------------------------------------------


def test_runs_journals_and_files(tmp_path, capsys):
    """run, info, resume, export: what the package gives."""
    path, out = str(tmp_path / "run.dal"), str(tmp_path / "run.csv")
    options = ["--h", "0.01", "--parameter", "a=0.3", "--stride", "2", "--scheme", "midpoint"]
    assert cli.main(["run", "sleigh", *options, "--t-end", "1", "--journal", path]) == 0
    assert "51 states at t = 0 .. 1, every 2 steps" in capsys.readouterr().out
    assert cli.main(["info", path]) == 0
    text = capsys.readouterr().out
    for part in (
        "sleigh(x, y, theta), built-in", "a = 0.3",
        "midpoint, h = 0.01, a state stored every 2 steps",
        "100 of 100 steps, t = 1", "51 records of ", "row 50, t = 1", "events         none",
    ):  # fmt: skip
        assert part in text
    assert cli.main(["resume", path]) == 0
    assert "already complete; nothing was computed" in capsys.readouterr().err
    assert cli.main(["resume", path, "--t-end", "0.5"]) == 2
    assert "--t-end 0.5 is before the end of the journal (t = 1)" in capsys.readouterr().err
    assert cli.main(["resume", path, "--steps", "200", "--output", out]) == 0
    shown = capsys.readouterr()
    assert "101 states" in shown.out and "already complete" not in shown.err
    sleigh = dal.systems.sleigh(a=0.3)
    whole = dal.integrate(sleigh, "midpoint", h=0.01, steps=200, stride=2)
    values = np.loadtxt(out, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(values[:, 1:7], whole.x)
    saved = str(tmp_path / "run.npz")
    assert cli.main(["export", path, saved]) == 0
    np.testing.assert_array_equal(dal.load(saved).x, whole.x)
    capsys.readouterr()
    assert cli.main(["info", saved]) == 0
    assert "Solution of sleigh by midpoint" in capsys.readouterr().out


MODEL = """
import dalembert as dal

def make():
    return dal.System(mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], q0=[0, 1, 0], v0=[1, 1, 1])

system = make()
number = 3
"""


def test_a_model_of_ones_own(tmp_path, capsys):
    file, path = tmp_path / "own.py", str(tmp_path / "run.dal")
    file.write_text(MODEL)
    for name in ("system", "make"):
        assert cli.main(["run", f"{file}:{name}", "--h", "0.1", "--steps", "5"]) == 0
    assert cli.main(["run", f"{file}:system", "--h", "0.1", "--steps", "5", "--journal", path]) == 0
    assert cli.main(["resume", path, "--steps", "9"]) == 2
    assert "not a built-in system" in capsys.readouterr().err
    assert cli.main(["resume", path, f"{file}:make", "--steps", "9"]) == 0
    assert "10 states" in capsys.readouterr().out
    assert cli.main(["info", path]) == 0
    assert "user-defined" in capsys.readouterr().out
    for name in ("number", "dal"):
        assert cli.main(["run", f"{file}:{name}", "--h", "0.1", "--steps", "5"]) == 2
        assert "expected a dalembert.System, or a function" in capsys.readouterr().err


def test_the_run_that_is_recommended(tmp_path, capsys):
    """Its last line can be typed, and the error is what it says."""
    file, q0, v0 = tmp_path / "own.py", [0.5, 1.0, -0.25], [1.0, -0.5, 1.0]
    file.write_text(MODEL)
    asked = ["recommend", f"{file}:system", "--t-end", "4", "--accuracy", "1e-5"]
    assert cli.main([*asked, "--q0=0.5,1,-0.25", "--v0=1,-0.5,1", "--t0=-1"]) == 0
    printed = capsys.readouterr().out
    assert "It is the fastest of" in printed and printed.count("error") > 5
    command = shlex.split(printed.splitlines()[-1])
    assert command[:3] == ["dalembert", "run", f"{file}:system"] and "--t0=-1.0" in command
    assert cli.main([*command[1:], "--output", str(tmp_path / "a.npz")]) == 0
    system = cli.runs.model(f"{file}:system", {})
    end = dal.reference(system, q0, v0, t0=-1, t=4)
    found = dal.load(tmp_path / "a.npz", system)
    assert np.abs(found.q[-1] - end.q).max() < 1e-5 * (1 + np.abs(end.q).max())
    for wrong, words in (["--accuracy=9", "--accuracy 9.0"], ["--q0=1,1,1", "without --v0"]):
        assert cli.main([*asked, wrong]) == 2
        assert words in capsys.readouterr().err
    assert cli.main(["recommend", "particle"]) == 2
    assert "--t-end" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_model_of_ones_own_has_studies_and_pages(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(MODEL)
    assert cli.main(["study", "own.py:system", "--scheme", "midpoint", "--no-report"]) == 0
    assert "midpoint" in capsys.readouterr().out
    assert cli.main(["catalogue", "book", "--system", "own.py:system"]) == 0
    assert [x.name for x in (tmp_path / "book").glob("*.html") if x.name != "index.html"]


def test_a_file_that_cannot_be_is_refused_before_the_run(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cli.runs, "integrate", lambda *_, **__: pytest.fail("it has run"))
    asked = ["run", "sleigh", "--h", "0.1", "--steps", "3", "--output", str(tmp_path / "a.mat")]
    assert cli.main(asked) == 2
    assert "expected a name that ends in .npz, .nc or .csv" in capsys.readouterr().err


def test_a_warning_names_options_of_the_command(capsys):
    assert cli.main(["run", "chaotic", "--h", "0.2", "--t-end", "100"]) == 0
    err = capsys.readouterr().err
    assert "(--h 0.2)" in err and err.endswith(
        "turn this estimate off with --no-check-h\nnot saved: add --output FILE.nc\n"
    )


def test_a_velocity_that_is_not_in_D_may_be_projected(capsys):
    asked = ["run", "particle", "--h", "0.1", "--steps", "3", "--q0=0,1,0", "--v0=1,1,0"]
    assert cli.main(asked) == 2
    assert capsys.readouterr().err.endswith(
        "Pass --consistent project to use the nearest admissible velocity\n"
    )
    assert cli.main([*asked, "--consistent", "project"]) == 0


def test_a_run_that_fails_says_how_to_go_on(tmp_path, capsys):
    file, path = tmp_path / "own.py", str(tmp_path / "run.dal")
    file.write_text(MODEL.replace("system = make()", """
def fails(t, q, v):
    if t > 0.5:
        raise dal.DomainError("too late")
    return 0 * v

system = dal.System(mass=[1, 1, 1], force=fails, q0=[0, 1, 0], v0=[1, 1, 1])
"""))
    out = tmp_path / "part.npz"
    arguments = ["run", f"{file}:system", "--h", "0.1", "--steps", "9", "--journal", path]
    assert cli.main([*arguments, "--output", str(out)]) == 1
    text = capsys.readouterr().err
    assert f"dalembert resume {path} {file}:system" in text and "too late" in text
    missing = str(tmp_path / "none" / "run.dal")
    assert cli.main([*arguments[:-1], missing]) == 1
    assert "to resume" not in capsys.readouterr().err
    with np.load(out) as found:
        assert 4 <= len(found["x"]) <= 6


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run", "sleigh", "--h", "0.1"], "one of the arguments --t-end --steps is required"),
        (["run", "sleigh", "--steps", "3"], "--steps 3: not used with --h own; give --t-end"),
        (["run", "sleigh", "--h", "0.1", "--steps", "3", *["--parameter", "a=1"] * 2],
         "--parameter a is given more than once"),
        (["run", "sleigh", "--dt", "0.1"], "unknown option --dt; did you mean '--h'?\nsee `dal"),
        (["run", "sleigh", "--t_end", "1"], "unknown option --t_end; did you mean '--t-end'?\n"),
        (["run", "sleigh", "--frob", "1"], "dalembert run: unknown option --frob\nsee `dalembert"),
        (["run", "sleigh", "--h", "1", "--t-end", "x"], "--t-end: 'x'; expected a number\n"),
        (["run", "sleigh", "--h", "1", "--steps", "1.5"], "'1.5'; expected a whole number\n"),
        (["run", "sleigh", "--h", "0.3", "--t-end", "1"],
         "take --t-end 0.9 or 1.2, or --h 0.25 or 0.3333333333333333\n"),
        (["run", "sleigh", "--h", "0.1", "--t-end", "1", "--q0", "-1,0,0"],
         "--q0 is given without --v0"),
        (["run", f"{__file__}:flatt", "--h", "1", "--steps", "1"],
         f"{__file__} has no 'flatt'; did you mean 'flat'?\n"),
        (["resume", "run.dal", "--parameter", "a=1"], "--parameter without MODEL"),
        (["run", "slegh", "--h", "0.1", "--steps", "3"], "did you mean 'sleigh'?"),
        (["run", "sleigh", "--h", "0.1", "--steps", "3", "--output", "a.txt"], "ends in .npz"),
        (["run", "own.py", "--h", "0.1", "--steps", "3"], "expected own.py:NAME"),
        (["export", "none.dal", "a.csv"], "none.dal: No such file or directory"),
        (["info", __file__], "expected the journal of a run or a saved run"),
    ],
)
def test_refused_runs(arguments, text, capsys):
    assert cli.main(arguments) in (1, 2)
    assert text in capsys.readouterr().err
