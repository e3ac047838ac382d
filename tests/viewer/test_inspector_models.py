"""What the window shows, without it: lengths, seam stops, photographs, themes, figures, a PLY."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.ply import save_ply
from radiant_viewer.layers.palette import GREY, INK, heat_table
from radiant_viewer.layers.themes import DARK, LIGHT, apply_theme
from radiant_viewer.pictures.measure import area_text, length_text, path_length, polygon_area
from radiant_viewer.runs.photo_access import find_photograph
from radiant_viewer.runs.run_feeds import StageState
from radiant_viewer.runs.run_figures import image_figures
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.runs.seam_tour import seam_stops
from radiant_viewer.window.subject import load_subject
from tests.viewer.made_up_run import made_up_town, save_run

SQUARE = np.array([[0.0, 0], [30, 0], [30, 40], [0, 40]])


def test_the_table_of_cameras_is_saved_without_formulas(tmp_path: Path) -> None:
    table = pytest.importorskip("radiant_viewer.docks.camera_table", reason="needs PySide6")
    town = made_up_town()
    held_out, _, *others = town.scene.cameras.names
    names = (held_out, "=1+1.jpg", *others)
    scene = replace(town.scene, cameras=replace(town.scene.cameras, names=names))
    save_run(tmp_path / "run", replace(town, scene=scene))
    table.CameraTable(load_run_view(tmp_path / "run")).save_csv(tmp_path / "cameras.csv", [0, 1])
    lines = (tmp_path / "cameras.csv").read_text().splitlines()
    assert lines[2].startswith("'=1+1.jpg,") and lines[1].startswith(f"{held_out},")


@pytest.mark.parametrize("shift", [0.0, 5e6, -1e7])
def test_lengths_and_areas_are_those_of_the_ground_wherever_it_lies(shift: float) -> None:
    assert path_length(SQUARE + shift) == pytest.approx(100, rel=1e-9)
    assert polygon_area(SQUARE + shift) == pytest.approx(1200, rel=1e-7)
    assert polygon_area(SQUARE[::-1] + shift) == pytest.approx(1200, rel=1e-7)


def test_what_has_no_length_or_area_says_so() -> None:
    assert (path_length(SQUARE[:1]), polygon_area(SQUARE[:2]), path_length(np.zeros((0, 2)))) == (0, 0, 0)
    with pytest.raises(BadInput, match="cross"):
        polygon_area(np.array([[0.0, 0], [1, 1], [1, 0], [0, 2]]))
    with pytest.raises(BadInput):
        path_length(np.array([[0.0, np.nan]]))
    assert (length_text(1234.5, "m"), length_text(3.456, "units")) == ("1.234 km", "3.456 units")
    assert (area_text(12.0, "m"), area_text(25_000, "m"), area_text(3e6, "m"), area_text(2, "units")) == (
        "12 m²",
        "2.5 ha",
        "3 km²",
        "2 square units",
    )


def test_the_planted_seam_is_the_first_stop_and_is_in_view_there() -> None:
    town = made_up_town(step_levels=60)
    stops = seam_stops(town.scene, town.cloud_plan, town.splats)
    assert {frozenset(stop.figures.names) for stop in stops[:2]} == {
        frozenset(("north", "harbour")),
        frozenset(("harbour", "quarry")),
    }
    levels = [stop.figures.step_levels for stop in stops]
    assert levels[0] > 30 > 10 > levels[-1]
    assert levels == sorted(levels, reverse=True)
    camera = stops[0].view(0.0).camera((640, 360))
    in_camera = camera.cam_from_world[0] @ [*stops[0].worst, 0.0, 1.0]
    np.testing.assert_allclose((camera.Ks[0] @ in_camera[:3])[:2] / in_camera[2], (320, 180), atol=1e-6)
    few = replace(town.splats, means=town.splats.means + np.float32([1e4, 0, 0]))
    assert all(np.isnan(stop.figures.step_levels) for stop in seam_stops(town.scene, town.cloud_plan, few))


def test_a_photograph_is_found_with_its_device_and_with_nobody_else(tmp_path: Path) -> None:
    town = made_up_town()
    save_run(tmp_path / "run", town)
    run = load_run_view(tmp_path / "run")
    trained, held_out = run.scene.cameras.names.index("DJI_0009.JPG"), run.scene.cameras.names.index("DJI_0008.JPG")
    owner = run.roles.device_ids[run.roles.device_of_camera[trained]]
    elsewhere = tmp_path / "run/sfm/undistorted/images/DJI_0009.JPG"
    other = tmp_path / "run/devices" / next(name for name in run.roles.device_ids if name != owner) / "photos/DJI_0009.JPG"
    for path in (elsewhere, other):
        path.parent.mkdir(parents=True)
        path.write_bytes(b"x")
    absent = find_photograph(run, trained)
    assert absent.path is None
    assert owner in absent.reason
    own = tmp_path / "run/devices" / owner / "photos/DJI_0009.JPG"
    own.parent.mkdir(parents=True)
    own.write_bytes(b"x")
    assert find_photograph(run, trained).path == own
    assert find_photograph(run, held_out).path == tmp_path / "run/pictures/photographs/DJI_0008.JPG.png"
    (tmp_path / "run/pictures/photographs/DJI_0008.JPG.png").unlink()
    assert "held out" in find_photograph(run, held_out).reason
    climbing = replace(run.scene.cameras, names=("../../secret.jpg", *run.scene.cameras.names[1:]))
    escaping = replace(run, scene=replace(run.scene, cameras=climbing))
    assert find_photograph(escaping, 0).path is None


def test_figures_are_read_by_photograph_and_a_broken_file_is_named(tmp_path: Path) -> None:
    assert image_figures(tmp_path) == {}
    rows = [{"name": "a.jpg", "psnr_db": 21.5, "ssim": 0.7, "lpips": None, "flip": True}]
    (tmp_path / "metrics.json").write_text(json.dumps({"images": rows}))
    assert image_figures(tmp_path) == {"a.jpg": {"psnr_db": 21.5, "ssim": 0.7}}
    (tmp_path / "metrics.json").write_text('{"images": [3]}')
    with pytest.raises(StoreDamaged, match=r"metrics\.json"):
        image_figures(tmp_path)


def contrast(color: ArrayLike, ground: ArrayLike) -> float:
    """Of two colours (3,) uint8, as WCAG 2 defines it."""
    shares = np.array([color, ground]) / 255
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    darker, lighter = np.sort(linear @ (0.2126, 0.7152, 0.0722))
    return float((lighter + 0.05) / (darker + 0.05))


def test_dark_draws_ink_light_and_fills_dark_and_leaves_what_is_data(tmp_path: Path) -> None:
    save_run(tmp_path / "run", made_up_town())
    layers = {layer.name: layer for layer in load_subject(tmp_path / "run").layers}
    regions = apply_theme(layers["Regions"], DARK)
    assert (layers["Regions"].segment_colors == INK).all()
    assert (regions.segment_colors == DARK.ink).all()
    assert regions.polygon_colors.mean() < 0.6 * layers["Regions"].polygon_colors.mean()
    cameras, loads = layers["Cameras by device"], layers["Edge loads"]
    assert np.array_equal(apply_theme(cameras, DARK).point_colors, cameras.point_colors)
    filled = ~(loads.polygon_colors == 255).all(axis=1)
    assert 0 < filled.sum() < len(filled)
    assert np.array_equal(apply_theme(loads, DARK).polygon_colors[filled], loads.polygon_colors[filled])
    assert (apply_theme(loads, DARK).polygon_colors[~filled] == DARK.field).all()
    # The lowest value of a heat scale can be seen, and the legend shows the colours that are drawn.
    for name in ("Seams", "Overlap"):
        seen = apply_theme(layers[name], DARK)
        assert seen.heat is not None
        table = heat_table(seen.heat.start)
        drawn = np.concatenate([seen.segment_colors, seen.polygon_colors])
        # What was not photographed is grey and stands in the legend.
        drawn = drawn[(drawn != GREY).any(axis=1)]
        assert (drawn[:, None] == table).all(axis=2).any(axis=1).all()
        assert contrast(table[0], DARK.view) > 3 > contrast(heat_table()[0], DARK.view)
    assert apply_theme(layers["Regions"], LIGHT) is layers["Regions"]


def test_a_ply_from_elsewhere_is_shown_and_a_broken_one_refused(tmp_path: Path) -> None:
    save_ply(tmp_path / "model.ply", made_up_town().splats)
    subject = load_subject(tmp_path / "model.ply")
    assert subject.run is None
    assert [layer.name for layer in subject.layers] == ["Gaussians"]
    assert subject.model is not None
    save_ply(tmp_path / "empty.ply", subject.model.splats.select(np.zeros(0, np.int64)))
    (tmp_path / "broken.ply").write_bytes((tmp_path / "model.ply").read_bytes()[:-7])
    for name in ("empty.ply", "broken.ply", "none.ply"):
        with pytest.raises(BadInput, match=name):
            load_subject(tmp_path / name)


def test_how_much_of_a_stage_is_done() -> None:
    assert StageState(stage="sfm", state="running").share is None
    assert StageState(stage="sfm", state="running", completed=3, total=4).share == 0.75
    assert StageState(stage="sfm", state="running", completed=9, total=4).share == 1
    assert StageState(stage="sfm", state="skipped").share == 1
