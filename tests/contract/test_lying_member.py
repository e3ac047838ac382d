"""Devices that lie in all that their own nodes send, signed by their own keys, cost a run over a network their own part alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import ExecutionOptions, RunConfig, TrainOptions
from radiant_app.events import Event, Warned
from radiant_app.executors import local
from radiant_app.network import cloud as far_cloud
from radiant_app.network import executor as network
from radiant_app.network import hub
from radiant_app.network.errands import Errands
from radiant_app.workers.delivering import deliver
from radiant_core.io.run_store import read_json, write_json
from tests.app.network_nodes import POLL_S, nodes_in, split_photographs
from tests.app.test_lying_members import ROW
from tests.forked_workers import forked_workers

TINY = TrainOptions(long_side_px=64, num_steps=30, max_num_splats=800)
EVENTS = [
    json.dumps({"event": "Decided", "decision": {"stage": 5, "topic": "t", "choice": "c", "figure": 1, "unit": "", "reason": "r"}}),
    json.dumps({"event": "StageStarted", "stage": "devices/liar"}),
    json.dumps({"event": "StageDone", "stage": "devices/liar", "seconds": 1.0, "emulated": True}),
    "[" * 3900,
]


def with_shares(scores: dict[str, Any], secret: Path) -> None:
    scores["images"] = [{**ROW, "name": f"liar/held-out-{index:04d}", "psnr_db": 99.0} for index in range(1000)]
    scores["versions"] = {name: [60.0 if name == "joined" else 0.0] * 1000 for name in scores["versions"]}


def with_a_path(scores: dict[str, Any], secret: Path) -> None:
    scores["images"][0]["name"] = str(secret.with_suffix(""))


LIES = {
    "liar": (with_shares, "it scores 1,000 photographs and holds out"),
    "thief": (with_a_path, "scores cannot be used: a score is of '/"),
}
"""What a device makes of its scores, and why they are not used."""
LIARS = {f"devices/{name}": name for name in LIES}
DEVICES = ["honest", *LIES]


def test_devices_that_lie_are_left_out_by_name_and_the_run_is_scored(tmp_path: Path) -> None:
    secret = tmp_path / "secret.png"
    cv2.imwrite(str(secret), np.full((8, 8, 3), 77, np.uint8))
    result, events = run_with_liars(tmp_path, secret)
    metrics = read_json(result.folder / "metrics.json")
    assert sorted(metrics["failed_scoring"]) == sorted(LIES) and 5 < metrics["psnr_db"] < 50
    assert [row["name"].split("/")[0] for row in metrics["images"]] == ["honest"] * len(metrics["images"]) and metrics["num_unscored"] >= 0
    assert metrics["missing"] == {}, "their models are in the scene: those were not wrong"
    for liar, (_, reason) in LIES.items():
        said = [event.message for event in events if isinstance(event, Warned) and event.stage == f"devices/{liar}/score"]
        assert any(reason in message for message in said), said
    assert f"Photograph of {secret.with_suffix('')}" not in (result.folder / "report.html").read_text()


def run_with_liars(folder: Path, secret: Path) -> tuple[RunResult, list[Event]]:
    """A run of an edge with three devices, two of which add wrong events to each poll and sign other scores than they have."""
    hamlet = sample_scenes_folder() / "hamlet"
    source = split_photographs(hamlet / "images", folder / "photos", DEVICES)
    system = folder / "system.toml"
    system.write_text('[[edge]]\nid = "north"\n' + "".join(f'[[edge.device]]\nid = "{device}"\n' for device in DEVICES))
    (folder / "server").mkdir()
    body, send = Errands._poll_body, Errands._send

    def lying_body(errands: Errands) -> dict[str, Any]:
        told = body(errands)
        return told | {"events": [*told["events"], *EVENTS]} if errands.home.node in LIARS and told["task"] else told

    def lying_send(errands: Errands, errand: Any, paths: Mapping[str, Path]) -> None:
        if errands.home.node in LIARS and errand.envelope.kind == "score":
            path = paths["scores.json"]
            scores = read_json(path)
            LIES[LIARS[errands.home.node]][0](scores, secret)
            write_json(path, scores)
            deliver(path.parent, {"scores.json": path}, "scores", path.parent.parent)
        send(errands, errand, paths)

    with (
        pytest.MonkeyPatch.context() as patch,
        forked_workers(folder / "server", "tests.app.network_worker") as command,
        nodes_in(folder, command) as nodes,
    ):
        patch.setattr(hub, "POLL_S", POLL_S)
        patch.setattr(Errands, "_poll_body", lying_body)
        patch.setattr(Errands, "_send", lying_send)
        for module in (local, network, far_cloud):
            patch.setattr(module, "worker_command", command)
        nodes.make({"north": DEVICES})
        nodes.start_edge("north")
        for device in DEVICES:
            nodes.start_device(device, source / device, hamlet / "known")
        config = RunConfig(
            source=nodes.home("cloud"),
            frames="known",
            system=system,
            out=folder / "run",
            train=TINY,
            execution=ExecutionOptions(executor="network"),
        )
        events: list[Event] = []
        result = run(config, events.append)
        assert nodes.errors == []
        return result, events
