"""--preset paper end to end on the smallest sample scene: what each tier was told to skip, and both ways the cloud can go."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.fields import config_of as run_config
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Event, Warned
from radiant_app.workers.nodes import run_node
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_splats
from radiant_core.io.run_store import read_json, write_json

TINY = {"train.long_side_px": 64, "train.num_steps": 40}
SYSTEM = """
[[edge]]
id = "north"
[[edge.device]]
id = "n"
[[edge]]
id = "south"
[[edge.device]]
id = "s1"
max_cameras = 2
[[edge.device]]
id = "s2"
[cloud]
memory_gb = 64.0
time_s = 36000.0
"""


def config_of(project: Path, folder: Path) -> RunConfig:
    return run_config({"source": project, "out": folder / "run", "system": folder / "system.toml", "preset": "paper", **TINY})


def decided(events: list[Event]) -> list[Decision]:
    return [event.decision for event in events if isinstance(event, Decided)]


@pytest.fixture(scope="module")
def finished(hamlet_project: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult, list[Event]]:
    folder = tmp_path_factory.mktemp("paper")
    (folder / "system.toml").write_text(SYSTEM)
    events: list[Event] = []
    return folder, run(config_of(hamlet_project, folder), events.append), events


def test_every_skip_is_off_and_said(finished: tuple[Path, RunResult, list[Event]]) -> None:
    folder, result, events = finished
    decisions = decided(events)
    assert {d.topic for d in decisions if d.forced} >= {"size", "sky", "fill-in points", "retraining"}
    assert not [d for d in decisions if d.choice == "skipped"]
    device = read_json(folder / "run" / "devices" / "n" / "task.json")["train"]
    assert (device["density"]["kind"], device["sky"], device["fill_in"], device["adam"], device["max_num_splats"]) == (
        "adc", False, False, "dense", 5_000_000,
    )  # fmt: skip
    # One device at this edge: its model is retrained all the same, 10 epochs of its views.
    edge = read_json(folder / "run" / "edges" / "north" / "summary.json")
    assert edge["num_models"] == 1 and edge["num_steps"] == 10 * len(load_cameras(folder / "run/edges/north/virtual_cameras.safetensors"))
    assert load_plan(folder / "run" / "plan.json")[0].method == "paper"
    assert result.metrics["psnr_db"] > 5


def test_the_cloud_retrained_everything_it_was_sent_on_virtual_cameras(finished: tuple[Path, RunResult, list[Event]]) -> None:
    folder, _, events = finished
    cloud = folder / "run" / "cloud"
    sent = sorted(str(path.relative_to(cloud / "inbox")) for path in (cloud / "inbox").rglob("*") if path.is_file())
    assert sent == [f"{edge}/{name}.safetensors" for edge in ("north", "south") for name in ("model", "virtual_cameras")]
    models = [load_splats(cloud / "inbox" / edge / "model.safetensors") for edge in ("north", "south")]
    scene = load_ply(folder / "run" / "scene.ply")
    assert len(scene) == sum(map(len, models)) and not np.isin(scene.means[:, 0], np.concatenate([m.means[:, 0] for m in models])).all()
    views = sum(len(load_cameras(cloud / "inbox" / edge / "virtual_cameras.safetensors")) for edge in ("north", "south"))
    assert read_json(cloud / "summary.json")["num_steps"] == 10 * views
    (choice,) = [d for d in decided(events) if d.stage == "cloud" and d.topic == "aggregation"]
    assert choice.choice.startswith("retraining") and choice.unit == "GB predicted" and 0.1 < (choice.figure or 0) < 64


def test_nothing_at_the_cloud_names_a_device_or_counts_them(finished: tuple[Path, RunResult, list[Event]]) -> None:
    folder, _, _ = finished
    task = (folder / "run" / "cloud" / "task.json").read_text()
    assert '"s1"' not in task and "num_models" not in task
    virtual = load_cameras(folder / "run" / "cloud" / "inbox" / "south" / "virtual_cameras.safetensors")
    own = [load_cameras(path) for path in (folder / "run" / "edges" / "south" / "inbox").glob("*/cameras.safetensors")]
    assert len(own) == 2 and sum(map(len, own)) == len(virtual)
    for cameras in own:
        assert not set(cameras.names) & set(virtual.names)
        assert not np.isclose(cameras.centers[:, None], virtual.centers, atol=1e-6).all(axis=2).any()
    model = load_splats(folder / "run" / "edges" / "south" / "model.safetensors")
    first = len(load_splats(folder / "run" / "edges" / "south" / "inbox" / "s1" / "model.safetensors"))
    # In Morton order the first device's Gaussians no longer stand before the second's.
    assert np.abs(np.diff(model.means, axis=0)).mean() < np.abs(model.means - model.means.mean(0)).mean() and 0 < first < len(model)


def test_a_device_holds_no_more_cameras_than_its_limit(finished: tuple[Path, RunResult, list[Event]]) -> None:
    folder, _, _ = finished
    assert len(list((folder / "run" / "devices" / "s1" / "photos").iterdir())) <= 2


@pytest.mark.parametrize(
    ("limit", "told"),
    [({"memory_bytes": 1e7}, "memory of retraining"), ({"time_s": 1e-3}, "time of retraining"), ({"max_cameras": 3}, "views")],
)
def test_beyond_a_limit_the_cloud_cuts_at_the_borders_and_says_the_figure(
    finished: tuple[Path, RunResult, list[Event]], tmp_path: Path, limit: dict[str, float], told: str
) -> None:
    folder, _, _ = finished
    cloud = tmp_path / "cloud"
    shutil.copytree(folder / "run" / "cloud", cloud)
    task = read_json(cloud / "task.json")
    assert len(task["edge_times_s"]) == 2 and min(task["edge_times_s"]) > 0
    write_json(cloud / "task.json", {**task, "limits": {**task["limits"], **limit}})
    events: list[Event] = []
    run_node("cloud", cloud, "cloud", events.append)
    (choice,) = [d for d in decided(events) if d.topic == "aggregation"]
    assert choice.choice.startswith("models are cut") and told in choice.reason and "exceeds" in choice.reason
    (warning,) = [event.message for event in events if isinstance(event, Warned)]
    assert (
        choice.reason in warning
        and "dB lower" in warning
        and "raise that limit under [cloud]" in warning
        and "`radiant join RUN" in warning
    )
    summary = read_json(cloud / "summary.json")
    models = [load_splats(cloud / "inbox" / edge / "model.safetensors") for edge in task["edges"]]
    owners = [np.argmin(((m.means[:, None, :2] - np.array(task["sites"])) ** 2).sum(-1) - task["weights"], axis=1) for m in models]
    assert summary["num_splats"] == len(load_ply(cloud / "scene.ply")) == sum(int((o == i).sum()) for i, o in enumerate(owners))


def test_a_single_option_wins_over_the_preset() -> None:
    where = {"source": Path("photos"), "out": Path("run")}
    chosen = run_config({**where, "preset": "paper", "plan.method": "exact"})
    assert (chosen.plan.method, chosen.train.preset, chosen.upload) == ("exact", "paper", "float32")
    assert run_config({**where, "preset": "default"}) == run_config(where) == RunConfig(**where)
    with pytest.raises(BadInput, match="use one of default, paper"):
        run_config({**where, "preset": "papers"})
