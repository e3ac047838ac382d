"""Measuring on the page that is sent: lengths that are known, with σ, and a bar of known length; places as they are named."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.splats import Splats
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.bookmarks import Bookmark, Bookmarks
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.share.folder import ScenePage, page_of_run, save_single_page
from radiant_viewer.share.scene_page import PLACES, WEAK, PageScale, overview
from tests.viewer.made_up_run import made_up_town, save_run

DEADLINE_S = 120
SIZE_WH = (760, 460)
SCALE = PageScale(unit="m", scale_sigma=0.01, place_sigma=0.02, note="scale by GPS, σ 1 %", ground=0.0)
ON_SCREEN = """(point) => {
  const camera = radiantViewer.app.root.findByName('camera').camera, v = camera.viewMatrix.data, p = camera.projectionMatrix.data;
  const times = (m, q) => [0, 1, 2, 3].map((row) => m[row] * q[0] + m[row + 4] * q[1] + m[row + 8] * q[2] + m[row + 12] * q[3]);
  const q = times(p, times(v, [...point, 1]));
  return [(q[0] / q[3] + 1) / 2 * innerWidth, (1 - q[1] / q[3]) / 2 * innerHeight];
}"""


def flat_ground(half_m: float = 15.0, step_m: float = 0.5) -> Splats:
    """Opaque discs side by side at height 0, in squares of two colours."""
    axis = np.arange(-half_m, half_m + step_m / 2, step_m)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    light = ((np.floor(x / 3) + np.floor(y / 3)) % 2)[:, None]
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1))
    return Splats(
        means=np.column_stack([x, y, np.zeros_like(x)]).astype(np.float32),
        quats=quats.astype(np.float32),
        log_scales=np.tile(np.log([0.35, 0.35, 0.01]), (len(x), 1)).astype(np.float32),
        logit_opacities=np.full(len(x), 8.0, np.float32),
        sh0=np.repeat(np.where(light > 0, 1.2, -0.8)[:, None, :], 3, axis=2).astype(np.float32),
        shN=np.zeros((len(x), 0, 3), np.float32),
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    folder = tmp_path_factory.mktemp("sent") / "town"
    save_run(folder, made_up_town(step_levels=40))
    bookmarks = Bookmarks(folder)
    pose = ViewPose(position=np.array([0.0, -80, 60]), focal_point=np.zeros(3), up=np.array([0.0, 0, 1]), angle_deg=40.0)
    bookmarks.keep(1, pose)
    bookmarks.keep(2, pose)
    record = json.loads(bookmarks.path.read_text())
    record["views"]["1"] |= {"title": "The market", "note": "Its paving is new <b>."}
    bookmarks.path.write_text(json.dumps(record))
    return load_run_view(folder)


@pytest.mark.parametrize("phone", [False, True])
def test_a_known_length_is_measured_within_its_sigma_and_the_bar_is_as_long_as_it_says(
    drawing_browser: Any, tmp_path: Path, phone: bool
) -> None:
    low, high = np.array([-15.0, -15, 0]), np.array([15.0, 15, 0])
    save_single_page(tmp_path / "a.html", ScenePage(splats=flat_ground(), title="ground", start=overview(low, high), scale=SCALE))
    size = {"width": 390, "height": 844} if phone else {"width": SIZE_WH[0], "height": SIZE_WH[1]}
    context = drawing_browser.new_context(bypass_csp=True, viewport=size, has_touch=phone, is_mobile=phone)
    page = context.new_page()
    page.set_default_timeout(1000 * DEADLINE_S)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{(tmp_path / 'a.html').as_uri()}?webgl")
    page.wait_for_function("window.radiantViewer?.state.loaded")
    page.wait_for_function("!document.getElementById('scale').hidden")
    page.add_style_tag(content=".sse-controlsHint { display: none !important; }")
    assert page.evaluate("document.documentElement.scrollWidth") == size["width"]

    said, length = page.locator("#scale").inner_text().split()[:2], float(page.locator("#scale").get_attribute("data-length"))
    assert float(said[0]) == length and said[1] == "m"
    shown_px = page.locator("#scale div").bounding_box()["width"]
    ends = [page.evaluate(ON_SCREEN, [east, 0.0, 0.0]) for east in (-length / 2, length / 2)]
    assert shown_px == pytest.approx(ends[1][0] - ends[0][0], rel=0.04), "level and across, at the middle of the ground in sight"

    if phone:
        page.locator("#open").tap()
    page.locator("#measuring").click()
    half = 3.0 if phone else 5.0
    for number, east in enumerate((-half, half)):
        x, y = page.evaluate(ON_SCREEN, [east, 0.0, 0.0])
        page.touchscreen.tap(x, y) if phone else page.mouse.click(x, y)
        page.wait_for_function(f"document.getElementById('measured').textContent.includes('{('second', 'Distance')[number]}')")
    text = page.locator("#measured").inner_text()
    found = re.search(r"Distance ([\d.]+) ± ([\d.]+) m, level ([\d.]+) ± [\d.]+ m, height (-?[\d.]+) ± ([\d.]+) m", text)
    assert found is not None, text
    distance, sigma, level, rise, rise_sigma = map(float, found.groups())
    assert abs(distance - 2 * half) < 3 * sigma and abs(level - 2 * half) < 3 * sigma and abs(rise) < 3 * rise_sigma
    # At least the share of the scale, and less than a pixel or two of the screen beside it.
    assert 0.01 * 2 * half <= sigma + 0.005 < 0.6
    assert "Scale by GPS, σ 1 %." in text and errors == []
    drawn = "document.getElementById('lines').getContext('2d').getImageData(0, 0, 9999, 9999).data.some((value) => value > 0)"
    assert page.evaluate(drawn), "the measured line is drawn over the model"
    stood = page.evaluate("radiantViewer.app.root.findByName('camera').getPosition().toString()")
    page.wait_for_timeout(800)
    assert page.evaluate("radiantViewer.app.root.findByName('camera').getPosition().toString()") == stood, "measuring moves nothing"
    context.close()


def test_places_have_titles_and_notes_and_no_file_name_is_a_title(run: RunView, tmp_path: Path) -> None:
    page = page_of_run(run, with_photographs=False)
    titles = [(place.group, place.title, place.text) for place in page.places]
    assert [title for group, title, _ in titles if group == PLACES] == [
        "Overview",
        "From above",
        "The market",
        "View 2",
        *run.cloud_plan.edge_ids,
    ]
    assert titles[2][2] == "Its paving is new <b>."
    weak = [(title, text) for group, title, text in titles if group == WEAK]
    assert all(title.startswith("Border ") for title, _ in weak[:3])
    assert "of 255 levels where the parts meet, to be seen" in weak[0][1]
    worst = min(run.placed_psnr_db, key=lambda name: run.placed_psnr_db[name])
    assert weak[3] == ("Weakest view", f"of {worst}, which took no part in the training: {run.placed_psnr_db[worst]:.1f} dB")
    assert not [title for _, title, _ in titles if title in run.scene.cameras.names]
    save_single_page(tmp_path / "a.html", page)
    text = (tmp_path / "a.html").read_text()
    scene = json.loads(text.split('id="scene-data">')[1].split("</script>")[0])
    assert [place["title"] for place in scene["places"]] == [title for _, title, _ in titles]
    marked = [place for place in scene["places"] if place["annotation"] is not None]
    assert [place["title"] for place in marked] == [each["title"] for each in scene["settings"]["annotations"]]
    assert all(place["camera"] for place in scene["places"] if place["annotation"] is None)


def test_a_bookmark_keeps_what_is_said_of_the_others_and_a_broken_title_is_refused(tmp_path: Path) -> None:
    pose = ViewPose(position=np.array([0.0, -8, 6]), focal_point=np.zeros(3), up=np.array([0.0, 0, 1]), angle_deg=40.0)
    bookmarks = Bookmarks(tmp_path)
    bookmarks.keep(1, pose)
    record = json.loads(bookmarks.path.read_text())
    record["views"]["1"]["title"] = "The gate"
    bookmarks.path.write_text(json.dumps(record))
    bookmarks.keep(2, pose)
    assert [view.title for view in bookmarks.load().values()] == ["The gate", ""]
    before = bookmarks.path.read_bytes()
    with pytest.raises(BadInput, match="cannot be printed"):
        bookmarks.save({**bookmarks.load(), 2: Bookmark(pose=pose, title="a\u0007bell")})
    assert bookmarks.path.read_bytes() == before
    bookmarks.save({2: Bookmark(pose=pose, title="The church", note="Its roof was renewed.")})
    assert [(number, view.title, view.note) for number, view in bookmarks.load().items()] == [(2, "The church", "Its roof was renewed.")]
    record["views"]["1"]["title"] = "a\u0007bell"
    bookmarks.path.write_text(json.dumps(record))
    with pytest.raises(StoreDamaged, match="cannot be printed"):
        bookmarks.load()
