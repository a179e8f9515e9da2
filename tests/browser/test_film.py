"""The page of a film in a browser: what is seen, and what keys and buttons do."""

from __future__ import annotations

import io
import shutil

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import sync_playwright

import dalembert as dal

FRAMES = 20


@pytest.fixture(scope="module")
def browser():
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    assert program, "no chromium: apt install chromium"
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def run():
    return dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=4)


@pytest.fixture(scope="module")
def file(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.html"
    dal.plot.animate(run, fps=10, seconds=FRAMES / 10).save(path)
    return path


@pytest.fixture
def visit(browser):
    """Open a file; nothing but it may be asked for, and no script may fail."""
    wrong, pages = [], []

    def opened(path, width=900, **options):
        page = browser.new_page(viewport={"width": width, "height": 900}, **options)
        pages.append(page)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text))
        page.on("request", lambda x: x.url.startswith("file:") or wrong.append(x.url))
        page.goto(path.as_uri())
        return page

    yield opened
    assert wrong == []
    for page in pages:
        page.close()


@pytest.fixture
def still(visit, file):
    """The page where motion is not wanted: it does not move by itself."""
    return visit(file, reduced_motion="reduce")


def pixels(page, selector="#film"):
    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"))


def place(page):
    return int(page.locator("#place").input_value())


def has(picture, colour):
    """How many pixels are near a colour."""
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - wanted).max(axis=2) < 12).sum())


def test_the_keys_step_through_the_frames(still):
    assert place(still) == 0 and still.text_content("#clock") == "t = 0.0"
    first = pixels(still)
    still.keyboard.press("ArrowRight")
    assert place(still) == 1
    assert (pixels(still) != first).any()
    still.keyboard.press("End")
    assert place(still) == FRAMES - 1 and still.text_content("#clock") == "t = 4.0"
    still.keyboard.press("ArrowRight")
    assert place(still) == FRAMES - 1
    still.keyboard.press("Home")
    still.keyboard.press("ArrowLeft")
    assert place(still) == 0
    assert (pixels(still) == first).all()


def test_the_slider_leads_to_a_frame(still):
    slider = still.locator("#place")
    slider.fill("7")
    assert still.text_content("#clock") == slider.get_attribute("aria-valuetext") == "t = 1.5"
    slider.focus()
    still.keyboard.press("ArrowRight")
    assert place(still) == 8


def test_the_blade_is_drawn_where_it_is(still, run):
    """Its colour is that of nothing else on the picture."""
    still.locator("#place").fill("12")
    picture = pixels(still)
    near = np.abs(picture.astype(int) - [0xD5, 0x5E, 0x00]).max(axis=2) < 30
    rows, columns = np.nonzero(near)
    assert len(rows) > 10
    film = dal.plot.animate(run, fps=10, seconds=FRAMES / 10)
    (edge,) = (x for x in film._scene.frames[12] if x.role == "blade")
    low, high = film._scene.limits
    height, width = picture.shape[:2]
    unit = min(width / (high - low)[0], (height - 18) / (high - low)[1])
    x = width / 2 + unit * (edge.middle[0] - (low + high)[0] / 2)
    y = (height - 18) / 2 - unit * (edge.middle[1] - (low + high)[1] / 2)
    assert abs(columns.mean() - x) < 3 and abs(rows.mean() - y) < 3


def test_it_plays_pauses_and_stops_at_the_end_where_motion_is_not_wanted(still):
    assert still.text_content("#play") == "Play"
    still.locator("#play").click()
    assert still.text_content("#play") == "Pause"
    still.wait_for_function("document.getElementById('place').value > 2")
    still.keyboard.press("Escape")
    still.locator("#film").click()  # so that the blank is not for the button
    still.evaluate("document.activeElement.blur()")
    still.keyboard.press(" ")
    assert still.text_content("#play") == "Play"
    stopped = place(still)
    still.wait_for_timeout(300)
    assert place(still) == stopped > 0
    still.keyboard.press(" ")
    last = FRAMES - 1
    still.wait_for_function(f"document.getElementById('place').value == {last}")
    still.wait_for_function("document.getElementById('play').textContent == 'Play'")
    assert place(still) == last
    still.locator("#play").press(" ")  # once, not twice: from the start again
    assert still.text_content("#play") == "Pause"
    still.wait_for_function(f"document.getElementById('place').value < {last}")


def test_it_moves_by_itself_in_time_and_starts_again(visit, file):
    page = visit(file, reduced_motion="no-preference")
    assert page.text_content("#play") == "Pause"
    page.evaluate(
        """() => {
            window.seen = [];
            const place = document.getElementById("place");
            const look = (t) => {
                seen.push([t, Number(place.value)]);
                requestAnimationFrame(look);
            };
            requestAnimationFrame(look);
        }"""
    )
    page.wait_for_timeout(2600)
    seen = np.array(page.evaluate("seen"))
    jumps = np.flatnonzero(np.diff(seen[:, 1]) < 0)
    assert len(jumps) >= 1  # 2 seconds long
    before = seen[: jumps[0] + 1]
    speed = np.polyfit(before[:, 0] / 1000, before[:, 1], 1)[0]
    assert 8 < speed < 12


@pytest.mark.parametrize("width", [360, 900])
def test_nothing_sticks_out(visit, file, width):
    page = visit(file, width, reduced_motion="reduce")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("#film", "#play", "#place", "#clock"):
        box = page.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
    assert page.locator("#play").bounding_box()["height"] >= 40


def test_light_and_dark(visit, file):
    page = visit(file, color_scheme="light", reduced_motion="reduce")
    assert has(pixels(page), "#ffffff") > 1000 and has(pixels(page), "#d55e00") > 10
    page.emulate_media(color_scheme="dark")
    assert has(pixels(page), "#16181b") > 1000 and has(pixels(page), "#ff8a3d") > 10
    assert has(pixels(page), "#ffffff") == 0


def test_the_curves_have_a_cursor(still):
    curves = still.locator(".curve")
    assert curves.count() == 2
    columns = []
    for key in ("Home", "End"):
        still.keyboard.press(key)
        for k in range(2):
            still.locator(".curve").nth(k).scroll_into_view_if_needed()
            shot = Image.open(io.BytesIO(curves.nth(k).screenshot())).convert("RGB")
            red, _, blue = np.moveaxis(np.asarray(shot).astype(int), 2, 0)
            columns.append(np.nonzero(red > blue + 60)[1].mean())  # a line between two pixels
    width = curves.nth(0).bounding_box()["width"]
    np.testing.assert_allclose(columns, [62, 62, width - 8, width - 8], atol=3)
    assert curves.nth(0).get_attribute("aria-label") == "E − E₀ over time"


def test_what_a_user_writes_is_text(visit, tmp_path):
    name = "</script><script>alert(1)</script><img src=x onerror=alert(2)>$x${1}{{ 7*7 }}"
    system = dal.System(mass=[1, 1], name=name, coordinates=["<b>", "$`${2}"])
    run = dal.integrate(system, "leapfrog", [0, 0], [1, 0], h=0.1, steps=5)
    path = tmp_path / "film.html"
    dal.plot.animate(run).save(path)
    page = visit(path, reduced_motion="reduce")
    assert page.text_content("h1") == name == page.title()
    assert page.locator("img").count() == 0 and page.locator("script").count() == 2


def test_a_film_of_one_frame_has_no_controls(visit, tmp_path):
    run = dal.integrate(dal.systems.disk(), "leapfrog", h=0.1, steps=0)
    path = tmp_path / "film.html"
    dal.plot.animate(run).save(path)
    page = visit(path)
    assert not page.locator("#play").is_visible()
    assert has(pixels(page), "#d55e00") > 0
    page.keyboard.press("ArrowRight")
    assert page.locator("#place").input_value() == "0"


def test_a_film_in_a_notebook_waits(visit, run, tmp_path):
    path = tmp_path / "notebook.html"
    text = dal.plot.animate(run, fps=10, seconds=2)._repr_html_()
    path.write_text(f"<!DOCTYPE html><meta charset=utf-8>{text}", encoding="utf-8")
    page = visit(path, reduced_motion="no-preference")
    frame = page.frame_locator("iframe")
    assert frame.locator("#play").text_content() == "Play"
    frame.locator("#play").click()
    assert frame.locator("#play").text_content() == "Pause"


@pytest.mark.parametrize("chosen", ["light", "dark"])
def test_a_film_in_a_page_has_the_colours_of_the_page(visit, run, tmp_path, chosen):
    path = tmp_path / "page.html"
    text = dal.plot.animate(run, fps=10, seconds=2)._repr_html_()
    path.write_text(
        f"<!DOCTYPE html><html style='color-scheme:{chosen}'><meta charset=utf-8>{text}",
        encoding="utf-8",
    )
    papers = {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 24, 27)"}
    other = "light" if chosen == "dark" else "dark"
    page = visit(path, color_scheme=other, reduced_motion="reduce")
    body = page.frame_locator("iframe").locator("body")
    paper = "document => getComputedStyle(document).backgroundColor"
    assert body.evaluate(paper) == papers[chosen]
    page.evaluate(f"document.documentElement.style.colorScheme = '{other}'")
    page.wait_for_timeout(100)
    assert body.evaluate(paper) == papers[other]


@pytest.mark.parametrize("width", [360, 900])
@pytest.mark.parametrize("name", ["sleigh", "knife_edge", "particle"])
def test_a_film_fits_in_its_frame(visit, tmp_path, name, width):
    run = dal.integrate(dal.systems.get(name), "leapfrog", h=0.02, t_end=4)
    path = tmp_path / "page.html"
    text = dal.plot.animate(run, fps=10, seconds=1)._repr_html_()
    path.write_text(f"<!DOCTYPE html><meta charset=utf-8>{text}", encoding="utf-8")
    page = visit(path, width, reduced_motion="reduce")
    inner = page.frame_locator("iframe").locator("html")
    assert inner.evaluate("x => x.scrollHeight <= innerHeight && x.scrollWidth <= innerWidth")


@pytest.mark.parametrize("name", ["rolling_disc", "ball_on_table", "particle", "chaotic"])
def test_films_in_space_and_of_several_points(visit, tmp_path, name):
    run = dal.integrate(dal.systems.get(name), "leapfrog", h=0.02, t_end=4)
    path = tmp_path / "film.html"
    dal.plot.animate(run, fps=10, seconds=1).save(path)
    page = visit(path, reduced_motion="reduce")
    first = pixels(page)
    page.keyboard.press("End")
    assert (pixels(page) != first).mean() > 1e-4
    assert has(first, "#1a1a1a") > 0  # a dot
