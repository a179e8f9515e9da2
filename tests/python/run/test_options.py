"""Which options apply to which kind of run: each has an effect, or is refused by name."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import dalembert as dal
from dalembert import cli
from dalembert.core.records import options_of
from dalembert.ensembles.spec import EnsembleOptions
from dalembert.run.options import KINDS, IntegrateOptions, ResumeOptions, StepperOptions, in_c
from dalembert.system.definition import SympyOptions, SystemOptions

PAGE = Path(__file__).resolve().parents[3] / "docs" / "howto" / "steps.md"
ALL = sorted(set.union(*(set(kind.options) for kind in KINDS.values())))


def hilly(inputs=(), steep=40):
    """The particle of the paper in a valley, with inputs or without."""
    force = {"force": lambda t, q, v, u: [u[0], 0, 0]} if inputs else {}
    return dal.System(
        mass=[1, 1, 1],
        mu=lambda q: [[-q[1], 0, 1]],
        mu_v_q=lambda q, v: [[0, -v[0], 0]],
        potential=lambda q: steep * q[0] ** 4 + q[1] ** 2,
        gradient=lambda q: [4 * steep * q[0] ** 3, 2 * q[1], 0],
        hessian=lambda q: np.diag([12 * steep * q[0] ** 2, 2, 0]),
        inputs=list(inputs), q0=[0.9, 1, 0], v0=[0.1, 0, 0.1], **force,
    )  # fmt: skip


def base(kind):
    """Return the arguments of a run of this kind, without any option that can be left out."""
    plain = {"scheme": "midpoint", "h": 0.05, "t_end": 0.4}
    return {
        "fixed": plain,
        "kept": {**plain, "scheme": "midpoint-nodes", "initial": "D"},
        "auto": {**plain, "scheme": "midpoint-kl8", "h": "auto"},
        "reversible": {**plain, "scheme": "midpoint-kl8", "h": "reversible"},
        "flow": {**plain, "scheme": "reference"},
        "own": {"scheme": "reference", "t_end": 0.4},
    }[kind]


def values(option, folder):
    """Return what is given for an option, and what for comparison."""
    seen = []
    given = {
        "t0": 0.2, "t_end": 0.2, "steps": 3, "stride": 2, "t_eval": [0.1, 0.3],
        "consistent": "project", "initial": "shift", "max_iterations": 1, "energy": "keep",
        "method": "msadams", "tolerance": 1e-4, "h_max": 0.01, "eps": 0.1,
        "inputs": [3.0], "hold": 2, "journal_errors": "stop", "throw": False,
        "check_h": True, "dense": True,
        "events": [lambda t, q, v: q[0] - 0.5], "journal": folder / "run.dal",
        "observer": lambda step, t, q, v: seen.append(t),
        "progress": lambda done, total: seen.append(done),
    }[option]  # fmt: skip
    return given, seen


def fails(step, t, q, v):
    raise dal.ConvergenceError("no further")


def made(system, given):
    """Return what a run leaves: numbers, or the kind of its error."""
    try:
        run = dal.integrate(system, **given)
    except Exception as error:
        return type(error).__name__, str(error)
    return (
        run.t.tobytes(), run.x.tobytes(), run.stats, run.message, [*map(len, run.t_events)]
    )  # fmt: skip


def test_the_table_is_whole():
    taken = inspect.signature(dal.integrate).parameters.values()
    assert {p.name for p in taken if p.kind is p.KEYWORD_ONLY} == {"h", *ALL}


@pytest.mark.parametrize("option", ALL)
@pytest.mark.parametrize("kind", KINDS)
def test_each_option_has_an_effect_or_is_refused(kind, option, tmp_path):
    value, seen = values(option, tmp_path)
    plain, needed = base(kind), {}
    if option in ("inputs", "hold"):
        needed = {"inputs": [1.0] if option == "inputs" else [[3.0], [1.0], [2.0], [4.0]]}
        if kind in ("auto", "own") and option == "hold":
            value = 0.1
    if option == "journal_errors":
        needed = {"journal": tmp_path / "beside.dal"}
    with_it = {**plain, **needed, option: value}
    if option == "steps":
        del with_it["t_end"]
    if option not in KINDS[kind].options:
        given = {**plain, option: value} if option == "hold" else with_it
        with pytest.raises(ValueError, match=rf"^{option} = .*: not used with .*; "):
            dal.integrate(hilly(), **given)
        return
    system = hilly(["push"] if "inputs" in needed else ())
    if option == "max_iterations":  # of steps so long that the full iteration is needed
        system = hilly(steep=400)
        needed = {"tolerance": 0.1} if kind == "auto" else {}
    if option == "consistent":
        needed = {"q0": [0.9, 1, 0], "v0": [0.1, 0, 0.11]}
    if option == "throw":
        needed = {"observer": fails}
    with_it |= {**needed, option: value}
    without = {**plain, **needed}
    if (kind, option) == ("reversible", "max_iterations"):  # a step as long as that is shortened
        assert made(system, {**with_it, option: 0})[0] == "ValueError"
    elif option == "journal_errors":
        without["journal"] = tmp_path / "other.dal"
        assert made(system, with_it)[:2] == made(system, without)[:2]
        assert made(system, {**with_it, option: "sotp"})[0] == "ValueError"
    elif option == "check_h":
        without |= {option: False}
        assert made(system, with_it) == made(system, without)
        assert dal.integrate(system, **with_it).stats.remade > 0
        assert dal.integrate(system, **without).stats.remade == 0
        assert made(system, {**with_it, option: "no"})[0] == "ValueError"
    elif option == "journal":
        dal.integrate(system, **with_it)
        assert value.stat().st_size > 0
    elif option in ("observer", "progress"):
        dal.integrate(system, **with_it)
        assert seen
    else:
        assert made(system, with_it) != made(system, without)


def test_an_option_beside_another():
    system, plain = hilly(), base("fixed")
    with pytest.raises(ValueError, match=r"^hold = 1: not used without inputs"):
        dal.integrate(system, **plain, hold=1)
    with pytest.raises(ValueError, match=r"^journal_errors = 'warn': not used without journal"):
        dal.integrate(system, **plain, journal_errors="warn")
    with pytest.raises(ValueError, match=r"^stride = 2: not used with t_eval"):
        dal.integrate(system, **plain, stride=2, t_eval=[0.1])
    seen = []
    dal.integrate(system, **plain, stride=2, t_eval=[0.1], observer=lambda k, *_: seen.append(k))
    assert seen == [0, 2, 4, 6, 8]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"h": "auto", "t_end": 1, "steps": 10},
            "steps = 10: not used with h = 'auto'; give t_end instead, because the steps vary",
        ),
        (
            {"h": 0.1, "t_end": 1, "initial": "D"},
            "initial = 'D': not used with a fixed step at moved nodes; remove it, because "
            "only schemes with kept nodes take it, such as 'midpoint-nodes'",
        ),
        (
            {"h": 0.1, "t_end": 1, "tolerance": 1e-6},
            "tolerance = 1e-06: not used with a fixed step; remove it, or take h = 'auto', "
            "h = 'own' or the schemes 'reference' and 'taylor'",
        ),
        (
            {"scheme": "reference", "h": 1, "t_end": 1, "energy": "keep"},
            "energy = 'keep': not used with the schemes 'reference' and 'taylor'; remove it, or "
            "take a fixed step at moved nodes, h = 'auto' or h = 'reversible'",
        ),
        (
            {"h": "auto", "t_end": 1, "check_h": True},
            "check_h = True: not used with h = 'auto'; remove it, or take a fixed step",
        ),
    ],
)
def test_an_option_that_is_not_used_is_refused_in_words(given, text):
    with pytest.raises(ValueError) as caught:
        dal.integrate(hilly(), **given)
    assert str(caught.value) == text


def test_the_text_says_what_would_use_it():
    with pytest.raises(ValueError) as caught:
        dal.integrate(hilly(), h="auto", t_end=1, method="garbage")
    assert str(caught.value) == (
        "method = 'garbage': not used with h = 'auto'; remove it, or take h = 'own' or the "
        "schemes 'reference' and 'taylor'"
    )
    for scheme, why in (("reference", "own step sizes"), ("midpoint-nodes", "kept nodes")):
        with pytest.raises(ValueError, match=f"^h = 'auto' with the scheme '{scheme}'.*{why}"):
            dal.integrate(hilly(), scheme, h="auto", t_end=1)


@pytest.mark.parametrize(
    ("member", "record"),
    [
        (dal.integrate, IntegrateOptions), (dal.resume, ResumeOptions),
        (dal.Stepper, StepperOptions), (dal.ensemble, EnsembleOptions),
        (dal.System, SystemOptions), (dal.System.from_sympy, SympyOptions),
    ],
)  # fmt: skip
def test_signatures_and_docstrings_are_those_of_the_list(member, record):
    given, doc = inspect.signature(member).parameters, inspect.getdoc(member)
    section = re.split(r"\n\n\w+\n-----", doc.split("Parameters\n----------\n")[1])[0]
    heads = [line.partition(" : ")[0] for line in section.splitlines() if line[:1].strip()]
    names = [name for head in heads for name in head.split(", ")]
    assert names == [*given] == [*options_of(record)]
    for name, one in options_of(record).items():
        assert all(line.strip() in section for line in one.help.splitlines())
    first = [x for x in given.values() if x.kind is not x.KEYWORD_ONLY]
    required = [None for x in first if x.default is x.empty]
    steps = {"h": 1} if "h" in given else {}
    with pytest.raises(TypeError, match=rf"^{member.__name__}\(\): .*'nme'") as caught:
        member(*required, **steps, nme=1)
    assert ("did you mean 'name'?" in str(caught.value)) == ("name" in given)
    with pytest.raises(TypeError, match="too many positional arguments"):
        member(*[None] * 9)


def test_the_command_has_the_text_of_the_list(capsys):
    for command, record in (("run", IntegrateOptions), ("ensemble", EnsembleOptions)):
        assert cli.main([command, "--help"]) == 0
        shown = capsys.readouterr().out
        words = " ".join(shown.replace("-\n", "-").split())
        for name, one in options_of(record).items():
            there = one.parse is not None or name == "executor"
            assert (f"--{name.replace('_', '-')} " in words) == there, name
        assert "Advance several members at once" in words or command == "run"
        assert '"keep": conserve the energy to roundoff by scaling the velocity' in words
        assert "as long as --tolerance allows" in words and "With --h auto it is" in words


def test_options_of_c_are_those_of_the_list():
    given = {"max_iterations": 7, "tolerance": 1e-6, "h_max": 0.5, "eps": 0.1, "energy": "keep"}
    made = in_c({**given, "h": "auto", "system": None, "stride": 3})
    values = [made.max_iterations, made.tolerance, made.h_max, made.eps, made.keep_energy]
    assert values == [7, 1e-6, 0.5, 0.1, 1] and made is in_c(given)
    own = in_c({"h": "own"})
    assert [own.own_steps, own.tolerance] == [1, 0.0]
    names = {"", "own_steps", *(one.c for one in options_of(IntegrateOptions).values())}
    assert names == {"", *dir(made)}


@pytest.mark.parametrize("kind", ["fixed", "kept", "flow"])
@pytest.mark.parametrize("make", [dal.Stepper, dal.ensemble])
def test_steppers_and_ensembles_refuse_by_the_same_table(make, kind, tmp_path):
    given = {k: x for k, x in base(kind).items() if k in ("scheme", "h", "initial")}
    if make is dal.ensemble:
        given |= {"steps": 2, "progress": False, "threads": 1}
    for option in inspect.signature(make).parameters.keys() & {*ALL} - given.keys():
        value, _ = values(option, tmp_path)
        if option not in KINDS[kind].options:
            with pytest.raises(ValueError, match=rf"^{option} = .*: not used with "):
                make(hilly(), **given, **{option: value})
        elif option == "hold":
            with pytest.raises(ValueError, match=r"^hold = 2: not used without inputs"):
                make(hilly(), **given, hold=value)


def test_a_run_that_is_resumed_refuses_steps(tmp_path):
    system = hilly()
    path = tmp_path / "run.dal"
    dal.integrate(system, **base("auto"), journal=path)
    with pytest.raises(ValueError, match=r"^steps = 5: not used with h = 'auto'"):
        dal.resume(path, system, steps=5)
    with pytest.raises(ValueError, match="inputs"):
        dal.resume(path, system, t_end=1, inputs=[1.0])


def test_studies_refuse_what_has_no_effect():
    edge, chaotic = dal.systems.knife_edge(), dal.systems.chaotic()
    few = {"t_end": 1, "steps": [8, 16, 32]}
    with pytest.raises(ValueError, match=r"^tolerance = 1e-09: not used, .* exact solution"):
        dal.convergence(edge, "midpoint", tolerance=1e-9, **few)
    with pytest.raises(ValueError, match=r"^initial = 'D': not used with a fixed step at mo"):
        dal.convergence(edge, "midpoint", initial="D", **few)
    for given in ({"initial": "D"}, {"tolerance": 1e-9}):
        with pytest.raises(ValueError, match=r": not used by any of these schemes"):
            dal.studies(edge, ["midpoint", "leapfrog"], **given, **few)
    both = dal.studies(edge, ["midpoint", "midpoint-nodes"], initial="D", tolerance=1e-9, **few)
    assert [study.initial for study in both] == [None, "D"]
    rough, fine = (dal.convergence(chaotic, "midpoint", tolerance=x, **few) for x in (1e-3, None))
    assert rough.reference > fine.reference


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("--h auto --eps 0.1", "--eps 0.1: not used with --h auto"),
        ("--h 0.1 --tolerance 1e-6", "--tolerance 1e-06: not used with a fixed step"),
        ("--h 0.1 --h-max 1", "--h-max 1.0: not used with a fixed step; remove it, or take --h a"),
        ("--h 0.1 --initial D", "--initial D: not used"),
        ("--h 0.1 --journal-errors stop", "--journal-errors stop: not used without journal"),
        ("--h auto --initial D", "--initial D: not used with --h auto"),
        ("--h auto --steps 10", "--steps 10: not used with --h auto; give --t-end instead"),
    ],
)
def test_the_command_refuses_by_the_same_table(words, named, capsys):
    end = [] if "--steps" in words else ["--t-end", "1"]
    assert cli.main(["run", "particle", *end, *words.split()]) == 2
    assert named in capsys.readouterr().err


def test_the_page_has_the_table():
    always = set.intersection(*(set(kind.options) for kind in KINDS.values()))
    page = PAGE.read_text(encoding="utf-8").split("(options)=")[1]
    words = {name.strip("`") for name in re.search(r"accepts (.*)\. In", page)[1].split(", ")}
    assert words == always
    rows = re.findall(r"^\| (.+?) \| (`.+`) \|$", page, re.MULTILINE)
    shown = {kind: {name.strip("`") for name in names.split(", ")} for kind, names in rows}
    assert shown == {kind.asked_by: kind.options - always for kind in KINDS.values()}
