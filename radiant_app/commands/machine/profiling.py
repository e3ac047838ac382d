"""Measures what this machine takes to train and to join, by nodes of a real run. Once per profile.

    pilot           the largest count of photographs, a few steps    → how many steps are possible
    G, F_n, H (c)   two device nodes per count                       → start-up, steps, bytes
    F_m (2c)        an edge node of their two models, and of one's   → a + b · views
    cloud (2c)      a cloud node of the two, as two edges' models    → a + b · views
    frames (2c)     the largest join, of models that GPS has placed  → seconds beside F_m, the cloud
    own frames (c)  structure from motion of one or two counts       → seconds beside G

The two devices have the c photographs on either side of the middle of the scene's long side. Nodes
run `num_workers` at a time with their share of the cores, and are forked, as in a run: side by side
they are slower than alone, and a process that starts anew takes 4 s longer. Where the time does not
allow all the steps that a run takes, all trainings get the same smaller number and their seconds
are multiplied: every schedule of a preset follows the share of its steps, and density control gets
as many rounds.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Event, Listener, StageProgress, Warned
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.run.dealing import deal_files
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.sources import sfm_task
from radiant_app.workers.tasks import SfmTask
from radiant_core.aggregate.config import CLOUD_EPOCHS, EDGE_EPOCHS, Join
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import FrameUncertainty
from radiant_core.hierarchy.codec import save_frame, save_task
from radiant_core.hierarchy.messages import CloudTask, DeviceTask, EdgeTask, Renderer
from radiant_core.hierarchy.recipe import training_among
from radiant_core.io.records import save_cameras
from radiant_core.io.run_store import read_json
from radiant_core.plan.devices.device_split import long_axis
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
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
NUM_MODELS = 2
"""Of each count of photographs: an edge joins them."""
MAX_PLACED, MAX_PLACED_LATER = 16, 64
"""Photographs of the first own structure from motion and of the second: of the town 13 take 20 s
and 52 take 105 s, where 6 take 6 s."""
OVERTIME = 1.2
"""Share of the time up to which the second is expected to end, or it is left out: larger ones are
predicted in proportion to the first then, 52 of the town a quarter too short."""
_FRAMES_S, _PLACED_S = 8.0, 1.5
"""Guesses for the time left alone: of the frames of two models, and of placing a photograph."""
UNSURE = FrameUncertainty(position_m=2.0, scale=0.02, rotation_rad=0.02)
"""As GPS places a model of a dozen photographs."""
Task = DeviceTask | EdgeTask | CloudTask | SfmTask


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
    """A join of some photographs' devices at an edge, or of their edges at the cloud."""

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
    """Count of a device's photographs that a check leaves out of the fit."""
    merges: tuple[EdgeSample, ...] = ()
    """Joins at the cloud; `num_devices` is the number of edges."""
    sfm: tuple[tuple[int, float], ...] = ()
    """Photographs, and seconds of a device's own structure from motion."""
    frames_s: float | None = None
    """Seconds of bringing two models into one frame, beside as many processes as a run has."""
    frames_alone_s: float | None = None


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


def _counts_to_place(sizes: Sequence[int]) -> list[int]:
    """Which of the measured counts of photographs get an own structure from motion: one or two."""
    largest = (max((size for size in sizes if MIN_PHOTOGRAPHS <= size <= most), default=0) for most in (MAX_PLACED, MAX_PLACED_LATER))
    return sorted({count for count in largest if count})


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
    num_workers: int
    """Nodes side by side, as in the runs that are to be planned."""
    num_threads: int | None
    """Of each node; None: its share of the cores."""
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
        sizes = sorted(counts + ([] if held_out is None else [held_out]))
        joined = [count for count in sizes if 2 * count <= counts[-1]] or sizes[:1]
        steps = min(PILOT_STEPS, self.train.num_steps)
        self.left_s, self.note = [time_s], f"pilot on {counts[-1]} photographs"
        pilot, seconds = self._device(counts[-1], steps), self._elapsed_s
        rounds = -(-NUM_MODELS // self.num_workers)
        step_s = rounds * pilot.train_s / self.train.num_steps
        # Not of what else has passed: importing what nodes are forked from is done once.
        start_s = rounds * max(0.0, pilot.init_s)
        num_joins = 2 * len(joined) + 5
        free_s = max(0.0, time_s - seconds - start_s * (len(sizes) + num_joins))
        num_steps = int(np.clip(_TRAINING_SHARE * free_s / (len(sizes) * step_s), steps, self.train.num_steps))
        view_s = _RETRAIN_STEP_COST * step_s
        epoch_s = view_s * 2 * sum(joined) * (1 + CLOUD_EPOCHS / EDGE_EPOCHS)

        def epochs_in(seconds: float) -> int:
            return int(np.clip(seconds / epoch_s, 1, EDGE_EPOCHS))

        num_epochs = epochs_in((1 - _TRAINING_SHARE) * free_s)
        self.left_s = [start_s + step_s * num_steps] * len(sizes)
        self.left_s += [start_s + view_s * num_epochs * 2 * count for count in joined] + [start_s] * (num_joins - len(joined) - 2)
        self.left_s += [start_s + _FRAMES_S] * 2 + [_PLACED_S * count for count in _counts_to_place(sizes)]
        devices, edges, merges = [], [], []
        for count in sizes:
            self.note = f"{count} photographs, {num_steps:,} steps"
            # What was run in full needs no second run.
            is_done = (count, num_steps) == (counts[-1], steps)
            devices.append(pilot if is_done else self._device(count, num_steps))
        # The trainings may have taken longer than the pilot promised, or less.
        num_epochs = epochs_in(time_s - self._elapsed_s - start_s * num_joins)
        for count, num_devices in [*((count, 2) for count in joined), (joined[0], 1), (counts[-1], 1)]:
            self.note = f"joining {num_devices} of {count} photographs at an edge"
            edges.append(self._edge(count, num_steps, num_devices, num_epochs))
        for count in joined:
            self.note = f"joining 2 of {count} photographs at the cloud"
            merges.append(self._cloud(count, num_steps, max(1, num_epochs * CLOUD_EPOCHS // EDGE_EPOCHS)))
        frames_s, frames_alone_s = self._frames(joined[-1], num_steps)
        sfm = self._placements(sizes, min((edge.seconds for edge in edges if edge.num_devices == 1), default=0.0), OVERTIME * time_s)
        return Measured(
            devices=tuple(devices),
            edges=tuple(edges),
            num_steps=num_steps,
            num_epochs=num_epochs,
            held_out=held_out,
            merges=tuple(merges),
            sfm=tuple(sfm),
            frames_s=frames_s,
            frames_alone_s=frames_alone_s,
        )

    @property
    def _elapsed_s(self) -> float:
        return self.clock() - self._begun_s

    def _device(self, count: int, num_steps: int) -> DeviceSample:
        """Train on two neighbouring strips of so many photographs."""
        tasks: dict[Path, Task] = {}
        train = training_among(NUM_MODELS, shorten_training(self.train, num_steps))
        for index, rows in enumerate(self._shares(count)):
            folder = self._folder(f"devices/{count}-{num_steps}-{index}")
            device_scene = self.scene.restricted_to(rows)
            deal_files(self.images, device_scene.cameras.names, folder / "photos")
            tasks[folder] = DeviceTask(train=train, backend=self.backend, upload=UPLOAD, scene=device_scene)
        seconds = self._run("device", tasks)
        summaries = [read_json(folder / "summary.json", ("train_s", "model_bytes")) for folder in tasks]
        train_s, model_bytes = (float(np.mean([summary[name] for summary in summaries])) for name in ("train_s", "model_bytes"))
        return DeviceSample(
            num_cameras=count,
            init_s=float(np.mean(seconds)) - train_s,
            train_s=train_s * self.train.num_steps / num_steps,
            model_bytes=model_bytes,
        )

    def _edge(self, count: int, num_steps: int, num_devices: int, num_epochs: int) -> EdgeSample:
        """Join two models of so many photographs, as many times side by side as a run has workers,
        or take one as it is: one device has nothing to join."""
        copies = min(self.num_workers, NUM_MODELS)
        tasks = self._edge_tasks(f"edges/{num_devices * count}-{num_devices}", count, num_steps, num_devices, num_epochs, copies)
        seconds = self._in_all_epochs("edge", tasks, EDGE_EPOCHS / num_epochs)
        return EdgeSample(num_cameras=num_devices * count, num_devices=num_devices, seconds=seconds)

    def _edge_tasks(self, name: str, count: int, num_steps: int, num_devices: int, num_epochs: int, copies: int) -> dict[Path, Task]:
        # Models that agree are only cut: here they are retrained all the same.
        join = Join(epochs=num_epochs, agreement_db=None)
        tasks: dict[Path, Task] = {}
        for copy in range(copies):
            folder = self._folder(f"{name}-{copy}")
            names = self._fill_inbox(folder, count, num_steps, num_devices, "cameras.safetensors")
            tasks[folder] = EdgeTask(
                devices=names,
                num_dealt=(count,) * num_devices,
                strips=((),) * num_devices,
                train=self.train,
                join=join,
                backend=self.backend,
                upload=UPLOAD,
            )
        return tasks

    def _frames(self, count: int, num_steps: int) -> tuple[float, float] | tuple[None, None]:
        """Seconds of bringing two models of so many photographs into one frame, as edges do side by
        side and as the cloud does alone: what a join takes beside its epoch with frames that GPS
        gave, less the same with exact ones. None, and a warning, where their ground does not
        match."""
        self.note = f"frames of 2 models of {count} photographs"
        together = min(self.num_workers, NUM_MODELS)
        try:
            exact_s, unsure_s = (self._beside_epoch(kind, count, num_steps, together) for kind in ("exact", "unsure"))
            alone_s = self._beside_epoch("alone", count, num_steps, 1) if together > 1 else unsure_s
        except (BadInput, StageFailed) as error:
            self.listen(Warned(stage=STAGE, message=f"{self.note} are not measured: {error}"))
            return None, None
        return max(unsure_s - exact_s, 0.1), max(alone_s - exact_s, 0.1)

    def _beside_epoch(self, kind: str, count: int, num_steps: int, copies: int) -> float:
        """Seconds of a join in one epoch without those of its training; BadInput where models of
        which GPS is unsure were not brought together."""
        tasks = self._edge_tasks(f"frames/{kind}", count, num_steps, NUM_MODELS, 1, copies)
        for place in (place for folder in tasks for place in (folder / "inbox").iterdir()):
            save_frame(place, None if kind == "exact" else UNSURE)
        seconds = float(np.mean(self._run("edge", tasks)))
        moves = [move for folder in tasks for move in load_corrections(folder).values()]
        # Models that share no ground stay where they are, to the bit.
        if kind != "exact" and not all(move is not None and move.scale != 1 for move in moves):
            raise BadInput("their ground does not match.")
        return seconds - float(np.mean([read_json(folder / "summary.json").get("train_s", 0.0) for folder in tasks]))

    def _cloud(self, count: int, num_steps: int, num_epochs: int) -> EdgeSample:
        """Join two models of so many photographs as those of two edges, alone as in a run."""
        join = Join(epochs=num_epochs, agreement_db=None)
        folder = self._folder(f"cloud/{2 * count}")
        names = self._fill_inbox(folder, count, num_steps, 2, "virtual_cameras.safetensors")
        middles = [self.scene.cameras.centers[rows, :2].mean(axis=0) for rows in self._shares(count)]
        task = CloudTask(
            edges=names,
            num_dealt=(count, count),
            sites=tuple((float(x), float(y)) for x, y in middles),
            weights=(0.0, 0.0),
            train=self.train,
            join=join,
            backend=self.backend,
        )
        seconds = self._in_all_epochs("cloud", {folder: task}, CLOUD_EPOCHS / num_epochs)
        return EdgeSample(num_cameras=2 * count, num_devices=2, seconds=seconds)

    def _placements(self, sizes: Sequence[int], start_s: float, time_s: float) -> list[tuple[int, float]]:
        """Photographs and seconds of own structures from motion, begun with those that can be
        expected to end in `time_s`."""
        sfm: list[tuple[int, float]] = []
        counts = _counts_to_place(sizes)
        for index, count in enumerate(counts):
            each_s = sfm[-1][1] / sfm[-1][0] if sfm else _PLACED_S
            self.left_s = [each_s * num_photographs for num_photographs in counts[index:]]
            if sfm and self._elapsed_s + self.left_s[0] > time_s:
                self.left_s = []
                continue
            seconds = self._place(count, start_s)
            if seconds is not None:
                sfm.append((count, seconds))
        return sfm

    def _place(self, count: int, start_s: float) -> float | None:
        """Seconds of structure from motion of so many photographs beside the `start_s` of a
        process, of which training has its own; None where they cannot be placed."""
        self.note = f"structure from motion of {count} photographs"
        tasks: dict[Path, Task] = {}
        for index, rows in enumerate(self._shares(count)):
            folder = self._folder(f"sfm/{count}-{index}")
            deal_files(self.images, self.scene.cameras.select(rows).names, folder / "photos")
            tasks[folder] = sfm_task(folder / "photos", SfmConfig(), None, Placement())
        try:
            return max(float(np.mean(self._run("sfm", tasks))) - start_s, 0.1)
        except (BadInput, StageFailed) as error:
            self.listen(Warned(stage=STAGE, message=f"{self.note} is not measured: {error}"))
            return None

    def _fill_inbox(self, folder: Path, count: int, num_steps: int, num_models: int, cameras_name: str) -> tuple[str, ...]:
        """Copy trained models and their cameras; the names of their senders."""
        names = [f"model-{index + 1}" for index in range(num_models)]
        for index, (name, rows) in enumerate(zip(names, self._shares(count), strict=False)):
            place = folder / "inbox" / name
            place.mkdir(parents=True)
            shutil.copyfile(self.work / f"devices/{count}-{num_steps}-{index}" / "model.safetensors", place / "model.safetensors")
            save_cameras(place / cameras_name, self.scene.cameras.select(rows))
        return tuple(names)

    def _in_all_epochs(self, kind: str, tasks: Mapping[Path, Task], factor: float) -> float:
        """Mean seconds of joins whose retraining is to be `factor` times as long."""
        seconds = self._run(kind, tasks)
        trained = [read_json(folder / "summary.json").get("train_s", 0.0) for folder in tasks]
        return float(np.mean(seconds)) + float(np.mean(trained)) * (factor - 1)

    def _shares(self, count: int) -> tuple[NDArray[np.int64], ...]:
        """So many cameras on either side of the middle of the scene's long side: neighbours, since
        models that do not meet are not retrained. Beyond half of all, the first and the last."""
        order, middle = self._order, len(self._order) // 2
        start, second_start = max(0, middle - count), min(len(order) - count, middle)
        return np.sort(order[start : start + count]), np.sort(order[second_start : second_start + count])

    @property
    def _order(self) -> NDArray[np.int64]:
        positions = self.scene.cameras.centers[:, :2]
        return np.argsort((positions - positions.mean(axis=0)) @ long_axis(positions), kind="stable")

    def _folder(self, name: str) -> Path:
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def _run(self, kind: str, tasks: Mapping[Path, Task]) -> list[float]:
        """Run nodes side by side as a run would; the seconds of each, the start of its process
        among them."""
        nodes: dict[str, NodeTask] = {}
        for folder, task in tasks.items():
            save_task(folder, task)
            stage = str(folder.relative_to(self.work))
            nodes[stage] = NodeTask(kind=kind, stage=stage, folder=folder, key=stage)
        threads = self.num_threads or max(1, (os.cpu_count() or 1) // self.num_workers)
        executor = LocalExecutor(num_workers=self.num_workers, clock=self.clock, num_threads=threads)
        expected_s = self.left_s.pop(0) if self.left_s else 0.0
        begun_s = self._elapsed_s

        def listen(event: Event) -> None:
            if isinstance(event, StageProgress):
                self._report_progress(max(0.0, expected_s - (self._elapsed_s - begun_s)))

        self._report_progress(expected_s)
        leaves = tuple(Tree(id=stage, tier="device") for stage in nodes)
        spans = executor.fold(Tree(id=STAGE, tier="cloud", children=leaves), lambda node: nodes.get(node.id), listen)
        return [spans[stage].ended_s - spans[stage].started_s for stage in nodes]

    def _report_progress(self, node_left_s: float) -> None:
        elapsed_s = self._elapsed_s
        self.listen(StageProgress(stage=STAGE, done=elapsed_s, total=elapsed_s + node_left_s + sum(self.left_s), note=self.note))
