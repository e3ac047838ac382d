"""The page for a browser on a phone, its first picture, and its map in panes of any shape."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_viewer.pictures.images import save_png
from radiant_viewer.runs.run_layers import hidden_at_first, run_layers
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.web.first_picture import first_page, first_picture
from tests.viewer.test_web import DEADLINE_S, address, changed_share, conflict_resolved, marked, picture, run_folder, until

__all__ = ["address", "run_folder"]
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
SHOWN = "list => list.filter(one => one.checkVisibility() && one.getClientRects().length).map(one => one.getBoundingClientRect().toJSON())"


def beside_the_edges(image: np.ndarray) -> float:
    """Of the columns at the left and right edge, how much is background: nothing of the regions is cut off."""
    columns = np.concatenate([image[40:, 2], image[40:, -3]]).astype(int)
    return float((np.abs(columns - image[-3, 2].astype(int)).max(axis=1) < 24).mean())


def test_nothing_is_cut_off_at_390_px_and_layers_are_a_sheet(browser: Any, address: str) -> None:
    context = browser.new_context(**PHONE)
    page = context.new_page()
    page.set_default_timeout(1000 * DEADLINE_S)
    page.goto(address)
    page.locator("[data-layer='Seams']").wait_for(state="attached")
    before = conflict_resolved(page, "Map")
    assert beside_the_edges(before) > 0.9
    for boxes in (page.locator("header button, header .v-btn").evaluate_all(SHOWN), page.locator(".v-tab").evaluate_all(SHOWN)):
        assert boxes and all(box["left"] >= 0 and box["right"] <= 390 for box in boxes)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    map_box, view_box = (page.locator(f"[data-view='{view}']").bounding_box() for view in ("Map", "3D"))
    assert map_box["width"] == view_box["width"] == 390 and view_box["y"] >= map_box["y"] + map_box["height"] - 1

    worst = page.locator("th", has_text="PSNR (dB)").first.bounding_box()
    assert worst["x"] + worst["width"] <= 390, "what is looked for among the cameras is out of sight"

    sheet = page.locator(".v-navigation-drawer")
    assert sheet.bounding_box()["y"] >= 844 - 1, "layers are out of the way at first"
    page.locator("[data-action='layers']").tap()
    page.wait_for_function("document.querySelector('.v-navigation-drawer').getBoundingClientRect().bottom <= 845")
    assert sheet.bounding_box()["width"] == 390
    page.locator("[data-layer='Regions'] input").click()
    page.mouse.click(195, 120)
    page.wait_for_function("document.querySelector('.v-navigation-drawer').getBoundingClientRect().top >= 843")
    until(page, "Map", lambda now: changed_share(before, now) > 0.1, "the regions' ground is gone")

    page.locator("tr[data-camera]").first.tap()
    shown = page.locator(".rad-photo img").first
    shown.wait_for()
    assert 300 < shown.bounding_box()["width"] <= 390
    until(page, "Map", lambda now: marked(now) > 20, "the chosen camera is marked")
    page.locator("[data-action='close']").tap()
    page.locator(".rad-panel").wait_for(state="hidden")
    until(page, "Map", lambda now: marked(now) < 20, "a camera that is chosen no more has no mark")
    context.close()


def test_the_map_keeps_in_sight_what_was_when_its_pane_narrows(browser: Any, address: str) -> None:
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.set_default_timeout(1000 * DEADLINE_S)
    page.goto(address)
    page.locator("[data-layer='Seams']").wait_for()
    assert beside_the_edges(conflict_resolved(page, "Map")) > 0.9
    page.locator("[data-pane='map']").click()
    assert beside_the_edges(conflict_resolved(page, "Map")) > 0.9
    page.locator("[data-pane='both']").click()
    page.set_viewport_size({"width": 820, "height": 900})
    narrow = conflict_resolved(page, "Map")
    assert narrow.shape[1] < 300 and beside_the_edges(narrow) > 0.9


def test_a_picture_stands_before_the_page_and_for_its_address_alone(browser: Any, address: str, run_folder: Path) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1000 * DEADLINE_S)
    # Without the page's libraries nothing but the first picture can be there.
    page.route("**/vuetify3.js", lambda route: route.abort())
    page.goto(address)
    page.locator("#rad-first img").wait_for()
    seen = cv2.imdecode(np.frombuffer(page.locator("#rad-first img").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert seen is not None and seen.std() > 12
    assert page.locator("#rad-first progress").get_attribute("max") == "1"
    own, secret = address.split("/?secret=")
    assert page.request.get(f"{own}/first.jpg?secret={secret}").status == 200
    other = secret[:-1] + ("y" if secret.endswith("x") else "x")
    for guess in ("first.jpg", "first.jpg?secret=", f"first.jpg?secret={other}"):
        assert page.request.get(f"{own}/{guess}").status == 404
    page.close()
    whole = browser.new_page(viewport={"width": 1280, "height": 800})
    whole.set_default_timeout(1000 * DEADLINE_S)
    whole.goto(address)
    whole.locator("#rad-first img").wait_for()
    assert whole.locator("[data-layer]").count() == 0
    whole.locator("[data-view='3D']").wait_for()
    whole.wait_for_function("!document.querySelector('.rad-first-picture') && !document.querySelector('#rad-first')")
    assert picture(whole, "3D").std() > 12, "the first picture goes when there is another"


def test_the_first_picture_is_the_reports_where_there_is_one(tmp_path: Path) -> None:
    red, drawn = np.zeros((30, 2000, 3), np.uint8), np.full((20, 40, 3), 200, np.uint8)
    red[..., 0] = 255
    decoded = cv2.imdecode(np.frombuffer(first_picture(tmp_path, lambda: drawn), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None and decoded.shape == (20, 40, 3)
    (tmp_path / "pictures").mkdir()
    save_png(tmp_path / "pictures" / "model.png", red)
    decoded = cv2.imdecode(np.frombuffer(first_picture(tmp_path, lambda: drawn), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None and decoded.shape[1] == 1280 and decoded[9, 640].tolist()[2] > 240
    assert first_page("<body></body>", 0).count("const total = 1,") == 1


def test_a_map_of_any_shape_shows_what_was_wanted_and_keeps_a_zoom(run_folder: Path) -> None:
    pytest.importorskip("trame_vuetify", reason="the extra 'web' is not installed")
    from radiant_viewer.web.scene import WebScene

    layers = run_layers(load_run_view(run_folder), with_seams=False)
    scene = WebScene(layers, hidden_at_first(layers), lambda seconds, call: None)
    camera, window = scene.map.plotter.camera, scene.map.plotter.render_window
    assert window is not None

    def halves(width: int, height: int) -> tuple[float, float]:
        window.SetSize(width, height)
        return camera.parallel_scale * width / height, camera.parallel_scale

    wide, tall = halves(900, 400), halves(200, 800)
    assert wide[1] <= tall[1] and tall[0] == pytest.approx(min(wide[0], tall[0])), "all is in sight in either shape"
    assert halves(900, 400) == pytest.approx(wide), "and the first one comes back"
    camera.parallel_scale /= 3
    zoomed = halves(900, 400)
    assert halves(300, 400)[0] == pytest.approx(zoomed[0]), "what was zoomed to stays in sight"
    assert halves(900, 400) == pytest.approx(zoomed)
    scene.close()
