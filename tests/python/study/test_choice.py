"""What the documentation says about which scheme to choose is what was measured."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
spec = importlib.util.spec_from_file_location("choose", ROOT / "benchmarks" / "choose.py")
choose = importlib.util.module_from_spec(spec)
spec.loader.exec_module(choose)
RESULTS = json.loads((choose.DOCS / "scheme.json").read_text(encoding="utf-8"))
NEARLY = 1.3  # times the fastest, the median over systems
CONSTANT, GENERAL, CHANGING = RESULTS


def without_series(kind):
    """The results of schemes that need no expressions."""
    return {
        system: {accuracy: found | {"taylor": None} for accuracy, found in by.items()}
        for system, by in RESULTS[kind].items()
    }


def ratio(kind, name, accuracy):
    results = RESULTS[kind] if name == "taylor" else without_series(kind)
    return choose.ratios(results, accuracy)[name][0]


def chosen():
    """Yield (scheme, accuracy) as the page of schemes recommends them."""
    text = (ROOT / "docs" / "reference" / "schemes.md").read_text(encoding="utf-8")
    table = text.split("| recommended for |")[1].split("\n\n")[0]
    for row in re.findall(r"^\| `.*\|$", table, re.M):
        name, *_, words = row.strip("| ").split(" | ")
        scheme = re.findall("`(.*?)`", name)[-1]
        for word in re.findall(r"`.*?`|1e-\d+", words):
            if word.startswith("`"):
                scheme = word.strip("`")
            else:
                yield scheme.removeprefix("…-"), word


def test_the_page_has_the_tables_of_the_file():
    page = (choose.DOCS / "scheme.md").read_text(encoding="utf-8")
    assert choose.page(page, RESULTS) == page
    assert set(RESULTS) == set(choose.KINDS)
    for kind, systems in RESULTS.items():
        assert set(systems) == set(choose.KINDS[kind])


@pytest.mark.parametrize("scheme, accuracy", sorted(set(chosen())))
def test_the_page_of_schemes_names_fast_ones(scheme, accuracy):
    assert ratio(CONSTANT, scheme, accuracy) <= NEARLY


def test_the_page_of_schemes_names_the_fastest():
    named = set(chosen())
    for accuracy in choose.ACCURACIES:
        columns = choose.ratios(without_series(CONSTANT), accuracy)
        fastest = min(columns, key=lambda name: columns[name][0])
        assert (fastest, accuracy) in named, (fastest, accuracy)


def test_flows_are_fast_where_the_page_of_schemes_says():
    for kind in (GENERAL, CHANGING):
        for accuracy in choose.ACCURACIES:
            assert ratio(kind, "taylor", accuracy) <= NEARLY, (kind, accuracy)
            if accuracy != "1e-3":
                assert ratio(kind, "reference", accuracy) <= NEARLY, (kind, accuracy)


def test_ratios_and_wins():
    made_up = {
        "a": {"1e-3": dict.fromkeys(choose.ORDER) | {"bm4": 2.0, "bm6": 1.0, "kl8": 3.0}},
        "b": {"1e-3": dict.fromkeys(choose.ORDER) | {"bm4": 1.0, "bm6": 4.0}},
        "c": {"1e-3": dict.fromkeys(choose.ORDER) | {"bm4": 1.0, "bm6": 3.0}},
    }
    found = choose.ratios(made_up, "1e-3")
    assert found["bm4"] == (1.0, 2) and found["bm6"] == (3.0, 1)
    assert found["kl8"] == (float("inf"), 0)
