"""A run over a network makes the scene of a run on one machine, bit for bit, and nothing of a photograph leaves its device.

Structure from motion with several threads differs in the last digits from run to run, wherever it runs: here it has one.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from radiant_app.commands.inspect.feeds import feeds_of
from radiant_app.commands.network import node as commands
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import ExecutionOptions, RunConfig, SfmOptions, TrainOptions
from radiant_app.events import Event, StageDone, StageProgress
from radiant_app.executors import local
from radiant_app.network import cloud as far_cloud
from radiant_app.network import executor as network
from radiant_app.network import hub
from radiant_core.io.records import load_cameras
from tests.app.network_nodes import POLL_S, Nodes, nodes_in, split_photographs
from tests.forked_workers import forked_workers

EDGES = {"north": ["north-1", "north-2"], "south": ["south-1"]}
DEVICES = [device for devices in EDGES.values() for device in devices]
TINY = TrainOptions(long_side_px=96, num_steps=40, max_num_splats=1200)


@dataclass
class Runs:
    """The same run on one machine and over a network."""

    here: RunResult
    far: RunResult
    nodes: Nodes
    config: RunConfig
    events: list[Event]
    source: Path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    folder, hamlet = tmp_path_factory.mktemp("network"), sample_scenes_folder() / "hamlet"
    source = split_photographs(hamlet / "images", folder / "photos", DEVICES)
    system = folder / "system.toml"
    system.write_text(
        "".join(f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{each}"\n' for each in EDGES[edge]) for edge in EDGES)
    )
    place = tmp_path_factory.mktemp("server")
    with (
        pytest.MonkeyPatch.context() as patch,
        forked_workers(place, "tests.app.network_worker") as command,
        nodes_in(folder, command) as nodes,
    ):
        patch.setattr(hub, "POLL_S", POLL_S)
        for module in (local, network, far_cloud):
            patch.setattr(module, "worker_command", command)
        patch.setattr("radiant_app.run.stages.LocalExecutor", lambda **options: local.LocalExecutor(**{**options, "command": command}))
        known = SfmOptions(poses=hamlet / "known")
        here = run(RunConfig(source=source, frames="known", sfm=known, system=system, out=folder / "here", train=TINY))
        nodes.make(EDGES)
        for edge in EDGES:
            nodes.start_edge(edge)
        for device in DEVICES:
            nodes.start_device(device, source / device, hamlet / "known")
        config = RunConfig(
            source=nodes.home("cloud"),
            frames="known",
            system=system,
            out=folder / "far",
            train=TINY,
            execution=ExecutionOptions(executor="network"),
        )
        events: list[Event] = []
        yield Runs(here=here, far=run(config, events.append), nodes=nodes, config=config, events=events, source=source)


def test_the_scene_is_that_of_a_run_on_one_machine_to_the_bit(runs: Runs) -> None:
    assert (runs.here.folder / "scene.ply").read_bytes() == (runs.far.folder / "scene.ply").read_bytes()
    for name in ("psnr_db", "ssim", "num_gaussians", "missing", "not_refined", "refined", "num_unscored", "version", "versions"):
        assert runs.here.metrics[name] == runs.far.metrics[name], name
    assert runs.far.metrics["refined"] and runs.far.metrics["missing"] == {}


def test_progress_is_told_for_every_device(runs: Runs) -> None:
    done = {event.stage for event in runs.events if isinstance(event, StageDone)}
    assert {f"devices/{device}" for device in DEVICES} | {"edges/north", "edges/south", "cloud"} <= done
    assert {event.stage for event in runs.events if isinstance(event, StageProgress)} >= {f"devices/{device}" for device in DEVICES}
    states = {row["node"]: row for row in commands.status(runs.nodes.home("cloud"))["nodes"]}
    assert {name: row["state"] for name, row in states.items()} == {"edges/north": "joined", "edges/south": "joined"}
    assert states["edges/north"]["task"]["state"] == "accepted"
    shown = feeds_of(runs.far.folder).progress().machines
    assert [line.split(",")[0] for line in shown] == ["edges/north: joined", "edges/south: joined"]
    assert feeds_of(runs.here.folder).progress().machines == ()
    # A device hears of the verdict over its last result at its next request, which the cloud does not wait for.
    until_s = time.monotonic() + 30
    while sum("the finished scene is " in line for line in runs.nodes.said) < len(DEVICES) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert sum("the finished scene is " in line for line in runs.nodes.said) == len(DEVICES)
    lines = commands.status_lines(commands.status(runs.nodes.home("north-1")))
    assert any("finished scene" in line for line in lines)


def test_the_cloud_has_no_pose_and_nobody_a_name_of_a_photograph(runs: Runs) -> None:
    beyond = [runs.far.folder, runs.nodes.home("cloud"), *(runs.nodes.home(edge) for edge in EDGES)]
    names = [path.name.encode() for path in runs.source.rglob("*.jpg")]
    for path in (path for place in beyond for path in place.rglob("*") if path.is_file()):
        content = path.read_bytes()
        assert not any(name in content for name in names), path
        assert b"\xff\xd8\xff" not in content[:4], path
    # What photographs show stays at the edge that counted it.
    for edge, own in EDGES.items():
        counted = {path.stem for path in runs.nodes.home(edge).rglob("counted/*")}
        assert counted and counted <= set(own)
    elsewhere = [runs.far.folder, runs.nodes.home("cloud"), *map(runs.nodes.home, DEVICES)]
    assert not [path for place in elsewhere for path in place.rglob("counted")]
    # A device's cameras go to its edge; what the cloud got of that stands nowhere near them.
    for device in DEVICES:
        edge = next(edge for edge, own in EDGES.items() if device in own)
        (own,) = runs.nodes.home(edge).glob(f"runs/*/devices/{device}/cameras.safetensors")
        assert not list(runs.far.folder.rglob(f"*{device}/cameras.safetensors"))
        centers = load_cameras(own).centers
        for virtual in runs.far.folder.glob("cloud/inbox/*/virtual_cameras.safetensors"):
            gaps = ((load_cameras(virtual).centers[:, None] - centers) ** 2).sum(-1) ** 0.5
            assert gaps.min() > 1e-3
    assert not list(runs.nodes.home("north").rglob("model.safetensors.part"))


def test_what_is_signed_is_signed_by_its_own_maker(runs: Runs) -> None:
    registered = (runs.far.folder / "cloud" / "senders" / "north.pub").read_bytes()
    assert registered == (runs.nodes.home("north") / "identity" / "signing_key.pub").read_bytes()
    keys = [path for path in runs.far.folder.rglob("signing_key.pem") if not path.is_symlink()]
    assert keys == [], "the run holds no key of a node, and no copy of its own"
    assert not list(runs.nodes.home("north").glob("runs/*/devices/*/identity/signing_key.pem"))


def test_resuming_asks_nobody_to_train_again(runs: Runs) -> None:
    before = (runs.far.folder / "scene.ply").read_bytes()
    events: list[Event] = []
    run(replace(runs.config), events.append, resume=True)
    assert not [event for event in events if isinstance(event, StageDone) and event.stage.startswith("devices/")]
    assert (runs.far.folder / "scene.ply").read_bytes() == before


def test_the_report_names_no_photograph(runs: Runs) -> None:
    assert "drone_" not in runs.far.report.read_text()
    assert "drone_" not in json.dumps([vars(event) for event in runs.events], default=str)
    assert not any("drone_" in line for line in runs.nodes.said) and runs.nodes.errors == []
