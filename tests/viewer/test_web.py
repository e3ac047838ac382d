"""The web page in Chromium: layers, sorting, a camera, the tour; only its own address opens it."""

from __future__ import annotations

import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import ORANGE, VERMILLION
from radiant_viewer.layers.themes import DARK, LIGHT
from radiant_viewer.pictures.images import save_png
from radiant_viewer.runs.run_layers import run_layers
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.web.browser_splats import MARK_COLOR
from radiant_viewer.web.rows import camera_headers, camera_pictures, camera_rows, layer_row, run_camera_figures
from radiant_viewer.web.server import address_text, open_page, require_web
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import page_server

DEADLINE_S = 120
"""For each step, on a busy machine; a step takes under a second on an idle one."""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("web") / "run"
    save_run(folder, made_up_town(step_levels=40))
    # A chart is drawn on white.
    (folder / "pictures").mkdir(exist_ok=True)
    save_png(folder / "pictures/gantt.png", np.full((60, 300, 3), 255, np.uint8))
    return folder


@pytest.fixture
def address(run_folder: Path, tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("trame_vuetify", reason="the extra 'web' is not installed")
    log = tmp_path / "server.log"
    with page_server("radiant_app", "inspect", run_folder, "--web", "--port", 0, log=log, patience_s=DEADLINE_S) as (found, interrupt):
        yield found
        assert interrupt() == 130, log.read_text()
        assert "Traceback" not in log.read_text()


def picture(page: Any, view: str) -> np.ndarray:
    """What the browser shows of one view (H,W,3)."""
    pixels = page.locator(f"[data-view='{view}']").screenshot()
    image = cv2.imdecode(np.frombuffer(pixels, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


def changed_share(before: np.ndarray, after: np.ndarray) -> float:
    return float((np.abs(before.astype(int) - after).max(axis=2) > 24).mean())


def until(page: Any, view: str, is_there: Callable[[np.ndarray], bool], what: str) -> np.ndarray:
    """A view as soon as it shows what is waited for."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        now = picture(page, view)
        if is_there(now):
            return now
        page.wait_for_timeout(100)
    pytest.fail(f"within {DEADLINE_S} s the view {view!r} did not show that {what}")


def conflict_resolved(page: Any, view: str) -> np.ndarray:
    """A view that has not changed for three looks, more than the half second between frames."""
    looks = [picture(page, view)]

    def is_still(now: np.ndarray) -> bool:
        looks.append(now)
        page.wait_for_timeout(250)
        return len(looks) > 3 and now.std() > 12 and all(changed_share(look, now) == 0 for look in looks[-4:-1])

    return until(page, view, is_still, "it came to rest")


def marked(image: np.ndarray, color: tuple[int, int, int] = VERMILLION) -> int:
    """Pixels in the colour of the chosen camera."""
    return int((np.abs(image.astype(int) - color[::-1]).max(axis=2) < 30).sum())


def first_cells(page: Any) -> list[str]:
    return [row.locator("td").first.inner_text() for row in page.locator("tr[data-camera]").all()[:3]]


def test_chromium_toggles_sorts_chooses_and_tours(browser: Any, address: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1000 * DEADLINE_S)
    outside, errors = [], []
    own = address.split("/?", maxsplit=1)[0]
    page.on("request", lambda request: outside.append(request.url) if not request.url.startswith((own, "data:", "blob:")) else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    # The seams are measured last: from here on nothing changes by itself.
    page.locator("[data-layer='Seams']").wait_for()
    first = conflict_resolved(page, "Map")
    box = page.locator("[data-layer='Regions'] input")
    assert box.is_checked()
    box.click()
    until(page, "Map", lambda now: changed_share(first, now) > 0.2, "the regions' ground is gone")
    box.click()
    until(page, "Map", lambda now: changed_share(first, now) < 0.03, "the regions are back")
    solo = page.locator("[data-layer='Edges'] button", has_text="solo")
    solo.click()
    page.wait_for_function("document.querySelectorAll('[data-layer] input:checked').length === 1")
    solo.click()
    page.wait_for_function("document.querySelectorAll('[data-layer] input:checked').length > 3")

    assert first_cells(page) == ["DJI_0000.JPG", "DJI_0008.JPG", "DJI_0016.JPG"], "the worst photograph does not come first"
    page.locator("th", has_text="PSNR").click()
    page.wait_for_function("document.querySelector('tr[data-camera] td').innerText === 'DJI_0016.JPG'")
    assert first_cells(page) == ["DJI_0016.JPG", "DJI_0008.JPG", "DJI_0000.JPG"]
    assert marked(picture(page, "Map")) == marked(picture(page, "3D")) == 0
    page.locator("tr[data-camera='DJI_0016.JPG']").click()
    page.locator("[data-chosen]", has_text="DJI_0016.JPG").wait_for()
    for view in ("Map", "3D"):
        before = until(page, view, lambda now: marked(now) > 50, "a camera is chosen")
    page.locator("[data-kind='difference']").click()
    shown = page.locator(".rad-photo img")
    width, height = page.locator(".rad-photo").evaluate("box => [box.clientWidth, box.clientHeight]")
    assert width > 300
    assert width / height < 1.05 * 80 / 60, "a photograph of 4:3 does not fill the width of its panel"
    assert shown.evaluate("image => image.decode().then(() => [image.naturalWidth, image.naturalHeight])") == [80, 60]
    page.locator("[data-action='fly']").click()
    flown = until(page, "3D", lambda now: changed_share(before, now) > 0.3, "it stands where the camera stood")

    page.locator("[data-tab='seams']").click()
    page.get_by_text("Next", exact=True).click()
    page.locator("tr[data-seam].chosen").wait_for()
    steps = [float(row.locator("td").nth(1).inner_text()) for row in page.locator("tr[data-seam]").all()]
    assert steps == sorted(steps, reverse=True)
    assert steps[0] > 30, "the planted seam of 40 levels was not found"
    assert "harbour" in page.locator("tr[data-seam]").first.get_attribute("data-seam")
    until(page, "3D", lambda now: changed_share(flown, now) > 0.05, "the tour is at the worst seam")
    swatch = page.locator("[data-layer='Borders'] .rad-swatch")
    levels = "swatch => getComputedStyle(swatch).backgroundColor.match(/\\d+/g).map(Number)"
    assert max(swatch.evaluate(levels)) < 80
    page.locator("[data-action='theme']").click()
    page.wait_for_function("document.querySelector('.v-theme--dark') !== null")
    until(page, "Map", lambda now: now.mean() < 160, "the map is dark")
    # The legend follows in a message of its own.
    bright = "(levels => Math.min(...levels) > 180)(getComputedStyle(document.querySelector('[data-layer=Borders] .rad-swatch'))"
    page.wait_for_function(f"{bright}.backgroundColor.match(/\\d+/g).map(Number))")
    page.locator("[data-tab='plan']").click()
    chart = cv2.imdecode(np.frombuffer(page.locator(".rad-chart").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert chart is not None and chart.mean() < 60, "a chart is white on a dark page"
    assert (outside, errors) == ([], [])

    assert page.locator("iframe[data-loaded]").count() == 0, "without WebGL 2 the server's picture stays in sight"
    stranger = browser.new_page()
    stranger.goto(f"{own}/?secret=guessed")
    stranger.wait_for_timeout(1500)
    assert "DJI_" not in stranger.content()
    assert stranger.locator("[data-layer]").count() == 0


def test_a_browser_with_webgl_draws_the_model_itself_and_follows_the_page(drawing_browser: Any, address: str) -> None:
    page = drawing_browser.new_page(viewport={"width": 1100, "height": 700})
    page.set_default_timeout(1000 * DEADLINE_S)
    outside, errors = [], []
    own = address.split("/?", maxsplit=1)[0]
    page.on("request", lambda request: outside.append(request.url) if not request.url.startswith((own, "data:", "blob:")) else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.locator("iframe[data-loaded]").wait_for()
    frame = page.locator("iframe").element_handle().content_frame()
    assert re.fullmatch(rf"{own}/splats-\S{{22}}/scene/index\.html\?webgl", frame.url)
    position = "viewer => radiantViewer.app.root.findByName('camera').getPosition().toString()"
    stood = frame.evaluate(position)
    page.set_viewport_size({"width": 1900, "height": 900})
    scale, button = frame.locator("#scale").bounding_box(), page.locator("[data-action='splats']").bounding_box()
    assert scale["y"] > button["y"] + button["height"], "the button covers the scale bar"
    page.set_viewport_size({"width": 1100, "height": 700})
    drawn = until(page, "3D", lambda now: now.std() > 12, "the browser draws the model")
    for theme in (LIGHT, DARK):
        until(
            page,
            "3D",
            lambda now, theme=theme: marked(now, theme.view) > 0.05 * now[..., 0].size,
            f"its ground is the {theme.name} theme's",
        )
        for name, color in (("Cameras by region", ORANGE), ("Cameras by split", VERMILLION)):
            page.locator(f"[data-layer='{name}'] .v-btn").click()
            until(page, "3D", lambda now, color=color: marked(now, color) > 40, f"{name} have the colours of their legend")
            page.locator(f"[data-layer='{name}'] .v-btn").click()
        page.locator("[data-action='theme']").click()
    page.locator("tr[data-camera='DJI_0016.JPG']").click()
    until(page, "3D", lambda now: marked(now, MARK_COLOR) > 20, "the selected camera is marked")
    page.locator("[data-action='fly']").click()
    until(page, "3D", lambda now: changed_share(drawn, now) > 0.2, "the browser's view flies to the camera")
    assert frame.evaluate(position) != stood
    if os.environ.get("RADIANT_SHOT"):
        page.screenshot(path=os.environ["RADIANT_SHOT"])
    page.locator("[data-action='splats']").click()
    page.wait_for_function("getComputedStyle(document.querySelector('iframe')).display === 'none'")
    assert (outside, errors) == ([], [])
    guess = page.request.get(f"{own}/splats-guessed/index.html")
    assert guess.status == 404


def test_rows_say_every_figure_once_with_its_unit(run_folder: Path) -> None:
    run = load_run_view(run_folder)
    figures = run_camera_figures(run)
    headers, rows = camera_headers(figures), camera_rows(figures)
    titles = [header["title"] for header in headers]
    assert titles[:5] == ["Photograph", "PSNR (dB)", "Use", "Region", "Device"]
    assert len(set(titles)) == len(titles)
    assert len(rows) == 24
    assert rows[8]["psnr_db"] == "21.00"
    assert rows[1]["psnr_db"] == ""
    layers = {row["name"]: row for row in map(layer_row, run_layers(run, with_seams=False))}
    heat = layers["Cameras by PSNR"]["heat"]
    assert (heat["label"], heat["low"], heat["high"]) == ("PSNR of held-out photographs (dB)", "20", "22")
    assert heat["gradient"].startswith("linear-gradient(to right, #440154"), "the bar is not the colours of the layer"
    assert layers["Regions"]["legend"][0]["text"].startswith("north: ")


def test_pictures_come_only_where_this_machine_may_see_them(run_folder: Path) -> None:
    run = load_run_view(run_folder)
    held_out, trained = camera_pictures(run, 8), camera_pictures(run, 1)
    assert all(held_out[kind].startswith("data:image/jpeg;base64,") for kind in ("photograph", "render", "difference"))
    assert (trained["photograph"], trained["render"]) == ("", "")
    assert "stays with device" in trained["reason"]


def test_what_cannot_be_served_is_one_sentence(run_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(BadInput, match=r"cannot be bound.*another --port"):
        open_page(run_folder, print, port=taken.getsockname()[1])
    with pytest.raises(BadInput, match=r"192\.0\.2\.1"):
        open_page(run_folder, print, host="192.0.2.1", port=0)
    with pytest.raises(BadInput, match="is no run"):
        open_page(tmp_path, print, port=0)
    assert "not encrypted" in address_text("0.0.0.0", 80, "s")
    monkeypatch.setattr("radiant_core.extras.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"trame.*install.*'radiant-splats\[web\]'.*--screenshot"):
        require_web()
