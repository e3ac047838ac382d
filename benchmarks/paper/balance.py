"""Even against balanced regions: time of each device, quality of the joined scene. Once per page.

Both are rows of the main table: every device takes the steps that a run gives it, by its share of
the photographs. Measured: CPU seconds of a device's training on this machine ÷ its speed.
Predicted: photographs ÷ speed × the mean CPU seconds per photograph of all these trainings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.methods.arms import Arm, Arms
from benchmarks.methods.bench import METHODS
from benchmarks.methods.cells import Cell
from benchmarks.paper.parts import Part
from benchmarks.tracking import track_items
from radiant_core.hierarchy.recipe import Recipe

if TYPE_CHECKING:
    from benchmarks.charts.latency_chart import PlanLatency

NAMES = ("even", "balanced")


@dataclass(frozen=True, kw_only=True)
class DeviceTime:
    """A device: relative speed, photographs, and CPU seconds of training here, mean over seeds."""

    device: str
    speed: float
    num_photographs: int
    cpu_s: float

    @property
    def measured_s(self) -> float:
        """Training time on the device."""
        return self.cpu_s / self.speed


@dataclass(frozen=True, kw_only=True, eq=False)
class _Side:
    """Devices and scene of one plan; photograph_s: CPU seconds per photograph over both plans."""

    name: str
    devices: list[DeviceTime]
    psnr_db: float
    photograph_s: float

    @property
    def measured_s(self) -> float:
        return max(device.measured_s for device in self.devices)

    @property
    def predicted_s(self) -> float:
        return max(self.predicted_time_s(device) for device in self.devices)

    def predicted_time_s(self, device: DeviceTime) -> float:
        return device.num_photographs / device.speed * self.photograph_s


def balance_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Latency per device and PSNR of both."""
    from benchmarks.charts.latency_chart import latency_picture

    del quick
    cells = [arms.cell(arms.layout, seed) for seed in seeds]
    jobs = track_items([(name, cell) for name in NAMES for cell in cells], "bench paper, balance")
    results = [(name, arms.row(cell, _arm(name)), _times(cell, _recipe(name, cell))) for name, cell in jobs]
    every = [device for _, _, times in results for device in times]
    photograph_s = sum(device.cpu_s for device in every) / sum(device.num_photographs for device in every)
    even, balanced = (
        _Side(
            name=name,
            devices=_mean_times([times for cell_name, _, times in results if cell_name == name]),
            psnr_db=float(np.mean([row.mean_psnr_db for cell_name, row, _ in results if cell_name == name])),
            photograph_s=photograph_s,
        )
        for name in NAMES
    )
    saved = {
        "measured": 100 * (1 - balanced.measured_s / even.measured_s),
        "predicted": 100 * (1 - balanced.predicted_s / even.predicted_s),
    }
    title = "Even against balanced regions: time of each device"
    detail = (
        f"{arms.scene.name}, {arms.scene.long_side_px} px; CPU seconds of training here ÷ speed of the device; dashed: the slowest device"
    )
    return Part(
        title=title,
        text=_table([even, balanced], saved),
        pictures={"balance.png": latency_picture([_latency_of(side) for side in (even, balanced)], title, detail)},
        figures={
            "rows": [asdict(row) for _, row, _ in results],
            "devices": {side.name: [asdict(device) for device in side.devices] for side in (even, balanced)},
            "cpu_s_per_photograph": photograph_s,
            "saved_percent": saved,
        },
    )


def _table(sides: Sequence[_Side], saved: dict[str, float]) -> str:
    lines = ["| regions | device | speed | photographs | CPU s here | measured s | predicted s |", "|---|---|---|---|---|---|---|"]
    lines += [
        f"| {side.name} | {device.device} | {device.speed:g} | {device.num_photographs} | {device.cpu_s:.1f} | {device.measured_s:.1f} |"
        f" {side.predicted_time_s(device):.1f} |"
        for side in sides
        for device in side.devices
    ]
    lines += ["", "| regions | slowest device, measured s | predicted s | PSNR dB of the joined scene |", "|---|---|---|---|"]
    lines += [f"| {side.name} | {side.measured_s:.1f} | {side.predicted_s:.1f} | {side.psnr_db:.2f} |" for side in sides]
    later = {kind: f"{abs(percent):.0f} % {'sooner' if percent >= 0 else 'later'}" for kind, percent in saved.items()}
    lines += ["", f"Balanced regions are done {later['measured']} as measured, {later['predicted']} as predicted."]
    return "\n".join([*lines, "", (__doc__ or "").split("\n\n")[1].strip()])


def _latency_of(side: _Side) -> PlanLatency:
    from benchmarks.charts.latency_chart import DeviceLatency, PlanLatency

    devices = [
        DeviceLatency(
            name=f"{device.device}, speed {device.speed:g}\n{device.num_photographs} photographs",
            measured_s=device.measured_s,
            predicted_s=side.predicted_time_s(device),
        )
        for device in side.devices
    ]
    note = f"slowest device {side.measured_s:.1f} s; joined scene {side.psnr_db:.2f} dB"
    return PlanLatency(name=side.name, note=note, devices=tuple(devices))


def _recipe(name: str, cell: Cell) -> Recipe:
    return cell.even if name == "even" else cell.recipe


def _arm(name: str) -> Arm:
    return METHODS["even" if name == "even" else "ours"]


def _times(cell: Cell, recipe: Recipe) -> list[DeviceTime]:
    models = cell.train_devices(recipe)
    return [
        DeviceTime(
            device=device.id,
            speed=device.speed or 1.0,
            num_photographs=len(recipe.cameras_of(device.id)),
            cpu_s=float(models[device.id].summary["cpu_s"]) if device.id in models else 0.0,
        )
        for device in recipe.system.devices
    ]


def _mean_times(of_seeds: Sequence[Sequence[DeviceTime]]) -> list[DeviceTime]:
    return [replace(times[0], cpu_s=float(np.mean([one.cpu_s for one in times]))) for times in zip(*of_seeds, strict=True)]
