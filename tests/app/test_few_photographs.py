"""Few photographs of one owner are trained by few devices; which, and what is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from radiant_app.commands.machine.forecast import forecast
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import PlanOptions, RunConfig
from radiant_app.events import Decided, Event, Warned
from radiant_app.files.system_file import dump_system, even_system
from radiant_app.run import few_photographs, pooled
from radiant_app.run.few_photographs import choose_workforce, num_devices_worth
from radiant_app.run.predictions import planned_training
from radiant_app.run.this_machine import MEMORY_SHARE
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, System
from radiant_core.regimes import FEW_PHOTOGRAPHS, PHOTOGRAPHS_OF_A_DEVICE
from radiant_core.train.memory import training_memory
from radiant_core.train.needs import Overrides
from tests.app.pipeline_kit import TINY
from tests.app.test_doctor import CURVES

CONFIG = RunConfig(source=Path("photos"), out=Path("run"))
TRAIN = planned_training("draft", Overrides())
GIGABYTE = 10.0**9


def with_devices(system: System, **changes: dict[str, object]) -> System:
    """The system with fields of its devices changed: name (edge_1_1) → field → value."""

    def changed(device: Device) -> Device:
        return replace(device, **changes.get(device.id.replace("-", "_"), {}))  # type: ignore[arg-type]

    return replace(system, edges=tuple(replace(edge, devices=tuple(map(changed, edge.devices))) for edge in system.edges))


@pytest.mark.parametrize(
    ("num_photographs", "num_devices", "expected"),
    [
        (0, 4, 1),
        (1, 4, 1),
        (39, 4, 1),
        (40, 4, 4),
        (35, 2, 1),
        (36, 2, 2),
        (35, 3, 1),
        (36, 3, 3),
        (1, 1, 1),
        (100, 16, 2),
        (159, 16, 4),
        (160, 16, 16),
    ],
)
def test_fewer_than_ten_photographs_per_device_are_worth_fewer_devices(num_photographs: int, num_devices: int, expected: int) -> None:
    assert num_devices_worth(num_photographs, num_devices) == expected


def test_no_count_of_devices_is_worth_none_or_more_than_there_are() -> None:
    for num_devices in range(1, 60):
        found = [num_devices_worth(number, num_devices) for number in range(600)]
        assert found == sorted(found) and found[0] == 1 and found[-1] == num_devices
        for number, count in enumerate(found):
            assert count in (1, num_devices) or number // count >= FEW_PHOTOGRAPHS
            assert (count == num_devices) or number < max(PHOTOGRAPHS_OF_A_DEVICE * num_devices, FEW_PHOTOGRAPHS)


def test_the_fastest_device_works_alone_and_its_edge_with_it() -> None:
    system = with_devices(even_system(2, 2), edge_2_1={"train_s": CostCurve(linear=0.1), "init_s": CostCurve()})
    made = choose_workforce(CONFIG, system, 20, TRAIN)
    assert [edge.id for edge in made.system.edges] == ["edge-2"]
    assert [device.id for device in made.system.devices] == ["edge-2-1"]
    assert made.decision is not None and made.decision.figure == 5.0 and made.warning is not None
    assert made.decision.choice == "edge-2-1 trains on all 20 photographs, and 3 others stay idle"
    assert made.warning == f"{made.decision.choice}: too few to divide; --devices all deals them to all."


def test_as_few_devices_as_hold_the_photographs_work() -> None:
    fast = {"train_s": CostCurve(linear=0.1), "init_s": CostCurve(), "max_cameras": 12}
    system = with_devices(even_system(2, 2), edge_2_1=fast)
    made = choose_workforce(CONFIG, system, 20, TRAIN)
    assert [device.id for device in made.system.devices] == ["edge-1-1"], "the fastest of those that hold all"
    limits = {"edge_1_1": 3, "edge_1_2": 16, "edge_2_2": 4}
    limited = with_devices(system, **{name: {"max_cameras": most} for name, most in limits.items()})
    made = choose_workforce(CONFIG, limited, 20, TRAIN)
    assert [device.id for device in made.system.devices] == ["edge-1-2", "edge-2-1"], "not one that holds little"
    assert made.decision is not None and made.decision.choice == "edge-1-2, edge-2-1 train on all 20 photographs, and 2 others stay idle"


def test_all_devices_work_where_fewer_cannot_hold_the_photographs() -> None:
    little = {device.id.replace("-", "_"): {"max_cameras": 5} for device in even_system(2, 2).devices}
    small = with_devices(even_system(2, 2), **little)
    made = choose_workforce(CONFIG, small, 20, TRAIN)
    assert made.system is small and made.decision is None
    assert made.warning is not None and made.warning.endswith("fewer cannot hold them: raise max_cameras or memory_gb.")
    poor = {device.id.replace("-", "_"): {"memory_bytes": 0.4 * GIGABYTE} for device in small.devices}
    assert len(choose_workforce(CONFIG, with_devices(even_system(2, 2), **poor), 20, TRAIN).system.devices) > 1


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (PlanOptions(devices="all"), "without --devices all fewer would work."),
        (PlanOptions(method="paper"), "without --plan-method paper fewer would work."),
        (PlanOptions(file=Path("plan.json")), "without --plan fewer would work."),
    ],
)
def test_all_devices_work_where_they_are_asked_for(plan: PlanOptions, said: str) -> None:
    system = even_system(2, 2)
    made = choose_workforce(replace(CONFIG, plan=plan), system, 20, TRAIN)
    assert made.system is system and made.decision is None
    assert made.warning is not None and made.warning.startswith("20 training photographs are few for 4 devices: ")
    assert made.warning.endswith(said)
    assert choose_workforce(replace(CONFIG, plan=plan), system, 40, TRAIN).warning is None


def test_a_run_of_few_photographs_is_one_devices_and_says_so(hamlet_project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooled, "choose_workforce", few_photographs.choose_workforce)
    events: list[Event] = []
    (tmp_path / "system.toml").write_text(dump_system(even_system(2, 2)))
    config = RunConfig(source=hamlet_project, system=tmp_path / "system.toml", out=tmp_path / "run", train=TINY)
    result = run(config, events.append)
    _, edge_plans = load_plan(config.out / "plan.json")
    assert [plan.device_ids for plan in edge_plans] == [("edge-1-1",)]
    assert [len(plan.camera_indices) for plan in edge_plans] == [10]
    assert [path.name for path in sorted((config.out / "devices").iterdir())] == ["edge-1-1"], "idle devices get no folder"
    decided = [event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "devices"]
    (said,) = (event.message for event in events if isinstance(event, Warned) and "stay idle" in event.message)
    assert [decision.choice for decision in decided] == ["edge-1-1 trains on all 10 photographs, and 3 others stay idle"]
    assert said.startswith(decided[0].choice) and "3 others stay idle" in result.report.read_text()
    assert result.metrics["psnr_db"] > 10 and result.metrics["missing"] == {} and not result.metrics["refined"]
    assert json.loads((config.out / "manifest.json").read_text())["status"] == "done"
    again = run(config, resume=True)
    assert again.metrics["psnr_db"] == result.metrics["psnr_db"], "a resumed run has the same devices"
    with pytest.raises(BadInput, match="begun with another --devices"):
        run(replace(config, plan=PlanOptions(devices="all")), resume=True)


def test_a_forecast_counts_photographs_that_are_trained_on(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(CURVES + "[aggregate_alone_s]\nlinear = 0.1\nrange = [8, 40]\n")
    found = forecast(20, tmp_path / "machine.toml", free_bytes=64 * 10**9)
    assert list(found.parts_s) == ["structure from motion", "device", "edge"]
    assert found.parts_s == pytest.approx({"structure from motion": 40.0, "device": 4 + 10 + 20, "edge": 2.0})
    assert found.unknown == ()
    train = planned_training("default", Overrides())
    # Room for a training of 70 photographs: of 80 an eighth is held out.
    free = round(training_memory(train, 70).needed_bytes / MEMORY_SHARE) + 1
    stages = {number: list(forecast(number, tmp_path / "machine.toml", free_bytes=free).parts_s) for number in (80, 160)}
    assert "device" in stages[80] and "devices" in stages[160]
