"""Tasks that come down: the newest one that was signed by the node above is taken, and nothing else, however near it comes."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_app.workers.delivering import (
    ABOVE_NAME,
    FROM_ABOVE,
    IDENTITY,
    TAKEN_NAME,
    accept_task,
    exchange_keys,
    identify_part,
    sign_task,
)
from radiant_app.workers.tasks import (
    TASKS,
    AverageTask,
    CountTask,
    FieldTask,
    FinishTask,
    JobTask,
    Move,
    OwnFieldTask,
    PlacingTask,
    PlannedEdge,
    PositionsTask,
    RasterTask,
    RefineNodeTask,
    RegionsTask,
    ScoreTask,
    SfmSettings,
    SfmTask,
    receive_task,
)
from radiant_core.aggregate.config import Join
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.hierarchy.codec import load_task, message_record, save_task
from radiant_core.hierarchy.messages import NO_CAMERAS, CloudTask, DeviceTask, EdgeTask
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.io.transport.signing import KEY_NAME, PUBLIC_NAME
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.config import train_preset
from tests.memory_folder import memory_folder

DEVICE, EDGE = "devices/a-1", "edges/a"
SHARED = ("task.json", "scene.safetensors", "photos")
TRAIN = train_preset("draft")
SCENE = SfmScene(
    cameras=NO_CAMERAS,
    points=np.zeros((0, 3)),
    colors=np.zeros((0, 3), np.uint8),
    observations=np.zeros((0, 2), np.int64),
    frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
)
MESSAGES: dict[str, Any] = {
    "sfm": SfmTask(source="/photos", sfm=SfmConfig(), masks=None, placement=Placement()),
    "positions": PositionsTask(source="/photos", cell_m=20.0, held_out=("b.jpg",), owned=True),
    "regions": RegionsTask(
        cell_m=20.0,
        cells=((0, 1),),
        counts=(3,),
        edges=(PlannedEdge(id="a", position=(0.0, 1.0), uplink_bytes_per_s=1e6, time_s=CostCurve(linear=1.0), max_cameras=9),),
        method="exact",
    ),
    "device": DeviceTask(train=TRAIN, backend="native", scene=SCENE),
    "field": FieldTask(
        train=TRAIN,
        backend="native",
        placing=PlacingTask(
            frames="gps",
            source="/photos",
            names=("a.jpg",),
            held_out=("b/c.jpg",),
            fetch=True,
            origin=(45.0, 7.5, 300.0),
            sfm=SfmSettings(matching="auto", seed=0),
            poses=None,
        ),
        changed=((10, 20),),
    ),
    "count": CountTask(frames="gps"),
    "raster": RasterTask(frames="known", cell_m=5.0, first_held_out=3),
    "own_field": OwnFieldTask(
        train=TRAIN,
        backend="native",
        frames="gps",
        first_held_out=7,
        origin=(45.0, 7.5, 300.0),
        sfm=SfmSettings(matching="auto", seed=0),
    ),
    "edge": EdgeTask(
        train=TRAIN,
        backend="native",
        devices=("a-1",),
        num_dealt=(2,),
        strips=(((0.0, 1.0), (2.0, 3.0), (4.0, 5.0)),),
        join=Join(epochs=10),
    ),
    "cloud": CloudTask(
        train=TRAIN, backend="native", edges=("a",), num_dealt=(2,), sites=((0.0, 1.0),), weights=(0.0,), join=Join(epochs=5)
    ),
    "score": ScoreTask(
        corrections=(Move.of(Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))),),
        long_side_px=64,
        backend="native",
        lpips=None,
        light="auto",
        owned=True,
    ),
    "refine": RefineNodeTask(
        train=TRAIN,
        backend="native",
        epochs=4,
        corrections=(Move.of(Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))),),
    ),
    "average": AverageTask(
        senders=("a-1",),
        num_dealt=(2,),
        corrections=((Move.of(Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))),),),
        upload="float16",
        backend="native",
        long_side_px=64,
        joined="0" * 64,
        counted_in=(0,),
    ),
    "finish": FinishTask(senders=("a",), num_dealt=(2,), another_round=True),
    "run": JobTask(config={"source": "photos"}, resume=True),
}


def run_with(folder: Path, *devices: str) -> Path:
    """A run of one edge whose devices were introduced."""
    exchange_keys(folder, "cloud", None, [EDGE])
    exchange_keys(folder, EDGE, "cloud", devices)
    for device in devices:
        exchange_keys(folder, device, EDGE)
    return folder


def given(run: Path, device: str = DEVICE, seed: int = 0) -> Path:
    """A device's folder with a signed task of this seed and two photographs."""
    folder = run / device
    (folder / "photos").mkdir(exist_ok=True)
    for name in ("one.jpg", "two.jpg"):
        (folder / "photos" / name).write_bytes(name.encode() * 20)
    (folder / "scene.safetensors").write_bytes(b"scene")
    write_json(folder / "task.json", message_record(replace(MESSAGES["device"], train=replace(TRAIN, seed=seed))))
    sign_task(run, EDGE, device, "device_task", folder, SHARED)
    return folder


def refusal(folder: Path, kind: Any = "device_task") -> str:
    """Why a task is not taken; what was taken before stays what it was."""
    taken = folder / IDENTITY / TAKEN_NAME
    before = taken.read_bytes() if taken.is_file() else None
    with pytest.raises(BadInput) as caught:
        accept_task(folder, kind)
    assert (taken.read_bytes() if taken.is_file() else None) == before
    return str(caught.value)


def test_a_task_is_taken_as_often_as_its_process_begins_and_a_newer_one_replaces_it(tmp_path: Path) -> None:
    run = run_with(tmp_path, DEVICE)
    folder = given(run)
    accept_task(folder, "device_task")
    accept_task(folder, "device_task")
    assert json.loads((folder / IDENTITY / TAKEN_NAME).read_text())["attempt"] == 1
    accept_task(given(run), "device_task")
    assert json.loads((folder / IDENTITY / TAKEN_NAME).read_text())["attempt"] == 1, "the same files are the same attempt"
    accept_task(given(run, seed=1), "device_task")
    assert json.loads((folder / IDENTITY / TAKEN_NAME).read_text())["attempt"] == 2


def test_an_older_task_does_not_come_back(tmp_path: Path) -> None:
    run = run_with(tmp_path, DEVICE)
    old = shutil.copytree(given(run), tmp_path / "old")
    folder = given(run, seed=1)
    accept_task(folder, "device_task")
    for name in ("task.json", f"{FROM_ABOVE}/{RECORD_NAME}", f"{FROM_ABOVE}/{SIGNATURE_NAME}"):
        shutil.copyfile(old / name, folder / name)
    assert "attempt 1 is old, attempt 2 was taken" in refusal(folder)


def test_a_task_for_somebody_else_of_another_run_or_kind_is_refused(tmp_path: Path) -> None:
    run = run_with(tmp_path / "run", DEVICE, "devices/a-2")
    folder, other = given(run), given(run, "devices/a-2")
    shutil.copytree(other / FROM_ABOVE, folder / FROM_ABOVE, dirs_exist_ok=True)
    assert "it is addressed to 'devices/a-2'" in refusal(folder)
    folder = given(run)
    assert "is 'device_task', expected 'field_task'" in refusal(folder, "field_task")
    (run / "run.json").unlink()
    # The same keys, another number: a run that was copied and begun anew.
    exchange_keys(run, DEVICE, EDGE)
    assert "it belongs to run" in refusal(folder)


def test_only_the_key_that_was_registered_counts_until_it_is_renewed(tmp_path: Path) -> None:
    run = run_with(tmp_path, DEVICE, "devices/a-2")
    accept_task(given(run), "device_task")
    accept_task(given(run, seed=1), "device_task")
    # Somebody changes the edge's key; then a device gives itself a task.
    shutil.copytree(run / EDGE / IDENTITY, tmp_path / "kept")
    for name in (KEY_NAME, PUBLIC_NAME):
        shutil.copyfile(run / "devices/a-2" / IDENTITY / name, run / EDGE / IDENTITY / name)
    run_with(run, DEVICE, "devices/a-2")
    assert "is not signed by the key that is registered" in refusal(given(run, seed=2))
    # Its owner removes it on purpose: a new one is registered, and counting begins anew.
    shutil.rmtree(run / EDGE / IDENTITY)
    run_with(run, DEVICE, "devices/a-2")
    for device in (DEVICE, "devices/a-2"):
        accept_task(given(run, device), "device_task")
    assert (run / DEVICE / IDENTITY / ABOVE_NAME).read_bytes() != (tmp_path / "kept" / PUBLIC_NAME).read_bytes()


def test_a_scoring_takes_what_is_addressed_to_its_device(tmp_path: Path) -> None:
    run = run_with(tmp_path, DEVICE)
    folder = run / DEVICE / "score"
    (folder / "inbox").mkdir(parents=True)
    for name in ("task.json", "inbox/scene.ply", "inbox/plan.json"):
        (folder / name).write_bytes(name.encode())
    identify_part(run, f"{DEVICE}/score", DEVICE, EDGE)
    sign_task(run, EDGE, DEVICE, "score_task", folder, ["task.json", "inbox/scene.ply", "inbox/plan.json"])
    accept_task(folder, "score_task")
    (folder / "inbox" / "lpips.safetensors").write_bytes(b"not sent")
    assert "was not sent with the score_task" in refusal(folder, "score_task")


def test_no_tampered_task_is_taken() -> None:
    # `make stress` tries a hundred thousand.
    with memory_folder() as folder:
        assert tampered_tasks(folder, count=300, seed=1) == []


def tampered_tasks(folder: Path, count: int, seed: int) -> list[str]:
    """Change a device's task in `count` ways that need no key of its edge; those that were taken."""
    run = run_with(folder / "run", DEVICE, "devices/a-2")
    signed = (f"{FROM_ABOVE}/{RECORD_NAME}", f"{FROM_ABOVE}/{SIGNATURE_NAME}")
    kept = {
        name: shutil.copytree(given(run, device, number), folder / name)
        for name, device, number in (("older", DEVICE, 1), ("other", "devices/a-2", 2), ("right", DEVICE, 3))
    }
    # All of it right, but signed by another device.
    shutil.copytree(run / "devices/a-2" / IDENTITY, folder / "forger" / "edges/x" / IDENTITY)
    shutil.copyfile(run / "run.json", folder / "forger" / "run.json")
    sign_task(folder / "forger", "edges/x", DEVICE, "device_task", shutil.copytree(kept["right"], folder / "forged"), SHARED)
    place = run / DEVICE
    names = ["task.json", "scene.safetensors", "photos/one.jpg", "photos/two.jpg", *signed]
    whole = {name: (place / name).read_bytes() for name in names}
    rng = random.Random(seed)

    def flipped(data: bytes) -> bytes:
        edited = bytearray(data)
        edited[rng.randrange(len(edited))] ^= 1 << rng.randrange(8)
        return bytes(edited)

    def one(edit: Callable[[bytes], bytes]) -> dict[str, bytes]:
        name = rng.choice(names)
        return {name: edit(whole[name])}

    def of(source: str, *chosen: str) -> dict[str, bytes]:
        return {name: (folder / source / name).read_bytes() for name in chosen}

    attacks: list[Callable[[], dict[str, bytes]]] = [
        lambda: one(flipped),
        lambda: one(lambda data: data[: rng.randrange(len(data))]),
        lambda: one(lambda data: data + rng.randbytes(rng.randrange(1, 9))),
        lambda: {f"photos/{rng.randrange(99)}.jpg": rng.randbytes(9)},
        lambda: {"masks/one.jpg.png": rng.randbytes(9)},
        lambda: {"photos/one.jpg": whole["photos/two.jpg"], "photos/two.jpg": whole["photos/one.jpg"]},
        lambda: of("older", *signed),
        lambda: of("older", "task.json"),
        lambda: of("older", *names),
        lambda: of("other", *signed),
        lambda: of("other", *names),
        lambda: of("forged", *signed),
    ]
    accept_task(place, "device_task")
    taken = []
    for number in range(count):
        attack = rng.randrange(len(attacks))
        changed = attacks[attack]()
        for name, data in changed.items():
            (place / name).parent.mkdir(exist_ok=True)
            (place / name).write_bytes(data)
        try:
            accept_task(place, "device_task")
            taken.append(f"task {number}, attack {attack}")
        except BadInput:
            pass
        for name in changed:
            (place / name).unlink()
        shutil.rmtree(place / "masks", ignore_errors=True)
        for name in changed.keys() & whole.keys():
            (place / name).write_bytes(whole[name])
    # Nothing of it was refused because the receiver was broken.
    accept_task(place, "device_task")
    return taken


@pytest.mark.parametrize("kind", TASKS)
def test_a_task_has_exactly_the_fields_of_its_kind_and_comes_back_as_it_was(kind: str, tmp_path: Path) -> None:
    save_task(tmp_path, MESSAGES[kind])
    path = tmp_path / "task.json"
    right = read_json(path)
    back = load_task(TASKS[kind], tmp_path)
    assert message_record(back) == right and type(back) is type(MESSAGES[kind])
    wrongs = [{key: value for key, value in right.items() if key != left_out} for left_out in right]
    wrongs += [{**right, "more": 1}, {**right, "backend": "cuda; rm"}]
    wrongs += [{**right, key: "1"} for key, value in right.items() if isinstance(value, int | float | dict)]
    wrongs += [{**right, "train": {**right["train"], "num_steps": 0}}] if "train" in right else []
    wrongs += [{**right, key: ["../x"]} for key in ("devices", "edges") if key in right]
    wrongs += [{**right, "placing": {**right["placing"], key: ["../x"]}} for key in ("names", "held_out") if "placing" in right]
    for wrong in wrongs:
        write_json(path, wrong)
        with pytest.raises(BadInput, match=r"task\.json: "):
            load_task(TASKS[kind], tmp_path)
    path.write_text('{"a": 1, "a": 2}')
    with pytest.raises(BadInput, match="is not valid JSON"):
        load_task(TASKS[kind], tmp_path)
    path.write_text("null")
    with pytest.raises(BadInput, match=r"task\.json is no JSON object"):
        load_task(TASKS[kind], tmp_path)


def test_what_is_no_node_of_a_run_is_not_asked_for_a_signature(tmp_path: Path) -> None:
    save_task(tmp_path, MESSAGES["device"])
    assert receive_task("device", tmp_path).train == TRAIN
    folder = run_with(tmp_path / "run", DEVICE) / DEVICE
    save_task(folder, MESSAGES["sfm"])
    assert receive_task("sfm", folder) == MESSAGES["sfm"]
    save_task(folder, MESSAGES["device"])
    with pytest.raises(BadInput, match=r"delivery\.json"):
        receive_task("device", folder)


def test_a_worker_refuses_a_changed_task_before_it_works(tmp_path: Path) -> None:
    folder = given(run_with(tmp_path, DEVICE))
    text = (folder / "task.json").read_text()
    (folder / "task.json").write_text(text.replace('"seed": 0', '"seed": 7'))
    command = [sys.executable, "-m", "radiant_app.workers.worker", "device", str(folder), DEVICE, "key"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, stdin=subprocess.DEVNULL)
    assert done.returncode == BadInput.exit_code and "has other bytes than its sender signed" in done.stdout
    assert not (folder / "done.json").exists()
