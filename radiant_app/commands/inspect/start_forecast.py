"""What a run begun by clicks will take, and the command line that it is. Once per choice.

    this machine    `doctor_forecast`, by the curves of `radiant machine profile` where
                    this machine was measured, else by an estimate of a laptop
    a system file   the least makespan of its machines over so many photographs, as `radiant plan`
                    has it before it knows where they lie

Three qualities scale the default training: a third of its steps, the training itself, three times
its steps at twice the pixels a side.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from radiant_app.commands.inspect.start_look import SourceSummary
from radiant_app.commands.machine.forecast import duration_text, forecast
from radiant_app.commands.machine.this_machine import machine_profile
from radiant_app.files.profile_file import library_profiles
from radiant_app.files.system_file import load_system
from radiant_app.run.predictions import planned_training, with_camera_limits, with_short_joins, with_step_law
from radiant_app.run.training_costs import scaled_to_training
from radiant_app.workers.memory import available_bytes
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_atomic
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts, system_capacity
from radiant_core.train.config import Preset, TrainConfig
from radiant_core.train.memory import training_memory
from radiant_core.train.needs import Overrides

QualityName = Literal["quick", "usual", "fine"]
LAPTOP = "laptop-cpu"
QUICK_SHARE, FINE_SHARE = 1 / 3, 3
"""Of the default training's steps; of its Gaussians at the finest."""
QUICK_SIDE, FINE_SIDE = 2 / 3, 2
"""Of the default training's long side."""
TOWN_DB: dict[QualityName, float | None] = {"quick": 25.3, "usual": 28.1, "fine": 28.6}
"""PSNR of the sample town's held-out photographs in full, at 640 px, by one model on a CPU, where
it was measured: `python -m tests.app.town_qualities`."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """A step of quality as options of `radiant run`."""

    name: QualityName
    preset: Preset = "default"
    overrides: Overrides = Overrides()

    @property
    def training(self) -> TrainConfig:
        """The training that it is on a machine like this one."""
        return planned_training(self.preset, self.overrides)

    @property
    def options(self) -> tuple[str, ...]:
        """As they are typed."""
        overrides = self.overrides
        pairs = (("--steps", overrides.num_steps), ("--long-side-px", overrides.long_side_px), ("--max-splats", overrides.max_num_splats))
        preset = () if self.preset == "default" else ("--train-preset", self.preset)
        return (*preset, *(word for option, value in pairs if value is not None for word in (option, str(value))))


def quality_of(name: QualityName) -> Quality:
    """A step of quality on a machine like this one, whose default training it is made of."""
    usual = planned_training("default", Overrides())
    if name == "usual":
        return Quality(name=name)
    steps, side = (QUICK_SHARE, QUICK_SIDE) if name == "quick" else (FINE_SHARE, FINE_SIDE)
    overrides = Overrides(num_steps=_round(steps * usual.num_steps), long_side_px=round(side * usual.long_side_px))
    if name == "quick":
        return Quality(name=name, preset="draft", overrides=overrides)
    splats = FINE_SHARE * usual.max_num_splats
    return Quality(
        name=name, overrides=Overrides(num_steps=overrides.num_steps, long_side_px=overrides.long_side_px, max_num_splats=splats)
    )


@dataclass(frozen=True, kw_only=True)
class StartForecast:
    """Lines for a person; `warning` where memory or machines do not suffice."""

    time: str
    memory: str
    quality: str
    warning: str = ""


def forecast_start(source: SourceSummary, system: Path | None, quality: Quality) -> StartForecast:
    """What a run of what was found takes; BadInput where the system file is none, or its machines
    hold too few photographs."""
    if not source.num_photographs:
        return StartForecast(time="unknown before the frames are chosen", memory="", quality=_quality_text(quality))
    if source.next == "plan":
        return StartForecast(time=_system_time(source, system, quality) if system else "seconds", memory="", quality="none before capture")
    if system is None:
        return _here(source, quality)
    return StartForecast(
        time=_system_time(source, system, quality), memory=_memory_text(quality, source.num_trained), quality=_quality_text(quality)
    )


def _here(source: SourceSummary, quality: Quality) -> StartForecast:
    measured = machine_profile()
    profile = measured if measured.is_file() else library_profiles()[LAPTOP]
    free = available_bytes()
    estimate = forecast(source.num_photographs, profile, free, None if quality.name == "usual" else quality.training)
    parts_s = {name: seconds for name, seconds in estimate.parts_s.items() if not (source.is_placed and name == "structure from motion")}
    unknown = [] if source.is_placed else list(estimate.unknown)
    parts = ", ".join(f"{name} {duration_text(seconds)}" for name, seconds in parts_s.items())
    by = estimate.machine if measured.is_file() else f"an estimate of {estimate.machine}; measure this machine to know better"
    more = [*(f"{name} not known" for name in unknown), "scoring and the report come on top"]
    more += [f"beyond what was measured: {', '.join(estimate.extrapolated)}"] if estimate.extrapolated else []
    division = estimate.division
    models = "" if division.num_devices == 1 else f", {division.num_devices} models of parts, which are joined"
    return StartForecast(
        time=f"about {duration_text(sum(parts_s.values()))} ({parts}; {'; '.join(more)}), by {by}",
        memory=f"{division.needed_bytes / 1e9:.1f} GB of {free / 1e9:.1f} GB free{models}",
        quality=_quality_text(quality),
        warning=estimate.shortage or "",
    )


def _system_time(source: SourceSummary, path: Path, quality: Quality) -> str:
    num, train = source.num_trained, quality.training
    system = load_system(path)
    scaled = scaled_to_training(system, train, quality.preset, num)
    system = with_short_joins(with_step_law(scaled.system, train, num), train, num, AggregateConfig())
    system = with_camera_limits(system, train, num)[0]
    if (room := system_capacity(system, num)) < num:
        raise BadInput(
            f"the machines of {path.name} hold {room:,} of {num:,} photographs: raise max_cameras or memory_gb, or add machines."
        )
    counts = fastest_edge_counts(system, num)
    busy = ", ".join(f"{edge.id} {count:,}" for edge, count in zip(system.edges, counts.counts, strict=True))
    total = duration_text(float(counts.edge_time_s.max()))
    return f"about {total} of devices and edges ({busy} photographs); structure from motion, joining and scoring come on top"


def _memory_text(quality: Quality, num_photographs: int) -> str:
    memory = training_memory(quality.training, num_photographs)
    return f"{memory.needed_bytes / 1e9:.1f} GB where one machine trains on all; each machine keeps to its memory_gb"


def _quality_text(quality: Quality) -> str:
    train, town_db = quality.training, TOWN_DB[quality.name]
    measured = "" if town_db is None else f"{town_db:.1f} dB PSNR by one model of the sample town in full size, more or less on others; "
    return f"{measured}{train.num_steps:,} steps at {train.long_side_px:,} px, up to {train.max_num_splats:,} Gaussians"


def _round(steps: float) -> int:
    return max(100, round(steps / 100) * 100)


def command_of(source: SourceSummary, out: Path, system: Path | None, quality: Quality) -> tuple[str, ...]:
    """The arguments of `radiant` that begin it; BadInput for a folder that is taken."""
    machines = () if system is None else ("--system", str(system))
    if source.next == "plan":
        plan = out if out.suffix == ".json" else out / "plan.json"
        return ("plan", str(source.path), "--out", str(plan), *machines, *quality.options)
    if out.is_dir() and any(out.iterdir()):
        raise BadInput(f"{out} is not empty: choose another folder for the result, or open it to go on with a run there.")
    return ("run", str(source.path), "--out", str(out), *machines, *quality.options)


def free_folder(source: Path, ending: str = "_run") -> Path:
    """A folder beside a source that is not there yet."""
    stem = source.parent.name if source.name == "images" and source.parent.name else source.stem if source.is_file() else source.name
    parent = source.parent.parent if source.name == "images" else source.parent
    names = (f"{stem}{ending}{'' if number == 1 else f'_{number}'}" for number in range(1, 10_000))
    return next(parent / name for name in names if not (parent / name).exists())


@dataclass(frozen=True, kw_only=True)
class MachineRow:
    """A line of the form: so many equal machines of a site, on whose edge models are joined."""

    site: str
    machine: str
    count: int = 1
    profile: str = ""
    """A name of the library, or a curve file; empty: costs of no machine in particular."""
    memory_gb: float | None = None
    uplink_mbit_per_s: float | None = None


def system_text(rows: Sequence[MachineRow]) -> str:
    """A system file of these machines, an edge per site; BadInput without any."""
    if not rows:
        raise BadInput("no machine is listed: add a line for each kind of machine.")
    lines = ["# Machines of the start window; docs/system_files.md has every key."]
    for site in dict.fromkeys(row.site for row in rows):
        devices = [row for row in rows if row.site == site]
        lines += ["", "[[edge]]", f"id = {json.dumps(site)}"]
        if devices[0].profile:
            lines.append(f"profile = {json.dumps(devices[0].profile)}")
        for row in devices:
            lines += ["", "[[edge.device]]", f"id = {json.dumps(row.machine)}", *_row_lines(row)]
    return "\n".join(lines) + "\n"


def _row_lines(row: MachineRow) -> list[str]:
    values: dict[str, Any] = {"profile": row.profile or None, "count": row.count if row.count > 1 else None}
    values |= {"memory_gb": row.memory_gb, "uplink_mbit_per_s": row.uplink_mbit_per_s}
    return [f"{name} = {json.dumps(value)}" for name, value in values.items() if value is not None]


def save_system(rows: Sequence[MachineRow], path: Path) -> None:
    """Write a system file of these machines that `load_system` reads; BadInput where a value is
    none, and the file is then as it was."""
    if path.suffix != ".toml":
        raise BadInput(f"{path} is no name for a system file: let it end in .toml.")
    text = system_text(rows).encode()
    with tempfile.TemporaryDirectory(prefix="radiant-", dir=path.parent if path.parent.is_dir() else None) as folder:
        tried = Path(folder) / path.name
        tried.write_bytes(text)
        try:
            load_system(tried)
        except BadInput as error:
            raise BadInput(str(error).replace(str(tried), path.name)) from error
    write_atomic(path, text)
