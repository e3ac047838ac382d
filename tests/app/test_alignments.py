"""An alignment beside photographs is found by itself, named in one line, and used; two are not chosen between."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Warned
from radiant_app.run.source_key import used_files
from radiant_app.workers.sources import NO_POSES, detect_source, reconstruct_source, sfm_task
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.masks import save_mask
from radiant_core.io.poses.recognise import read_alignment
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.pose_project import read_named, said_of
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.needs import Overrides
from tests.app.known_points import NEAR_M, geocentric_of_utm, offset_said, quiet_display, require_models, require_rasters
from tests.colmap_projects import HAMLET, center_of, hamlet_model, write_model
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import Truth, bent_hamlet
from tests.core.io.poses.test_readers import ECEF


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    folder = tmp_path_factory.mktemp("bent")
    return folder, bent_hamlet(folder)


@pytest.fixture
def project(tmp_path: Path, bent) -> tuple[Path, Truth]:
    """A folder with images/ and no alignment yet."""
    folder, truth = bent
    shutil.copytree(folder / "images", tmp_path / "project" / "images")
    return tmp_path / "project", truth


WRITERS = {
    "transforms.json": writers.transforms,
    "reconstruction.json": writers.opensfm,
    "cameras.xml": writers.metashape,
    "alignment.csv": writers.realityscan,
    "p_calibrated_camera_parameters.txt": writers.pix4d,
    "sfm_data.json": writers.openmvg,
    "bundle.out": writers.bundler,
    "project.opf": writers.opf,
    "keyframes/corrected_cameras/drone_0000.json": writers.polycam,
}


@pytest.mark.parametrize("name", WRITERS)
def test_an_alignment_is_found_by_itself_with_all_its_files(name: str, project) -> None:
    folder, truth = project
    path = WRITERS[name](folder, truth)
    assert detect_source(folder) == ("alignment", folder / "images", path) and path == folder / name
    used = used_files(folder, None)
    assert name in used and len(used) > len(truth.names)
    said = said_of(read_named(path, folder / "images"))
    assert " of " in said and "gives the poses of 12 photographs" in said and "\n" not in said
    assert detect_source(folder, NO_POSES)[0] == "photographs"


def test_opensfm_is_found_where_odm_leaves_it(project) -> None:
    folder, truth = project
    (folder / "opensfm").mkdir()
    writers.opensfm(folder / "opensfm", truth)
    assert detect_source(folder)[2] == folder / "opensfm" / "reconstruction.json"


def test_polycam_has_its_photographs_beside_its_cameras(tmp_path: Path, bent, monkeypatch) -> None:
    folder, truth = bent
    writers.polycam(tmp_path, truth)
    for name in ("images", "corrected_images"):
        shutil.copytree(folder / "images", tmp_path / "keyframes" / name)
    assert detect_source(tmp_path)[1] == tmp_path / "keyframes" / "corrected_images"
    cameras = tmp_path / "keyframes" / "corrected_cameras"
    monkeypatch.chdir(cameras)
    named = Path(min(path.name for path in cameras.iterdir()))
    assert detect_source(Path("../.."), named)[1] == tmp_path / "keyframes" / "corrected_images"


def test_an_alignment_may_be_named_from_within_its_folder(project, monkeypatch) -> None:
    folder, truth = project
    writers.transforms(folder, truth)
    monkeypatch.chdir(folder)
    assert detect_source(Path(), Path("transforms.json"))[:2] == ("alignment", Path("images"))
    monkeypatch.chdir(folder / "images")
    assert detect_source(Path(), Path("missing"))[1] == Path()
    with pytest.raises(BadInput, match="missing does not exist: expected a file with an alignment"):
        read_alignment(Path("missing"), lambda name: (4, 3))


def test_older_odm_leaves_bundle_files_beside_the_same_alignment(project) -> None:
    folder, truth = project
    (folder / "opensfm").mkdir()
    writers.bundler(folder / "opensfm", truth)
    path = writers.opensfm(folder / "opensfm", truth)
    assert detect_source(folder)[2] == path


def test_a_file_that_is_no_alignment_can_be_left_aside(project, tmp_path: Path) -> None:
    folder, _ = project
    (folder / "transforms.json").write_text("{}")
    task = sfm_task(folder, SfmConfig(), None, Placement())
    with pytest.raises(BadInput, match=r"transforms.json has no 'frames'.*--poses none leaves it aside"):
        reconstruct_source(task, tmp_path / "work", lambda progress: None)
    named = sfm_task(folder, SfmConfig(), None, Placement(), folder / "transforms.json")
    with pytest.raises(BadInput, match=r"export the file again.$"):
        reconstruct_source(named, tmp_path / "work", lambda progress: None)
    with pytest.raises(BadInput, match="photographs without an alignment: leave out --refine-poses"):
        reconstruct_source(
            sfm_task(folder, SfmConfig(), None, Placement(), NO_POSES, refine_poses=True), tmp_path / "w", lambda progress: None
        )


def test_a_colmap_project_is_named_in_one_line(project, tmp_path: Path) -> None:
    folder, _ = project
    for path in (folder / "images").iterdir():
        shutil.copy(HAMLET / "images" / path.name, path)
    write_model(folder / "sparse" / "0", hamlet_model())
    result = reconstruct_source(sfm_task(folder, SfmConfig(), None, Placement()), tmp_path / "work", lambda progress: None)
    assert result.warnings[0] == f"sparse/0 of COLMAP gives the poses of 12 photographs and {len(result.scene.points)} points."
    (check,) = (decision for decision in result.decisions if decision.topic == "poses")
    assert check.choice == "those of sparse/0 of COLMAP" and check.figure is not None and check.figure < 0.01


def test_poses_of_a_colmap_model_are_adjusted_too(project, tmp_path: Path) -> None:
    from tests.stress.pose_formats import true_model

    folder, truth = project
    write_model(tmp_path / "model", true_model(truth))
    task = sfm_task(folder, SfmConfig(), None, Placement(), tmp_path / "model", refine_poses=True)
    result = reconstruct_source(task, tmp_path / "work", lambda progress: None)
    assert len(result.scene.cameras) == 12 and any(decision.topic == "refined poses" for decision in result.decisions)


def test_of_two_alignments_none_is_taken_unless_it_is_named(project) -> None:
    folder, truth = project
    one, other = writers.transforms(folder, truth), writers.metashape(folder, truth)
    with pytest.raises(BadInput, match=r"2 alignments \(cameras.xml, transforms.json\): name the one to use with --poses"):
        detect_source(folder)
    assert detect_source(folder, other)[2] == other and detect_source(folder, one)[2] == one
    write_model(folder / "sparse" / "0", hamlet_model())
    assert detect_source(folder)[0] == "colmap" and detect_source(folder, one)[0] == "alignment"


def test_devices_that_place_their_own_photographs_take_no_poses(project) -> None:
    folder, _ = project
    with pytest.raises(BadInput, match="whose devices place their photographs"):
        RunConfig(source=folder, out=folder / "run", frames="gps", sfm=SfmOptions(poses=folder / "transforms.json"))


FAR = np.array([112_000.0, 54_000.0, 300.0])


def written_at(place: str, folder: Path, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Write an alignment whose world lies there; rotation and shift from the hamlet's metres to its coordinates."""
    if place == "utm":
        writers.pix4d(folder, truth, prj="EPSG:25832")
        return np.eye(3), writers.UTM
    if place == "far":
        writers.realityscan(folder, replace(truth, t=truth.t - truth.R @ FAR))
        return np.eye(3), FAR
    if place == "enu":
        writers.opensfm(folder, truth)
        return np.eye(3), np.zeros(3)
    writers.metashape(folder, truth, ecef=ECEF if place == "ecef" else None)
    return (ECEF[:3, :3], ECEF[:3, 3]) if place == "ecef" else (np.eye(3), np.zeros(3))


# Metres, a map and the globe; the other two are further values of the first and of the last.
OTHERS = [pytest.param(place, marks=pytest.mark.stress) for place in ("far", "enu")]


@pytest.mark.parametrize("place", ["local", "utm", "ecef", *OTHERS])
def test_a_training_says_what_it_used_and_exports_in_the_coordinates_of_the_file(
    place: str, project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Known points and the cameras' places: in every export they are the file's within 1 mm. local, far: metres, near and 100 km
    from their origin; enu: metres of a place on the globe."""
    folder, truth = project
    turn, shift = written_at(place, folder, truth)
    (folder / "scene.nvm").write_text("NVM_V3")
    told: list[str] = []
    request = TrainRequest(source=folder, out=tmp_path / "out", overrides=Overrides(num_steps=4, long_side_px=64))
    train(request, lambda event: told.append(event.message) if isinstance(event, Warned) else None)
    first = next(message for message in told if "gives the poses of" in message)
    assert "12 photographs" in first and first.endswith("beside the photographs there are 1 .nvm (poses of VisualSfM): they are not used.")
    assert sum("are not used" in message for message in told) == 1
    for crs in (None, "given", *(("EPSG:25832",) if place == "utm" else ())):
        out = tmp_path / f"colmap_{crs}".replace(":", "_")
        offset = offset_said(export(ExportRequest(model=tmp_path / "out", out=out, crs=crs), quiet_display()))
        given = {image.name: center_of(image) + offset for image in read_model(out / "sparse" / "0").images}
        assert len(given) == 12
        wanted = truth.C @ turn.T + shift
        assert max(np.abs(given[name] - wanted[number]).max() for number, name in enumerate(truth.names)) < NEAR_M
        assert (tmp_path / f"{out.name}.prj").is_file() == (place == "utm")
    systems = ("given", "EPSG:25832") if place == "utm" else ("given",)
    require_models(tmp_path / "out", truth.points @ turn.T + shift, tmp_path, systems)
    file_from_map = {"ecef": geocentric_of_utm, "enu": lambda places: (geocentric_of_utm(places) - ECEF[:3, 3]) @ ECEF[:3, :3]}
    epsg = {"utm": 25832, "ecef": 32632, "enu": 32632}.get(place)
    require_rasters(tmp_path / "out", file_from_map.get(place, np.copy), monkeypatch, tmp_path, epsg)


@pytest.mark.parametrize("refine_poses", [False, True])
def test_masks_beside_an_alignments_photographs_apply_to_them(project, tmp_path: Path, refine_poses: bool) -> None:
    folder, truth = project
    writers.transforms(folder, truth)
    used_px = np.ones((240, 320), bool)
    used_px[:80, :160] = False
    for name in truth.names[:3]:
        save_mask(folder / "masks" / f"{Path(name).stem}.png", used_px)
    task = sfm_task(folder, SfmConfig(), None, Placement(), refine_poses=refine_poses)
    assert task.masks == str((folder / "masks").resolve())
    assert sum(name.startswith("mask of ") for name in used_files(folder, folder / "masks")) == 3
    result = reconstruct_source(task, tmp_path / "work", lambda progress: None)
    assert result.masks_folder is not None and len(list(result.masks_folder.iterdir())) == 3
    assert "masks/: masks of 3 of 12 photographs are used, black is left out." in result.warnings
    assert not any("masks, which --masks takes" in message for message in result.warnings)
