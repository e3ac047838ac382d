"""Unequal machines: whatever trainings their profiles are of, a slow one gets a small share, and one that gets nothing is told why."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.files.profile_file import library_profiles, load_profile, save_profile
from radiant_app.files.system_file import load_system
from radiant_app.run.few_photographs import choose_workforce
from radiant_app.run.predictions import planned_training, with_step_law
from radiant_app.run.stages import costs_of_run
from radiant_app.run.training_costs import scaled_to_training
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve
from radiant_core.plan.profiles.profile import Profile, ProfileKey
from radiant_core.plan.profiles.training_scale import TrainingSize, splats_at, step_time
from radiant_core.plan.system import System
from radiant_core.train.needs import Overrides

GPUS = [name for name in library_profiles() if name not in ("laptop-cpu", "jetson-orin")]
TRAININGS: list[tuple[str, tuple[str, ...]]] = [
    ("default", ()),
    ("default", ("--steps", "30000", "--long-side-px", "1237")),
    ("default", ("--steps", "30000", "--long-side-px", "1237", "--max-splats", "5000000")),
    ("standard", ("--steps", "30000", "--long-side-px", "1237", "--max-splats", "5000000")),
    ("default", ("--long-side-px", "288")),
    ("default", ("--long-side-px", "4000")),
    ("default", ("--steps", "200")),
    ("draft", ()),
]
WAYPOINTS = 240


def system_file(folder: Path, *devices: str, edge: str = "") -> Path:
    """One edge with a device for each text of keys."""
    tables = "".join(f'[[edge.device]]\nid = "d{index}"\n{keys}\n' for index, keys in enumerate(devices))
    (folder / "system.toml").write_text(f'[[edge]]\nid = "e"\n{edge}\n{tables}')
    return folder / "system.toml"


def profile(name: str) -> str:
    return f'profile = "{name}"'


def dealt(folder: Path, system: Path, *options: str) -> tuple[list[int], str]:
    """Waypoints of each device, and what the terminal says: results, then messages."""
    rows = [f"{47.37 + 1e-4 * (k // 20):.6f},{8.54 + 1e-4 * (k % 20):.6f},60" for k in range(WAYPOINTS)]
    (folder / "flight.csv").write_text("latitude,longitude,altitude(m)\n" + "\n".join(rows) + "\n")
    out = folder / "plan" / "plan.json"
    result = CliRunner().invoke(app, ["plan", str(folder / "flight.csv"), "--system", str(system), "--out", str(out), *options])
    assert result.exception is None, result.exception
    _, edges = load_plan(out)
    return [len(plan.cameras_of(name)) for plan in edges for name in plan.device_ids], result.stdout + result.stderr


@pytest.mark.parametrize(("preset", "options"), TRAININGS, ids=lambda value: " ".join(value) if isinstance(value, tuple) else value)
def test_a_laptop_beside_three_gpus_gets_a_small_share_of_any_training(tmp_path: Path, preset: str, options: tuple[str, ...]) -> None:
    system = system_file(tmp_path, *[profile("rtx-3090")] * 3, profile("laptop-cpu"))
    (*gpus, laptop), said = dealt(tmp_path, system, "--train-preset", preset, *options)
    # Kernels of small images take as long to launch as those of larger ones.
    times = 2 if "288" in options else 3
    assert sum(gpus) + laptop == WAYPOINTS and times * laptop < min(gpus), "dealt 60, 60, 66 and 54 before"
    first = said.splitlines()[0]
    assert (
        first.startswith("Times of profiles made for other trainings (") and "are scaled by pixels, steps and Gaussians to preset" in first
    )
    assert said.index("Times of profiles") < said.index("device")


@pytest.mark.parametrize("gpu", GPUS)
def test_each_gpu_of_the_library_is_faster_than_the_laptop_in_any_training(gpu: str, tmp_path: Path) -> None:
    system = load_system(system_file(tmp_path, profile(gpu), profile("laptop-cpu")))
    for preset, overrides in (("default", Overrides()), ("standard", Overrides(long_side_px=1237, num_steps=30_000))):
        train = planned_training(preset, overrides)
        fast, slow = with_step_law(scaled_to_training(system, train, preset, 100).system, train, 100).devices
        for count in (5, 20, 100):
            assert float(fast.train_s(count)) < float(slow.train_s(count)) / (1.2 if count == 5 else 1.4)


def test_profiles_of_the_planned_training_stay_as_they_were_measured(tmp_path: Path) -> None:
    system = load_system(system_file(tmp_path, profile("laptop-cpu"), f"{profile('laptop-cpu')}\nrelative_speed = 0.5"))
    train = planned_training("default", Overrides())
    scaled = scaled_to_training(system, train, "default", 60)
    assert scaled.note is None and [d.train_s for d in scaled.system.devices] == [d.train_s for d in system.devices]
    assert scaled.system.training is not None and scaled.system.training.long_side_px == 576
    spelt_out = load_system(system_file(tmp_path, "train_s = { linear = 2.0 }", "train_s = { linear = 3.0 }"))
    assert scaled_to_training(spelt_out, train, "default", 60).system == spelt_out


LAW = {"launch_s": 0.004, "pixels_s": 0.03, "splat_s": 2e-8}
SPLAT_BYTES = 92.0


def made(long_side_px: int, num_steps: int, per_photograph: float) -> Profile:
    """A machine whose steps follow the law exactly, measured in a training of this size."""
    counts = np.array([5.0, 50.0])
    splats = 1_000 + per_photograph * counts
    step_s = LAW["launch_s"] + LAW["pixels_s"] * (long_side_px / 1000) ** 2 + LAW["splat_s"] * splats
    slope, constant = np.polyfit(counts, num_steps * step_s, 1)
    of_bytes = CostCurve(constant=1_000 * SPLAT_BYTES, linear=per_photograph * SPLAT_BYTES)
    fitted = {
        name: FittedCurve(curve=curve, smallest_count=5, largest_count=50)
        for name, curve in (("train_s", CostCurve(constant=float(constant), linear=float(slope))), ("model_bytes", of_bytes))
    }
    return Profile(
        name=f"{long_side_px}.toml", kind="measured", machine="m", source="s", launch_s=LAW["launch_s"],
        key=ProfileKey(preset="default", num_steps=num_steps, long_side_px=long_side_px),
        init_s=FittedCurve(curve=CostCurve(constant=2.0), smallest_count=5, largest_count=50), **fitted,
    )  # fmt: skip


@pytest.mark.parametrize(("from_px", "to_px"), [(400, 1600), (1600, 400), (576, 1237), (1237, 288)])
def test_what_a_machine_is_measured_at_one_size_it_takes_at_another(from_px: int, to_px: int) -> None:
    measured, wanted = made(from_px, 1500, 700.0), made(to_px, 9000, 700.0 * (to_px / from_px) ** 2)
    law = step_time(measured, SPLAT_BYTES)
    # A and B are told apart: the Gaussians of the photographs are known.
    assert law.pixels_s == pytest.approx(LAW["pixels_s"] * (from_px / 1000) ** 2, rel=1e-6) and law.splat_s == pytest.approx(2e-8, rel=1e-6)
    size = TrainingSize(long_side_px=to_px, splats_of=splats_at(measured, SPLAT_BYTES, to_px, None))
    counts = np.array([5.0, 20.0, 50.0])
    scaled_1000 = 1_000 * ((to_px / from_px) ** 2 - 1) * LAW["splat_s"]
    np.testing.assert_allclose(law.seconds(size, counts), wanted.train_s.curve(counts) / 9000 + scaled_1000, rtol=1e-6)
    assert float(splats_at(measured, SPLAT_BYTES, to_px, 2_000)(np.array([50.0]))[0]) <= 2_000


def test_curves_of_one_machine_at_two_sizes_deal_as_two_equal_machines(tmp_path: Path) -> None:
    save_profile(tmp_path / "small.toml", made(400, 1500, 400.0))
    save_profile(tmp_path / "large.toml", made(1600, 30_000, 6_400.0))
    system = system_file(tmp_path, profile("small.toml"), profile("large.toml"))
    counts, said = dealt(tmp_path, system, "--long-side-px", "400", "--steps", "1500")
    assert abs(counts[0] - counts[1]) <= 6, counts
    assert "with as many Gaussians as small.toml has" in said.splitlines()[0]


def test_the_edge_that_joins_is_scaled_as_its_devices_are(tmp_path: Path) -> None:
    system = load_system(system_file(tmp_path, profile("laptop-cpu"), profile("laptop-cpu"), edge=profile("rtx-3090")))
    train = planned_training("default", Overrides())
    (edge,) = scaled_to_training(system, train, "default", 60).system.edges
    assert float(edge.aggregate_s(60)) < 0.6 * float(system.edges[0].aggregate_s(60))
    assert edge.devices[0].train_s == system.edges[0].devices[0].train_s


@pytest.mark.parametrize("policy", ["per_photograph", "fixed"])
def test_a_run_has_the_costs_that_a_plan_has(tmp_path: Path, policy: Any) -> None:
    system = load_system(system_file(tmp_path, *[profile("rtx-3090")] * 3, profile("laptop-cpu")))
    config = RunConfig(source=tmp_path, out=tmp_path / "o", train=TrainOptions(step_policy=policy))
    scaled, notes = costs_of_run(config, system, WAYPOINTS)
    assert len(notes) == 1 and notes[0].startswith("Times of profiles made for other trainings (rtx-3090: preset standard")
    gpu, laptop = scaled.devices[0], scaled.devices[3]
    assert 3 * float(gpu.train_s(60)) < float(laptop.train_s(60)) < 30 * float(gpu.train_s(60))
    train = planned_training(config.train.preset, config.train.overrides)
    if policy == "per_photograph":
        expected = with_step_law(scaled_to_training(system, train, "default", WAYPOINTS).system, train, WAYPOINTS)
        assert [d.train_s for d in scaled.devices] == [d.train_s for d in expected.devices]


def test_the_fastest_of_few_is_a_gpu_whatever_steps_its_profile_has(tmp_path: Path) -> None:
    system = load_system(system_file(tmp_path, profile("laptop-cpu"), profile("rtx-3090"), profile("laptop-cpu")))
    config = RunConfig(source=tmp_path, out=tmp_path / "o")
    train = planned_training(config.train.preset, config.train.overrides)
    assert [device.id for device in choose_workforce(config, system, 20, train).system.devices] == ["d1"]


@pytest.mark.parametrize("speed", [0.1, 0.2, 0.5, 2.0])
def test_relative_speed_alone_is_of_the_machines_beside(tmp_path: Path, speed: float) -> None:
    *gpus, own = load_system(system_file(tmp_path, *[profile("rtx-3090")] * 3, f"relative_speed = {speed}")).devices
    assert own.profile == gpus[0].profile and own.model_bytes == gpus[0].model_bytes and own.memory_bytes == gpus[0].memory_bytes
    assert float(own.train_s(50)) == pytest.approx(float(gpus[0].train_s(50)) / speed)
    (*counts, slow), _ = dealt(tmp_path, tmp_path / "system.toml")
    assert (slow < min(counts) / 1.2) == (speed < 1) and (slow > max(counts) * 1.2) == (speed > 1)


def test_relative_speed_of_all_is_of_one_another(tmp_path: Path) -> None:
    one, two = load_system(system_file(tmp_path, "relative_speed = 1.0", "relative_speed = 0.25")).devices
    assert float(two.train_s(30)) == pytest.approx(4 * float(one.train_s(30))) and float(one.train_s(30)) == 50.0, "the file's defaults"
    counts, _ = dealt(tmp_path, tmp_path / "system.toml")
    assert counts[1] < counts[0] / 2.5


@pytest.mark.parametrize(
    ("devices", "expected"),
    [
        (("train_s = { linear = 6.0 }", "relative_speed = 0.5"), 120.0),
        (("train_s = { linear = 6.0 }\nrelative_speed = 2.0", "relative_speed = 0.5"), 60.0),
        (("train_s = { linear = 6.0 }", ""), 30.0),
        ((profile("laptop-cpu"), ""), 30.7 + 6.8),
    ],
)
def test_a_device_without_costs_is_like_those_beside_it_where_that_says_something(
    tmp_path: Path, devices: tuple[str, str], expected: float
) -> None:
    assert float(load_system(system_file(tmp_path, *devices)).devices[1].train_s(10)) == pytest.approx(expected)


def test_a_speed_beside_machines_that_differ_is_asked_about(tmp_path: Path) -> None:
    with pytest.raises(
        BadInput, match=r"device 'd2' names neither a profile nor costs.*these differ \(h100, rtx-3090\): give it the profile"
    ):
        load_system(system_file(tmp_path, profile("rtx-3090"), profile("h100"), "relative_speed = 0.2"))


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("relative_speed = 0.001", r"one takes it [\d.,]+ s, and the others of e are done with all in [\d.,]+ s"),
        (f"{profile('laptop-cpu')}\nmax_cameras = 0", "its memory holds none"),
        (f"{profile('laptop-cpu')}\nmemory_gb = 0.3", "its memory holds none"),
    ],
)
def test_a_device_that_gets_nothing_is_told_why_in_the_table(tmp_path: Path, keys: str, told: str) -> None:
    import re

    counts, said = dealt(tmp_path, system_file(tmp_path, *[profile("rtx-3090")] * 3, keys))
    assert counts[3] == 0
    (row,) = (line for line in said.splitlines() if line.startswith("d3"))
    assert re.fullmatch(rf"d3 +0 {told}", row)
    assert re.search(rf"Devices without anything to capture: d3 \({told}\)\.", said)


def test_limits_of_memory_hold_for_the_gaussians_of_the_planned_training(tmp_path: Path) -> None:
    system = system_file(tmp_path, f"{profile('rtx-3090')}\nmemory_gb = 0.6", profile("rtx-3090"))
    counts, _ = dealt(tmp_path, system)
    assert counts[0] < counts[1] and sum(counts) == WAYPOINTS


def test_what_joins_a_plan_is_taken_for_the_training_of_the_plan(tmp_path: Path) -> None:
    options = ("--steps", "30000", "--long-side-px", "1237")
    dealt(tmp_path, system_file(tmp_path, *[profile("rtx-3090")] * 3), *options)
    written = load_system(tmp_path / "plan" / "plan_system.toml")
    assert written.training == ProfileKey(preset="default", num_steps=30_000, long_side_px=1237, max_num_splats=200_000)
    (tmp_path / "join.toml").write_text(f'[[edge]]\nid = "e"\n[[edge.device]]\nid = "late"\n{profile("laptop-cpu")}\n')
    out = tmp_path / "new.json"
    arguments = ["plan", "--after", tmp_path / "plan" / "plan.json", "--system", tmp_path / "plan" / "plan_system.toml"]
    result = CliRunner().invoke(app, [*map(str, arguments), "--join", str(tmp_path / "join.toml"), "--out", str(out)])
    assert result.exception is None, result.exception
    (plan,) = load_plan(out)[1]
    counts = [len(plan.cameras_of(name)) for name in plan.device_ids]
    assert "late" in plan.device_ids and 3 * counts[-1] < min(counts[:-1]), counts


def test_costs_that_are_nobodys_are_said_beside_those_of_machines(tmp_path: Path) -> None:
    _, said = dealt(tmp_path, system_file(tmp_path, profile("rtx-3090"), profile("h100"), ""))
    assert "the costs of device d2 are a system file's defaults and no machine's, beside those of others" in said
    (tmp_path / "alone").mkdir()
    _, said = dealt(tmp_path / "alone", system_file(tmp_path, "", ""))
    assert "defaults" not in said


def test_a_profile_keeps_its_launching_time(tmp_path: Path) -> None:
    assert all((load_profile(path).launch_s is None) == (name == "laptop-cpu") for name, path in library_profiles().items())
    save_profile(tmp_path / "p.toml", made(400, 1500, 400.0))
    assert load_profile(tmp_path / "p.toml").launch_s == 0.004
    with pytest.raises(BadInput, match="launch_s"):
        replace(made(400, 1500, 400.0), launch_s=-1.0)
    assert isinstance(load_system(system_file(tmp_path, profile("p.toml"))), System)
