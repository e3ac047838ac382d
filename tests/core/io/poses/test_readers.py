"""Each reader against the hamlet's truth: centres within 1 mm, rotations within 0.001°, pixels within 0.01 px; what is wrong is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import ecef_from_local
from radiant_core.sfm.pose_project import PosedProject, read_project
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import BROWN, SIMPLE, Truth, bent_hamlet

CENTRED = {"cx": 160.0, "cy": 120.0}
ECEF = ecef_from_local(writers.LLA)
UTM_WKT = "EPSG:25832"
FORMATS = {
    "transforms": (writers.transforms, BROWN, {}, None),
    "transforms with points": (lambda *given: writers.transforms(*given, ply=True, applied=False), BROWN, {}, None),
    "opensfm": (writers.opensfm, BROWN, {}, None),
    "opensfm with tracks": (lambda *given: writers.opensfm(*given, tracks=True), BROWN, {}, None),
    "metashape": (writers.metashape, BROWN, {"fx": 213.5}, None),
    "metashape with k4 and skew": (writers.metashape, BROWN, {"k4": 0.02, "skew": 1.5}, None),
    "metashape in ecef": (lambda *given: writers.metashape(*given, ecef=ECEF), BROWN, {}, "ecef"),
    "realityscan": (writers.realityscan, BROWN, {"k4": 0.01}, None),
    "pix4d": (writers.pix4d, BROWN, {}, None),
    "pix4d in utm": (lambda *given: writers.pix4d(*given, prj=UTM_WKT), BROWN, {}, "utm"),
    "openmvg": (writers.openmvg, BROWN, {}, None),
    "openmvg without structure": (lambda *given: writers.openmvg(*given, structure=False), BROWN, {}, None),
    "bundler": (writers.bundler, SIMPLE, CENTRED, None),
    "opf": (writers.opf, BROWN, {}, "utm"),
    "polycam": (writers.polycam, (0.0,) * 5, {}, None),
}
"""How it is written, its lens, what of the truth differs, and where its world lies."""


WRONG = ("k", "p", "c2w", "yup", "center")


def wrongs_of(name: str) -> tuple[str, ...]:
    """What can be wrong in a format: without coefficients no sign of theirs."""
    dist = FORMATS[name][1]
    return tuple(wrong for wrong in WRONG if not (wrong == "p" and dist[2:4] == (0, 0)) and not (wrong == "k" and dist[0] == 0))


def refuse(name: str, wrong: str, folder: Path, bent) -> str:
    """What is said of a format with a wrong convention."""
    write, dist, changed, _ = FORMATS[name]
    photos, truth = bent(dist, changed)
    with pytest.raises(BadInput, match=r"does not fit (its photographs|itself).*(px|%|grey levels)") as caught:
        read_project(write(folder, truth, wrong), photos)
    return str(caught.value)


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory):
    """The hamlet by a lens, each made once: (folder of images, truth)."""
    made: dict[str, tuple[Path, Truth]] = {}

    def make(dist, changed) -> tuple[Path, Truth]:
        key = repr((dist, changed))
        if key not in made:
            folder = tmp_path_factory.mktemp("bent")
            made[key] = folder / "images", bent_hamlet(folder, dist, **changed)
        return made[key]

    return make


def world_of(truth: Truth, place: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and shift from the hamlet's metres to the file's world."""
    if place == "ecef":
        return ECEF[:3, :3], ECEF[:3, 3]
    return np.eye(3), writers.UTM if place == "utm" else np.zeros(3)


@pytest.mark.parametrize("name", FORMATS)
def test_a_reader_gives_the_truth(name: str, tmp_path: Path, bent) -> None:
    write, dist, changed, place = FORMATS[name]
    photos, truth = bent(dist, changed)
    project = read_project(write(tmp_path, truth), photos)
    turn, shift = world_of(truth, place)
    _require_truth(project, truth, turn, shift)


def _require_truth(project: PosedProject, truth: Truth, turn: np.ndarray, shift: np.ndarray) -> None:
    views = project.alignment.views
    assert [view.name for view in views] == sorted(truth.names)
    numbers = [truth.names.index(view.name) for view in views]
    rotations = np.array([view.cam_from_world[:3, :3] for view in views])
    centers = np.array([-view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3] for view in views])
    away_m = np.linalg.norm(centers - (truth.C[numbers] @ turn.T + shift), axis=1)
    cosines = (np.einsum("cij,cij->c", rotations, truth.R[numbers] @ turn.T) - 1) / 2
    sines = np.linalg.norm(rotations - truth.R[numbers] @ turn.T, axis=(1, 2)) / np.sqrt(2)
    assert cosines.min() > 0.99
    assert away_m.max() < 1e-3
    assert np.degrees(sines.max()) < 1e-3
    # The truth's equations are OpenCV's; the hamlet's points in the file's world.
    points = truth.points @ turn.T + shift
    for number, view in zip(numbers, views, strict=True):
        _, rows = truth.seen[number]
        in_camera = points[rows] @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
        lens = project.alignment.lenses[view.lens_id]
        off_px = np.linalg.norm(lens.img_from_cam(in_camera) - truth.project(number, truth.points[rows]), axis=1)
        assert off_px.max() < 0.01
        assert np.abs(lens.img_from_cam(lens.cam_from_img(truth.seen[number][0])) - truth.seen[number][0]).max() < 1e-6


@pytest.mark.parametrize(("name", "wrong"), [(name, wrongs_of(name)[number % len(wrongs_of(name))]) for number, name in enumerate(FORMATS)])
def test_a_wrong_convention_is_refused_with_its_figure(name: str, wrong: str, tmp_path: Path, bent) -> None:
    """One of each format; `tests/stress/test_pose_conventions.py` has all of all."""
    refuse(name, wrong, tmp_path, bent)


@pytest.mark.parametrize("name", ["opensfm with tracks", "openmvg"])
def test_half_a_pixel_is_seen_where_the_file_says_what_its_photographs_see(name: str, tmp_path: Path, bent) -> None:
    write, dist, changed, _ = FORMATS[name]
    photos, truth = bent(dist, changed)
    with pytest.raises(BadInput, match="half a pixel"):
        read_project(write(tmp_path, truth, "half"), photos)


WRITTEN = {
    "nerfstudio": ("transforms.json", (*BROWN[:4], 0.0), {}, None, True),
    "pyopf": ("project.opf", BROWN, {}, "utm", False),
    "colmap": ("model.bundle.out", SIMPLE, CENTRED, None, True),
}
"""File, lens, what of the truth differs, where its world lies, and whether it has points."""


@pytest.mark.parametrize("name", WRITTEN)
def test_what_the_programs_wrote_themselves_is_the_truth(name: str, bent) -> None:
    """colmap_to_json of nerfstudio 1.1.5 from a binary COLMAP model of the truth; pyopf 1.4.1's classes and its `save`; Bundler's
    files of `colmap model_converter` 3.8 from a model of the truth in text."""
    file, dist, changed, place, has_points = WRITTEN[name]
    photos, truth = bent(dist, changed)
    project = read_project(Path(__file__).parent / "written" / name / file, photos)
    _require_truth(project, truth, *world_of(truth, place))
    assert len(project.alignment.points) == (len(truth.points) if has_points else 0)


@pytest.mark.parametrize("name", ["opensfm with tracks", "openmvg", "realityscan"])
def test_poses_of_other_photographs_are_refused(name: str, tmp_path: Path, bent) -> None:
    """The same names, each for the next photograph: what the file says of itself fits."""
    write, dist, changed, _ = FORMATS[name]
    photos, truth = bent(dist, changed)
    (tmp_path / "images").mkdir()
    for number, each in enumerate(truth.names):
        (tmp_path / "images" / each).write_bytes((photos / truth.names[(number + 5) % len(truth.names)]).read_bytes())
    with pytest.raises(BadInput, match=r"does not fit its photographs.*(px|grey levels)"):
        read_project(write(tmp_path, truth), tmp_path / "images")
