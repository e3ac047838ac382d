"""Nodes of a finished run by themselves: what limits a device, whom an edge and the cloud refuse."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.events import Decided, Event, Warned
from radiant_app.workers.delivering import IDENTITY
from radiant_app.workers.memory import resident_bytes
from radiant_app.workers.nodes import run_node
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.io.records import load_cameras, load_plan, save_cameras
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import load_upload, save_upload
from tests.app.pipeline_kit import TINY, Finished


def by_hand(node: Path, folder: Path) -> Path:
    """A copy of a node's folder, whose task may be changed: nothing there is signed."""
    shutil.copytree(node, folder)
    shutil.rmtree(folder / IDENTITY)
    return folder


def test_a_devices_memory_limits_its_gaussians(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    by_hand(next((config.out / "devices").iterdir()), tmp_path / "device")
    task = read_json(tmp_path / "device" / "task.json")
    assert task["memory_bytes"] is None, "the system names no limit"
    events: list[Event] = []
    write_json(tmp_path / "device" / "task.json", {**task, "memory_bytes": 64e9})
    run_node("device", tmp_path / "device", "devices/one", events.append)
    (decision,) = (event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "memory")
    assert decision.choice.startswith(f"at most {TINY.max_num_splats:,} Gaussians") and decision.figure == 64e3
    write_json(tmp_path / "device" / "task.json", {**task, "memory_bytes": 1e6})
    with pytest.raises(BadInput, match="1 MB of memory leave room for 0 Gaussians, expected 1,000 or more: give"):
        run_node("device", tmp_path / "device", "devices/one", events.append)


def test_too_little_memory_makes_a_smaller_budget_that_the_next_process_keeps(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    by_hand(next((config.out / "devices").iterdir()), tmp_path / "device")
    task = read_json(tmp_path / "device" / "task.json")
    wanted = {**task["train"], "max_num_splats": 1_000_000}
    # A million Gaussians need over 1 GB beside the process.
    memory_bytes = resident_bytes() + 200_000_000
    write_json(tmp_path / "device" / "task.json", {**task, "train": wanted, "memory_bytes": memory_bytes})

    def choice() -> str:
        events: list[Event] = []
        run_node("device", tmp_path / "device", "devices/one", events.append)
        return next(event.decision.choice for event in events if isinstance(event, Decided) and event.decision.topic == "memory")

    first = choice()
    (limit,) = re.findall(r"at most ([\d,]+) Gaussians", first)
    assert 1000 <= int(limit.replace(",", "")) < 500_000
    # What a later process holds is another matter: with another limit, its checkpoints would be
    # another training's.
    ballast = np.ones(5_000_000)
    assert choice() == first and ballast[-1] == 1
    kept = read_json(tmp_path / "device" / "memory.json")
    write_json(tmp_path / "device" / "memory.json", {name: value - 50_000_000 for name, value in kept.items()})
    assert choice() != first, "it is the figure in the file that counts"
    # A damaged one is taken anew, whatever the figure is now.
    (tmp_path / "device" / "memory.json").write_text("{")
    assert "Gaussians" in choice() and read_json(tmp_path / "device" / "memory.json")


def test_a_device_that_sends_more_cameras_than_it_was_dealt_is_refused_by_its_edge_and_an_edge_by_the_cloud(
    finished: Finished, tmp_path: Path
) -> None:
    config, _, _ = finished
    joining = next(folder for folder in sorted((config.out / "edges").iterdir()) if len(list((folder / "inbox").iterdir())) > 1)
    edge = by_hand(joining, tmp_path / "edge")
    task = read_json(edge / "task.json")
    photographs = [len(list((config.out / "devices" / device / "photos").iterdir())) for device in task["devices"]]
    assert task["num_dealt"] == photographs
    write_json(edge / "task.json", task)
    greedy, *others = task["devices"]
    _send_more_cameras(edge / "inbox" / greedy / "cameras.safetensors", 20_000)
    events: list[Event] = []
    run_node("edge", edge, "edges/one", events.append)
    told = f"it sends 20,000 cameras, where {photographs[0]} photographs were dealt to it."
    assert read_json(edge / "refused.json") == {greedy: told}
    assert f"the model of {greedy} is left out: {told}" in [event.message for event in events if isinstance(event, Warned)]
    assert len(load_cameras(edge / "virtual_cameras.safetensors")) == sum(photographs[1:])
    assert read_json(edge / "summary.json")["num_models"] == len(others)

    cloud = by_hand(config.out / "cloud", tmp_path / "cloud")
    task = read_json(cloud / "task.json")
    _, edge_plans = load_plan(config.out / "plan.json")
    assert task["num_dealt"] == [len(plan.camera_indices) for plan in edge_plans if plan.edge_id in task["edges"]]
    for name in task["edges"]:
        _send_more_cameras(cloud / "inbox" / name / "virtual_cameras.safetensors", 500)
    run_node("cloud", cloud, "cloud", events.append)
    assert {reason[:22] for reason in read_json(cloud / "refused.json").values()} == {"it sends 500 cameras, "}


def _send_more_cameras(path: Path, count: int) -> None:
    cameras = load_cameras(path)
    copies = [replace(cameras, names=tuple(f"{index}-{name}" for name in cameras.names)) for index in range(-(-count // len(cameras)))]
    save_cameras(path, concatenate_cameras(copies).select(np.arange(count)))


def test_a_model_out_of_its_cameras_sight_is_refused_and_the_rest_is_joined(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    edge = next(folder for folder in sorted((config.out / "edges").iterdir()) if len(list((folder / "inbox").iterdir())) > 1)
    by_hand(edge, tmp_path / "edge")
    senders = read_json(tmp_path / "edge" / "task.json")["devices"]
    bad, *good = senders
    place = tmp_path / "edge" / "inbox" / bad / "model.safetensors"
    model = load_upload(place)
    save_upload(place, replace(model, means=model.means + np.float32(1e5)), "float32")
    events: list[Event] = []
    run_node("edge", tmp_path / "edge", "edges/one", events.append)
    moves = read_json(tmp_path / "edge" / "corrections.json")
    assert [name for name in senders if moves[name] is not None] == good and moves[bad] is None
    assert list(read_json(tmp_path / "edge" / "refused.json")) == [bad]
    (warning,) = (event.message for event in events if isinstance(event, Warned))
    assert warning.startswith(f"the model of {bad} is left out: its own cameras see 0.0% of its Gaussians")
    for name in good:
        (tmp_path / "edge" / "inbox" / name / "model.safetensors").write_bytes(b"no model")
    outputs = run_node("edge", tmp_path / "edge", "edges/one", events.append)
    assert outputs == ["summary.json", "corrections.json", "refused.json", "frame.json", "notes.json"]
    assert set(read_json(tmp_path / "edge" / "refused.json")) == set(senders)
    assert read_json(tmp_path / "edge" / "frame.json") == {"status": "missing", "reason": "", "uncertainty": None}
