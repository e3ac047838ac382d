"""A run that names no machines is this machine's alone, and divided where memory asks for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.fields import config_of, with_settings
from radiant_app.config.run_config import AggregateOptions, ExecutionOptions, PlanOptions, RunConfig, TrainOptions
from radiant_app.events import Decided, Event, Outlined, Warned
from radiant_app.files.system_file import dump_system, even_system, load_system
from radiant_app.run import this_machine
from radiant_app.run.predictions import planned_training
from radiant_app.run.this_machine import (
    MACHINE_NAME,
    MEMORY_SHARE,
    Division,
    divided,
    is_one_device,
    machine_of,
    system_of,
)
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_core.regimes import PHOTOGRAPHS_OF_A_DEVICE
from radiant_core.train.memory import TrainingMemory, training_memory
from radiant_core.train.needs import Overrides
from tests.app.pipeline_kit import FOUR

SMALL = TrainOptions(long_side_px=96, num_steps=40)
TRAIN = planned_training("default", Overrides(long_side_px=96))


def devices_of(out: Path) -> list[str]:
    return [device for plan in load_plan(out / "plan.json")[1] for device in plan.device_ids]


def machines_decided(out: Path) -> dict[str, object]:
    decisions = json.loads((out / "manifest.json").read_text())["decisions"]
    (decision,) = (each for each in decisions if each["topic"] == "machines")
    return decision


@pytest.fixture(scope="module")
def alone(hamlet_project: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunResult, list[Event]]:
    events: list[Event] = []
    config = RunConfig(source=hamlet_project, out=tmp_path_factory.mktemp("alone") / "run", train=SMALL)
    return config, run(config, events.append), events


def test_a_run_without_a_system_is_one_training_of_all_photographs_of_the_hamlet(alone: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, result, events = alone
    assert devices_of(config.out) == ["edge-1-1"]
    stages = next(event.stages for event in events if isinstance(event, Outlined))
    assert stages == ("sfm", "devices/edge-1-1", "edges/edge-1", "cloud", "evaluation")
    decision = machines_decided(config.out)
    assert decision["choice"] == "this machine trains one model of all 10 photographs" and not decision["forced"]
    assert 0.3 < float(str(decision["figure"])) < 0.6 and str(decision["unit"]).endswith("GB are free")
    summary = json.loads((config.out / "devices" / "edge-1-1" / "summary.json").read_text())
    assert summary["num_steps"] == SMALL.num_steps, "as many as `radiant train` takes"
    assert result.metrics["psnr_db"] > 10 and not result.metrics["refined"] and result.metrics["missing"] == {}
    assert "this machine trains one model of all 10 photographs" in result.report.read_text()


def test_edge_and_cloud_pass_the_model_of_a_lone_device_on(alone: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, result, _ = alone
    edge, cloud = (json.loads((config.out / name / "summary.json").read_text()) for name in ("edges/edge-1", "cloud"))
    assert edge["num_steps"] == cloud["num_steps"] == 0, "nothing is joined"
    device = json.loads((config.out / "devices" / "edge-1-1" / "summary.json").read_text())
    assert device["num_splats"] == len(result.load_splats())
    assert load_system(config.out / "system.toml").edges[0].aggregation_s(10, 1) < 1, "and little time is planned for it"


def test_the_model_is_that_of_radiant_train_but_for_the_format_of_its_upload(
    alone: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    from radiant_app.commands.run.train import TrainRequest, train
    from radiant_core.io.ply import load_ply

    config, result, _ = alone
    train(TrainRequest(source=config.out, out=tmp_path / "train", overrides=Overrides(long_side_px=96, num_steps=40)))
    one, other = load_ply(tmp_path / "train" / "scene.ply").means, result.load_splats().means
    assert len(one) == len(other)
    # An upload has another order, and centres in 21 bits: steps of 0.5 mm where the sky is 600 m away.
    assert KDTree(one).query(other)[0].max() < 1e-3


def test_a_resumed_run_keeps_its_division_when_memory_is_short(
    alone: tuple[RunConfig, RunResult, list[Event]], monkeypatch: pytest.MonkeyPatch
) -> None:
    config, result, _ = alone
    monkeypatch.setattr(this_machine, "available_bytes", lambda: 10**6)
    assert run(config, resume=True).metrics["psnr_db"] == result.metrics["psnr_db"]
    assert devices_of(config.out) == ["edge-1-1"] and machines_decided(config.out)["forced"] is False


def test_a_machine_is_divided_by_force(hamlet_project: Path, tmp_path: Path) -> None:
    config = RunConfig(source=hamlet_project, out=tmp_path / "run", train=SMALL, plan=FOUR)
    run(config)
    edge_plans = load_plan(config.out / "plan.json")[1]
    assert [plan.device_ids for plan in edge_plans] == [("edge-1-1", "edge-1-2"), ("edge-2-1", "edge-2-2")]
    decision = machines_decided(config.out)
    assert decision["forced"] and str(decision["choice"]).startswith("this machine trains 4 models of about 3 photographs")


def test_where_memory_is_short_several_devices_train_one_after_another(
    hamlet_project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The hamlet's 10 training photographs are too few to divide: here three are a device's.
    monkeypatch.setattr(this_machine, "PHOTOGRAPHS_OF_A_DEVICE", 3)
    half, whole = (training_memory(TRAIN, count, 96 * 72) for count in (5, 10))
    assert half.needed_bytes < whole.needed_bytes
    monkeypatch.setattr(this_machine, "available_bytes", lambda: round((half.needed_bytes + whole.needed_bytes) / 2 / MEMORY_SHARE))
    events: list[Event] = []
    config = RunConfig(source=hamlet_project, out=tmp_path / "run", train=SMALL)
    result = run(config, events.append)
    assert devices_of(config.out) == ["edge-1-1", "edge-1-2"]
    (decision,) = (event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "machines")
    assert decision.choice == "this machine trains 2 models of about 5 photographs, one after another, and joins them"
    assert decision.figure == pytest.approx(half.needed_bytes / 1e9) and not decision.forced
    spans = [json.loads((config.out / "manifest.json").read_text())["stages"][f"devices/{name}"] for name in ("edge-1-1", "edge-1-2")]
    first, second = sorted(spans, key=lambda span: span["started_s"])
    assert second["started_s"] >= first["ended_s"], "memory holds one training at a time"
    assert not [event for event in events if isinstance(event, Warned) and "of memory" in event.message]
    assert result.metrics["missing"] == {}


@given(
    num_photographs=st.integers(1, 3000),
    free_mb=st.integers(0, 20_000),
    fixed_mb=st.integers(100, 900),
    each_kb=st.integers(1, 20_000),
)
def test_a_division_is_the_least_that_fits(num_photographs: int, free_mb: int, fixed_mb: int, each_kb: int) -> None:
    def memory_of(count: int) -> TrainingMemory:
        needed = fixed_mb * 10**6 + each_kb * 1000 * count
        return TrainingMemory(needed_bytes=needed, ample_bytes=2 * needed)

    found = divided(memory_of, num_photographs, free_mb * 10**6)
    budget = MEMORY_SHARE * free_mb * 1e6
    each = -(-num_photographs // found.num_devices)
    assert found.needed_bytes == memory_of(each).needed_bytes and found.at_once >= 1
    assert found.at_once == 1 or found.at_once * found.ample_bytes <= budget
    assert found.num_devices == 1 or num_photographs // found.num_devices >= PHOTOGRAPHS_OF_A_DEVICE
    if found.num_devices > 1:
        fewer = -(-num_photographs // (found.num_devices - 1))
        assert memory_of(fewer).needed_bytes > budget, "one fewer would not fit"
    assert (found.warning is None) == (found.needed_bytes <= budget)


def test_what_the_loss_keeps_is_given_up_before_photographs_are_divided() -> None:
    memory = TrainingMemory(needed_bytes=10**9, ample_bytes=2 * 10**9)
    ample, short, none = (divided(lambda count: memory, 100, round(free / MEMORY_SHARE)) for free in (2.1e9, 1.5e9, 0.9e9))
    assert [found.num_devices for found in (ample, short)] == [1, 1]
    assert [device.memory_bytes for device in ample.system.devices] == [None]
    assert [device.memory_bytes for device in short.system.devices] == [pytest.approx(1.5e9)]
    assert short.warning is None and ample.warning is None
    assert none.num_devices == 10 and none.warning is not None
    assert "needs 1.0 GB" not in none.warning and none.warning.startswith("a training is predicted to need 1.0 GB of memory and 0.9")
    assert {device.memory_bytes for device in none.system.devices} == {None}, "a limit that no training keeps would refuse it"


def test_a_training_of_more_photographs_or_pixels_needs_more_memory() -> None:
    for config in (TRAIN, planned_training("standard", Overrides())):
        needed = [training_memory(config, count).needed_bytes for count in (1, 10, 100, 1000)]
        assert needed == sorted(set(needed))
        assert training_memory(config, 100, 2e5).needed_bytes > training_memory(config, 100, 1e5).needed_bytes
        for count in (1, 10, 1000):
            assert training_memory(config, count).ample_bytes >= training_memory(config, count).needed_bytes


@pytest.mark.parametrize(("count", "layout"), [(1, [1]), (2, [2]), (4, [2, 2]), (5, [5]), (6, [3, 3]), (9, [3, 3, 3]), (16, [4] * 4)])
def test_devices_of_one_machine_lie_on_edges_of_as_many_devices_each(count: int, layout: list[int]) -> None:
    assert [len(edge.devices) for edge in machine_of(count).edges] == layout


def test_runs_whose_machines_are_elsewhere_or_that_ask_for_a_division_have_two_edges_with_two_devices(tmp_path: Path) -> None:
    config = RunConfig(source=tmp_path, out=tmp_path / "run")
    assert is_one_device(config) and len(system_of(config).devices) == 1
    for divided_run in (
        replace(config, execution=ExecutionOptions(executor="ray", address="local")),
        replace(config, plan=PlanOptions(method="even")),
        replace(config, plan=PlanOptions(file=tmp_path / "plan.json")),
        replace(config, aggregate=AggregateOptions(preset="paper")),
        replace(config, plan=FOUR),
    ):
        assert system_of(divided_run) == even_system(2, 2)
    (tmp_path / "mine.toml").write_text(dump_system(even_system(3, 1)))
    assert system_of(replace(config, system=tmp_path / "mine.toml")) == load_system(tmp_path / "mine.toml")


def test_owners_with_folders_are_the_devices_and_one_folder_is_this_machine(tmp_path: Path) -> None:
    for name in ("edge-1-1", "edge-2-2"):
        (tmp_path / "owners" / name).mkdir(parents=True)
        (tmp_path / "owners" / name / "a.jpg").write_bytes(b"photograph")
    config = RunConfig(source=tmp_path / "owners", out=tmp_path / "run", frames="gps")
    assert system_of(config) == even_system(2, 2)
    assert system_of(replace(config, source=tmp_path / "owners" / "edge-1-1")) == machine_of(1)
    (tmp_path / "owners" / "edge-1-1").rename(tmp_path / "owners" / "anna")
    (tmp_path / "owners" / "edge-2-2").rename(tmp_path / "owners" / "ben")
    with pytest.raises(BadInput, match="'anna', which is no device of the system"):
        system_of(config)


@pytest.mark.parametrize("number", ["0", "-2", "1001", "3.5", "many"])
def test_what_is_no_number_of_devices_is_refused(number: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["run", str(tmp_path), "--out", str(tmp_path / "run"), "--devices", number])
    assert isinstance(result.exception, BadInput) and not (tmp_path / "run").exists()
    assert str(result.exception).startswith("--devices is ") and "expected auto, all" in str(result.exception)


def test_a_number_of_devices_divides_no_other_machines(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--devices 2 divides this machine, and the run has machines of its own"):
        RunConfig(source=tmp_path, out=tmp_path / "run", system=tmp_path / "system.toml", plan=PlanOptions(devices=2))


def test_devices_are_given_by_options_settings_and_files() -> None:
    where = {"source": Path("photos"), "out": Path("run")}
    for values in ({**where, "plan.devices": 3}, with_settings(where, ["plan.devices=3"])):
        assert config_of(values).plan.devices == 3
    assert config_of(with_settings(where, ["plan.devices=all"])).plan.devices == "all"


def test_the_choice_is_kept_whole(tmp_path: Path) -> None:
    config = RunConfig(source=tmp_path, out=tmp_path)
    made = this_machine.divide(config, machine_of(1), TRAIN, 50)
    assert isinstance(made, Division) and this_machine.divide(config, machine_of(1), TRAIN, 70) == made
    (tmp_path / MACHINE_NAME).write_text('{"num_devices": 1}')
    with pytest.raises(BadInput, match=r"this_machine\.json is no JSON object with"):
        this_machine.divide(config, machine_of(1), TRAIN, 50)
