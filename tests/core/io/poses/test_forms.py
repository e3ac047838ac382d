"""The forms that files of one program take, and what is refused of them, each by its name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PoseFile
from radiant_core.io.poses.recognise import format_of, read_alignment
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import Truth

SIZE = (320, 240)
NAMES = ["a b.jpg", "c.jpg"]
TRUTH = Truth(
    names=NAMES,
    R=np.tile(writers.F, (2, 1, 1)),
    t=np.array([[0.0, 0, 9], [0.5, 0, 9]]),
    points=np.eye(3),
    colors=np.full((3, 3), 9, np.uint8),
    dist=(0.1, 0.01, 0.001, 0.002, 0.003),
    seen=[(np.array([[20.0, 30], [40, 50], [60, 70]]), np.arange(3))] * 2,
)


def read(path: Path) -> PoseFile:
    return read_alignment(path, lambda name: SIZE if name.rpartition("/")[2].removesuffix(".jpg") in ("a b", "c", "r_0", "r_1") else None)


def edited(path: Path, edit: Callable[[Any], Any]) -> Path:
    """The JSON of a file after an edit."""
    record = json.loads(path.read_text())
    path.write_text(json.dumps(edit(record) or record))
    return path


def test_blender_has_an_angle_and_names_without_ending_in_three_files(tmp_path: Path) -> None:
    for number, split in enumerate(("train", "val", "test")):
        frames = [{"file_path": f"./{split}/r_{each}", "transform_matrix": np.eye(4).tolist()} for each in range(2)]
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.7 + 0 * number, "frames": frames}))
    alignment = read(tmp_path / "transforms_val.json")
    (lens,) = alignment.lenses.values()
    assert alignment.program == "Blender" and [view.name for view in alignment.views][:3] == ["train/r_0", "train/r_1", "val/r_0"]
    assert lens == Lens(size_wh=SIZE, fx=160 / np.tan(0.35), fy=160 / np.tan(0.35), cx=160, cy=120)


def test_instant_ngp_says_that_its_frame_is_lost(tmp_path: Path) -> None:
    path = edited(
        writers.transforms(tmp_path, TRUTH, applied=False), lambda top: {**top, "aabb_scale": 16, "w": 320.0, "camera_model": None}
    )
    alignment = read(path)
    assert alignment.program == "instant-ngp" and "turns, moves and scales" in alignment.notes[0]


def test_frames_have_lenses_of_their_own_and_an_applied_scale_is_undone(tmp_path: Path) -> None:
    def edit(top: dict[str, Any]) -> dict[str, Any]:
        top["frames"][1]["fl_x"] = 300.0
        for frame in top["frames"]:
            frame["transform_matrix"] = (np.diag([4, 4, 4, 1]) @ np.array(frame["transform_matrix"])).tolist()
            rotation = np.array(frame["transform_matrix"])
            rotation[:3, :3] /= 4
            frame["transform_matrix"] = rotation.tolist()
        return {**top, "applied_scale": 4.0}

    alignment = read(edited(writers.transforms(tmp_path, TRUTH), edit))
    assert sorted(lens.fx for lens in alignment.lenses.values()) == [211.0, 300.0]
    centers = np.array([-view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3] for view in alignment.views])
    assert np.allclose(centers, TRUTH.C, atol=1e-12)


@pytest.mark.parametrize("kind", ["perspective", "fisheye", "fisheye_opencv"])
def test_lenses_of_opensfm(kind: str, tmp_path: Path) -> None:
    def edit(parts: list[Any]) -> list[Any]:
        camera = {"projection_type": kind, "width": 320, "height": 240, "focal": 0.5, "k1": -0.1, "k2": 0.02, "k3": 0.003, "k4": 0.004}
        for part in parts:
            part["cameras"] = {"v2 lens": camera}
        return parts

    (lens,) = read(edited(writers.opensfm(tmp_path, TRUTH), edit)).lenses.values()
    theta = 0.6
    x = np.tan(theta) if kind == "perspective" else theta
    bent = x * (1 - 0.1 * x**2 + 0.02 * x**4 + (0.003 * x**6 + 0.004 * x**8 if kind == "fisheye_opencv" else 0))
    assert np.allclose(lens.img_from_cam(np.array([[np.sin(theta), 0, np.cos(theta)]])), [[160 + 160 * bent, 120]], atol=1e-12)
    assert lens.camera(1) is not None


def test_lenses_of_metashape_before_2017(tmp_path: Path) -> None:
    path = writers.metashape(tmp_path, TRUTH)
    text = path.read_text()
    old = "<resolution width='320' height='240'/><fx>210</fx><fy>212</fy><cx>161</cx><cy>119</cy><skew>0.5</skew><k1>0.1</k1><p1>0.01</p1>"
    path.write_text(text[: text.index("class='adjusted'>") + 17] + old + text[text.index("</calibration></sensor>") :])
    (lens,) = read(path).lenses.values()
    assert lens == Lens(size_wh=SIZE, fx=210, fy=212, cx=161, cy=119, skew=0.5, k=(0.1, 0, 0, 0), p1=0.01)


def test_tables_of_realityscan_are_read_by_their_columns(tmp_path: Path) -> None:
    path = writers.realityscan(tmp_path, TRUTH)
    lines = [line.split(",") for line in path.read_text().splitlines()]
    turned = ["#cameras 2", *(";".join(cell for number, cell in enumerate(cells[::-1]) if number != 2) for cells in lines)]
    path.write_text("\n".join(turned))
    alignment = read(path)
    (lens,) = alignment.lenses.values()
    # k4 is the column that was left out.
    assert lens.k == (0.1, 0.01, 0.003, 0.0) and len(alignment.views) == 2 and "k4" in lines[0]


def _without(key: str) -> Callable[[Any], Any]:
    return lambda top: {name: value for name, value in top.items() if name != key}


def _wrong_external(folder: Path) -> Path:
    path = writers.pix4d(folder, TRUTH)
    other = folder / "p_calibrated_external_camera_parameters.txt"
    other.write_text(other.read_text().replace(" 0.000000000 ", " 5.000000000 ", 1))
    return path


def _cut(path: Path, lines: int) -> Path:
    path.write_text("\n".join(path.read_text().split("\n")[:lines]))
    return path


def _openmvg(folder: Path, **changed: Any) -> Path:
    def edit(top: dict[str, Any]) -> None:
        top["intrinsics"][0]["value"].update(changed)

    return edited(writers.openmvg(folder, TRUTH), edit)


def _opf(folder: Path, **changed: Any) -> Path:
    path = writers.opf(folder, TRUTH)
    edited(folder / "calibrated-cameras.json", lambda top: top["sensors"][0]["internals"].update(changed))
    return path


def _ns(folder: Path, edit: Callable[[Any], Any]) -> Path:
    return edited(writers.transforms(folder, TRUTH), edit)


def _sfm(folder: Path, edit: Callable[[Any], Any]) -> Path:
    return edited(writers.opensfm(folder, TRUTH), lambda parts: [edit(part) for part in parts] and parts)


def _text(write: writers.Writer, folder: Path, old: str, new: str) -> Path:
    path = write(folder, TRUTH)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a part of a panorama": (
        lambda folder: _ns(folder, lambda top: {**top, "camera_model": "EQUIRECTANGULAR"}),
        "expected one twice as wide as high",
    ),
    "no frames": (lambda folder: _ns(folder, _without("frames")), "has no 'frames'"),
    "a mirrored pose": (
        lambda folder: edited(
            writers.transforms(folder, TRUTH), lambda top: top["frames"][0].update(transform_matrix=np.diag([-1, 1, 1, 1]).tolist())
        ),
        "no rotation",
    ),
    "points that lack": (
        lambda folder: _ns(folder, lambda top: {**top, "ply_file_path": "none.ply"}),
        "put the points",
    ),
    "a dual lens": (
        lambda folder: edited(
            writers.opensfm(folder, TRUTH),
            lambda parts: [part["cameras"]["v2 lens"].update(projection_type="dual") for part in parts] and parts,
        ),
        "projection type 'dual'",
    ),
    "no camera": (
        lambda folder: _sfm(folder, lambda part: part["cameras"].clear()),
        "no camera 'v2 lens'",
    ),
    "off the globe": (
        lambda folder: edited(
            writers.opensfm(folder, TRUTH), lambda parts: [part["reference_lla"].update(latitude=95) for part in parts] and parts
        ),
        "not on the globe",
    ),
    "external parameters alone": (
        lambda folder: writers.pix4d(folder, TRUTH).with_name("p_calibrated_external_camera_parameters.txt"),
        "give p_calibrated_camera_parameters.txt",
    ),
    "files of two exports": (_wrong_external, "contradict each other"),
    "half a file of Pix4D": (lambda folder: _cut(writers.pix4d(folder, TRUTH), 20), "fisheyes have another form"),
    "a lens of openMVG": (lambda folder: _openmvg(folder, polymorphic_name="spherical"), "camera model 'spherical'"),
    "a lens without a name": (lambda folder: _openmvg(folder, polymorphic_name=None), "whose name stands nowhere"),
    "half a file of Bundler": (lambda folder: _cut(writers.bundler(folder, TRUTH), 9), "ends early"),
    "another list": (
        lambda folder: _cut(writers.bundler(folder, TRUTH).with_name("list.txt"), 1).with_name("bundle.out"),
        "its list 1 photographs",
    ),
    "a fisheye of OPF": (lambda folder: _opf(folder, type="fisheye"), "type 'fisheye'"),
    "no column": (lambda folder: _text(writers.realityscan, folder, "pitch", "tilt"), "no column pitch"),
    "a photograph that is not there": (
        lambda folder: _text(writers.realityscan, folder, "c.jpg", "d.jpg"),
        "needs the size of the photograph 'd.jpg'",
    ),
    "a part of Metashape's": (
        lambda folder: _text(writers.metashape, folder, 'type="frame"', 'type="spherical"'),
        "expected one twice as wide as high",
    ),
    "a lens of Metashape": (lambda folder: _text(writers.metashape, folder, 'type="frame"', 'type="rpc"'), "type 'rpc'"),
    "a document type": (
        lambda folder: _text(writers.metashape, folder, "<document", "<!DOCTYPE x><document"),
        "declares a document type",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_by_its_name(name: str, tmp_path: Path) -> None:
    write, told = REFUSED[name]
    with pytest.raises(BadInput, match=told) as caught:
        read(write(tmp_path))
    assert str(caught.value).count("\n") == 0


def test_other_files_are_no_alignments(tmp_path: Path) -> None:
    (tmp_path / "geo.csv").write_text("name,x,y,z\n")
    (tmp_path / "data.xml").write_text("<gpx/>")
    (tmp_path / "image.out").write_text("hello")
    assert [format_of(path) for path in sorted(tmp_path.iterdir())] == [None] * 3
    with pytest.raises(BadInput, match="no alignment that is read here: expected"):
        read(tmp_path / "geo.csv")
    with pytest.raises(BadInput, match="no file with an alignment"):
        read(tmp_path)


@pytest.mark.parametrize("changed", [{"fx": 0.0}, {"fx": float("nan")}, {"size_wh": (0, 5)}, {"kind": "fisheye", "p1": 0.1}, {"cx": 1e9}])
def test_a_lens_that_no_camera_has_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="lens has"):
        Lens(**{"size_wh": SIZE, "fx": 200.0, "fy": 200.0, "cx": 160.0, "cy": 120.0, **changed})
