"""The codec: what is written comes back, anything else is one sentence, and a key holds all that
decides a bit and nothing more."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiant_core.aggregate.config import Join, aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, FrameUncertainty
from radiant_core.hierarchy.codec import (
    TASK_NAME,
    load_task,
    message_of,
    message_record,
    passed_on,
    save_device_model,
    save_frame,
    save_task,
    sent_bytes,
    sent_files,
    task_key,
)
from radiant_core.hierarchy.groups import GroupTraining, Seat
from radiant_core.hierarchy.messages import (
    CloudTask,
    DeviceModel,
    DeviceSettings,
    DeviceTask,
    EdgeModel,
    EdgeTask,
    device_task,
)
from radiant_core.io.run_store import content_key, file_sha256, key_of_files
from radiant_core.plan.system import Cloud
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset, with_settings
from tests.core.scenes import cameras_above, ground_splats

TRAIN, JOIN, LIMITS = train_preset("draft"), Join(epochs=5), Cloud(memory_bytes=1e9)
TRIANGLE = ((0.0, 1.0), (2.0, 3.0), (4.0, 5.0))
DEVICE = DeviceSettings(train=TRAIN, backend="native", upload="float16", memory_bytes=2e9)
EDGE = EdgeTask(
    devices=("a-1",),
    num_dealt=(2,),
    strips=(TRIANGLE,),
    train=TRAIN,
    join=JOIN,
    backend="native",
)
CLOUD = CloudTask(
    edges=("a",),
    num_dealt=(2,),
    sites=((0.0, 1.0),),
    weights=(-3.5,),
    train=TRAIN,
    join=JOIN,
    backend="native",
    limits=LIMITS,
    edge_times_s=(4.5,),
)
WHOLE = (DEVICE, EDGE, CLOUD)
named = pytest.mark.parametrize("task", WHOLE, ids=lambda task: type(task).__name__)

ids = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,8}", fullmatch=True)
finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
pairs = st.tuples(finite, finite)
trains = st.sampled_from(["draft", "default", "standard", "paper"]).map(train_preset) | st.sampled_from(
    ["none", "adc", "planned", "mcmc"]
).map(lambda kind: with_settings(TRAIN, {"density.kind": kind}))
clouds = st.builds(
    Cloud, memory_bytes=st.none() | positive, time_s=st.none() | positive, max_cameras=st.none() | st.integers(min_value=0, max_value=10**9)
)
training = {
    "train": trains,
    "backend": st.sampled_from(["gsplat", "native", "reference"]),
    "checkpoint_every_s": positive,
}
joins = st.sampled_from([JOIN, aggregate_preset("paper").edge, Join(epochs=0, method="crop_merge", max_num_steps=3)])
devices = st.builds(DeviceSettings, **training, upload=st.sampled_from(["float32", "float16", "spz"]), memory_bytes=st.none() | positive)


def of_each(count: int, values: st.SearchStrategy[Any]) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.lists(values, min_size=count, max_size=count).map(tuple)


edges = st.integers(1, 4).flatmap(
    lambda count: st.builds(
        EdgeTask,
        **training,
        devices=of_each(count, ids),
        num_dealt=of_each(count, st.integers(0, 10**9)),
        strips=of_each(count, st.lists(pairs, max_size=4).map(tuple)),
        join=joins,
        memory_bytes=st.none() | positive,
    )
)
cloud_tasks = st.integers(1, 4).flatmap(
    lambda count: st.builds(
        CloudTask,
        **training,
        edges=of_each(count, ids),
        num_dealt=of_each(count, st.integers(0, 10**9)),
        sites=of_each(count, pairs),
        weights=of_each(count, finite),
        join=joins,
        limits=st.none() | clouds,
        edge_times_s=st.none() | of_each(count, finite),
    )
)


def test_a_wrong_field_is_named_by_the_path_at_which_it_stands() -> None:
    record = message_record(DEVICE)
    density = record["train"]["density"]
    missing = {name: value for name, value in density.items() if name != "every"}
    for wrong, said in (
        ({**density, "every": "x"}, "every is 'x'; expected a valid integer"),
        ({**density, "often": 1}, "often is not a key of a message"),
        (missing, "every is missing"),
    ):
        with pytest.raises(BadInput, match=rf"message: train\.density\.{said}"):
            message_of(DeviceSettings, {**record, "train": {**record["train"], "density": wrong}})
    with pytest.raises(BadInput, match=r"message: sites\[0\]\[1\] is missing"):
        message_of(CloudTask, {**message_record(CLOUD), "sites": [[0.0]]})


@settings(max_examples=60)
@given(devices | edges | cloud_tasks)
def test_a_task_comes_back_as_it_was(task: Any) -> None:
    record = message_record(task)
    assert message_of(type(task), record) == task
    assert message_record(message_of(type(task), json.loads(json.dumps(record)))) == record


def parts_of(record: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Every value inside a record, with the way to it."""
    pairs = record.items() if isinstance(record, dict) else enumerate(record) if isinstance(record, list) else ()
    for key, value in pairs:
        yield (*path, key), value
        yield from parts_of(value, (*path, key))


def edited(record: Any, path: tuple[Any, ...], edit: Any) -> Any:
    """A copy whose part at the path `edit` has changed."""
    copy = json.loads(json.dumps(record))
    place = copy
    for key in path[:-1]:
        place = place[key]
    edit(place, path[-1])
    return copy


def refusal(task: Any, record: Any) -> str:
    with pytest.raises(BadInput) as caught:
        message_of(type(task), record, "the task")
    message = str(caught.value)
    assert message.startswith("the task: ") and message.endswith(".") and "\n" not in message
    return message


@named
def test_no_key_may_be_missing_at_any_depth(task: Any) -> None:
    record = message_record(task)
    for path, _ in parts_of(record):
        if isinstance(path[-1], str) and path[-1] != "kind":
            place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")
            assert refusal(task, edited(record, path, lambda part, key: part.pop(key))) == f"the task: {place} is missing: add it."


@named
def test_no_key_may_be_unknown_at_any_depth(task: Any) -> None:
    record = message_record(task)
    for path in [("more",), *((*path, "more") for path, value in parts_of(record) if isinstance(value, dict))]:
        message = refusal(task, edited(record, path, lambda part, key: part.update({key: 1})))
        assert "more is not a key of a message: remove it or correct its spelling." in message


@named
def test_no_number_is_text_infinite_or_not_a_number(task: Any) -> None:
    record = message_record(task)
    numbers = [(path, value) for path, value in parts_of(record) if type(value) in (int, float)]
    assert numbers
    for path, value in numbers:
        for wrong in (str(value), float("inf"), -float("inf"), float("nan"), [value], True):
            message = refusal(task, edited(record, path, lambda part, key, wrong=wrong: part.__setitem__(key, wrong)))
            assert str(path[-1]) in message


@named
def test_no_text_is_another_choice_or_leaves_a_folder(task: Any) -> None:
    record = message_record(task)
    for path, value in parts_of(record):
        if isinstance(value, str):
            for wrong in ("../x", "cuda; rm", "", -1):
                refusal(task, edited(record, path, lambda part, key, wrong=wrong: part.__setitem__(key, wrong)))


def test_the_dataclasses_own_sentences_are_passed_on() -> None:
    record = message_record(EDGE)
    assert (
        refusal(EDGE, {**record, "train": {**record["train"], "num_steps": 0}}) == "the task: train: num_steps is 0, expected at least 1."
    )
    with pytest.raises(BadInput, match="1 devices, 2 counts and 1 strips"):
        message_of(EdgeTask, {**record, "num_dealt": [1, 2]})
    with pytest.raises(BadInput, match="give one per edge"):
        message_of(CloudTask, {**message_record(CLOUD), "weights": []})
    for task in (EDGE, CLOUD):
        with pytest.raises(BadInput, match="says no epochs"):
            replace(task, join=Join())


OTHERS: dict[str, Any] = {
    "train": replace(TRAIN, num_steps=7),
    "backend": "reference",
    "checkpoint_every_s": 99.0,
    "upload": "spz",
    "memory_bytes": 3e9,
    "join": replace(JOIN, epochs=9),
    "draws_cameras": False,
    "limits": Cloud(),
    "edge_times_s": (5.5,),
    "cloud": None,
    "devices": ("b",),
    "edges": ("b",),
    "num_dealt": (3,),
    "strips": (((9.0, 9.0),),),
    "sites": ((9.0, 9.0),),
    "weights": (1.0,),
    "seat": Seat(parent="edges/b", num_views=2, first=1),
    "group": GroupTraining(root="cloud", views={"b": {"b": 2}}, num_steps=9),
    "of_devices": (4,),
}


@named
def test_what_changes_no_bit_stands_in_no_key_and_everything_else_does(task: Any) -> None:
    names = {each.name for each in fields(task)}
    unkeyed = {name for name in names if task_key(replace(task, **{name: OTHERS[name]})) == task_key(task)}
    assert unkeyed == {"checkpoint_every_s"}
    assert unkeyed.isdisjoint(task_key(task))


def ground_scene() -> SfmScene:
    """Three cameras over a made-up ground."""
    truth, cameras = ground_splats(50), cameras_above([(-1, 0), (0, 0), (1, 0)])
    return SfmScene(
        cameras=cameras,
        points=truth.means.astype(float),
        colors=np.full((len(truth), 3), 128, np.uint8),
        observations=np.indices((len(truth), len(cameras))).reshape(2, -1).T,
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3), residual_m=0.0),
    )


def test_a_scene_travels_as_a_file_beside_its_task(tmp_path: Path) -> None:
    scene = ground_scene()
    task = device_task(DEVICE, scene)
    assert save_task(tmp_path, task) == [TASK_NAME, "scene.safetensors"] and "scene" not in task_key(task)
    back = load_task(DeviceTask, tmp_path)
    assert message_record(back) == message_record(task) and back.scene.cameras.names == scene.cameras.names
    assert (back.scene.points == scene.points).all() and (back.scene.observations == scene.observations).all()
    (tmp_path / "scene.safetensors").unlink()
    with pytest.raises(BadInput, match=r"scene\.safetensors"):
        load_task(DeviceTask, tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", "1", '{"a": 1, "a": 1}', '{"a": NaN}', '{"a": 1e999}', "[" * 2000, "\xff"])
def test_a_file_that_is_no_task_is_one_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / TASK_NAME).write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInput) as caught:
        load_task(EdgeTask, tmp_path)
    assert str(tmp_path / TASK_NAME) in str(caught.value) and "\n" not in str(caught.value)


def test_an_exact_upload_arrives_bit_for_bit_under_the_key_of_its_folder(tmp_path: Path) -> None:
    model = DeviceModel(
        splats=ground_splats(50),
        cameras=ground_scene().cameras,
        uncertainty=FrameUncertainty(position_m=1.0, scale=0.01, rotation_rad=0.02),
        summary={"num_steps": 3},
    )
    arrived = passed_on(model, "float32")
    assert isinstance(arrived, DeviceModel) and arrived.uncertainty == model.uncertainty
    assert arrived.initial is None and arrived.summary == {}, "figures stay on the device"
    for name, array in model.splats.arrays().items():
        np.testing.assert_array_equal(array, arrived.splats.arrays()[name])
    np.testing.assert_array_equal(model.cameras.cam_from_world, arrived.cameras.cam_from_world)
    save_frame(tmp_path, model.uncertainty)
    save_device_model(tmp_path, model, "float32", pytest.fail)
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    for name, path in sent_files(tmp_path).items():
        (inbox / name).write_bytes(path.read_bytes())
    assert key_of_files(arrived.received) == content_key(inbox)
    assert sent_bytes(model, "float32") == sum(path.stat().st_size for path in inbox.iterdir()) > sent_bytes(model, "float16") > 0


@settings(max_examples=20)
@given(st.dictionaries(st.from_regex(r"[a-z]{1,4}(/[a-z]{1,4})?\.x", fullmatch=True), st.binary(max_size=9), max_size=4))
def test_the_key_of_files_is_that_of_their_folder(tmp_path_factory: pytest.TempPathFactory, files: dict[str, bytes]) -> None:
    folder = tmp_path_factory.mktemp("files")
    for name, data in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    hashes = {name: file_sha256(folder / name) for name in files}
    assert key_of_files(hashes) == content_key(folder)
    assert key_of_files({**hashes, "one-more": "0" * 64}) != content_key(folder)


def test_a_compressed_upload_is_what_the_receiver_reads_and_one_that_fits_no_format_is_sent_exact() -> None:
    splats = ground_splats(50)
    arrived = passed_on(DeviceModel(splats=splats, cameras=ground_scene().cameras), "float16")
    assert isinstance(arrived, DeviceModel) and len(arrived.splats) == 50 and (arrived.splats.sh0 != splats.sh0).any()
    far = replace(splats, means=splats.means + np.float32(1e12) * (np.arange(50) == 0)[:, None])
    arrived = passed_on(DeviceModel(splats=far, cameras=ground_scene().cameras), "spz")
    assert isinstance(arrived, DeviceModel)
    np.testing.assert_array_equal(arrived.splats.means, far.means)


def test_an_edge_sends_its_model_and_virtual_cameras_and_names_no_device() -> None:
    cameras = ground_scene().cameras
    sent = EdgeModel(splats=ground_splats(50), cameras=cameras, refused={"a": "it is refused."}, corrections={"a": None})
    arrived = passed_on(sent, "float32")
    assert isinstance(arrived, EdgeModel) and not arrived.refused and not arrived.corrections, "nothing names a device"
    assert set(arrived.received) == {"model.safetensors", "virtual_cameras.safetensors"}, "no picture goes up"
    np.testing.assert_array_equal(arrived.cameras.cam_from_world, cameras.cam_from_world)
    assert sent_bytes(EdgeModel(splats=None, refused=sent.refused), "float32") == 0
    lone = passed_on(EdgeModel(splats=ground_splats(50)), "float32")
    assert isinstance(lone, EdgeModel) and not len(lone.cameras) and set(lone.received) == {"model.safetensors"}


def test_what_is_no_model_arrives_as_a_reason() -> None:
    empty = DeviceModel(splats=ground_splats(50).select(np.arange(0)), cameras=ground_scene().cameras)
    arrived = passed_on(empty, "float32")
    assert isinstance(arrived, str) and "0 Gaussians" in arrived
