"""A folder of panoramas becomes a scene of faces, placed as one rig, and a model of them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.reporting import EventReporter
from radiant_app.workers.nodes import run_sfm
from radiant_app.workers.sources import FACE_MASKS, images_folder_of, load_scene_of, masks_folder_of, photographs_of_task, sfm_task
from radiant_core.errors import BadInput
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import load_ply
from radiant_core.panoramas import RIG, frame_of
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.intake import Intake
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.needs import Overrides
from tests.panorama_scene import Walk, walk, write_walk

FACES = {face.folder: face.cam_from_rig for face in RIG.faces}


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Walk]:
    """Ten panoramas with their GPS, and a mask of the lowest fifth of one of them."""
    folder, made = tmp_path_factory.mktemp("walk"), walk(10, 640, step_m=1.2)
    write_walk(folder / "images", made, gps=True)
    mask = np.full((320, 640), 255, np.uint8)
    mask[256:] = 0
    (folder / "masks").mkdir()
    cv2.imwrite(str(folder / "masks" / "pano_002.png"), mask)
    return folder, made


@pytest.fixture(scope="module")
def placed(walked: tuple[Path, Walk], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The folder of their scene, and what was told."""
    folder, told = tmp_path_factory.mktemp("placed"), list[str]()
    task = sfm_task(walked[0], SfmConfig(num_threads=1), None, Placement())
    run_sfm(folder, task, EventReporter(stage="sfm", emit=lambda event: told.append(getattr(event, "message", ""))))
    return folder, told


def true_poses(made: Walk, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Centres (C,3) and rotations (C,3,3) of faces in the town's metres."""
    rows = [made.names.index(frame_of(name)) for name in names]
    turned = [FACES[name.split("/")[0]] @ made.axes[row] for name, row in zip(names, rows, strict=True)]
    return made.centers[rows], np.array(turned)


def test_panoramas_are_found_placed_as_one_rig_and_masked(walked: tuple[Path, Walk], placed: tuple[Path, list[str]]) -> None:
    (folder, made), (work, told) = walked, placed
    task = sfm_task(folder, SfmConfig(num_threads=1), None, Placement())
    scene = load_scene_of(work)
    names = scene.cameras.names
    assert "10 photographs are panoramas: each becomes 6 faces of 204 px, placed as one rig." in told
    assert any("masks of 1 of 10 photographs are used" in message for message in told)
    assert not any("read from 6 folders" in message for message in told), "the folders are not the user's"
    # Faces of the sky see nothing that was matched.
    assert any("10 faces of panoramas see under 15 points" in message for message in told)
    assert {frame_of(name) for name in names} == set(made.names) and {name.split("/")[0] for name in names} == FACES.keys() - {"face_up"}
    assert scene.frame.kind == "metric" and photographs_of_task(task, work) == work / "faces"
    centers, rotations = true_poses(made, names)
    fit = fit_sim3(scene.cameras.centers, centers)
    # A pixel of these panoramas is 0.56°, 10 cm at the width of the street: a third of that at most.
    off_m = np.linalg.norm(fit.apply(scene.cameras.centers) - centers, axis=1)
    off_deg = angles_deg(scene.cameras.cam_from_world[:, :3, :3] @ fit.rotation.T, rotations)
    assert np.median(off_m) < 0.02 and off_m.max() < 0.05, off_m
    assert np.median(off_deg) < 0.15 and off_deg.max() < 0.4, off_deg
    assert abs(fit.scale - 1) < 0.01
    for frame in made.names:
        rows = [row for row, name in enumerate(names) if frame_of(name) == frame]
        assert np.ptp(scene.cameras.centers[rows], axis=0).max() < 1e-6, "one centre"
        rigs = [FACES[names[row].split("/")[0]].T @ scene.cameras.cam_from_world[row, :3, :3] for row in rows]
        assert np.abs(np.array(rigs) - rigs[0]).max() < 1e-7, "one rig"
    masks = masks_folder_of(work)
    assert masks is not None and {path.name for path in masks.rglob("*.png")} == {"pano_002.jpg.png"}
    assert (cv2.imread(str(masks / "face_down" / "pano_002.jpg.png"), 0) == 0).mean() > 0.3 and (work / FACE_MASKS).is_dir()
    # What other programs read has no rigs, and the scene's images alone.
    model = read_model(work / "undistorted" / "sparse")
    assert tuple(image.name for image in model.images) == names
    assert {path.relative_to(images_folder_of(work)).as_posix() for path in images_folder_of(work).rglob("*.jpg")} == set(names)


def test_panoramas_are_held_out_with_all_their_faces(placed: tuple[Path, list[str]], tmp_path: Path) -> None:
    train(TrainRequest(source=placed[0], out=tmp_path / "out", overrides=Overrides(num_steps=60, long_side_px=96)))
    rows = json.loads((tmp_path / "out" / "metrics.json").read_text())["images"]
    # Every eighth of ten.
    assert {frame_of(row["name"]) for row in rows} == {"pano_000.jpg", "pano_008.jpg"} and len(rows) >= 8
    better = [row["psnr_db"] > row["initial_psnr_db"] for row in rows]
    assert sum(better) > len(better) / 2, "training fits the held-out faces better than the points it starts from"
    assert len(load_ply(tmp_path / "out" / "scene.ply")) > 500


def angles_deg(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    traces = np.einsum("nij,nij->n", found, wanted)
    return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def test_panoramas_that_come_with_poses_are_not_asked_for(walked: tuple[Path, Walk], tmp_path: Path) -> None:
    from radiant_app.workers.sources import reconstruct_source
    from tests.colmap_projects import hamlet_model, write_project

    write_project(tmp_path / "project", hamlet_model())
    task = sfm_task(tmp_path / "project", SfmConfig(), None, Placement(), intake=Intake(panoramas="all"))
    with pytest.raises(BadInput, match="comes with poses: leave it out"):
        reconstruct_source(task, tmp_path / "work", lambda progress: None)
