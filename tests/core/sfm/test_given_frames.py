"""The frame of a given model is kept, or the way back to it is exact: camera centres and points come
back to where the model has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3, geodetic_from_enu
from radiant_core.georef.control_points import ControlRequest
from radiant_core.georef.given_frame import GivenFrame, load_given_frame, save_given_frame
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.colmap.text import write_model
from radiant_core.io.run_store import write_json
from radiant_core.sfm.config import SfmProgress, SfmResult
from radiant_core.sfm.given_poses import Where, read_given_poses
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from tests.colmap_projects import HAMLET, UTM, center_of, hamlet_model, moved, quiet, renamed, write_photographs, write_project


def turned(model: ColmapModel, scale: float, degrees: tuple[float, float, float], shift: tuple[float, float, float]) -> ColmapModel:
    """The model after a similarity, as another program would have it."""
    move = Sim3(scale=scale, rotation=Rotation.from_euler("xyz", degrees, degrees=True).as_matrix(), translation=np.array(shift))
    poses = move.apply_to_poses([image.cam_from_world for image in model.images])
    images = tuple(
        replace(image, quat_wxyz=Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True), translation=pose[:3, 3])
        for image, pose in zip(model.images, poses, strict=True)
    )
    return replace(model, images=images, points=replace(model.points, xyz=move.apply(model.points.xyz)))


GIVEN: dict[str, tuple[Callable[[ColmapModel], ColmapModel], bool, float]] = {
    # Frame of the model; whether it is kept but for a shift; digits lost in its unit.
    "metres, z up": (lambda model: model, True, 1e-9),
    "UTM": (lambda model: moved(model, UTM), True, 1e-8),
    "UTM, south": (lambda model: moved(model, np.array([334_000.0, 9_250_000.0, 3_800.0])), True, 1e-8),
    "below the sea": (lambda model: moved(model, np.array([-120_000.0, -30.0, -430.0])), True, 1e-8),
    "a mile of feet": (lambda model: turned(model, 3.28084, (0, 0, 0), (987_000.0, 210_000.0, 30.0)), True, 1e-8),
    "y down": (lambda model: turned(model, 0.031, (115, 4, 30), (1, 2, 3)), False, 1e-10),
    "y down, far out": (lambda model: turned(model, 20.0, (-90, 0, 0), (4e5, 5e6, 0)), False, 1e-7),
    "tiny": (lambda model: turned(model, 1e-5, (0, 0, 0), (0, 0, 0)), False, 1e-12),
    "huge": (lambda model: turned(model, 1e4, (0, 0, 0), (0, 0, 0)), False, 1e-6),
}


def scene_of(model: ColmapModel, folder: Path, placement: Placement | None = None) -> SfmResult:
    project = write_project(folder / "project", model)
    return scene_from_colmap(project / "sparse" / "0", project / "images", folder / "work", quiet, None, placement or Placement())


@pytest.mark.parametrize("frame", GIVEN)
def test_a_scene_of_a_given_model_leads_back_to_it(frame: str, tmp_path: Path) -> None:
    change, is_kept, atol = GIVEN[frame]
    model = change(hamlet_model())
    result = scene_of(model, tmp_path)
    assert result.given_frame is not None
    name = save_given_frame(tmp_path, result.given_frame)
    given = load_given_frame(tmp_path)
    assert name == "given_frame.json" and given is not None
    cameras = result.scene.cameras
    assert np.allclose(given.given_from_scene.apply(cameras.centers), [center_of(image) for image in model.images], rtol=0, atol=atol)
    assert np.allclose(given.given_from_scene.apply(result.scene.points), model.points.xyz, rtol=0, atol=atol)
    back = given.given_from_scene
    assert (back.scale == 1 and (back.rotation == np.eye(3)).all()) == is_kept
    # A model of float32 keeps a millimetre of what was a millimetre: near the origin.
    assert np.abs(result.scene.points).max() < 2e4
    said = [warning for warning in result.warnings if "given_frame.json" in warning]
    assert len(said) == (not given.is_same) and (not is_kept or not said or "in its own unit" in said[0])


@pytest.mark.parametrize("frame", GIVEN)
def test_a_file_in_the_given_frame_is_the_model_less_a_whole_offset(frame: str, tmp_path: Path) -> None:
    model = GIVEN[frame][0](hamlet_model())
    result = scene_of(model, tmp_path)
    given = result.given_frame
    assert given is not None and (given.offset % 100 == 0).all()
    moved_scene = given.move_scene(result.scene)
    expected = np.array([center_of(image) for image in model.images])
    assert np.allclose(moved_scene.cameras.centers + given.offset, expected, rtol=1e-12, atol=1e-6)
    for pose, image in zip(moved_scene.cameras.cam_from_world, model.images, strict=True):
        assert np.allclose(pose[:3, :3], image.cam_from_world[:3, :3], atol=1e-9)
    far = np.abs(expected).max() > 1.5e4
    assert far == bool(given.offset.any()) or frame == "huge"


@pytest.mark.parametrize("option", [{"up": "level"}, {"distance": "drone_0000.jpg,drone_0001.jpg,7"}, {"up": "0,0.3,1"}])
def test_what_is_asked_for_goes_before_the_given_frame_and_leads_back_as_well(option: dict[str, str], tmp_path: Path) -> None:
    model = moved(hamlet_model(), UTM)
    result = scene_of(model, tmp_path, Placement(**option))
    assert result.given_frame is not None and not result.given_frame.is_same
    back = result.given_frame.given_from_scene
    assert np.allclose(back.apply(result.scene.cameras.centers), [center_of(image) for image in model.images], rtol=0, atol=1e-7)
    if option.get("up") == "0,0.3,1":
        assert np.degrees(np.arccos(back.rotation[2, 2])) == pytest.approx(np.degrees(np.arctan(0.3)), abs=1e-6)
    if "distance" in option:
        assert np.linalg.norm(np.subtract(*result.scene.cameras.centers[:2])) == pytest.approx(7)


def test_gps_places_the_scene_and_the_model_is_found_again(tmp_path: Path) -> None:
    model = turned(hamlet_model(), 0.5, (90, 0, 0), (1, 2, 3))
    write_model(tmp_path / "model", model)
    result = scene_from_colmap(tmp_path / "model", HAMLET / "images", tmp_path / "work", quiet)
    assert result.scene.frame.kind == "metric" and result.given_frame is not None
    back = result.given_frame.given_from_scene
    assert np.allclose(back.apply(result.scene.points), model.points.xyz, rtol=0, atol=1e-9)


def test_an_adjusted_model_says_how_far_it_was_moved_and_the_adjustment_of_a_project_runs(tmp_path: Path) -> None:
    """Five points of the ground with a check point: their marks are where the known model has them,
    a third of a pixel off, their places 20 m east in a local frame."""
    model = hamlet_model()
    rng = np.random.default_rng(5)
    rows = np.argsort(np.bincount(model.points.tracks[:, 0], minlength=len(model.points.ids)))[-6:]
    lines = ["EPSG:32632"]
    places = model.points.xyz[rows] + UTM
    for number, (row, place) in enumerate(zip(rows, places, strict=True)):
        for _, image_id, index in model.points.tracks[model.points.tracks[:, 0] == row]:
            image = next(image for image in model.images if image.image_id == image_id)
            x, y = image.points2d[index] + rng.normal(0, 0.3, 2)
            lines.append(f"{place[0]} {place[1]} {place[2]} {x} {y} {image.name} p{number}")
    told: list[SfmProgress] = []
    project = write_project(tmp_path / "project", model)
    result = scene_from_colmap(
        project / "sparse" / "0",
        project / "images",
        tmp_path / "work",
        told.append,
        None,
        Placement(control=ControlRequest(text="\n".join(lines) + "\n", source="gcp.txt", check="p5")),
    )
    assert {progress.phase for progress in told} == {"checking photographs", "refining"}
    given = result.given_frame
    assert given is not None and 0 < given.largest_error < 1
    off = np.linalg.norm(given.given_from_scene.apply(result.scene.cameras.centers) - [center_of(image) for image in model.images], axis=1)
    assert off.max() == pytest.approx(given.largest_error)
    assert any("after the adjustment" in warning for warning in result.warnings)
    # The scene is where the list says: its origin and metres east, north, up.
    assert result.scene.frame.kind == "metric"
    assert geodetic_from_enu(np.zeros((1, 3)), result.scene.frame.origin_lat_lon_alt).shape == (1, 3)


WHERE: list[tuple[Where, Callable[[str], str]]] = [
    ("together", str),
    ("by device", lambda name: f"{'north' if name < 'drone_0006' else 'south'}/{name}"),
]


@pytest.mark.parametrize(("where", "place_of"), WHERE)
@pytest.mark.parametrize("name_of", [str, str.upper, lambda name: f"images/{name}", lambda name: name.replace(".jpg", ".tif")])
def test_known_poses_on_a_map_are_moved_by_whole_hundreds_and_find_their_photographs(
    where: Where, place_of: Callable[[str], str], name_of: Callable[[str], str], tmp_path: Path
) -> None:
    model = moved(hamlet_model(), UTM)
    write_photographs(tmp_path, named=place_of)
    write_model(tmp_path / "sparse" / "0", renamed(model, name_of))
    poses = read_given_poses(tmp_path, None, where)
    assert poses.cameras.names == tuple(image.name for image in model.images)
    assert (poses.frame.given_from_scene.translation % 100 == 0).all() and np.abs(poses.cameras.centers).max() < 1000
    expected = np.array([center_of(image) for image in model.images])
    assert np.allclose(poses.frame.given_from_scene.apply(poses.cameras.centers), expected, rtol=0, atol=1e-8)
    (tmp_path / "device").mkdir()
    assert poses.deal(poses.cameras.names[:4], tmp_path / "device")
    assert poses.model is not None
    assert np.allclose([center_of(image) for image in poses.model.images], poses.cameras.centers, rtol=0, atol=1e-8)
    assert any("in its own unit" in note for note in poses.notes)
    # In folders of devices a photograph is known by its file name, whatever folder the model names.
    differs = name_of("a.jpg").rpartition("/")[2] != "a.jpg" if where == "by device" else name_of is not str
    assert any("another name" in note for note in poses.notes) == differs


def camera_folder(name: str) -> str:
    """Two folders of one camera in that of a device, each with a DJI_0000.jpg."""
    number = int(name[6:10])
    return f"north/{100 + number // 6}MEDIA/DJI_{number % 6:04d}.jpg"


@pytest.mark.parametrize("name_of", [camera_folder, lambda name: f"/card/{camera_folder(name)}", lambda name: camera_folder(name)[6:]])
def test_photographs_below_folders_of_devices_are_known_by_their_paths_there(name_of: Callable[[str], str], tmp_path: Path) -> None:
    write_photographs(tmp_path, named=camera_folder)
    write_model(tmp_path / "sparse" / "0", renamed(hamlet_model(), name_of))
    poses = read_given_poses(tmp_path, None, "by device")
    assert poses.cameras.names == tuple(camera_folder(image.name).removeprefix("north/") for image in hamlet_model().images)
    assert all((tmp_path / "north" / name).is_file() for name in poses.cameras.names) and poses.notes == ()


def test_a_name_that_two_devices_have_is_refused_with_both(tmp_path: Path) -> None:
    def two_devices(name: str) -> str:
        number = int(name[6:10])
        return f"{'north' if number < 6 else 'south'}/DJI_{number % 6:04d}.jpg"

    write_photographs(tmp_path, named=two_devices)
    write_model(tmp_path / "sparse" / "0", renamed(hamlet_model(), two_devices))
    with pytest.raises(BadInput, match=r"^the poses have north/DJI_0000.jpg and south/DJI_0000.jpg, which are both 'DJI_0000.jpg' in the"):
        read_given_poses(tmp_path, None, "by device")


def test_poses_near_their_origin_stay_to_the_last_bit(tmp_path: Path) -> None:
    write_photographs(tmp_path / "images")
    write_model(tmp_path / "model", hamlet_model())
    poses = read_given_poses(tmp_path, tmp_path / "model")
    assert poses.frame.is_same and poses.notes == () and poses.model is not None
    for image, given in zip(poses.model.images, hamlet_model().images, strict=True):
        assert (image.translation == given.translation).all() and (image.quat_wxyz == given.quat_wxyz).all()


def test_one_device_of_many_with_poses_far_out_is_refused_before_it_trains(tmp_path: Path) -> None:
    write_photographs(tmp_path)
    write_model(tmp_path / "model", moved(hamlet_model(), UTM))
    with pytest.raises(BadInput, match=r"the poses lie up to 5\.25e\+06 from their origin, .* take the same whole numbers off the poses"):
        read_given_poses(tmp_path, tmp_path / "model", "own")


@pytest.mark.parametrize(("where", "place_of"), WHERE)
def test_poses_of_undistorted_photographs_are_told_of_by_whoever_has_the_photographs(
    where: Where, place_of: Callable[[str], str], tmp_path: Path
) -> None:
    write_photographs(tmp_path, named=place_of)
    model = hamlet_model()
    smaller = {number: replace(camera, size_wh=(319, 239)) for number, camera in model.cameras.items()}
    write_model(tmp_path / "sparse" / "0", replace(model, cameras=smaller))
    if where == "by device":
        # Each device compares its own: nobody else opens them (tests/app/test_field.py).
        assert read_given_poses(tmp_path, None, where).cameras.sizes_wh.tolist() == [[319, 239]] * len(model.images)
        return
    with pytest.raises(BadInput, match=r"has \(320, 240\) px and its camera \(319, 239\): the poses are of undistorted photographs"):
        read_given_poses(tmp_path, None, where)


def test_poses_of_undistorted_photographs_are_not_given_to_those_as_they_were_taken(tmp_path: Path) -> None:
    model = hamlet_model()
    write_photographs(tmp_path)
    smaller = {number: replace(camera, size_wh=(319, 239)) for number, camera in model.cameras.items()}
    write_model(tmp_path / "model", replace(model, cameras=smaller))
    told = r"has \(320, 240\) px and its camera \(319, 239\): the poses are of undistorted photographs .* sfm/undistorted/images"
    with pytest.raises(BadInput, match=told) as refused:
        read_given_poses(tmp_path, tmp_path / "model")
    assert "np." not in str(refused.value)
    with pytest.raises(BadInput, match=told):
        scene_from_colmap(tmp_path / "model", tmp_path, tmp_path / "work", quiet)


@pytest.mark.parametrize(
    "matrix",
    [np.zeros((4, 4)).tolist(), np.eye(3).tolist(), np.diag([1.0, 1, 2, 1]).tolist(), np.diag([1.0, 1, -1, 1]).tolist(), [["a"] * 4] * 4],
)
def test_a_given_frame_that_is_no_similarity_is_refused(matrix: list[list[float]], tmp_path: Path) -> None:
    write_json(tmp_path / "given_frame.json", {"model": "m", "given_from_scene": matrix, "largest_error": 0.0})
    with pytest.raises(BadInput):
        load_given_frame(tmp_path)


def test_a_scene_without_a_given_model_has_no_way_back(tmp_path: Path) -> None:
    assert load_given_frame(tmp_path) is None
    same = GivenFrame(given_from_scene=Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3)), model="m")
    assert same.is_same and same.notes() == () and not same.offset.any()
