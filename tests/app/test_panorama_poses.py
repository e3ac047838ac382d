"""Panoramas that come with the poses of another program become faces with the poses that follow from them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
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


def opf(folder: Path, made: Walk) -> Path:
    """As the specification has it: a spherical sensor, ω φ κ of OpenGL's axes, a frame that is scaled and shifted."""
    scale, shift = 0.5, np.array([300.0, -40.0, 7.0])
    cameras = []
    for number, center in enumerate(made.centers):
        G = made.axes[number].T * (1, -1, -1)
        angles = np.degrees([np.arctan2(-G[1, 2], G[2, 2]), np.arcsin(G[0, 2]), np.arctan2(-G[0, 1], G[0, 0])])
        cameras.append({"id": number, "sensor_id": 7, "orientation_deg": angles.tolist(), "position": (center * scale + shift).tolist()})
    internals = {"type": "spherical", "principal_point_px": [made.width / 2, made.width / 4]}
    sensor = {"id": 7, "name": "theta", "image_size_px": [made.width, made.width // 2]}
    parts = {
        "calibrated-cameras": {"sensors": [{"id": 7, "internals": internals}], "cameras": cameras},
        "camera-list": {"cameras": [{"id": number, "uri": f"images/{name}"} for number, name in enumerate(made.names)]},
        "input-cameras": {"sensors": [sensor], "captures": []},
        "scene-reference-frame": {
            "crs": {"definition": "Arbitrary (m)"},
            "base_to_canonical": {"shift": shift.tolist(), "scale": [scale] * 3, "swap_xy": False},
        },
    }
    for name, content in parts.items():
        (folder / f"{name}.json").write_text(json.dumps({"format": f"application/opf-{name}+json", "version": "1.0", **content}))
    resources = [[{"uri": f"{name}.json", "format": f"application/opf-{name}+json"}] for name in parts]
    items = [{"id": name, "type": name, "sources": [], "resources": each} for name, each in zip(parts, resources, strict=True)]
    path = folder / "project.opf"
    path.write_text(json.dumps({"format": "application/opf-project+json", "version": "1.0", "items": items}))
    return path


def colmap(folder: Path, made: Walk, form: str) -> Path:
    """By pycolmap: cameras EQUIRECTANGULAR, points with tracks."""
    points, colors, seen = seen_points(made)
    size = (made.width, made.width // 2)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=size[0], height=size[1], params=size, camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    tracks: dict[int, pycolmap.Track] = {}
    for number, name in enumerate(made.names):
        R, shown = made.axes[number], sorted(seen[number])
        image = pycolmap.Image(name=name, camera_id=1, image_id=number + 1)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array(seen[number][row])) for row in shown])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ made.centers[number]))
        for index, row in enumerate(shown):
            tracks.setdefault(row, pycolmap.Track()).add_element(number + 1, index)
    for row, track in tracks.items():
        model.add_point3D(points[row], track, np.clip(np.round(colors[row]), 0, 255).astype(np.uint8))
    place = folder / "sparse" / "0"
    place.mkdir(parents=True)
    (model.write_text if form == "text" else model.write_binary)(place)
    return place


def made_scene(walked: tuple[Path, Walk], work: Path, path: Path | None) -> SfmResult:
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


@pytest.mark.parametrize("form", ["binary", "text"])
def test_colmaps_panoramas_are_taken_with_their_points(walked: tuple[Path, Walk], tmp_path: Path, form: str) -> None:
    folder, made = walked
    place = colmap(folder, made, form)
    assert detect_source(folder)[0] == "colmap"
    result = made_scene(walked, tmp_path, None)
    with pytest.raises(BadInput, match=r"EQUIRECTANGULAR, a panorama of 360°, which becomes flat photographs with --frames shared alone"):
        read_given_poses(folder, place)
    shutil.rmtree(folder / "sparse")
    require_true(result, made)
    (check,) = (decision for decision in result.decisions if decision.topic == "poses")
    assert check.unit == "px" and check.figure is not None and check.figure < 0.01
    assert result.warnings[0].startswith("sparse/0 of COLMAP gives the poses of 36 photographs")


@pytest.mark.parametrize("write", [metashape, transforms, opf])
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
