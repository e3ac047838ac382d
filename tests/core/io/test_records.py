"""Records: every type comes back equal; a broken file, or another one, is refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.frames import Frame
from radiant_core.io.array_file import header_of
from radiant_core.io.records import (
    load_cameras,
    load_plan,
    load_plan_file,
    load_plan_waypoints,
    load_scene,
    load_splats,
    save_cameras,
    save_plan,
    save_scene,
    save_splats,
)
from radiant_core.numerics import rotmats_from_quats
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats


def some_splats(count: int = 9, bases: int = 8) -> Splats:
    rng = np.random.default_rng(1)
    return Splats(
        means=rng.standard_normal((count, 3), dtype=np.float32),
        quats=rng.standard_normal((count, 4), dtype=np.float32),
        log_scales=rng.standard_normal((count, 3), dtype=np.float32),
        logit_opacities=rng.standard_normal(count, dtype=np.float32),
        sh0=rng.standard_normal((count, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((count, bases, 3), dtype=np.float32),
    )


def some_cameras(count: int = 5) -> Cameras:
    rng = np.random.default_rng(2)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotmats_from_quats(rng.normal(size=(count, 4)))
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    Ks = np.tile(np.array([[500.1, 0, 320.3], [0, 499.9, 240.7], [0, 0, 1]]), (count, 1, 1))
    names = tuple(f'ö/{index} "x".jpg' for index in range(count))
    return Cameras(names=names, Ks=Ks, cam_from_world=poses, sizes_wh=np.tile([640, 480], (count, 1)))


def some_scene(kind: Any = "metric", residual_m: float | None = 0.1) -> SfmScene:
    rng = np.random.default_rng(3)
    return SfmScene(
        cameras=some_cameras(),
        points=rng.normal(size=(7, 3)) * 1e3,
        colors=rng.integers(0, 256, (7, 3), dtype=np.uint8),
        observations=np.array([[0, 0], [6, 4], [3, 2]]),
        frame=Frame(kind=kind, origin_lat_lon_alt=np.array([50.8, -0.13, 1 / 3]), residual_m=residual_m),
    )


def some_plan() -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    square = np.array([[0.1, 0.0], [1.0, 0.0], [1.0, 1 / 3]])
    cloud = CloudPlan(
        method="paper",
        edge_ids=("north", "south"),
        sites=np.array([[0.0, 1 / 7], [1.0, 2.0]]),
        weights=np.array([0.5, -0.5]),
        borders=(square, np.zeros((0, 2))),
        edge_of_camera=np.array([0, 0, 0]),
        edge_time_s=np.array([1.5, 0.0]),
        lower_bound_s=1.25,
        status="converged",
        certified=True,
        history=(2.0, 1.5),
    )
    north = EdgePlan(
        edge_id="north",
        device_ids=("n1", "n2"),
        camera_indices=np.array([2, 0, 1]),
        device_of_camera=np.array([0, 0, 0]),
        strips=(square, np.zeros((0, 2))),
        device_time_s=np.array([1.5, 0.0]),
    )
    empty = np.zeros(0, np.int64)
    south = EdgePlan(
        edge_id="south",
        device_ids=("s1",),
        camera_indices=empty,
        device_of_camera=empty,
        strips=(np.zeros((0, 2)),),
        device_time_s=np.zeros(1),
    )
    return cloud, (north, south)


def some_waypoints() -> Waypoints:
    return Waypoints(names=("a", "ö b", 'c"'), lat_lon_alt=[[47.1, 8.1, 1 / 3], [47.2, 8.2, 0.0], [47.3, 8.3, -1.0]])


def assert_same(a: Any, b: Any) -> None:
    """Equal down to type and bits, dataclasses and tuples field by field."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert a.tobytes() == b.tobytes()
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_same(left, right)
    elif hasattr(a, "__dataclass_fields__"):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    else:
        assert a == b


@pytest.mark.parametrize("splats", [some_splats(), some_splats(0, 0), some_splats(3, 15)])
def test_splats_come_back(tmp_path: Path, splats: Splats) -> None:
    save_splats(tmp_path / "a.safetensors", splats)
    assert_same(load_splats(tmp_path / "a.safetensors"), splats)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_cameras_come_back(tmp_path: Path, count: int) -> None:
    save_cameras(tmp_path / "a.safetensors", some_cameras(count))
    assert_same(load_cameras(tmp_path / "a.safetensors"), some_cameras(count))


@pytest.mark.parametrize("name", ["../../out.jpg", "/tmp/out.jpg", "a/../../out.jpg", "a\\b.jpg", "", "line\nbreak.jpg"])
def test_names_that_lead_out_of_a_folder_are_refused(tmp_path: Path, name: str) -> None:
    cameras = replace(some_cameras(), names=("0.jpg", "1.jpg", name, "3.jpg", "4.jpg"))
    save_cameras(tmp_path / "cameras", cameras)
    save_scene(tmp_path / "scene", replace(some_scene(), cameras=cameras))
    for load, file in ((load_cameras, "cameras"), (load_scene, "scene")):
        with pytest.raises(BadInput, match=r"names an image .* expected relative paths inside a folder") as caught:
            load(tmp_path / file)
        assert str(tmp_path / file) in str(caught.value) and repr(name) in str(caught.value)


@pytest.mark.parametrize("size_wh", [(1_000_000, 1_000_000), (1 << 15, (1 << 13) + 1), (1 << 32, 1 << 32)])
def test_cameras_that_are_larger_than_any_photograph_are_refused(tmp_path: Path, size_wh: tuple[int, int]) -> None:
    cameras = some_cameras()
    sizes_wh = cameras.sizes_wh.copy()
    sizes_wh[3] = size_wh
    save_cameras(tmp_path / "cameras", replace(cameras, sizes_wh=sizes_wh))
    save_scene(tmp_path / "scene", replace(some_scene(), cameras=replace(cameras, sizes_wh=sizes_wh)))
    for load, file in ((load_cameras, "cameras"), (load_scene, "scene")):
        with pytest.raises(BadInput, match=f"has {size_wh[0]} × {size_wh[1]} px, expected at most 268,435,456"):
            load(tmp_path / file)
    sizes_wh[3] = (1 << 15, 1 << 13)
    save_cameras(tmp_path / "cameras", replace(cameras, sizes_wh=sizes_wh))
    assert load_cameras(tmp_path / "cameras").sizes_wh[3].tolist() == [32768, 8192], "as large as a photograph may be"


@pytest.mark.parametrize(("part", "field"), [("cloud", "edge_ids"), ("edges", "edge_id"), ("edges", "device_ids")])
def test_ids_of_a_plan_that_can_name_no_folder_are_refused(tmp_path: Path, part: str, field: str) -> None:
    save_plan(tmp_path / "plan.json", *some_plan())
    record = json.loads((tmp_path / "plan.json").read_text())
    place = record[part] if part == "cloud" else record[part][0]
    place[field] = "../../out" if field == "edge_id" else ["../../out", *place[field][1:]]
    (tmp_path / "plan.json").write_text(json.dumps(record))
    with pytest.raises(BadInput, match=r"id '\.\./\.\./out' cannot name a folder"):
        load_plan(tmp_path / "plan.json")


@pytest.mark.parametrize("scene", [some_scene(), some_scene("unscaled", None)])
def test_scenes_come_back(tmp_path: Path, scene: SfmScene) -> None:
    save_scene(tmp_path / "a.safetensors", scene)
    assert_same(load_scene(tmp_path / "a.safetensors"), scene)


def test_plans_come_back_with_empty_regions(tmp_path: Path) -> None:
    cloud, edges = some_plan()
    save_plan(tmp_path / "plan.json", cloud, edges)
    assert_same(load_plan(tmp_path / "plan.json"), (cloud, edges))


def test_a_plan_brings_its_waypoints_along(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    save_plan(path, *some_plan())
    assert load_plan_waypoints(path) is None
    save_plan(path, *some_plan(), some_waypoints())
    assert_same(load_plan(path), some_plan())
    assert_same(load_plan_waypoints(path), some_waypoints())


def test_waypoints_that_are_not_the_plans_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    with pytest.raises(BadInput, match="3 cameras, there are 2"):
        save_plan(path, *some_plan(), some_waypoints().select([0, 1]))
    assert not path.exists()
    save_plan(path, *some_plan(), some_waypoints())
    good = json.loads(path.read_text())
    poison: list[tuple[str, Any]] = [
        ("names", ["a", "b"]),
        ("names", ["a", "b", "b"]),
        ("names", "abc"),
        ("lat_lon_alt", [[1, 2, 3]]),
        ("lat_lon_alt", [[47, 8, 1], [47, 8, 1], [47, None, 1]]),
        ("lat_lon_alt", [[147, 8, 1]] * 3),
    ]
    for name, value in poison:
        path.write_text(json.dumps({**good, "waypoints": {**good["waypoints"], name: value}}))
        for load in (load_plan, load_plan_waypoints):
            with pytest.raises(BadInput, match=r"plan\.json"):
                load(path)
    for waypoints in ([], 3, "x", {}):
        path.write_text(json.dumps({**good, "waypoints": waypoints}))
        with pytest.raises(BadInput, match=r"plan\.json"):
            load_plan_waypoints(path)
    good["edges"][0]["camera_indices"] = [2, 0, 7]
    path.write_text(json.dumps(good))
    with pytest.raises(BadInput, match="deals camera 7 of 3"):
        load_plan_waypoints(path)


def test_the_same_scene_gives_the_same_bytes(tmp_path: Path) -> None:
    scene, path = some_scene(), tmp_path / "a.safetensors"
    written = set()
    for _ in range(6):
        save_scene(path, scene)
        written.add(path.read_bytes())
    assert len(written) == 1, "keys of stages hash these bytes"


def test_one_type_is_not_read_as_another(tmp_path: Path) -> None:
    save_cameras(tmp_path / "a.safetensors", some_cameras())
    with pytest.raises(BadInput, match=r"a\.safetensors.*radiant\.cameras.*radiant\.splats"):
        load_splats(tmp_path / "a.safetensors")


def test_a_strangers_safetensors_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    save_file({"means": np.zeros((1, 3), np.float32)}, path)
    with pytest.raises(BadInput, match="expected"):
        load_splats(path)
    arrays = {name: array.astype(np.float64) for name, array in some_splats().arrays().items()}
    save_file(arrays, path, {"radiant": json.dumps({"schema": "radiant.splats", "version": "1", "about": {}})})
    with pytest.raises(BadInput, match="it holds the arrays"):
        load_splats(path)
    for broken in ("[]", "{", '{"schema": "radiant.splats", "version": "1"}'):
        save_file(some_splats().arrays(), path, {"radiant": broken})
        with pytest.raises(BadInput, match=r"a\.safetensors"):
            load_splats(path)


def test_a_model_with_a_nan_is_refused_by_file_and_tensor(tmp_path: Path) -> None:
    arrays = {name: array.copy() for name, array in some_splats().arrays().items()}
    arrays["means"][2, 1] = np.nan
    save_file(arrays, tmp_path / "a.safetensors", {"radiant": json.dumps({"schema": "radiant.splats", "version": "1", "about": {}})})
    with pytest.raises(BadInput, match=r"a\.safetensors: means has 1 values that are not finite, the first at index \(2, 1\)"):
        load_splats(tmp_path / "a.safetensors")


@pytest.mark.parametrize("load", [load_splats, load_cameras, load_scene, load_plan])
def test_what_is_not_there_or_no_file_is_store_damaged(tmp_path: Path, load: Callable[[Path], Any]) -> None:
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(StoreDamaged):
            load(path)


@pytest.mark.parametrize(
    ("save", "load"),
    [
        (lambda path: save_splats(path, some_splats(2, 0)), load_splats),
        (lambda path: save_cameras(path, some_cameras(2)), load_cameras),
        (lambda path: save_scene(path, some_scene()), load_scene),
        (lambda path: save_plan(path, *some_plan()), load_plan),
        (lambda path: save_plan(path, *some_plan(), some_waypoints()), load_plan_waypoints),
    ],
    ids=["splats", "cameras", "scene", "plan", "plan with waypoints"],
)
def test_two_thousand_mutations_raise_our_errors_only(tmp_path: Path, save: Callable[[Path], None], load: Callable[[Path], Any]) -> None:
    path = tmp_path / "a.file"
    save(path)
    good = path.read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(2000):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            # Half of the damage goes into the first 400 bytes, where the headers are.
            at = int(rng.integers(0, min(len(data), 400) if rng.random() < 0.5 else len(data)))
            data[at : at + int(rng.integers(0, 3))] = rng.bytes(int(rng.integers(0, 3)))
        path.unlink()
        path.write_bytes(bytes(data))
        said = refusal(load, path)
        assert said is None or "a.file" in said


def refusal(load: Callable[[Path], Any], path: Path) -> str | None:
    """What the loader says against the file, None when it takes it; any other exception goes on."""
    try:
        load(path)
    except (BadInput, StoreDamaged) as error:
        return str(error)
    return None


PLAN_POISON: list[tuple[str, Any]] = [
    ("edge_ids", ["north", "north"]),
    ("edge_ids", "ns"),
    ("sites", [[0, 1]]),
    ("weights", [None, 1]),
    ("borders", [[[0, 1, 2]], []]),
    ("borders", 5),
    ("edge_of_camera", [0, 0, 2]),
    ("edge_of_camera", [0.5, 0, 0]),
    ("status", "fine"),
    ("certified", 1),
    ("history", ["x"]),
    ("lower_bound_s", "soon"),
]


@pytest.mark.parametrize(("name", "value"), PLAN_POISON)
def test_a_wrong_field_of_a_plan_is_bad_input(tmp_path: Path, name: str, value: Any) -> None:
    path = tmp_path / "plan.json"
    save_plan(path, *some_plan())
    record = json.loads(path.read_text())
    record["cloud"][name] = value
    path.write_text(json.dumps(record))
    with pytest.raises(BadInput, match=r"plan\.json"):
        load_plan(path)


@pytest.mark.parametrize("text", ["[]", "{}", '{"schema": "radiant.plan", "version": "2"}', '{"schema": "radiant.plan", "version": "1"}'])
def test_json_that_is_no_plan_is_bad_input(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(BadInput, match=r"plan\.json"):
        load_plan(tmp_path / "plan.json")


@pytest.mark.parametrize(("name", "value"), [("edge_id", 5), ("edge_id", None), ("dealt", 1), ("device_ids", "ab")])
def test_a_wrong_field_of_an_edges_plan_is_bad_input(tmp_path: Path, name: str, value: Any) -> None:
    path = tmp_path / "plan.json"
    save_plan(path, *some_plan())
    record = json.loads(path.read_text())
    record["edges"][0][name] = value
    path.write_text(json.dumps(record))
    with pytest.raises(BadInput, match=r"plan\.json"):
        load_plan(path)


def test_the_keys_of_a_plans_file_do_not_change(tmp_path: Path) -> None:
    """Readers of plans of older runs read these; whole numbers come back as the same floats."""
    cloud, edges = some_plan()
    waypoints = Waypoints(
        names=("a", "b", "c"), lat_lon_alt=some_waypoints().lat_lon_alt, heading_pitch_deg=[[90, -45], [np.nan, -90], [0, np.nan]]
    )
    curve = [SlackPoint(slack=1.5, makespan_s=2.0, mean_distance_m=3.0, rms_distance_m=4.0, border_m=5.0, certified=True)]
    save_plan(tmp_path / "p.json", cloud, edges, waypoints, slack_curve=curve, warnings=["w"], content={"forecast": 1, "ground_m": 412})
    record = json.loads((tmp_path / "p.json").read_text())
    assert set(record) == {"schema", "version", "cloud", "edges", "waypoints", "slack_curve", "warnings", "forecast", "ground_m"}
    assert record["slack_curve"] == [asdict(curve[0])]
    assert (record["schema"], record["version"], record["warnings"]) == ("radiant.plan", "1", ["w"])
    assert set(record["cloud"]) == {
        "method", "edge_ids", "sites", "weights", "borders", "edge_of_camera", "edge_time_s", "lower_bound_s", "status", "certified",
        "history", "slack", "constrained", "num_outside",
    }  # fmt: skip
    assert set(record["edges"][0]) == {
        "edge_id", "device_ids", "camera_indices", "device_of_camera", "strips", "device_time_s", "dealt"
    }  # fmt: skip
    assert record["waypoints"]["heading_pitch_deg"] == [[90, -45], [None, -90], [0, None]]
    found = load_plan_file(tmp_path / "p.json")
    assert found.ground_m == 412.0 and isinstance(found.ground_m, float)
    assert found.waypoints is not None and found.waypoints.heading_pitch_deg is not None
    np.testing.assert_array_equal(found.waypoints.heading_pitch_deg, waypoints.heading_pitch_deg)
    record["cloud"] |= {"lower_bound_s": 1, "history": [3, 2], "slack": 2, "num_outside": 0}
    (tmp_path / "p.json").write_text(json.dumps(record))
    again = load_plan(tmp_path / "p.json")[0]
    assert (again.lower_bound_s, again.history, again.slack) == (1.0, (3.0, 2.0), 2.0)
    assert [type(value) for value in (again.lower_bound_s, *again.history, again.slack, again.num_outside)] == [float] * 4 + [int]


def test_the_names_of_what_a_stage_leaves_do_not_change(tmp_path: Path) -> None:
    for save, value, name, about in (
        (save_splats, some_splats(2, 3), "splats", {"antialiased": False}),
        (save_cameras, some_cameras(2), "cameras", {"names": list(some_cameras(2).names)}),
        (save_scene, some_scene(), "scene", {"names": list(some_cameras().names), "frame_kind": "metric", "frame_residual_m": 0.1}),
    ):
        save(tmp_path / name, value)
        assert header_of(tmp_path / name)[0] == {"schema": f"radiant.{name}", "version": "1", "about": about}
    assert header_of(tmp_path / "scene")[1] == {
        "Ks": (5, 3, 3), "cam_from_world": (5, 4, 4), "sizes_wh": (5, 2), "points": (7, 3), "colors": (7, 3), "observations": (3, 2),
        "origin_lat_lon_alt": (3,),
    }  # fmt: skip
    save_splats(tmp_path / "a", replace(some_splats(2, 3), antialiased=True))
    assert load_splats(tmp_path / "a").antialiased and not load_splats(tmp_path / "splats").antialiased


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("method", 5, "its method is 5, expected str"),
        ("status", None, "its status is None, expected str"),
        ("certified", "yes", "its certified is 'yes', expected bool"),
        ("edge_ids", [1, 2], "a list of names holds something else"),
        ("constrained", "abc", "a list of names holds something else"),
        ("slack", "x", "could not convert string to float"),
        ("num_outside", "x", "invalid literal for int"),
        ("history", 3, "not iterable"),
        ("more", 3, "a part of it is no CloudPlan, which has exactly"),
    ],
)
def test_what_is_wrong_with_a_field_is_told(tmp_path: Path, name: str, value: Any, told: str) -> None:
    path = tmp_path / "plan.json"
    save_plan(path, *some_plan())
    record = json.loads(path.read_text())
    record["cloud"][name] = value
    path.write_text(json.dumps(record))
    with pytest.raises(BadInput, match=told):
        load_plan(path)


def test_a_plan_without_optional_parts_is_read_and_one_without_a_needed_part_is_not(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    save_plan(path, *some_plan())
    record = json.loads(path.read_text())
    for name in ("history", "slack", "constrained", "num_outside"):
        del record["cloud"][name]
    del record["edges"][0]["dealt"]
    path.write_text(json.dumps(record))
    assert load_plan(path)[0].history == ()
    del record["cloud"]["weights"]
    path.write_text(json.dumps(record))
    with pytest.raises(BadInput, match="a part of it is no CloudPlan"):
        load_plan(path)
    path.write_text("[]")
    with pytest.raises(BadInput, match="it holds no plan"):
        load_plan(path)
    path.write_text('{"schema": "radiant.plan", "version": "1"}')
    with pytest.raises(BadInput, match=r"KeyError: 'cloud'"):
        load_plan(path)


def test_the_altitude_of_the_ground_is_a_number(tmp_path: Path) -> None:
    save_plan(tmp_path / "p.json", *some_plan(), content={"ground_m": "high"})
    with pytest.raises(BadInput, match="the ground's altitude"):
        load_plan(tmp_path / "p.json")


def test_a_plan_of_two_thousand_waypoints_is_read(tmp_path: Path) -> None:
    count = 2000
    cloud, edges = some_plan()
    names = tuple(f"w{index}" for index in range(count))
    places = np.column_stack([np.linspace(47, 47.1, count), np.full(count, 8.0), np.zeros(count)])
    cloud = replace(cloud, edge_of_camera=np.zeros(count, np.int64))
    north = replace(edges[0], camera_indices=np.arange(count), device_of_camera=np.zeros(count, np.int64))
    save_plan(tmp_path / "p.json", cloud, (north, edges[1]), Waypoints(names=names, lat_lon_alt=places))
    found = load_plan_waypoints(tmp_path / "p.json")
    assert found is not None and found.names == names and (tmp_path / "p.json").stat().st_size > 100_000
