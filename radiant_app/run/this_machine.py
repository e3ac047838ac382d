"""This machine as the system of a run that names none: one device, or as many as memory asks for.

    needed(n) = train.memory.training_memory(⌈N / n⌉)     one training of an n-th of N photographs
    n         = the least with needed(n) ≤ 0.8 free, at least ten photographs each
    at once   = ⌊0.8 free / ample(n)⌋                     trainings side by side

One model of all photographs is better than several that are joined, so that memory alone divides
them; `--devices N` does where a user asks. The choice is kept in the run's folder: free memory is
another when a run is resumed. Once per run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Warned
from radiant_app.files.system_file import even_system, load_system
from radiant_app.run.progress import Progress
from radiant_app.workers.memory import available_bytes
from radiant_core.decisions import Decision
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import BYTES_FACTORS
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import System
from radiant_core.regimes import MACHINE, PHOTOGRAPHS_OF_A_DEVICE, require
from radiant_core.train.config import TrainConfig
from radiant_core.train.memory import TrainingMemory, training_memory

MACHINE_NAME = "this_machine.json"
"""The choice, in the run's folder."""
MEMORY_SHARE = 0.8
"""Of free memory, for trainings; the rest is left to the run itself and to what else runs here."""
NUM_PLAYED = 4
"""Devices, two on each of two edges, where something is to be divided and no system says among
whom."""
PASSING_ON = CostCurve(constant=0.5)
"""Seconds of an edge with a lone device, mostly those of starting its process: 0.2 on the hamlet,
1.7 in the town on cores that eight processes shared."""


@dataclass(frozen=True, kw_only=True)
class Division:
    """Into how many trainings this machine divides a run, and by which figures."""

    num_devices: int
    num_photographs: int
    """Training photographs of the run."""
    needed_bytes: int
    """Of one of the trainings."""
    ample_bytes: int
    """The same with all that its loss would keep of the photographs."""
    free_bytes: int
    """Of this machine before the first."""
    forced: bool = False
    """Whether the user asked for so many devices."""

    @property
    def budget_bytes(self) -> float:
        """What trainings may hold together."""
        return MEMORY_SHARE * self.free_bytes

    @property
    def at_once(self) -> int:
        """Trainings that memory holds side by side, at least one."""
        return max(1, int(self.budget_bytes // self.ample_bytes))

    @property
    def holds_all(self) -> bool:
        """Whether all its trainings may run at the same time."""
        return self.at_once >= self.num_devices

    @property
    def system(self) -> System:
        """So many equal devices, whose loss keeps less where memory is short of that."""
        system = machine_of(self.num_devices)
        if self.ample_bytes <= self.budget_bytes or self.needed_bytes > self.budget_bytes:
            return system
        limits = {"memory_bytes": self.budget_bytes, "max_cameras": self.num_photographs}
        edges = (replace(edge, devices=tuple(replace(device, **limits) for device in edge.devices)) for edge in system.edges)
        return replace(system, edges=tuple(edges))

    @property
    def decision(self) -> Decision:
        """What the report and the terminal say of it."""
        if self.num_devices == 1:
            choice = f"this machine trains one model of all {self.num_photographs} photographs"
        else:
            photographs_each, at_once = math.ceil(self.num_photographs / self.num_devices), min(self.at_once, self.num_devices)
            turns = "one after another" if at_once == 1 else f"up to {at_once} at a time"
            choice = f"this machine trains {self.num_devices} models of about {photographs_each} photographs, {turns}, and joins them"
        case = require(MACHINE)
        return Decision(
            stage="plan",
            topic="machines",
            choice=choice,
            figure=self.needed_bytes / 1e9,
            unit=f"GB needed by a training, {self.free_bytes / 1e9:.1f} GB are free",
            reason="asked for by --devices" if self.forced else case.reason,
            row="" if self.forced else case.row,
            forced=self.forced,
        )

    @property
    def warning(self) -> str | None:
        """What to do where memory holds none of the trainings; None where it does."""
        if self.needed_bytes <= self.budget_bytes:
            return None
        return (
            f"a training is predicted to need {self.needed_bytes / 1e9:.1f} GB of memory and {self.budget_bytes / 1e9:.1f} may be used: "
            "lower --max-splats or --long-side-px, free memory, or give more machines by --system."
        )


def machine_of(num_devices: int) -> System:
    """So many equal devices, on at most as many edges as each of these has devices. The edge of a
    lone device passes its model on."""
    num_edges = max(count for count in range(1, math.isqrt(num_devices) + 1) if num_devices % count == 0)
    system = even_system(num_edges, num_devices // num_edges)
    if num_devices > 1:
        return system
    return replace(system, edges=(replace(system.edges[0], aggregate_alone_s=PASSING_ON),))


def system_of(config: RunConfig) -> System:
    """The system of a run before its photographs are known: that of its file, or this machine.

    Raises:
        BadInput: the file is no system; the source holds no photographs, or those of folders that
            are named like no device.
    """
    if config.system_file is not None:
        return load_system(config.system_file)
    if isinstance(config.plan.devices, int):
        return machine_of(config.plan.devices)
    return machine_of(1 if is_one_device(config) else NUM_PLAYED)


def is_one_device(config: RunConfig) -> bool:
    """Whether a run that names no machines is this one's alone.

    It is not where others work (a cluster, a network), where devices have folders of their own,
    where a plan, a method of dividing or the paper's joining is asked for, and where an earlier
    version began it: these have `NUM_PLAYED` devices.
    """
    plan, elsewhere = config.plan, config.execution.executor != "local"
    if config.system_file is not None or elsewhere or plan.file is not None or plan.method != "exact" or config.aggregate.preset == "paper":
        return False
    if (config.out / "plan.json").is_file() and not (config.out / MACHINE_NAME).is_file():
        return False
    if config.frames == "shared":
        return True
    # It brings structure from motion, which a run of one owner's placed scene does without.
    from radiant_app.run.captured import device_folders

    return device_folders(config.source, machine_of(NUM_PLAYED)) is None


def divide(
    config: RunConfig, system: System, train: TrainConfig, num_photographs: int, pixels_each: float | None = None
) -> Division | None:
    """How this machine divides a run of so many training photographs.

    Args:
        config: the run; what was decided for it once stays.
        system: that of the run, as `system_of` has it.
        train: the training of its devices.
        num_photographs: those of all devices together.
        pixels_each: of one at the size of the training, in the mean; None: 4:3.

    Returns:
        The division; None where the run has other machines, or was begun by an earlier version.

    Raises:
        StoreDamaged: what was decided is no longer whole.
    """
    path = config.out / MACHINE_NAME
    if path.is_file():
        return Division(**read_json(path, [field.name for field in fields(Division)]))
    num_devices = config.plan.devices if isinstance(config.plan.devices, int) else None
    if num_devices is None and (len(system.devices) > 1 or not is_one_device(config)):
        return None
    division = divided(lambda count: training_memory(train, count, pixels_each), num_photographs, available_bytes(), num_devices)
    write_json(path, asdict(division))
    return division


def system_divided(config: RunConfig, division: Division, progress: Progress) -> System:
    """The system of a division, its models in the bytes of the run's uploads; says what was
    decided."""
    progress.listen(Decided(decision=division.decision))
    if division.warning is not None:
        progress.listen(Warned(stage="plan", message=division.warning))
    return division.system.with_uploads_of(BYTES_FACTORS[config.upload])


def divided(memory_of: Callable[[int], TrainingMemory], num_photographs: int, free_bytes: int, wanted: int | None = None) -> Division:
    """The division into the fewest trainings that fit, by what one of so many photographs takes;
    into those of `PHOTOGRAPHS_OF_A_DEVICE` where none does; into as many as are `wanted`."""
    most = max(1, num_photographs // PHOTOGRAPHS_OF_A_DEVICE)
    budget = MEMORY_SHARE * free_bytes
    fitting = (count for count in range(1, most + 1) if memory_of(math.ceil(num_photographs / count)).needed_bytes <= budget)
    num_devices = next(fitting, most) if wanted is None else wanted
    memory = memory_of(math.ceil(num_photographs / num_devices))
    return Division(
        num_devices=num_devices,
        num_photographs=num_photographs,
        needed_bytes=memory.needed_bytes,
        ample_bytes=memory.ample_bytes,
        free_bytes=free_bytes,
        forced=wanted is not None,
    )
