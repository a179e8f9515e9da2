"""Errata: what docs/errata.md says is what docs/errata.py computes with the library."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")
TABLE = TEXT.split("<!-- table")[1].split("<!-- end of table")[0]
PROSE = TEXT.replace(TABLE, "")

spec = importlib.util.spec_from_file_location("errata", ROOT / "docs" / "errata.py")
errata = sys.modules["errata"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(errata)


def written(name):
    """Return the cells of a point in the table of the document."""
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in TABLE.splitlines() if line[:1] == "|"]
    cells = [tuple(re.sub(r"\\(.)", r"\1", cell.strip()) for cell in row) for row in rows]
    return [row for row in cells if row[0] == name]


def same(a, b):
    """Compare two entries: slopes to 0.05, numbers to their second digit."""
    if "-" in (a, b) or "0" in (a, b) or (a[:2] == "h^") != (b[:2] == "h^"):
        return a == b
    if a[:2] == "h^":
        return abs(float(a[2:]) - float(b[2:])) < 0.05
    return abs(float(a) - float(b)) <= 0.1 * float(b)


@pytest.mark.parametrize("name", errata.POINTS)
def test_point_is_shown_and_written(name):
    computed, document = errata.table([name]), written(name)
    assert len(computed) == len(document) > 0
    for row, line in zip(computed, document):
        assert row[-1] in ("printed form fails", "confirmed"), row
        assert row[:3] == line[:3] and row[-1] == line[-1]
        assert same(row[3], line[3]) and same(row[4], line[4]), (row, line)


def test_verdicts_need_both_sides():
    H = errata.H
    assert errata.order("", 2, H, H**2).shown
    assert not errata.order("", 2, H, H).shown
    assert not errata.order("", 2, H**2, H**2).shown
    assert errata.zero("", 1e-3, 1e-15).shown and errata.zero("", None, 0.0).shown
    assert not errata.zero("", 1e-3, 1e-4).shown and not errata.zero("", 1e-15, 1e-15).shown
    assert errata.nonzero("", 0.0, 1.0).shown
    assert not errata.nonzero("", 1.0, 1.0).shown and not errata.nonzero("", 0.0, 0.0).shown
    assert errata.zero("", 1e-3, 1e-4).verdict == "NOT SHOWN"


def test_every_point_has_its_place():
    """E1 to E27 stand in the document, those that are computed with their command."""
    sections = re.findall(r"^### (E\d+):", PROSE, re.M)
    slips = re.findall(r"^- (E\d+)[,:]", PROSE, re.M)
    assert sorted(sections + slips, key=lambda name: int(name[1:])) == [
        f"E{k}" for k in range(1, 28)
    ]
    assert set(sections) == set(errata.POINTS)
    command = r"^- Command: `./dev shell python docs/errata.py --only (E\d+)`$"
    assert sections == re.findall(command, PROSE, re.M)
    for part in ("Place", "Printed", "Right", "Library"):
        assert len(re.findall(f"^- {part}: ", PROSE, re.M)) == len(sections)


def test_no_measured_number_outside_the_table():
    numbers = re.findall(r"\d+\.\d+|\d[eE][-+]\d", PROSE.replace("arXiv:1407.2116", ""))
    assert numbers == ["5.2"]  # a section of the paper


def test_names_of_the_library_exist():
    headers = (ROOT / "include").rglob("*.h")
    header = "\n".join(path.read_text(encoding="utf-8") for path in headers)
    names = set(re.findall(r"\b(?:dal|DAL)_\w+", PROSE))
    assert names
    for name in names:
        assert re.search(rf"\b{name}\b", header), name


def test_command(capsys):
    assert errata.main(["--only", "E13", "E1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["point", "E1", "E13"]
    with pytest.raises(SystemExit):
        errata.main(["--only", "E14"])
    with pytest.raises(SystemExit):
        errata.main(["--only", "E1", "--write"])


def test_write_changes_the_table_only(tmp_path, monkeypatch):
    copy = tmp_path / "errata.md"
    copy.write_text(TEXT, encoding="utf-8")
    monkeypatch.setattr(errata, "DOCUMENT", copy)
    errata.write([("E1", "here", "|x_k|", "1", "0", "printed form fails")])
    text = copy.read_text(encoding="utf-8")
    assert text.replace(text.split("<!-- table")[1].split("<!-- end of table")[0], "") == PROSE
    assert r"| E1 | here | \|x\_k\| | 1 | 0 | printed form fails |" in text
