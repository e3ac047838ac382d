"""The folder of one run and its manifest.json: what was asked, which stages ran when, what was decided and warned.

    manifest.json plan.json scene.ply metrics.json report.html pictures/
    sfm/ devices/<id>/ edges/<id>/ cloud/ evaluation/        one folder per process

Written whole after every stage by the one process that holds the run's lock.
"""

from __future__ import annotations

import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from radiant_app.config import RunConfig
from radiant_app.events import Decided, Event, StageDone, StageSkipped, StageStarted, Warned
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock, read_json, write_json

MANIFEST_VERSION = 1


@dataclass
class Manifest:
    """The record of a run while it goes on; `save` writes it."""

    folder: Path
    config: dict[str, Any]
    status: str = "running"
    stages: dict[str, dict[str, float]] = field(default_factory=dict)
    """Stage → started_s and ended_s since the run began; a skipped stage keeps the times of the run that finished it."""
    decisions: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    ledger: list[dict[str, Any]] = field(default_factory=list)

    def note(self, event: Event, now_s: float) -> None:
        """Take from the stream what the record keeps."""
        if isinstance(event, StageStarted):
            self.stages[event.stage] = {"started_s": now_s, "ended_s": now_s}
        elif isinstance(event, StageDone):
            self.stages[event.stage]["ended_s"] = now_s
            self.save()
        elif isinstance(event, StageSkipped):
            self.stages.setdefault(event.stage, {"started_s": now_s, "ended_s": now_s})
        elif isinstance(event, Decided):
            fields = asdict(event.decision)
            if fields not in self.decisions:
                self.decisions.append(fields)
        elif isinstance(event, Warned):
            message = f"{event.stage}: {event.message}"
            if message not in self.warnings:
                self.warnings.append(message)

    def save(self) -> None:
        """Write manifest.json."""
        record = {key: getattr(self, key) for key in ("config", "status", "stages", "decisions", "warnings", "ledger")}
        write_json(self.folder / "manifest.json", {"version": MANIFEST_VERSION, "software": software_versions(), **record})


@contextmanager
def opened_run(config: RunConfig, resume: bool) -> Iterator[Manifest]:
    """Make or reopen the run's folder and hold its lock.

    Raises BadInput when the folder exists and is not empty (without `resume`), was made by other settings, or cannot be made. When
    the input turns out to be unusable, a folder made here goes away again: nothing half-written stays behind.
    """
    settings = recorded_config(config)
    made_here = _make_folder(config.out, resume)
    try:
        with RunLock(config.out):
            manifest = _reopened(config.out, settings) if not made_here else Manifest(folder=config.out, config=settings)
            manifest.save()
            yield manifest
            manifest.status = "done"
            manifest.save()
    except BadInput:
        if made_here and not (config.out / "sfm" / "done.json").exists():
            shutil.rmtree(config.out)
        raise


def recorded_config(config: RunConfig) -> dict[str, Any]:
    """The settings as the manifest keeps them: all but where the run lies and how many processes work on it."""
    fields = asdict(config)
    fields["source"] = str(config.source.resolve())
    fields["system"] = None if config.system is None else str(config.system.resolve())
    del fields["out"], fields["max_workers"]
    return fields


def software_versions() -> dict[str, str]:
    """Versions of what decides a result."""
    packages = ("torch", "numpy", "scipy", "pycolmap", "open3d", "opencv-contrib-python-headless")
    found = {"radiant": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _make_folder(out: Path, resume: bool) -> bool:
    """Whether the folder was made here or was empty."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file, expected a folder for the run: choose another name.")
    if out.is_dir() and any(out.iterdir()):
        if resume:
            return False
        raise BadInput(f"{out} exists and is not empty: choose another folder, or go on with that run by --resume.")
    out.mkdir(parents=True, exist_ok=True)
    return True


def _reopened(out: Path, settings: dict[str, Any]) -> Manifest:
    if not (out / "manifest.json").is_file():
        raise BadInput(f"{out} holds no manifest.json, so it is no run to resume: choose another folder.")
    record = read_json(out / "manifest.json")
    if not isinstance(record, dict) or record.get("version") != MANIFEST_VERSION:
        raise BadInput(f"{out / 'manifest.json'} is not of version {MANIFEST_VERSION}: run again into another folder.")
    differing = sorted(key for key in settings if record["config"].get(key) != settings[key])
    if differing:
        raise BadInput(f"{out} was begun with another {', '.join(differing)}: repeat those settings to resume, or choose another folder.")
    return Manifest(folder=out, config=settings, stages=record["stages"], decisions=record["decisions"], warnings=record["warnings"])
