"""Panoramas that come with the poses of another program become faces with the poses that follow from them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_app.workers.sources import detect_source, reconstruct_source, sfm_task
from radiant_core.errors import BadInput
from radiant_core.io.poses.recognise import read_alignment
from radiant_core.panoramas import frame_of
from radiant_core.sfm.config import SfmConfig, SfmResult
from radiant_core.sfm.given_poses import read_given_poses
from radiant_core.sfm.world_frame.placement import Placement
from tests.app.test_panoramas import angles_deg, true_poses
from tests.panorama_scene import Walk, seen_points, walk, write_walk


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Walk]:
    folder, made = tmp_path_factory.mktemp("walk"), walk(6, 640, step_m=1.2)
    write_walk(folder / "images", made, xmp=False)
    return folder, made


def opensfm(folder: Path, made: Walk, kind: str = "spherical", *, mirrored: bool = False) -> Path:
    """As OpenSfM writes it: x and y as shares of the width from the middle."""
    points, colors, seen = seen_points(made)
    shots = {}
    for number, name in enumerate(made.names):
        R = made.axes[number]
        shots[name] = {"rotation": Rotation.from_matrix(R).as_rotvec().tolist(), "translation": (-R @ made.centers[number]).tolist()}
        shots[name]["camera"] = "theta"
    described = {
        str(row): {"coordinates": xyz.tolist(), "color": [float(value) for value in rgb]}
        for row, (xyz, rgb) in enumerate(zip(points, colors, strict=True))
    }
    camera = {"projection_type": kind, "width": made.width, "height": made.width // 2}
    (folder / "reconstruction.json").write_text(json.dumps([{"cameras": {"theta": camera}, "shots": shots, "points": described}]))
    lines = ["OPENSFM_TRACKS_VERSION_v2"]
    for name, shown in zip(made.names, seen, strict=True):
        for row, (column, line) in shown.items():
            x = (column - made.width / 2) / made.width * (-1 if mirrored else 1)
            lines.append(f"{name}\t{row}\t{row}\t{x:.9f}\t{(line - made.width / 4) / made.width:.9f}\t0.001\t1\t2\t3\t-1\t-1")
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    return folder / "reconstruction.json"


def metashape(folder: Path, made: Walk) -> Path:
    """As Metashape writes it: world from camera, no calibration of a spherical sensor."""
    cameras = []
    for number, name in enumerate(made.names):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = made.axes[number].T, made.centers[number]
        text = " ".join(repr(float(value)) for value in pose.ravel())
        cameras.append(f'<camera id="{number}" sensor_id="0" label="{Path(name).stem}"><transform>{text}</transform></camera>')
    resolution = f'<resolution width="{made.width}" height="{made.width // 2}"/>'
    (folder / "cameras.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk label="c"><sensors>'
        f'<sensor id="0" label="theta" type="spherical">{resolution}</sensor></sensors><cameras>{"".join(cameras)}</cameras>'
        "<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>1</scale></transform></chunk></document>"
    )
    return folder / "cameras.xml"


def transforms(folder: Path, made: Walk) -> Path:
    """As nerfstudio writes it: world from camera with y up and z back."""
    frames = []
    for number, name in enumerate(made.names):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = made.axes[number].T * (1, -1, -1), made.centers[number]
        frames.append({"file_path": f"images/{name}", "transform_matrix": pose.tolist()})
    record = {"camera_model": "EQUIRECTANGULAR", "w": made.width, "h": made.width // 2, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(record))
    return folder / "transforms.json"


def made_scene(walked: tuple[Path, Walk], work: Path, path: Path) -> SfmResult:
    task = sfm_task(walked[0], SfmConfig(num_threads=1), None, Placement(), path)
    return reconstruct_source(task, work, lambda progress: None)


def require_true(result: SfmResult, made: Walk) -> None:
    assert result.given_frame is not None
    back = result.given_frame.given_from_scene
    centers, rotations = true_poses(made, result.scene.cameras.names)
    assert np.abs(back.apply(result.scene.cameras.centers) - centers).max() < 1e-3
    assert angles_deg(result.scene.cameras.cam_from_world[:, :3, :3] @ back.rotation.T, rotations).max() < 1e-3
    assert {frame_of(name) for name in result.scene.cameras.names} == set(made.names)


@pytest.mark.parametrize("kind", ["spherical", "equirectangular"])
def test_opensfms_panoramas_with_what_they_see(walked: tuple[Path, Walk], tmp_path: Path, kind: str) -> None:
    folder, made = walked
    path = opensfm(folder, made, kind)
    assert detect_source(folder)[2] == path
    mask = np.full((320, 640), 255, np.uint8)
    mask[300:] = 0
    (folder / "masks").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "masks" / "pano_001.png"), mask)
    result = made_scene(walked, tmp_path, path)
    for each in (path, folder / "tracks.csv", folder / "masks" / "pano_001.png"):
        each.unlink()
    (folder / "masks").rmdir()
    require_true(result, made)
    (check,) = (decision for decision in result.decisions if decision.topic == "poses")
    assert check.unit == "px" and check.figure is not None and check.figure < 0.01
    assert any("6 panoramas as 6 faces each" in decision.choice for decision in result.decisions)
    assert result.warnings[1] == "reconstruction.json of OpenSfM gives the poses of 36 photographs, 360 points, in its own unit."
    assert result.masks_folder is not None and {path.name for path in result.masks_folder.rglob("*.png")} == {"pano_001.jpg.png"}


def test_observations_of_another_convention_are_refused(walked: tuple[Path, Walk], tmp_path: Path) -> None:
    folder, made = walked
    path = opensfm(folder, made, mirrored=True)
    with pytest.raises(BadInput, match=r"does not fit its photographs: points lie .* px from where poses and lenses put them"):
        made_scene(walked, tmp_path, path)
    for each in (path, folder / "tracks.csv"):
        each.unlink()


@pytest.mark.parametrize("write", [metashape, transforms])
def test_panoramas_without_points_are_checked_by_their_faces_and_triangulated(walked: tuple[Path, Walk], tmp_path: Path, write) -> None:
    folder, made = walked
    path = write(folder, made)
    result = made_scene(walked, tmp_path / "work", path)
    require_true(result, made)
    (check,) = (decision for decision in result.decisions if decision.topic == "poses")
    assert check.unit == "px" and check.figure is not None and check.figure < 0.5 and len(result.scene.points) > 300
    turned = replace(made, axes=made.axes.transpose(0, 2, 1))
    path = write(folder, turned)
    with pytest.raises(BadInput, match="does not fit its photographs: matched points lie"):
        made_scene(walked, tmp_path / "turned", path)
    path = write(folder, made)
    with pytest.raises(BadInput, match=r"the alignment is of panoramas, .* use --frames shared"):
        read_given_poses(folder, path)
    path.unlink()


def test_what_is_no_whole_panorama_is_refused(walked: tuple[Path, Walk], tmp_path: Path) -> None:
    _, made = walked
    path = transforms(tmp_path, made)
    path.write_text(path.read_text().replace('"h": 320', '"h": 640'))
    with pytest.raises(BadInput, match="a panorama has the size 640 × 640, expected one twice as wide as high"):
        read_alignment(path, lambda name: None)
    mixed = json.loads(transforms(tmp_path, made).read_text())
    mixed["frames"][0] |= {"camera_model": "PINHOLE", "fl_x": 300}
    path.write_text(json.dumps(mixed))
    with pytest.raises(BadInput, match="has 5 panoramas among 6 photographs"):
        made_scene(walked, tmp_path / "work", path)
