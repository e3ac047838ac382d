"""The folder of a run and its manifest.json: configuration, times, decisions and warnings.

    manifest.json plan.json scene.ply metrics.json report.html pictures/
    sfm/ devices/<id>/ edges/<id>/ cloud/ evaluation/        one folder per process

Written whole after every stage by the one process that holds the run's lock.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from radiant_app.config.fields import config_fields, tables_of
from radiant_app.config.run_config import RunConfig
from radiant_app.events import UPLINK, CpuSpent, Decided, Event, MemoryPeaked, StageDone, StageSkipped, StageStarted, Warned
from radiant_app.files.out_folder import require_folder_for
from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite, StageFailed, StoreDamaged
from radiant_core.io.run_store import LOCK_NAME, MAX_JSON_BYTES, RunLock, parse_json, read_bounded, read_json, write_json

MANIFEST_VERSION = 4
EARLIER = (
    "was made by an earlier version of radiant, which wrote tasks and settings in another form: begin again in another folder; its scene "
    "stays readable"
)
"""Why a folder can be looked at and not resumed."""
PLANNING_FOLDER = "planning"
"""Of a cloud that plans by counts of its devices: in a run's folder, and the stage's name."""
SFM_TASK = "task.json"
"""What `radiant sfm` was asked for, beside its work."""
BEGUN = ("manifest.json", SFM_TASK, "summary.json")
"""What a run, structure from motion or a batch writes first, by which `--resume` finds it."""
OPTIONS = {"source": "source", "preset": "--train-preset", "time_s": "--time", "memory_bytes": "--memory", "overrides.settings": "--set"}
"""Setting of `radiant train` and `sfm` → its option, where `config_fields` does not say."""
UNRECORDED = ("out", "execution", "evaluate")
"""What may differ when a run is resumed: its place, its execution, and the scoring in the end."""
RECORDED = ("config", "status", "stages", "emulated", "machines", "peak_bytes", "cpu_s", "decisions", "warnings")


@dataclass
class Manifest:
    """The record of a run while it goes on; `save` writes it."""

    folder: Path
    config: dict[str, Any]
    status: str = "running"
    stages: dict[str, dict[str, float]] = field(default_factory=dict)
    """Stage → started_s and ended_s since the run began; of a skipped stage, those of before."""
    emulated: dict[str, dict[str, float]] = field(default_factory=dict)
    """As `stages`, of devices, edges and uplinks in an emulated run: never among measured times."""
    machines: dict[str, str] = field(default_factory=dict)
    """Stage → the machine of a cluster that ran it last."""
    peak_bytes: dict[str, int] = field(default_factory=dict)
    """Stage → the most memory its process held, with its libraries."""
    cpu_s: dict[str, float] = field(default_factory=dict)
    """Stage → CPU seconds of its process."""
    decisions: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    access_log: list[dict[str, Any]] = field(default_factory=list)

    def record(self, event: Event, now_s: float) -> None:
        """Update the record by an event."""
        if isinstance(event, StageStarted):
            self.drop_notes(event.stage)
            self._times(event)[event.stage] = {"started_s": now_s, "ended_s": now_s}
            if event.machine:
                self.machines[event.stage] = event.machine
        elif isinstance(event, StageDone):
            self._times(event)[event.stage]["ended_s"] = now_s
            self.save()
        elif isinstance(event, MemoryPeaked):
            self.peak_bytes[event.stage] = event.peak_bytes
        elif isinstance(event, CpuSpent):
            self.cpu_s[event.stage] = event.seconds
        elif isinstance(event, StageSkipped):
            self._times(event).setdefault(event.stage, {"started_s": now_s, "ended_s": now_s})
        elif isinstance(event, Decided):
            fields = asdict(event.decision)
            if fields not in self.decisions:
                self.decisions.append(fields)
        elif isinstance(event, Warned):
            message = f"{event.stage}: {event.message}"
            if message not in self.warnings:
                self.warnings.append(message)

    def _times(self, event: StageStarted | StageDone | StageSkipped) -> dict[str, dict[str, float]]:
        return self.emulated if event.emulated else self.stages

    def drop_notes(self, stage: str) -> None:
        """Remove the decisions and warnings of an earlier attempt of this stage."""
        self.decisions = [decision for decision in self.decisions if decision["stage"] != stage]
        self.warnings = [warning for warning in self.warnings if not warning.startswith(f"{stage}: ")]

    def keep_stages(self, stages: Collection[str]) -> None:
        """Remove all other stages: those of devices and edges in an earlier plan."""
        for times in (self.stages, self.emulated):
            for stage in [stage for stage in times if stage.removesuffix(UPLINK) not in stages]:
                self.drop_notes(stage)
                del times[stage]
                self.peak_bytes.pop(stage, None)
                self.cpu_s.pop(stage, None)

    @property
    def ended_s(self) -> float:
        """Time at which the last stage ended, 0 at first; a resumed run's clock continues there."""
        return max((times["ended_s"] for times in (*self.stages.values(), *self.emulated.values())), default=0.0)

    def save(self) -> None:
        """Write manifest.json."""
        record = {"version": MANIFEST_VERSION, "software": software_versions(), **{key: getattr(self, key) for key in RECORDED}}
        record["ledger"] = self.access_log
        write_json(self.folder / "manifest.json", {**record, "sha256": _digest(record)})


@contextmanager
def open_run(config: RunConfig, resume: bool) -> Iterator[Manifest]:
    """Create or reopen the run's folder and hold its lock; BadInput when it is not empty (without
    `resume`), was made by other settings, or cannot be made. After unusable input a folder made
    here goes away again."""
    with open_folder(config.out, recorded_config(config), resume, keep=("sfm/done.json", "devices/*/done.json")) as manifest:
        yield manifest


@contextmanager
def open_folder(out: Path, settings: dict[str, Any], resume: bool, keep: Sequence[str]) -> Iterator[Manifest]:
    """As `open_run`, for any settings; bad input removes nothing if a file fits one of `keep`."""
    if resume and out.is_dir() and _has_content(out):
        with RunLock(out), _record_outcome(_reopen(out, settings)) as manifest:
            yield manifest
        return
    new_folders = _create_folders(out)
    # A lock held by another process is no reason to clean up: the folder is the work of that run.
    with RunLock(out):
        require_empty(out)
        fresh = Manifest(folder=out, config=settings)
        with _remove_after_bad_input(out, new_folders, keep=keep), _record_outcome(fresh) as manifest:
            yield manifest


@contextmanager
def _record_outcome(manifest: Manifest) -> Iterator[Manifest]:
    manifest.status = "running"
    manifest.save()
    try:
        yield manifest
    except BaseException as error:
        manifest.status = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        # The disk may be what failed; the original error is the one to report.
        with suppress(BadInput):
            manifest.save()
        raise
    manifest.status = "done"
    manifest.save()


@contextmanager
def sfm_folder(out: Path, task: dict[str, Any], *, resume: bool) -> Iterator[None]:
    """The folder of `radiant sfm` for a `task`, which it keeps in task.json; held by one process.

    With `resume`, what an interrupted one left, whose features and matches are used. Raises
    BadInput as `create_folder`, and with `resume` where the folder is of another task, or finished.
    """
    if resume and out.is_dir() and _has_content(out):
        with RunLock(out):
            _require_unfinished(out, task)
            yield
        return
    new_folders = _create_folders(out)
    with RunLock(out):
        require_empty(out)
        with _remove_after_bad_input(out, new_folders):
            write_json(out / SFM_TASK, task)
            yield


def _require_unfinished(out: Path, task: dict[str, Any]) -> None:
    if not (out / SFM_TASK).is_file():
        raise BadInput(f"{out} holds no {SFM_TASK}, so nothing was begun there that can go on: choose another folder.")
    before = read_json(out / SFM_TASK)
    differing = differing_options(task, before if isinstance(before, dict) else {})
    if differing:
        raise BadInput(f"{out} was begun with another {differing}: repeat that to go on, remove it, or choose another folder.")
    if (out / "result.json").is_file():
        raise BadInput(f"{out} is finished, there is nothing to go on with: choose another folder to make the scene anew.")


@contextmanager
def create_folder(out: Path, *, resumable: bool = False, whole: bool = False) -> Iterator[None]:
    """A folder for results, made with its parents; BadInput when it is a file, not empty, or cannot
    be made. After a BadInput within, everything that was made here goes again; where it is
    `resumable`, not after a full disk; where it is of use only as a `whole`, after a failure and
    Ctrl-C too."""
    new_folders = _create_folders(out, resumable=resumable)
    with _remove_after_bad_input(out, new_folders, resumable=resumable):
        try:
            yield
        except (StageFailed, StoreDamaged, KeyboardInterrupt):
            if whole:
                _empty(out, new_folders)
            raise


def _create_folders(out: Path, *, resumable: bool = True) -> list[Path]:
    """Make `out` an empty folder; the folders that had to be made for it, innermost first."""
    if out.is_symlink() and not out.exists():
        raise BadInput(f"{out} is a link to {out.readlink()}, which does not exist: make that folder or choose another name.")
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file, expected a folder: choose another name.")
    if out.is_dir():
        require_empty(out, resumable=resumable)
    require_folder_for(out)
    missing = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    return missing


def require_empty(out: Path, *, resumable: bool = True) -> None:
    """Raise BadInput if the folder has content beyond what a run killed at its start leaves."""
    if _has_content(out):
        begun = resumable and any((out / name).is_file() for name in BEGUN)
        way_on = ", or go on with what was begun there by --resume" if begun else ""
        raise BadInput(f"{out} exists and is not empty: choose another folder{way_on}.")


def _has_content(out: Path) -> bool:
    """Whether a folder holds more than a lock and a half-written manifest."""
    return any(path.name != LOCK_NAME and not path.match(".manifest.json.*.part") for path in out.iterdir())


@contextmanager
def _remove_after_bad_input(out: Path, new_folders: list[Path], keep: Sequence[str] = (), *, resumable: bool = True) -> Iterator[None]:
    """After a BadInput within, empty `out` and remove `new_folders`, unless a file fits `keep`."""
    try:
        yield
    except BadInput as error:
        # A damaged store or a full disk is no bad input: the other results are worth keeping.
        worth_it = isinstance(error, StoreDamaged | CannotWrite if resumable else StoreDamaged) and _has_content(out)
        if not worth_it and not any(path for pattern in keep for path in out.glob(pattern)):
            _empty(out, new_folders)
        raise


def _empty(out: Path, new_folders: list[Path]) -> None:
    """Take away what is in a folder, and the folders that were made for it."""
    for inner in list(out.iterdir()):
        shutil.rmtree(inner) if inner.is_dir() else inner.unlink()
    for folder in new_folders:
        # Another run may have started here in the meantime.
        with suppress(OSError):
            folder.rmdir()


def recorded_config(config: RunConfig) -> dict[str, Any]:
    """The configuration as the manifest keeps it, in the tables of a run file."""
    return {name: value for name, value in tables_of(config).items() if name not in UNRECORDED}


def differing_options(options: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    """The options that differ from those before, as the command line names them; empty if none."""
    return ", ".join(sorted(set(_differing_options(options, before))))


def _differing_options(options: Mapping[str, Any], before: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name in {*options, *before} if prefix else options:
        value, earlier, path = options.get(name), before.get(name), f"{prefix}{name}"
        if value != earlier and isinstance(value, dict | None) and isinstance(earlier, dict | None) and path not in OPTIONS:
            yield from _differing_options(value or {}, earlier or {}, f"{path}.")
        elif value != earlier:
            yield _option_name(path, name)


def _option_name(path: str, name: str) -> str:
    fields = config_fields()
    if path in OPTIONS or path in fields:
        return OPTIONS.get(path) or fields[path].option_name
    named = (field.option_name for field in fields.values() if field.option is not None and field.path.endswith(f".{name}"))
    return next(named, f"--{name.replace('_', '-')}")


def software_versions() -> dict[str, str]:
    """Versions of the software that results depend on."""
    packages = ("torch", "numpy", "scipy", "pycolmap", "open3d", "opencv-contrib-python-headless")
    versions = {"radiant": __version__, "python": platform.python_version(), "machine": platform.machine()}
    return versions | {package: _version_of(package) for package in packages}


@cache
def _version_of(package: str) -> str:
    """Of an installed package. Read once: six take 9 ms, and every stage writes a manifest."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")

    version: Literal[1, 2, 3, 4]
    config: dict[str, Any]
    stages: dict[str, dict[str, float]]
    emulated: dict[str, dict[str, float]] = {}
    machines: dict[str, str] = {}
    peak_bytes: dict[str, int] = {}
    cpu_s: dict[str, float] = {}
    decisions: list[dict[str, Any]]
    warnings: list[str]


def read_manifest(run: Path) -> Manifest:
    """The record of a run that stands or goes on; BadInput where there is none or it is damaged."""
    path = run / "manifest.json"
    if not path.is_file():
        raise BadInput(f"{run} holds no manifest.json: give the folder of a run.")
    return Manifest(folder=run, **_record(path).model_dump(exclude={"version"}))


def require_current(run: Path) -> None:
    """Raise BadInput where an earlier version wrote a run's tasks and settings in another form."""
    if (run / "manifest.json").is_file() and _record(run / "manifest.json").version != MANIFEST_VERSION:
        raise BadInput(f"{run} {EARLIER}.")


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _require_unchanged(record: Any) -> None:
    """Raise BadInput if a manifest was changed; older ones have no hash and are accepted."""
    known_keys = {"version", "software", "sha256", "ledger", *RECORDED}
    if not isinstance(record, dict) or not record.keys() <= known_keys:
        raise BadInput("it has keys that no manifest has")
    if "sha256" in record and record.pop("sha256") != _digest(record):
        raise BadInput("its hash is not that of what was written")


def _record(path: Path) -> _Record:
    data = read_bounded(path, MAX_JSON_BYTES)
    try:
        _require_unchanged(parse_json(data))
        return _Record.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise BadInput(f"{path} is damaged or of another version ({place}: {first['msg']}): run again into another folder.") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is damaged ({error}): run again into another folder.") from error


def _reopen(out: Path, settings: dict[str, Any]) -> Manifest:
    if not (out / "manifest.json").is_file():
        raise BadInput(f"{out} holds no manifest.json, so it is no run to resume: choose another folder.")
    require_current(out)
    manifest = read_manifest(out)
    differing = differing_options(settings, manifest.config)
    if differing:
        raise BadInput(f"{out} was begun with another {differing}: repeat those settings to resume, remove it, or choose another folder.")
    return replace(manifest, config=settings)
