"""Folders of `radiant train` and `radiant sfm` hold no plan: they are looked at, filmed and
exported all the same, or it is said what is missing and what makes it. A model alone is filmed
around its middle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from radiant_app.commands.inspect.window import run_setting
from radiant_app.commands.run.train import TrainRequest
from radiant_app.files.run_folder import Manifest
from radiant_app.workers.sources import load_scored_scene
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_scene
from radiant_core.io.run_store import write_json
from radiant_core.render.trajectories import middle_box
from radiant_core.splats import concatenate_splats
from radiant_viewer.runs.photo_access import find_photograph
from radiant_viewer.runs.run_view import is_planned, load_run_view
from radiant_viewer.window.subject import load_subject
from tests.app.test_output_commands import radiant
from tests.viewer.made_up_run import Town, made_up_town


@pytest.fixture(scope="module")
def town() -> Town:
    made = made_up_town()
    # Larger Gaussians close the ground, and a fifth of thin haze far away must not move an orbit.
    splats = replace(made.splats, log_scales=made.splats.log_scales + 0.9)
    return replace(made, splats=splats)


@pytest.fixture(scope="module")
def folders(town: Town, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The folder of `radiant sfm` and that of a training of it, with the files that the commands leave."""
    base = tmp_path_factory.mktemp("unplanned")
    sfm, trained = base / "sfm", base / "trained"
    (sfm / "undistorted/images").mkdir(parents=True)
    trained.mkdir()
    save_scene(sfm / "scene.safetensors", town.scene)
    write_json(sfm / "result.json", {"images": "undistorted/images", "masks": None})
    for name in town.scene.cameras.names[:2]:
        cv2.imwrite(str(sfm / "undistorted/images" / name), np.full((48, 64, 3), 99, np.uint8))
    manifest = Manifest(folder=trained, config=json.loads(json.dumps(TrainRequest(source=sfm, out=trained).settings, default=str)))
    manifest.save()
    save_ply(trained / "scene.ply", town.splats)
    held_out = sorted(town.scene.cameras.names)[::8]
    write_json(trained / "metrics.json", {"images": [{"name": name, "psnr_db": 20.0 + row} for row, name in enumerate(held_out)]})
    return sfm, trained


def test_a_training_is_looked_at_filmed_and_exported(folders: tuple[Path, Path], town: Town, tmp_path: Path) -> None:
    _, trained = folders
    for view in ((), ("--view", "cameras")):
        picture = tmp_path / f"a{len(view)}.png"
        radiant("inspect", trained, "--screenshot", picture, *view)
        shown = cv2.imread(str(picture))
        assert shown is not None and (shown != 255).any(axis=2).mean() > 0.02
    subject = load_subject(trained)
    assert subject.summary == "24 cameras, 9,000 points, 9,000 Gaussians"
    # Points without observations are called what they came from.
    assert [layer.name for layer in subject.layers] == ["Gaussians", "Surroundings", "Cameras by split", "Cameras by PSNR"]
    assert "made without one" in run_setting(trained).reason
    said = json.loads(radiant("render", trained, "--out", tmp_path / "held", "--long-side-px", 48, "--json"))
    assert said["pictures"] == 3, "the held-out cameras"
    said = json.loads(radiant("export", trained, tmp_path / "a.tif", "--format", "dsm", "--resolution", 2, "--long-side-px", 96, "--json"))
    assert said["crs"] == "EPSG:32631" and said["known"] > 0.5
    values = np.asarray(tifffile.imread(tmp_path / "a.tif"))
    assert 0 < np.median(values[values > -9000]) < 3
    radiant("export", trained, tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    # No region that nobody planned, and nobody's device.
    assert {feature["geometry"]["type"] for feature in features} == {"Point"}
    assert not any({"edge", "device"} & feature["properties"].keys() for feature in features)
    assert sum(feature["properties"]["held_out"] for feature in features) == 3


def test_a_training_shows_and_films_what_it_scored_where_its_scene_holds_copies(town: Town, tmp_path: Path) -> None:
    sfm, trained = tmp_path / "sfm", tmp_path / "trained"
    (sfm / "images").mkdir(parents=True)
    trained.mkdir()
    # A copy that comes first in the order of names moves every eighth photograph.
    names = town.scene.cameras.names
    order, alone = [0, *range(24)], town.scene.cameras
    poses, sizes_wh = alone.cam_from_world[order], alone.sizes_wh[order]
    cameras = Cameras(names=("A copy.JPG", *names), Ks=alone.Ks[order], cam_from_world=poses, sizes_wh=sizes_wh)
    observations = np.column_stack([np.arange(9000), np.arange(9000) % 25])
    save_scene(sfm / "scene.safetensors", replace(town.scene, cameras=cameras, observations=observations))
    for name in ("A copy.JPG", names[0]):
        cv2.imwrite(str(sfm / "images" / name), cv2.resize(np.full((4, 4, 3), 99, np.uint8), (640, 480)))
    write_json(sfm / "result.json", {"images": "images", "masks": None})
    settings = TrainRequest(source=sfm, out=trained).settings
    Manifest(folder=trained, config=json.loads(json.dumps(settings, default=str))).save()
    save_ply(trained / "scene.ply", town.splats)
    trained_on = load_scored_scene(sfm)[0].cameras.names
    scored = sorted(trained_on)[::8]
    write_json(trained / "metrics.json", {"images": [{"name": name, "psnr_db": 20.0} for name in scored]})
    run = load_run_view(trained)
    assert run.held_out == set(scored) and {cameras.names[row] for row in np.flatnonzero(run.roles.held_out)} == set(scored)
    radiant("render", trained, "--out", tmp_path / "held", "--long-side-px", 48)
    assert sorted(path.stem for path in (tmp_path / "held").iterdir()) == scored
    for folder in (trained, sfm):
        radiant("export", folder, tmp_path / f"{folder.name} colmap")
        assert [image.name for image in read_model(tmp_path / f"{folder.name} colmap" / "sparse" / "0").images] == list(
            load_scored_scene(sfm)[0].cameras.names
        )


def test_a_scene_shows_cameras_and_photographs_and_says_what_a_model_needs(folders: tuple[Path, Path], tmp_path: Path) -> None:
    sfm, trained = folders
    radiant("inspect", sfm, "--screenshot", tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5000
    radiant("export", sfm, tmp_path / "colmap")
    assert len(read_model(tmp_path / "colmap" / "sparse" / "0").images) == 24
    for folder in (sfm, trained):
        assert is_planned(folder)
        assert find_photograph(load_run_view(folder), 1).path == sfm / "undistorted/images" / "DJI_0001.JPG"
    assert "no longer where" in find_photograph(load_run_view(sfm), 5).reason
    ortho = ("export", sfm, tmp_path / "a.tif", "--format", "ortho")
    for arguments in (("export", sfm, tmp_path / "a.ply"), ortho, ("inspect", sfm, "--view", "splats")):
        with pytest.raises(BadInput, match=r"radiant train .* --out MODEL"):
            radiant(*arguments, *(("--screenshot", tmp_path / "b.png") if arguments[0] == "inspect" else ()))
    with pytest.raises(BadInput, match=r"radiant train .* --out MODEL"):
        radiant("render", sfm, "--out", tmp_path / "film", "--trajectory", "orbit")


def test_an_orbit_of_a_training_or_a_model_alone_shows_the_town(folders: tuple[Path, Path], town: Town, tmp_path: Path) -> None:
    far = town.splats.select(np.arange(0, 9000, 5))
    haze = replace(far, means=far.means * 40, logit_opacities=np.full_like(far.logit_opacities, -3.0))
    save_ply(tmp_path / "model.ply", concatenate_splats([town.splats, haze]))
    options = ("--trajectory", "orbit", "--frames", 2, "--size", "96x64")
    for place, name in ((folders[1], "trained"), (tmp_path / "model.ply", "model")):
        radiant("render", place, "--out", tmp_path / name, *options)
        for index in range(2):
            frame = cv2.imread(str(tmp_path / name / f"frame_{index:05d}.png"))
            # The town fills a good part of the frame, and its middle is that of the frame.
            assert frame is not None and (frame[24:40, 36:60].max(axis=2) > 40).mean() > 0.9
    with pytest.raises(BadInput, match="no borders to fly along: use --trajectory orbit"):
        radiant("render", tmp_path / "model.ply", "--out", tmp_path / "b", "--trajectory", "border")
    with pytest.raises(BadInput, match="made without a plan"):
        radiant("inspect", folders[1], "--screenshot", tmp_path / "b.png", "--view", "seams")


def test_what_is_not_trained_yet_names_the_command_that_goes_on(folders: tuple[Path, Path], tmp_path: Path) -> None:
    _, trained = folders
    begun = tmp_path / "begun"
    begun.mkdir()
    (begun / "manifest.json").write_bytes((trained / "manifest.json").read_bytes())
    with pytest.raises(BadInput, match=r"the training is not finished, finish it with 'radiant train … --out .*begun --resume'"):
        radiant("export", begun, tmp_path / "a.ply")
    moved = json.loads((trained / "manifest.json").read_text())
    moved["config"]["source"] = str(tmp_path / "gone")
    write_json(begun / "manifest.json", moved)
    assert not is_planned(begun)
    (begun / "scene.ply").write_bytes((trained / "scene.ply").read_bytes())
    with pytest.raises(BadInput, match=r"which holds no scene any more: put it back, or look at the model alone, .*scene\.ply"):
        load_run_view(begun)


def test_the_middle_box_ignores_a_third_that_lies_far_away() -> None:
    rng = np.random.default_rng(0)
    near, far = rng.uniform(-10, 10, (2000, 3)), rng.uniform(500, 900, (900, 3))
    low, high = middle_box(near)
    np.testing.assert_allclose([low, high], [[-10] * 3, [10] * 3], atol=1)  # 2,000 samples: medians within 0.05 of the width
    low, high = middle_box(np.concatenate([near, far]))
    assert (low > -25).all() and (high < 30).all()
