"""Haze around a scene is hidden at first, in the window, the page, exports of pages and pictures alike, and one box shows it."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.geometry.cleaning_file import cleaning_path
from radiant_viewer.open3d_window.content import load_content
from radiant_viewer.pictures.page import PANEL_PX
from radiant_viewer.pictures.splat_picture import fit_camera, render_rgbd
from radiant_viewer.runs import run_pictures
from radiant_viewer.runs.run_layers import hidden_at_first, run_layers
from radiant_viewer.runs.run_pictures import screenshot
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.runs.sent_pages import older_pages
from radiant_viewer.runs.shown_model import SURROUNDINGS, framed_box, framed_positions, model_box, seen_of, shown_model, shown_of_run
from radiant_viewer.share.folder import page_of_run
from radiant_viewer.web.start_server import PICTURE_WH, model_webp
from tests.viewer.hazy_town import NUM_HAZE, haze_share, hazy
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.town_share import shares
from tests.viewer.window_kit import run_python, virtual_display

TOWN_GAUSSIANS = 9000
SESSION = """
import json, sys
from pathlib import Path
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from radiant_core.geometry.cleaning import OpacityStep
from tests.viewer.hazy_town import haze_share
from tests.viewer.moved_views import pixels_of
from tests.viewer.window_user import until, use_window

seen = {}

def act(window):
    def look(name):
        QTest.qWait(50)
        until(lambda: window.model.shown_is_full and window.model._map_drawn == window.model._map_key(), f"never sharp: {name}")
        QTest.qWait(450)
        view, screen = window.view.plotter, pixels_of(window)
        corner, (width, height) = view.mapTo(window, view.rect().topLeft()), window.view.size_wh
        part = screen[corner.y() : corner.y() + height, corner.x() : corner.x() + width].astype(int)
        green = (part[..., 1] - part[..., 2] > 12) & (part[..., 1] >= part[..., 0])
        rows, columns = green.any(axis=1).nonzero()[0], green.any(axis=0).nonzero()[0]
        spans = [float(abs(at[-1] - at[0]) / side) if len(at) else 0.0 for at, side in ((columns, width), (rows, height))]
        seen[name] = {"haze": haze_share(screen), "town": max(spans), "drawn": window.model.num_gaussians}

    # What lies on the town in other colours is not counted.
    for name in ("Regions", "Cameras by region", "Edge loads", "Edges"):
        window.set_layer_visible(name, False)
    look("first")
    for key in range(1, 7):
        QTest.keySequence(window, QKeySequence(f"Ctrl+{key}"))
        look(f"Ctrl+{key}")
    QTest.keySequence(window, QKeySequence("F"))
    window.set_layer_visible("Surroundings", True)
    look("with surroundings")
    window.set_layer_visible("Gaussians", False)
    look("surroundings alone")
    window.set_layer_visible("Gaussians", True)
    window.set_layer_visible("Surroundings", False)
    dock = window.docks.cleaning
    assert dock.pages.button.isHidden()
    dock._add(OpacityStep(at_least=0.8))
    look("cleaned")
    seen["older"] = [window.statusBar().currentMessage(), not dock.pages.button.isHidden()]

use_window(Path(sys.argv[1]), act)
print(json.dumps(seen))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hazy") / "run"
    save_run(folder, hazy(made_up_town()))
    for page in ("report.html", "scene.html"):
        (folder / page).write_text("as it was")
    return folder


def test_the_first_look_in_the_window_is_the_town_from_every_side_and_a_box_shows_the_rest(run: Path) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    with virtual_display("1280x800x24") as display:
        result = run_python(SESSION, str(run), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-3000:]
    seen = json.loads(result.stdout.splitlines()[-1])
    for name in ("first", *(f"Ctrl+{key}" for key in range(1, 7)), "cleaned"):
        assert seen[name]["haze"] < 0.001, f"haze in {name}: {seen[name]}"
        assert seen[name]["town"] > 0.7, f"the town does not fill {name}: {seen[name]}"
        assert seen[name]["drawn"] == TOWN_GAUSSIANS
    assert seen["with surroundings"]["haze"] > 0.1 and seen["with surroundings"]["drawn"] == TOWN_GAUSSIANS + NUM_HAZE
    assert seen["surroundings alone"]["drawn"] == NUM_HAZE
    assert "report.html and scene.html show an earlier cleaning" in seen["older"][0] and seen["older"][1]
    cleaning_path(run).unlink()


def test_the_first_picture_is_the_town_and_none_of_it_is_smear(tmp_path: Path) -> None:
    town = made_up_town()
    # Wide enough that the ground has no holes by itself.
    dense = replace(town.splats, log_scales=town.splats.log_scales + np.float32(0.6))
    save_run(tmp_path / "run", hazy(replace(town, splats=dense)))
    view = load_run_view(tmp_path / "run")
    assert view.splats is not None
    (_, smeared_before), (covered, smeared) = (shares(view, splats) for splats in (view.splats, shown_of_run(view).splats))
    assert smeared_before > 0.5, "the test has no haze"
    assert covered >= 0.95 and smeared == 0


def test_the_page_on_which_runs_are_begun_shows_the_scene_alone_on_a_ground_of_any_colour(run: Path) -> None:
    view = load_run_view(run)
    assert view.splats is not None
    picture = cv2.imdecode(np.frombuffer(model_webp(run), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None and picture.shape == (PICTURE_WH[1], PICTURE_WH[0], 4)
    image, alpha = picture[..., 2::-1].astype(float), picture[..., 3:] / 255
    camera = fit_camera(framed_positions(view.scene, view.cloud_plan), PICTURE_WH)
    expected = 255 * render_rgbd(shown_of_run(view).splats, camera)[..., :3]
    # WebP changes colours by some levels.
    assert np.abs(image * alpha + 255 * (1 - alpha) - expected).mean() < 4 and expected.std() > 10
    columns, rows = (np.flatnonzero((alpha[..., 0] > 0.5).any(axis=axis)) for axis in (0, 1))
    assert np.ptp(columns) > 0.9 * PICTURE_WH[0] or np.ptp(rows) > 0.9 * PICTURE_WH[1], "the scene does not fill the picture"
    assert (alpha[:5] == 0).mean() > 0.5, "what is beside the scene is no ground of the page's"


def test_the_haze_is_a_decision_with_its_share_and_nothing_is_lost(run: Path) -> None:
    view = load_run_view(run)
    shown = shown_of_run(view)
    assert shown.decision.topic == SURROUNDINGS and shown.decision.figure == pytest.approx(
        100 * NUM_HAZE / (TOWN_GAUSSIANS + NUM_HAZE), abs=0.05
    )
    np.testing.assert_array_equal(np.flatnonzero(shown.around), np.arange(TOWN_GAUSSIANS, TOWN_GAUSSIANS + NUM_HAZE))
    assert view.model is not None
    box = framed_box(view.scene, view.cloud_plan)
    parts = [seen_of(view.model, box, lambda name, one=one: name == one) for one in ("Gaussians", SURROUNDINGS)]
    assert (parts[0] ^ parts[1]).all(), "a Gaussian is in both parts, or in none"
    assert seen_of(view.model, None, lambda name: name == "Gaussians").all(), "without a box something is hidden"


def test_a_picture_of_a_model_alone_has_its_roofs_and_pits_and_not_its_sky() -> None:
    ground, rng = made_up_town().splats, np.random.default_rng(3)
    # Like roofs and pits of a town, few beside its ground; a third of the model is its sky.
    means, parts = ground.means.copy(), {"roofs": slice(0, 400), "pits": slice(400, 800), "sky": slice(800, 3800)}
    for name, low, high in (("roofs", 6, 20), ("pits", -15, -5), ("sky", 400, 900)):
        means[parts[name], 2] += rng.uniform(low, high, len(means[parts[name]])).astype(np.float32)
    model = replace(ground, means=means)
    around = shown_model(model, model_box(model)).around
    assert around[parts["sky"]].all() and around[parts["roofs"]].mean() < 0.05 and around[parts["pits"]].mean() < 0.05
    assert around[3800:].mean() < 0.05


def test_a_model_alone_reaches_as_far_as_its_ground_goes_on() -> None:
    rng = np.random.default_rng(5)
    # Most of it in its middle, as where photographs overlap most; its haze is far and thin.
    parts = {"middle": (2000, 20.0), "ground": (6000, 40.0), "haze": (600, 200.0)}
    places = {name: rng.uniform(-half, half, (count, 2)) for name, (count, half) in parts.items()}
    places["haze"] = places["haze"][np.abs(places["haze"]).max(axis=1) > 60]
    names = np.repeat(list(parts), [len(places[name]) for name in parts])
    xy = np.concatenate([places[name] for name in parts])
    source = made_up_town().splats
    model = source.select(rng.integers(0, len(source), len(xy)))
    means = np.column_stack([xy, rng.normal(0, 0.5, len(xy))])
    model = replace(model, means=means, log_scales=np.full((len(xy), 3), np.log(0.3)), logit_opacities=np.full(len(xy), 3.0))
    around = shown_model(model, model_box(model)).around
    assert around[names == "haze"].all()
    assert around[names != "haze"].mean() < 0.02


def test_both_captions_count_all_gaussians_and_name_the_hidden(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(run_pictures, "draw_splat_view", lambda *_: None)
    monkeypatch.setattr(run_pictures, "compose_page", lambda drawing, layers, size_wh, text: told.append(text.subtitle))
    view = load_run_view(run)
    assert view.splats is not None
    run_pictures.splats_picture(view.scene, view.cloud_plan, view.splats)
    run_pictures.model_picture(view.splats)
    for caption in told:
        found = re.fullmatch(r"9,600 Gaussians, .*; the (\d+) around the scene \((\d) %\) are hidden", caption)
        assert found is not None, caption
        # Whole percent.
        assert abs(int(found[2]) - 100 * int(found[1]) / (TOWN_GAUSSIANS + NUM_HAZE)) <= 0.5
    assert len(told) == 2


def test_a_model_without_a_legend_has_the_whole_width_of_its_picture(run: Path) -> None:
    view = load_run_view(run)
    assert view.splats is not None
    picture = run_pictures.model_picture(view.splats, (960, 540))
    columns = np.flatnonzero((picture[80:] < 200).any(axis=(0, 2)))
    # Beyond where a legend would begin, and about the middle of the page.
    assert columns[-1] > 960 - PANEL_PX and abs(columns[0] + columns[-1] - 960) < 100, (columns[0], columns[-1])


def test_page_headless_pictures_and_open3d_leave_it_out_too(run: Path) -> None:
    view = load_run_view(run)
    page, whole = page_of_run(view, with_photographs=False), page_of_run(view, with_photographs=False, with_surroundings=True)
    assert len(page.splats) == TOWN_GAUSSIANS and f"the {NUM_HAZE} around the scene (6 %) are hidden" in page.about
    assert len(whole.splats) == TOWN_GAUSSIANS + NUM_HAZE and "hidden" not in whole.about
    for name in ("splats", "cameras"):
        assert haze_share(screenshot(run, name, (640, 480))) < 0.001, name
    layers = run_layers(view, with_seams=False)
    assert SURROUNDINGS in hidden_at_first(layers)
    (legend,) = next(layer for layer in layers if layer.name == SURROUNDINGS).legend
    assert legend.text == "600 Gaussians, 6.2 %"
    assert (open3d := load_content(run).splats) is not None and len(open3d) == TOWN_GAUSSIANS


def test_a_page_is_older_than_a_cleaning_until_it_is_made_anew(tmp_path: Path) -> None:
    save_run(tmp_path / "run", made_up_town())
    page, cleaning = tmp_path / "run/scene.html", cleaning_path(tmp_path / "run")
    assert older_pages(tmp_path / "run") == ()
    page.write_text("as it was")
    cleaning.write_text("{}")
    os.utime(page, (1000, 1000))
    assert older_pages(tmp_path / "run") == ("scene.html",)
    os.utime(page)
    os.utime(cleaning, (1000, 1000))
    assert older_pages(tmp_path / "run") == ()
