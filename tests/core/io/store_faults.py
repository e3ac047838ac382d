"""A job of several sealed stages on a disk that fails: every k-th call that writes, or a real file
system that is full.

job = Job(folder); job.run()    makes what is not sealed; raises BadInput where the disk refuses
job.problem()                   None where every file that is sealed or written over is whole
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io import run_store
from radiant_core.io.array_file import load_arrays, stream_arrays
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import is_sealed, read_json, seal, write_json
from tests.core.scenes import ground_splats

STAGES = ("devices/a", "devices/b", "edges/e", "cloud")
MODEL = ground_splats(40)


@dataclass
class Job:
    """Stages that each write four files by the store's four ways, then seal; a record of the whole
    is written over after each."""

    folder: Path
    generation: int = 0
    """Number in the record: what is written over says which of two states it is."""

    def run(self) -> list[str]:
        """Run the stages that are not sealed; their names."""
        made = []
        for stage in STAGES:
            place = self.folder / stage
            if is_sealed(place, stage):
                continue
            try:
                place.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise BadInput(f"cannot make {place}: {error.strerror}") from error
            write_json(place / "summary.json", {"stage": stage})
            save_splats(place / "model.safetensors", MODEL)
            save_ply(place / "model.ply", MODEL)
            stream_arrays(place / "state.safetensors", "radiant.test", {"steps": np.arange(50)}, {"stage": stage})
            seal(place, stage, ["summary.json", "model.safetensors", "model.ply", "state.safetensors"])
            made.append(stage)
            write_json(self.folder / "manifest.json", {"generation": self.generation, "done": stage, "padding": "x" * 2000})
        return made

    def problem(self, sealed_before: set[str], last_record: object) -> str | None:
        """What is wrong after a failure: a stage that was sealed is no more, a file is not whole,
        or one was left behind; or None."""
        if lost := sealed_before - self.sealed():
            return f"{lost} was sealed and is not"
        path = self.folder / "manifest.json"
        if last_record is not None and not path.is_file():
            return "the record is gone"
        readers: dict[str, Callable[[Path], object]] = {
            "summary.json": read_json,
            "model.safetensors": load_splats,
            "model.ply": load_ply,
            "state.safetensors": lambda path: load_arrays(path, "radiant.test", None),
            "manifest.json": read_json,
            "done.json": read_json,
        }
        for file in self.folder.rglob("*"):
            if file.is_file():
                if file.name not in readers:
                    return f"{file.name} was left behind"
                readers[file.name](file)
        return None

    def sealed(self) -> set[str]:
        return {stage for stage in STAGES if is_sealed(self.folder / stage, stage)}

    def record(self) -> object:
        path = self.folder / "manifest.json"
        return read_json(path) if path.is_file() else None


@dataclass
class FailingDisk:
    """From the k-th writing call on, the disk is full; `calls` counts them. Without `first` it only
    counts."""

    first: int | None = None
    calls: int = 0

    def _call(self) -> None:
        self.calls += 1
        if self.first is not None and self.calls >= self.first:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Opening for writing, every write, fsync and rename of the store go through here."""
        fsync, moved, opened = run_store.force_to_disk, Path.replace, Path.open

        def failing_fsync(path: Path) -> None:
            self._call()
            fsync(path)

        def failing_replace(path: Path, target: Path) -> Path:
            self._call()
            return moved(path, target)

        def failing_open(path: Path, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
            file = opened(path, mode, *args, **kwargs)
            if "x" not in mode:
                return file
            if self.first is not None and self.calls + 1 >= self.first:
                file.close()
            self._call()
            write = file.write

            class Failing:
                def __enter__(self) -> Failing:
                    return self

                def __exit__(self, *exc_info: object) -> None:
                    file.close()

                def write(self, data: bytes) -> int:
                    # Half of it is there when the disk is full.
                    write(data[: len(data) // 2])
                    disk._call()
                    return write(data[len(data) // 2 :])

            return Failing()

        disk = self
        with (
            patch.object(run_store, "force_to_disk", failing_fsync),
            patch.object(Path, "replace", failing_replace),
            patch.object(Path, "open", failing_open),
        ):
            yield


def every_failing_call(folder: Path, step: int = 1) -> list[str]:
    """Let each k-th call that writes, and all after it, fail; what went wrong afterwards, [] where
    nothing did.

    The job is paused with one sentence, what was sealed stays, nothing half-written lies about, and
    with space it goes on to the end.
    """
    counting = FailingDisk()
    with counting.installed():
        Job(folder / "count").run()
    problems = []
    for first in range(1, counting.calls + 1, step):
        job, disk = Job(folder / str(first)), FailingDisk(first=first)
        try:
            with disk.installed():
                job.run()
            problems.append(f"{first}: no error")
        except BadInput as error:
            if "No space left" not in str(error):
                problems.append(f"{first}: {error}")
        problem = job.problem(set(), None)
        before = job.sealed()
        made = replace(job, generation=1).run()
        if problem or set(made) != set(STAGES) - before or job.sealed() != set(STAGES):
            problems.append(f"{first}: {problem}, then {made} with {before} sealed")
    return problems
