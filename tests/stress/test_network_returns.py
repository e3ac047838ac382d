"""A device that vanishes is given up after its lease, and takes part again when the run goes on: the scene is that of one machine."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import ExecutionOptions, RunConfig, SfmOptions
from radiant_app.events import Event, StageDone
from radiant_app.executors import local
from radiant_app.network import cloud as far_cloud
from radiant_app.network import executor as network
from radiant_app.network import hub
from tests.app.network_nodes import nodes_in, split_photographs
from tests.app.network_worker import command
from tests.contract.test_network import TINY

pytestmark = pytest.mark.stress
DEVICES = ["north-1", "north-2"]


def test_a_device_that_comes_back_takes_part_when_the_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hamlet, source = (
        sample_scenes_folder() / "hamlet",
        split_photographs(sample_scenes_folder() / "hamlet" / "images", tmp_path / "photos", DEVICES),
    )
    (tmp_path / "system.toml").write_text('[[edge]]\nid = "north"\n' + "".join(f'[[edge.device]]\nid = "{each}"\n' for each in DEVICES))
    monkeypatch.setattr(hub, "POLL_S", 0.1)
    monkeypatch.setattr(network, "ALIVE_S", 0.5)
    for module in (local, network, far_cloud):
        monkeypatch.setattr(module, "worker_command", command)
    monkeypatch.setattr("radiant_app.run.stages.LocalExecutor", lambda **options: local.LocalExecutor(**{**options, "command": command}))
    config = RunConfig(source=source, frames="known", system=tmp_path / "system.toml", out=tmp_path / "here", train=TINY)
    here = run(replace(config, sfm=SfmOptions(poses=hamlet / "known")))
    with nodes_in(tmp_path, command) as nodes:
        nodes.make({"north": DEVICES})
        config = replace(config, source=nodes.home("cloud"), out=tmp_path / "far", execution=ExecutionOptions(executor="network"))
        nodes.start_edge("north")
        for device in DEVICES:
            nodes.start_device(device, source / device, hamlet / "known")
        counted = threading.Event()

        def vanish() -> None:
            counted.wait(300)
            nodes.stop("north-2")
            monkeypatch.setattr(network, "LEASE_S", 3.0)

        def listen(event: Event) -> None:
            if isinstance(event, StageDone) and event.stage == "edges/north/raster":
                counted.set()
                vanishing.join()

        vanishing = threading.Thread(target=vanish, daemon=True)
        vanishing.start()
        without = run(config, listen)
        assert list(without.metrics["missing"]) == ["north-2"]
        monkeypatch.setattr(network, "LEASE_S", 900.0)
        nodes.start_device("north-2", source / "north-2", hamlet / "known")
        events: list[Event] = []
        whole = run(config, events.append, resume=True)
        trained = [
            event.stage for event in events if isinstance(event, StageDone) and event.stage in ("devices/north-1", "devices/north-2")
        ]
        assert trained == ["devices/north-2"], "the other one keeps its model"
        assert whole.metrics["missing"] == {}
        assert (whole.folder / "scene.ply").read_bytes() == (here.folder / "scene.ply").read_bytes()
