"""Measures what this machine takes to train and to join, by nodes of a real run. Once per profile.

    pilot           the largest count of photographs, a few steps    → how many steps are possible
    G, F_n, H (c)   a device node per count                          → start-up, steps, bytes
    F_m (c)         an edge node per count with two devices' models  → a + b · views; and with one's

An edge does what it does in a run: it joins its devices' models.

Where the time does not allow all the steps that a run takes, all trainings get the same smaller
number and their seconds are multiplied: every schedule of a preset follows the share of its steps,
and density control gets as many rounds. An edge's two models are one, each with half the cameras.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Event, Listener, StageProgress
from radiant_app.executors.local import LocalExecutor, worker_command
from radiant_app.executors.protocol import NodeTask
from radiant_app.run.dealing import deal_files
from radiant_core.aggregate.config import aggregate_preset
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput
from radiant_core.hierarchy.messages import DeviceTask, EdgeTask, Renderer
from radiant_core.io.messages import save_task
from radiant_core.io.records import save_cameras
from radiant_core.io.run_store import read_json
from radiant_core.plan.devices.device_split import long_axis
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification

STAGE = "profile"
MIN_PHOTOGRAPHS = 4
MAX_COUNT = 200
"""Larger parts of a scene would only take longer: beyond twice this a plan warns."""
NUM_COUNTS = 4
PILOT_STEPS = 100
"""Also the fewest steps of a training: fewer are start-up and first rounds of density control."""
_TRAINING_SHARE = 0.7
_RETRAIN_STEP_COST = 2.0
"""A step of retraining against one of training, a guess that only divides the time."""
UPLOAD = "float16"


@dataclass(frozen=True, kw_only=True)
class DeviceSample:
    """A device's training on some photographs."""

    num_cameras: int
    init_s: float
    train_s: float
    """Of all steps that a run takes."""
    model_bytes: float


@dataclass(frozen=True, kw_only=True)
class EdgeSample:
    """An edge's aggregation of some photographs' devices."""

    num_cameras: int
    num_devices: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Measured:
    """All samples of one machine, and how many steps they rest on."""

    devices: tuple[DeviceSample, ...]
    edges: tuple[EdgeSample, ...]
    num_steps: int
    num_epochs: int
    """Of an edge's retraining; 0 if unknown."""
    held_out: int | None
    """Count of photographs that a check leaves out of the fit."""


def choose_counts(num_photographs: int) -> tuple[list[int], int | None]:
    """Counts of photographs to measure, evenly in ratio from an eighth on, and one in the middle
    that checks the fit (None among few); BadInput below `MIN_PHOTOGRAPHS`."""
    if num_photographs < MIN_PHOTOGRAPHS:
        raise BadInput(f"{num_photographs} photographs are left for training, expected {MIN_PHOTOGRAPHS} or more: give more that overlap.")
    largest = min(num_photographs, MAX_COUNT)
    spread = np.geomspace(max(2, largest / 8), largest, NUM_COUNTS).round().astype(int)
    counts = [int(count) for count in np.unique(spread)]
    middle = len(counts) // 2
    held_out = round((counts[middle - 1] * counts[middle]) ** 0.5)
    return counts, None if held_out in counts else held_out


def shorten_training(train: TrainConfig, num_steps: int) -> TrainConfig:
    """The same training in fewer steps, with as many rounds of density control and Gaussians."""
    density = train.density
    if not isinstance(density, NoDensification):
        density = replace(density, every=max(1, round(density.every * num_steps / train.num_steps)))
    return replace(train, num_steps=num_steps, density=density)


@dataclass(kw_only=True)
class Measuring:
    """Runs nodes in `work` with what is common to all of them."""

    work: Path
    scene: SfmScene
    """The training photographs alone."""
    images: Path
    train: TrainConfig
    backend: Renderer
    num_threads: int | None
    listen: Listener
    clock: Callable[[], float] = time.monotonic
    left_s: list[float] = field(default_factory=list)
    """What the nodes still to come are expected to take."""
    note: str = ""
    _begun_s: float = 0.0

    def measure(self, time_s: float) -> Measured:
        """Samples in about `time_s`; StageFailed when a node fails."""
        self._begun_s = self.clock()
        counts, held_out = choose_counts(len(self.scene.cameras))
        check = [] if held_out is None else [held_out]
        sizes, joined = sorted(counts + check), sorted({counts[0], *check, counts[-1]})
        steps = min(PILOT_STEPS, self.train.num_steps)
        self.left_s, self.note = [time_s], f"pilot on {counts[-1]} photographs"
        pilot, seconds = self._device(counts[-1], steps), self._elapsed_s
        step_s = pilot.train_s / self.train.num_steps
        start_s = seconds - step_s * steps
        free_s = max(0.0, time_s - seconds - start_s * (len(sizes) + len(joined) + 2))
        num_steps = int(np.clip(_TRAINING_SHARE * free_s / (len(sizes) * step_s), steps, self.train.num_steps))
        retrain_s = _RETRAIN_STEP_COST * step_s * sum(joined)
        all_epochs = aggregate_preset("default").edge_epochs

        def epochs_in(seconds: float) -> int:
            return int(np.clip(seconds / retrain_s, 1, all_epochs))

        num_epochs = epochs_in((1 - _TRAINING_SHARE) * free_s)
        self.left_s = [start_s + step_s * num_steps] * len(sizes)
        self.left_s += [start_s + _RETRAIN_STEP_COST * step_s * num_epochs * count for count in joined] + [start_s] * 2
        devices, edges = [], []
        for count in sizes:
            self.note = f"{count} photographs, {num_steps:,} steps"
            # What was run in full needs no second run.
            is_done = (count, num_steps) == (counts[-1], steps)
            devices.append(pilot if is_done else self._device(count, num_steps))
        # The trainings may have taken longer than the pilot promised, or less.
        num_epochs = epochs_in(time_s - self._elapsed_s - start_s * (len(joined) + 2))
        for count, num_devices in [*((count, 2) for count in joined), (counts[0], 1), (counts[-1], 1)]:
            self.note = f"joining {num_devices} of {count} photographs"
            edges.append(self._edge(count, num_steps, num_devices, num_epochs))
        return Measured(devices=tuple(devices), edges=tuple(edges), num_steps=num_steps, num_epochs=num_epochs, held_out=held_out)

    @property
    def _elapsed_s(self) -> float:
        return self.clock() - self._begun_s

    def _device(self, count: int, num_steps: int) -> DeviceSample:
        """Train on the first photographs along the scene's long side, as one of several strips."""
        folder = self._folder(f"devices/{count}-{num_steps}")
        own = self.scene.restricted_to(np.sort(self._order[:count]))
        deal_files(self.images, own.cameras.names, folder / "photos")
        task = DeviceTask(train=shorten_training(self.train, num_steps), backend=self.backend, upload=UPLOAD, scene=own)
        seconds = self._run("device", folder, task)
        summary = read_json(folder / "summary.json", ("train_s", "model_bytes"))
        return DeviceSample(
            num_cameras=count,
            init_s=seconds - summary["train_s"],
            train_s=summary["train_s"] * self.train.num_steps / num_steps,
            model_bytes=float(summary["model_bytes"]),
        )

    def _edge(self, count: int, num_steps: int, num_devices: int, num_epochs: int) -> EdgeSample:
        """Join the model of so many photographs with itself, half the cameras each, or take it as
        it is: one device has nothing to join."""
        folder = self._folder(f"edges/{count}-{num_devices}")
        cameras = self.scene.cameras
        names = [f"device-{index + 1}" for index in range(num_devices)]
        shares = np.array_split(self._order[:count], num_devices)
        for name, rows in zip(names, shares, strict=True):
            place = folder / "inbox" / name
            place.mkdir(parents=True)
            shutil.copyfile(self.work / f"devices/{count}-{num_steps}" / "model.safetensors", place / "model.safetensors")
            save_cameras(place / "cameras.safetensors", cameras.select(np.sort(rows)))
        aggregate = aggregate_preset("default")
        # A model agrees with itself: it is retrained all the same.
        task = EdgeTask(
            devices=tuple(names),
            num_dealt=tuple(map(len, shares)),
            strips=((),) * num_devices,
            train=self.train,
            aggregate=replace(aggregate, edge_epochs=num_epochs, agreement_db=None),
            backend=self.backend,
            upload=UPLOAD,
        )
        seconds = self._run("edge", folder, task)
        train_s = read_json(folder / "summary.json", ("train_s",))["train_s"]
        left_s = train_s * (aggregate.edge_epochs / num_epochs - 1)
        return EdgeSample(num_cameras=count, num_devices=num_devices, seconds=seconds + left_s)

    @property
    def _order(self) -> NDArray[np.int64]:
        positions = self.scene.cameras.centers[:, :2]
        return np.argsort((positions - positions.mean(axis=0)) @ long_axis(positions), kind="stable")

    def _folder(self, name: str) -> Path:
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def _run(self, kind: str, folder: Path, task: DeviceTask | EdgeTask) -> float:
        """Run one node as a run would; its seconds, the start of its process among them."""
        save_task(folder, task)
        stage = str(folder.relative_to(self.work))
        node = NodeTask(kind=kind, stage=stage, folder=folder, key=stage)
        executor = LocalExecutor(num_workers=1, clock=self.clock, command=self._command)
        expected_s = self.left_s.pop(0) if self.left_s else 0.0
        begun_s = self._elapsed_s

        def listen(event: Event) -> None:
            if isinstance(event, StageProgress):
                self._report_progress(max(0.0, expected_s - (self._elapsed_s - begun_s)))

        self._report_progress(expected_s)
        seen = executor.fold(Tree(id=stage, tier="cloud"), lambda _: node, listen)[stage]
        return seen.ended_s - seen.started_s

    def _report_progress(self, node_left_s: float) -> None:
        done = self._elapsed_s
        self.listen(StageProgress(stage=STAGE, done=done, total=done + node_left_s + sum(self.left_s), note=self.note))

    def _command(self, task: NodeTask) -> list[str]:
        command = worker_command(task)
        return command if self.num_threads is None else ["env", f"OMP_NUM_THREADS={self.num_threads}", *command]
