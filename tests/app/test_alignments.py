"""An alignment beside photographs is found by itself, named in one line, and used; two are not chosen between."""

from __future__ import annotations

import importlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.source_key import used_files
from radiant_app.workers.sources import NO_POSES, detect_source, load_scene_of, reconstruct_source, sfm_task
from radiant_core.errors import BadInput
from radiant_core.georef.given_frame import load_given_frame
from radiant_core.io.colmap.model import read_model
from radiant_core.io.model_reader import read_model as read_splats
from radiant_core.io.photos.masks import save_mask
from radiant_core.io.ply import save_ply
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.pose_project import read_named, said_of
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.splats import Splats
from radiant_core.train.needs import Overrides
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


def test_polycam_has_its_photographs_beside_its_cameras(tmp_path: Path, bent) -> None:
    folder, truth = bent
    writers.polycam(tmp_path, truth)
    for name in ("images", "corrected_images"):
        shutil.copytree(folder / "images", tmp_path / "keyframes" / name)
    assert detect_source(tmp_path)[1] == tmp_path / "keyframes" / "corrected_images"


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


@pytest.mark.parametrize("place", ["local", "utm", "ecef"])
def test_a_training_says_what_it_used_and_exports_in_the_coordinates_of_the_file(place: str, project, tmp_path: Path) -> None:
    """The camera's place is a known point: in every export it is the file's within 1 mm."""
    folder, truth = project
    if place == "utm":
        writers.pix4d(folder, truth, prj="EPSG:25832")
    else:
        writers.metashape(folder, truth, ecef=ECEF if place == "ecef" else None)
    (folder / "scene.nvm").write_text("NVM_V3")
    told: list[str] = []
    request = TrainRequest(source=folder, out=tmp_path / "out", overrides=Overrides(num_steps=4, long_side_px=64))
    train(request, lambda event: told.append(event.message) if isinstance(event, Warned) else None)
    first = next(message for message in told if "gives the poses of" in message)
    assert "12 photographs" in first and first.endswith("beside the photographs there are 1 .nvm (poses of VisualSfM): they are not used.")
    assert sum("are not used" in message for message in told) == 1
    centers = truth.C @ ECEF[:3, :3].T + ECEF[:3, 3] if place == "ecef" else truth.C + (writers.UTM if place == "utm" else 0)
    for crs in (None, "given", *(("EPSG:25832",) if place == "utm" else ())):
        out = tmp_path / f"colmap_{crs}".replace(":", "_")
        figures = export(ExportRequest(model=tmp_path / "out", out=out, crs=crs), quiet_display())
        offset = np.array([float(number) for number in str(figures["offset"]).partition(" (")[0].split(", ")])
        given = {image.name: center_of(image) + offset for image in read_model(out / "sparse" / "0").images}
        assert len(given) == 12
        assert max(np.abs(given[name] - centers[number]).max() for number, name in enumerate(truth.names)) < 1e-3
        assert (tmp_path / f"{out.name}.prj").is_file() == (place == "utm")
    points = truth.points @ ECEF[:3, :3].T + ECEF[:3, 3] if place == "ecef" else truth.points + (writers.UTM if place == "utm" else 0)
    require_known_points(tmp_path / "out", points, tmp_path, ("given", "EPSG:25832") if place == "utm" else ("given",))


def require_known_points(trained: Path, points: np.ndarray, folder: Path, systems: tuple[str, ...]) -> None:
    """A model of Gaussians at points whose coordinates in the file are known goes out within 1 mm in every form of a model; SOG
    has 16 bits for ln(1 + |x|), steps of up to 3 mm here."""
    given = load_given_frame(trained)
    assert given is not None
    inside = given.given_from_scene.inverse().apply(points).astype(np.float32)
    count = len(inside)
    model = Splats(
        means=inside,
        quats=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scales=np.full((count, 3), -4, np.float32),
        logit_opacities=np.full(count, 3, np.float32),
        sh0=np.zeros((count, 1, 3), np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    save_ply(trained / "scene.ply", model)
    for crs in systems:
        for name in ("a.ply", "b.spz", "c.sog", "d.usdc"):
            out = folder / f"{crs}_{name}".replace(":", "_")
            figures = export(ExportRequest(model=trained, out=out, crs=crs), quiet_display())
            offset = np.array([float(number) for number in str(figures["offset"]).partition(" (")[0].split(", ")])
            written = usd_positions(out) if name == "d.usdc" else read_splats(out).splats.means
            away_m, nearest = KDTree(written.astype(np.float64)).query(points - offset)
            assert away_m.max() < (3e-3 if name == "c.sog" else 1e-3), (crs, name)
            assert len(set(nearest.tolist())) > 0.9 * count
        out = folder / f"{crs}_nerfstudio".replace(":", "_")
        figures = export(ExportRequest(model=trained, out=out, crs=crs, format="nerfstudio"), quiet_display())
        offset = np.array([float(number) for number in str(figures["offset"]).partition(" (")[0].split(", ")])
        frames = json.loads((out / "transforms.json").read_text())
        places = {Path(frame["file_path"]).name: np.array(frame["transform_matrix"])[:3, 3] for frame in frames["frames"]}
        applied = np.array(frames.get("applied_transform", np.eye(3, 4)))
        scene = load_scene_of(trained).cameras
        wanted = given.given_from_scene.apply(scene.centers)
        for row, camera in enumerate(scene.names):
            # applied_transform leads from the original to what the file holds.
            original = applied[:, :3].T @ (places[Path(camera).name] - applied[:, 3])
            assert np.abs(original + offset - wanted[row]).max() < 1e-3


def usd_positions(path: Path) -> np.ndarray:
    usd, vol = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdVol"))

    stage = usd.Stage.Open(str(path))
    return np.array(vol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Splats")).GetPositionsAttr().Get())


def quiet_display() -> ProgressDisplay:
    import io

    from rich.console import Console

    return ProgressDisplay(Console(file=io.StringIO()))


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
