"""./dev, in a folder of its own, with a Python, a Meson and a pip that only log their arguments."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEV = ROOT / "dev"
STUB = r"""#!/bin/sh
log() { (IFS='|'; printf '%s\n' "$*") >>"$LOG"; }
case ${0##*/}:$* in
  python:-V) echo 'Python 3.99' ;;
  python:-\ *) printf '%s\n' "$0.whl" "$0" ;;
  python:*venv\ *)
    log venv
    mkdir -p "$4/bin"
    for name in python meson ninja; do cp "$0" "$4/bin/$name"; done
    ;;
  python:-m\ dalembert*) log "$@" ;;
  python:*pip\ *sympy*) log "$@" && [ ! -e "$LOG.late" ] ;;
  python:*pip\ *) log "$@" && [ ! -e "$LOG.full" ] ;;
  meson:configure*) log "$@" ;;
  meson:setup*)
    log "$@" && mkdir -p "$2/meson-uninstalled" && touch "$2/build.ninja"
    touch "$2/meson-uninstalled/dalembert-uninstalled.pc"
    ;;
  ninja:*) log begin && sleep 0.3 && log end ;;
  meson:*--list*nothing*) exit 1 ;;
  meson:*--list*one* | meson:*--list*quick*) echo 'house - dalembert:one' ;;
  meson:*--list*) printf '%s\n' 'house - dalembert:one' 'pages - dalembert:two' ;;
  meson:test*) log "$@" && "$DEV" build && log tested ;;
esac
"""


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A clone in a folder whose name has to be quoted; its log is beside it."""
    home = tmp_path / "it's a clone"
    home.mkdir()
    shutil.copy(DEV, home)
    python = tmp_path / "python"
    python.write_text(STUB)
    python.chmod(0o755)
    for name, value in {"PYTHON": python, "LOG": tmp_path / "log", "DEV": home / "dev"}.items():
        monkeypatch.setenv(name, str(value))
    monkeypatch.delenv("CC", raising=False)
    return home


@pytest.fixture(params=[True, False], ids=["flock", "no flock"])
def flock(request, monkeypatch, tmp_path):
    """Whether the machine has flock."""
    if not request.param:
        folders = [Path(x) for x in os.environ["PATH"].split(":")]
        tools = {tool.name: tool for x in reversed(folders) for tool in x.glob("*")}
        (tmp_path / "tools").mkdir()
        for name in tools.keys() - {"flock"}:
            (tmp_path / "tools" / name).symlink_to(tools[name])
        monkeypatch.setenv("PATH", str(tmp_path / "tools"))
    return request.param


def dev(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, **options)
    return done.returncode, done.stderr


def logged(what):
    lines = Path(os.environ["LOG"]).read_text().splitlines()
    return [line for line in lines if re.match(what, line)]


def typed(said):
    return re.search("please type:  (.*)", said)[1]


def test_one_clone_by_several_names(clone):
    link = clone.parent / "link"
    link.symlink_to(clone)
    command = clone.parent / "command"
    command.symlink_to(clone / "dev")
    for name in clone / "dev", link / "dev", command:
        assert dev(name, "build")[0] == 0
    assert len(logged("venv")) == 1 and len(logged("begin")) == 3
    assert not (clone.parent / "build-dev").exists()


def test_the_two_commands_of_the_readme(clone):
    """They do all set-up; one runs the main job, one the tests."""
    block = re.search("```sh\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    commands = block[1].splitlines()
    assert len(commands) == 2 and all(dev("sh", "-c", x, cwd=clone)[0] == 0 for x in commands)
    assert len(logged("venv")) == 1
    assert logged("-m.dalembert|tested") == ["-m|dalembert|study|particle", "tested"]


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/howto/install.md"])
def test_pages_name_commands_that_exist(page):
    named = set(re.findall(r"\./dev (\w+)", (ROOT / page).read_text(encoding="utf-8")))
    usage = subprocess.run([DEV, "help"], capture_output=True, text=True, check=True)
    commands = re.findall(r"^  (\w+)", usage.stdout + usage.stderr, re.M)
    assert named and named <= {"help", *commands}


def started(clone):
    """A ./dev that compiles."""
    building = subprocess.Popen([clone / "dev", "build"], stderr=subprocess.DEVNULL)
    while not (Path(os.environ["LOG"]).exists() and logged("begin")):
        assert building.poll() is None
    return building


def test_two_at_once(clone, flock):
    first = started(clone)
    status, said = dev(clone / "dev", "build")
    assert status == first.wait(timeout=240) == 0
    assert said.count("waiting for another ./dev in this clone") == 1
    assert logged("begin|end") == ["begin", "end"] * 2


def test_a_test_may_call_dev(clone, flock):
    assert dev(clone / "dev", "test")[0] == 0
    assert logged("begin|tested") == ["begin", "begin", "tested"]


def test_which_tests(clone):
    """Without a choice the quick ones; names and suites are looked for among all."""
    for words, passed in {
        ("-j", "1"): ["--setup", "quick", "-j", "1"], ("--full",): [], ("one",): ["one"],
    }.items():  # fmt: skip
        assert dev(clone / "dev", "test", *words)[0] == 0
        assert logged("test[|](?!.*--list)")[-1].split("|")[5:] == passed
    status, said = dev(clone / "dev", "test", "nothing", "--suite", "house")
    assert status == 3 and "both that name and that suite: nothing --suite house" in said
    assert typed(said).endswith("test --full --list")


def test_killed(clone, flock):
    """What it had started ends before another begins; without flock a line says what to do."""
    killed = started(clone)
    killed.kill()
    killed.wait()
    status, said = dev(clone / "dev", "build")
    assert status == (0 if flock else 3)
    if not flock:
        assert f"killed while it built (process {killed.pid})" in said
        assert dev("sh", "-c", typed(said))[0] == 0
    else:
        assert logged("begin|end") == ["begin", "end"] * 2


def test_lines_to_type(clone):
    """They survive the shell: a path with spaces and a quote, and `>=`."""
    full = Path(os.environ["LOG"] + ".full")
    full.touch()
    status, said = dev(clone / "dev", "build")
    assert status == 3 and "pip could not install these" in said
    full.unlink()
    assert dev("sh", "-c", typed(said), cwd=clone)[0] == 0
    first, second = logged(".*[.]whl/pip")
    assert second == first.replace("|-q|--no-compile", "") and "|meson>=1.3|" in second
    assert set(os.listdir(clone)) == {".lock", ".venv", "dev"}


def test_packages_that_the_build_does_not_wait_for(clone):
    """They are installed meanwhile; the environment is complete only with them."""
    late = Path(os.environ["LOG"] + ".late")
    late.touch()
    status, said = dev(clone / "dev", "build")
    assert status == 3 and "pip could not install these" in said
    assert logged("begin|end") == ["begin", "end"]
    late.unlink()
    assert [dev(clone / "dev", "build")[0] for _ in range(2)] == [0, 0]
    assert len(logged("venv")) == 2 and len(logged(".*[.]whl/pip.*sympy")) == 2


def test_a_shell_finds_this_python_first(clone, monkeypatch):
    """Whatever its start-up file puts first."""
    home, other = clone.parent / "home", clone.parent / "other"
    for folder in home, other:
        folder.mkdir()
    (home / ".bashrc").write_text(f"PATH={other}:$PATH; seen=1\n")
    shutil.copy(os.environ["PYTHON"], other)
    shell = clone.parent / "bash"  # the words: --rcfile FILE
    shell.write_text('#!/bin/sh\n. "$2"\necho "$seen $(command -v python)" >>"$LOG"\n')
    shell.chmod(0o755)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("SHELL", str(shell))
    status, said = dev(clone / "dev", "shell")
    assert status == 0 and "a shell with dalembert in it" in said
    assert logged("1 ") == [f"1 {clone}/.venv/bin/python"]


def test_no_such_tool(clone, monkeypatch):
    for name, what in {"PYTHON": "Python", "CC": "compiler"}.items():
        before = os.environ.get(name)
        monkeypatch.setenv(name, "/nonexistent")
        status, said = dev(clone / "dev", "build")
        assert status == 3 and f"{name}=/nonexistent: there is no such {what}" in said
        assert typed(said).startswith(f"unset {name}; ")
        if before:
            monkeypatch.setenv(name, before)
    assert dev("sh", "-c", typed(said))[0] == 0


def test_compiler_that_does_not_compile(clone, monkeypatch):
    monkeypatch.setenv("CC", "false")
    status, said = dev(clone / "dev", "build")
    assert status == 3 and "CC=false cannot compile a C program" in said


def test_read_only(clone):
    (clone / ".lock").symlink_to("nowhere/at/all")
    status, said = dev(clone / "dev", "build")
    assert status == 3 and f"nothing can be written in {clone}" in said
    assert "chmod -R u+w ~/dalembert" in typed(said)
    assert not (clone / ".venv").exists()


def test_the_site_installs_what_it_imports():
    """The gallery runs the scripts of examples/, in an environment without the tests' packages."""
    root = DEV.parent
    lists = dict(re.findall(r"^(\w*requirements)='(.*?)'", DEV.read_text(), re.M))
    docs = lists["docs_requirements"].split()
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert ["dalembert[all]", *docs] == project["optional-dependencies"]["docs"]
    files = [*root.glob("examples/*.py"), *root.glob("docs/extensions/*.py"), root / "docs/conf.py"]
    imported = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module.partition(".")[0])
    assert {"scipy", "sympy", "sphinx"} <= imported
    imported -= {*sys.stdlib_module_names, *(file.stem for file in files)}
    imported -= {"dalembert", "docutils", "distributed"}  # the last is tried, and done without
    names = [*docs, *lists["build_requirements"].split(), *lists["run_requirements"].split()]
    installed = {re.split(r"[>=\[]", name)[0] for name in names}
    assert {name.lower().replace("_", "-") for name in imported} <= installed


def test_options_of_the_build(clone):
    """As .ci/run gives them, before the first build and later."""
    for _ in range(2):
        assert dev(clone / "dev", "build", "-Dwerror=true")[0] == 0
    assert dev(clone / "dev", "build")[0] == 0
    build = clone / "build-dev"
    assert logged("setup|configure") == [
        f"setup|{build}|-Dpython=enabled|-Dwerror=true", f"configure|{build}|-Dwerror=true",
    ]  # fmt: skip


def test_another_name(clone):
    assert dev(clone / "dev", "tset")[1].startswith("dev: there is no command tset; did you mean t")
    assert "did you mean" not in dev(clone / "dev", "qqq")[1]
