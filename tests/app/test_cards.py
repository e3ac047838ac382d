"""CUDA devices of nodes, without one: which device each process is told, where Ray runs them, and what a machine without one does."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from radiant_app.events import Decided, Event
from radiant_app.executors.cards import VISIBLE, choose_card, visible_cards
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.workers.nodes import run_node
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput
from radiant_core.io.run_store import SEAL_NAME, read_json, seal, write_json
from radiant_core.render import gsplat_backend
from tests.app.pipeline_kit import Finished
from tests.app.test_pipeline_nodes import by_hand

DEVICES = tuple(Tree(id=f"devices/{number}", tier="device") for number in "1234")
TREE = Tree(id="edges/a", tier="edge", children=DEVICES)
NO_CUDA = "no CUDA device that this PyTorch can use"


def cards_of(run: Path, backend: str) -> dict[str, str]:
    """Device → the variable that its process got; four devices that wait for each other, so that all run at once."""
    see = f"""
import os, pathlib, time
pathlib.Path("seen").write_text(os.environ.get({VISIBLE!r}, "unset"))
while len(list(pathlib.Path({str(run)!r}).glob("devices/*/seen"))) < 4: time.sleep(0.01)
"""

    def command(task: NodeTask) -> list[str]:
        waits = see if task.kind == "device" else ""
        return [sys.executable, "-S", "-c", f"import os; os.chdir({str(task.folder)!r})\n{waits}\nos.rename('sealed', {SEAL_NAME!r})"]

    def prepare(node: Tree) -> NodeTask:
        folder = run / node.id
        folder.mkdir(parents=True)
        write_json(folder / "task.json", {"backend": backend})
        seal(folder, "key", ["task.json"])
        (folder / SEAL_NAME).rename(folder / "sealed")
        return NodeTask(kind=node.tier, stage=node.id, folder=folder, key="key")

    LocalExecutor(num_workers=4, command=command).fold(TREE, prepare, lambda event: None)
    return {node.name: (run / node.id / "seen").read_text() for node in DEVICES}


def test_processes_of_one_machine_share_its_cuda_devices_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert cards_of(tmp_path / "all", "gsplat") == {"1": "0", "2": "1", "3": "0", "4": "1"}
    assert set(cards_of(tmp_path / "cpu", "native").values()) == {"unset"}
    monkeypatch.setenv(VISIBLE, "5, GPU-7c")
    assert cards_of(tmp_path / "listed", "gsplat") == {"1": "5", "2": "GPU-7c", "3": "5", "4": "GPU-7c"}
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert set(cards_of(tmp_path / "one", "gsplat").values()) == {"5, GPU-7c"}, "one usable device leaves no choice"


def test_a_device_that_ended_leaves_its_card_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 3)
    cards = visible_cards({})
    assert choose_card(cards, ["0", "2"]) == "1" and choose_card(cards, ["0", "1", "2", None]) == "0"
    assert choose_card(visible_cards({VISIBLE: ""}), []) is None


def machine(name: str, **resources: float) -> dict[str, Any]:
    return {"NodeID": name, "Alive": True, "Resources": {"CPU": 4.0, **resources}}


def test_a_laptop_named_for_a_device_runs_it_although_the_starting_machine_has_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    places = pytest.importorskip("radiant_app.executors.ray_places")
    machines = [
        machine("laptop", **{"device:laptop": 1.0}),
        machine("tower", GPU=2.0, **{"device:tower": 1.0}),
        machine("spare"),
        machine("spare-gpu", GPU=1.0),
    ]
    monkeypatch.setattr(places, "living_machines", lambda: machines)

    def names(place: str, *, gpu: bool) -> set[str]:
        return {found["NodeID"] for found in places.find_machines(place, gpu)}

    assert names("device:laptop", gpu=True) == names("device:laptop", gpu=False) == {"laptop"}
    assert names("device:tower", gpu=True) == {"tower"}
    assert names("device:other", gpu=True) == {"tower", "spare-gpu"}, "a node without a machine of its own goes where a GPU is"
    assert names("device:other", gpu=False) == {"laptop", "tower", "spare", "spare-gpu"}
    member = {"node": "devices/laptop", "place": "device:laptop", "gpu": True, "computes": True, "near": "devices/laptop"}
    assert "GPU" not in places._bundle_of(member, ["device:laptop"], ["device:laptop"])
    tower = {**member, "node": "devices/tower", "place": "device:tower"}
    assert places._bundle_of(tower, ["device:tower"], ["device:tower"])["GPU"] == 1.0


def test_a_machine_without_cuda_trains_the_task_of_a_run_with_it_on_its_cpu(
    finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, _, _ = finished
    monkeypatch.setattr(gsplat_backend, "missing_for_gsplat", lambda: NO_CUDA)
    by_hand(next((config.out / "devices").iterdir()), tmp_path / "device")
    task = read_json(tmp_path / "device" / "task.json")
    before = (tmp_path / "device" / "model.safetensors").read_bytes()
    write_json(tmp_path / "device" / "task.json", {**task, "backend": "gsplat"})
    events: list[Event] = []
    run_node("device", tmp_path / "device", "devices/one", events.append)
    (decision,) = (event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "renderer")
    assert decision.choice == "native, on the CPU" and decision.reason.endswith(f"this machine has {NO_CUDA}")
    assert (tmp_path / "device" / "model.safetensors").read_bytes() == before, "as by the same task without CUDA"
    seat = {"parent": "edges/a", "num_views": 1, "first": 0, "masked": False}
    write_json(tmp_path / "device" / "task.json", {**task, "backend": "gsplat", "seat": seat})
    with pytest.raises(BadInput, match=r"trains one model with others on CUDA and has no CUDA device .*--within-edge joined"):
        run_node("device", tmp_path / "device", "devices/one", events.append)
