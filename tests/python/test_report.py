"""The report: one page that stands alone, with the verdict first, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import re
import shlex

import pytest
from conftest import Page

import dalembert as dal
from dalembert import table

STEPS = (10, 15, 20, 30)


@pytest.fixture(scope="module")
def studies():
    return dal.studies(
        dal.systems.particle(), ["midpoint", "explicit", "midpoint-nodes", "leapfrog-suzuki4"]
    )


@pytest.fixture(scope="module")
def text(studies, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    assert dal.report.write(studies, path) == path
    return path.read_text(encoding="utf-8")


def test_the_page_stands_alone(text):
    page = Page(text)
    assert "script" not in page.tags and "link" not in page.tags and "img" not in page.tags
    assert page.tags.count("svg") == 3
    # Names of XML vocabularies and of the maker of the pictures are no addresses that are fetched.
    assert not re.search(r"(?:src|action)\s*=|@import|url\((?!#)", text)
    assert all(ref.startswith("#") for ref in re.findall(r'href="([^"]*)"', text))


def test_ids_are_unique_and_references_resolve(text):
    ids = Page(text).ids
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used and used <= set(ids)


def test_the_verdict_is_the_first_sentence(studies, text):
    words = " ".join(Page(text).words.split())
    assert words.startswith(f"dalembert study: particle {studies.sentence()}")
    assert re.search(r"<h1>([^<]*)</h1>", text).group(1) == studies.sentence()


def test_the_parts_stand_in_order(text):
    places = [
        text.index(f'aria-label="{word}')
        for word in ("Errors", "Relative residuals", "Relative energy")
    ]
    places += [text.index("<h2>Tables"), text.index("<details>")]
    assert places == sorted(places)


def test_every_number_of_the_tables_is_there(studies, text):
    for study in studies:
        assert study.text in text
        for column in table.columns(study):
            assert all(f"<td>{cell}</td>" in text for cell in column.cells)


def test_the_same_studies_give_the_same_bytes(studies, text, tmp_path):
    again = dal.report.write(list(studies), tmp_path / "again.html")
    assert again.read_bytes().decode("utf-8") == text


def test_how_to_reproduce(studies, text):
    pre = [
        part.replace("&quot;", '"').replace("&#x27;", "'")
        for part in re.findall(r"<pre>(.*?)</pre>", text, re.S)
    ]
    command = shlex.split(pre[0])
    assert command[:3] == ["dalembert", "study", "particle"]
    assert [command[i + 1] for i, word in enumerate(command) if word == "--scheme"] == [
        study.scheme.name for study in studies
    ]
    assert dal.__version__ in text
    data = json.loads(pre[1])
    assert data["q0"] == studies[0].q0.tolist() and data["t_end"] == 1
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
    assert f"<code>{digest}</code>" in text


def test_a_failure_is_said_first(tmp_path):
    claim = dal.Scheme([(0.5, 1.0)], name="<claims> 3", order=3)
    studies = dal.studies(dal.systems.particle(), [claim, "midpoint"], steps=STEPS)
    text = dal.report.write(studies, tmp_path / "report.html").read_text(encoding="utf-8")
    Page(text)
    assert "&lt;claims&gt; 3 does not deliver what is promised" in text
    assert '<span class="fails">fails</span>' in text and "<claims>" not in text


@pytest.mark.parametrize("name", ["mine", "particle"])  # also one called as the library's is
def test_a_system_of_the_users_own(name, tmp_path):
    own = dal.System(
        mass=[1, 1, 1], forms=lambda q: [[-q[1], 0, 1]], q0=[0, 1, 0], v0=[1, 1, 1], name=name
    )
    studies = dal.studies(own, ["midpoint"], steps=STEPS)
    text = dal.report.write(studies, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "one of the user's own" in text and f"dalembert study {name}" not in text


def test_a_run_that_breaks_off_is_named(tmp_path):
    # y = -1, h v_y = 2 makes the step of beta = 1 singular: here h = t_end/20 = 2 of the pictures.
    studies = dal.studies(
        dal.systems.particle(),
        ["endpoint", "midpoint"],
        [0, -1, 0],
        [1, 1, -1],
        t_end=40,
        steps=(4000, 6000, 8000),
    )
    text = dal.report.write(studies, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "broke off: endpoint" in text


def test_bad_arguments_are_named(studies, tmp_path):
    with pytest.raises(ValueError, match="studies is empty"):
        dal.report.write([], tmp_path / "report.html")
    other = dal.convergence(dal.systems.knife_edge(), "midpoint")
    with pytest.raises(ValueError, match="knife_edge, particle; expected one system"):
        dal.report.write([studies[0], other], tmp_path / "report.html")
    with pytest.raises(OSError):
        dal.report.write(studies, tmp_path / "nowhere" / "report.html")
    assert not (tmp_path / "report.html").exists()
