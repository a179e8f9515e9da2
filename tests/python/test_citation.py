"""How to cite the library: the citation file is valid, and the paper says what was measured."""

import importlib.metadata
import json
import math
import re
import statistics
import sys
import tomllib
from pathlib import Path

import pytest
from cffconvert import Citation

from dalembert.core import extras

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def paper():
    """The text of the paper, without what stands before it."""
    return (ROOT / "paper" / "paper.md").read_text(encoding="utf-8").split("\n---\n", 1)[1]


@pytest.fixture(scope="module")
def entries():
    """The entries of the bibliography, as dictionaries."""
    text = (ROOT / "paper" / "paper.bib").read_text(encoding="utf-8")
    found = {}
    for entry in re.finditer(r"^@\w+\{(\w+),\n(.*?)^\}$", text, re.MULTILINE | re.DOTALL):
        fields = re.findall(r"^ *(\w+) *= *\{(.*)\},?$", entry[2], re.MULTILINE)
        assert entry[1] not in found
        found[entry[1]] = dict(fields)
    assert len(found) == text.count("@")
    return found


def test_citation_file():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    Citation(text).validate()
    with pytest.raises(Exception, match="Additional properties"):
        Citation(text + "unknown: 1\n").validate()


def test_citation_file_cites_the_paper_of_the_bibliography(entries):
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"doi: {entries['jimenez2015']['doi']}\n" in cited
    assert entries["jimenez2015"]["doi"] in (ROOT / "README.md").read_text(encoding="utf-8")


def test_addresses_of_the_package_are_those_of_the_citation():
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    doi, arxiv = re.search(r"doi: (\S+)", cited)[1], re.search(r"arXiv:([\d.]+)", cited)[1]
    addresses = [f"https://doi.org/{doi}", f"https://arxiv.org/abs/{arxiv}"]
    assert list(project["urls"].values()) == addresses


def test_lines_to_install_can_work():
    """The package is not on PyPI, and some modules are in a package of another name."""
    texts = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for part in (".", "benchmarks", "docs", "examples", "notebooks", "python")
        for path in (ROOT / part).glob("*" if part == "." else "**/*")
        if path.suffix in (".md", ".py", ".rst", ".ipynb")
    }
    assert {"README.md", "docs/howto/install.md", "python/dalembert/core/extras.py"} < set(texts)
    wrong = r"pip install (--?\w+ )*['\"]?dalembert['\"[]"
    assert [name for name in texts if re.search(wrong, texts[name])] == []
    modules = {
        found.partition(".")[0]
        for name, text in texts.items() if name.startswith("python/")
        for found in re.findall(r'require\("([\w.]+)"', text)
    }  # fmt: skip
    assert {"PIL", "sympy"} <= modules
    provided = importlib.metadata.packages_distributions()
    for module in modules - {"nowhere"}:
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with pytest.raises(ImportError) as caught:
                extras.require(module, "this")
        assert str(caught.value).rpartition(" ")[2] in [x.lower() for x in provided[module]]


def test_every_entry_is_cited_and_every_citation_has_one(paper, entries):
    assert set(re.findall(r"@(\w+)", paper)) == set(entries)
    for key, entry in entries.items():
        assert {"author", "title", "year"} <= set(entry), key
        assert key.endswith(entry["year"]), key


def test_length(paper):
    words = paper.split("# References")[0].split()
    assert 750 <= len(words) <= 1000, len(words)


def measured():
    """What the paper says of the comparison, from its results."""
    import draw

    results = json.loads((ROOT / "docs" / "peers.json").read_text())
    problems = list(results["problems"].values())
    assert draw.page(results) == (ROOT / "docs" / "peers.md").read_text(encoding="utf-8")

    reached = [[draw.best(p["state"], a, ours) for ours in (True, False)]
               for p in problems for a in draw.ACCURACIES]  # fmt: skip
    firsts = [min(filter(None, both))[1] for both in reached if any(both)]

    def count(words, names=firsts):
        return sum(words in name for name in names)

    won = sum(name in draw.OURS for name in firsts)
    assert len(firsts) == count("heyoka") + count("GSL") + won
    numbers = [draw.power(a) for a in draw.ACCURACIES]
    ours = [draw.best(p["state"], 1e-6, True)[0] for p in problems]
    theirs = [draw.best(p["state"], 1e-6, False)[0] for p in problems]

    def between(times, others):
        ratios = [t / o for t, o in zip(times, others)]
        return f"between {min(ratios):.3g} and {max(ratios):.3g}"

    def times(name):
        return [draw.seconds_for(p["state"][name], 1e-6) for p in problems]

    bare = [ratio for ratio, _ in draw.against_heyoka(results, draw.BARE, "bare")]
    mean = math.exp(statistics.fmean(map(math.log, bare)))
    energies = [p["energy"] for p in problems if "energy" in p]

    def kept(T, but=()):
        best = [min(filter(None, draw.rivals(energy, T, but)))[1] for energy in energies]
        return [name for name in best if name in draw.OURS]

    def residual(*names):
        largest = max(p["residual"] for energy in energies for name in names
                      if name in energy["methods"]
                      for p in energy["methods"][name]["points"])  # fmt: skip
        return f"{largest:.0e}".replace("e-0", "e-")

    n = len(energies)
    often = "mostly" if 2 * count("taylor", kept(1e5)) > len(kept(1e5)) else "rarely"
    return [
        f"The state at t = {results['t_state']:g}",
        f"errors of {', '.join(numbers[:-1])} and {numbers[-1]}:",
        f"{len(firsts)} pairs of a problem and an accuracy",
        f"`dalembert` was first in {won} of them",
        f"heyoka in {count('heyoka')}",
        f"method of GSL in {count('GSL')}.",
        "For an error of 1e-6",
        f"`dalembert` took {between(ours, theirs)} times",
        f"DOP853 of SciPy took {between(times('SciPy DOP853'), ours)} times",
        f"CVODE with Adams methods {between(times('CVODE Adams'), ours)} times",
        f"took {mean:.2f} times as long as that of heyoka in the geometric mean",
        f"and {max(bare):.2f} times at most",
        f"up to t = 1e5 was that of `dalembert` on {len(kept(1e5))} of {n},",
        f"{often} with the series",
        f"up to t = 1e3 on {len(kept(1e3))} of {n}.",
        f"was {residual(*draw.OURS)} with `dalembert`",
        f"{residual('heyoka')} with heyoka",
        f"{residual('GSL rk8pd')} with GSL",
    ]  # fmt: skip


def test_every_number_of_the_comparison_is_measured(paper, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks" / "peers")
    monkeypatch.delitem(sys.modules, "draw", raising=False)
    text = " ".join(re.search(r"# Comparison\n(.*?)\n# ", paper, re.DOTALL)[1].split())
    for words in measured():
        assert words in text, words
        text = text.replace(words, "", 1)
    assert re.findall(r"\d\S*", text) == []
