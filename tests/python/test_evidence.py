"""The published experiments: rows say what they should, and the page is what the results make."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS, FOLDER = ROOT / "experiments", ROOT / "docs" / "evidence"
NAMES = sorted(p.stem for p in EXPERIMENTS.glob("*.py") if "\n    common.main(" in p.read_text())
PAGE = (ROOT / "docs" / "evidence.md").read_text(encoding="utf-8")


def run(script, *arguments):
    return subprocess.run([sys.executable, str(script), *map(str, arguments)],
                          check=False, capture_output=True, text=True)  # fmt: skip


@pytest.fixture
def experiment(tmp_path):
    """An experiment of one row, in its own folder."""

    def write(row, pixels=2):
        (tmp_path / "common.py").write_text((EXPERIMENTS / "common.py").read_text())
        path = tmp_path / "made_up.py"
        path.write_text(f'''"""Made up, for the test."""
import common
import numpy as np
def run(quick):
    return {row}, 2 if quick else 3
def draw(data):
    from matplotlib.figure import Figure
    figure = Figure()
    noise = np.random.default_rng(0).random(({pixels}, {pixels}))
    figure.subplots().imshow(noise, interpolation="nearest")
    return figure
common.main(run, draw)
''')
        return path

    return write


@pytest.mark.parametrize(
    ("row", "status", "verdict"),
    [
        ("common.near('a', 1.0, 1.1, 0.2)", 0, "agrees: off by 1.0e-01, at most 0.2"),
        ("common.near('a', 1.0, 1.1, 0.05)", 1, "FAILS: off by 1.0e-01"),
        ("common.near('a', 1.0, float('nan'), 9.0)", 1, "FAILS: off by nan"),
        ("common.near('a', 1.0, 1.1, 0.05, differs='a slip')", 0, "differs: a slip"),
        ("common.near('a', 1.0, 1.1, 0.2, differs='a slip')", 1, "UNEXPECTED, agrees: off by"),
        ("common.holds('a', 'a band', '3', True, 'below 4')", 0, "agrees: below 4"),
        ("common.holds('a', 'a band', '5', False, 'below 4')", 1, "FAILS: below 4"),
        ("common.holds('a', '-', '3', True, 'below 4')", 0, "holds: below 4"),
        ("common.near('a', 1, 1.1, 0.2, source='by hand')", 0, "by hand: 1"),
        ("common.near('a', 1, 1.1, 0.2, note='h = 1')", 0, "at most 0.2; h = 1"),
    ],
)
def test_rows_and_exit_status(experiment, tmp_path, row, status, verdict):
    done = run(experiment(f"[{row}]"), "--quick", "--folder", tmp_path / "out")
    assert done.returncode == status and verdict in done.stdout, done
    (written,) = json.loads((tmp_path / "out" / "made_up.json").read_text())["rows"]
    assert verdict in json.dumps(written)
    assert (tmp_path / "out" / "made_up.png").read_bytes().startswith(b"\x89PNG")


def test_an_experiment_without_rows_is_an_error(experiment):
    done = run(experiment("[]"), "--quick")
    assert done.returncode == 1 and "no rows" in done.stderr


def test_a_large_picture_is_an_error(experiment, tmp_path):
    path = experiment("[common.near('a', 1.0, 1.0, 0.1)]", pixels=400)
    done = run(path, "--folder", tmp_path / "out")
    assert done.returncode == 1 and "bytes, more than 60000" in done.stderr


def test_quick_writes_nothing_unless_told(experiment, tmp_path):
    before = set(tmp_path.rglob("*"))
    path = experiment("[common.near('a', 1.0, 1.0, 0.1)]")
    assert run(path, "--quick").returncode == 0
    new = {p.name for p in set(tmp_path.rglob("*")) - before}
    assert new - {"__pycache__"} <= {"common.py", "made_up.py"} | {
        n for n in new if n.endswith(".pyc")
    }


def test_page_is_what_the_results_make(tmp_path):
    done = run(EXPERIMENTS / "table.py", "--check")
    assert done.returncode == 0, done.stderr
    # and a change of either is seen
    for path in (EXPERIMENTS / "common.py", EXPERIMENTS / "table.py", *FOLDER.glob("*.json")):
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    changed = tmp_path / "docs" / "evidence.md"
    changed.write_text(PAGE.replace("| agrees", "| Agrees", 1))
    again = run(tmp_path / "experiments" / "table.py", "--check")
    assert again.returncode == 1 and "is not what its results make" in again.stderr
    assert run(tmp_path / "experiments" / "table.py").returncode == 0
    assert changed.read_text() == PAGE
    next(changed.parent.glob("evidence/*.json")).unlink()
    assert run(tmp_path / "experiments" / "table.py", "--check").returncode == 1


def test_every_experiment_has_its_place():
    assert NAMES == sorted(p.stem for p in FOLDER.glob("*.json"))
    assert NAMES == sorted(p.stem for p in FOLDER.glob("*.png"))
    assert NAMES == sorted(re.findall(r"!\[[^]]+\]\(evidence/(\w+)\.png\)", PAGE))
    assert NAMES == sorted(re.findall(r"`experiments/(\w+)\.py`", PAGE))


@pytest.mark.parametrize("name", NAMES)
def test_results_are_good(name):
    results = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    assert len(results["rows"]) > 1
    for row in results["rows"]:
        assert row["agrees"] != bool(row["differs"]), row
    assert (FOLDER / f"{name}.png").stat().st_size <= 60_000


def test_the_residual_has_its_own_name():
    """Its scale is |mu| |v| (docs/residual.md), not the sum of the |mu_i v_i|."""
    places = (FOLDER, "*.json"), (EXPERIMENTS, "*.py"), (ROOT / "examples", "*.[cp]*")
    pages = [path for folder, names in places for path in folder.glob(names)]
    texts = [page.read_text(encoding="utf-8") for page in pages if page.is_file()] + [PAGE]
    assert len(texts) > 50 and not any(re.search(r"mu\\?_i\s*v\\?_i", text) for text in texts)
