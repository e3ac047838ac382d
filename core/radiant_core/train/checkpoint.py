"""Checkpoints of a training: a killed run loses seconds, and resumed ends with the same bits.

    checkpoints/step-00001200.safetensors   `TrainState`: its arrays; numbers and key as metadata
    checkpoints/step-00001200.json          step, key and SHA-256 of that file, written last: a
                                            whole record names a whole file

Once every `every_s` seconds; after a checkpoint that took t seconds none is written for 19 t, at
most 5 % of the time. Each file is written under a temporary name, forced to disk and renamed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from radiant_core import __version__
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.array_file import load_arrays, name_file_in_errors, stream_arrays
from radiant_core.io.run_store import content_key, file_sha256, read_json, write_json
from radiant_core.render.backends import resolve_backend
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.results import TrainState
from radiant_core.train.stored_images import Images
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews

SCHEMA = "radiant.checkpoint"
NUM_KEPT = 2
MAX_SHARE = 0.05
"""Largest share of the time that writing takes in the long run."""


def training_key(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions) -> str:
    """Hash of all that determines the bits: settings, first model, views, renderer, version."""
    inputs = [None if part is None else [part.cameras, *map(_hashes, (part.images, part.weights))] for part in (views, options.validation)]
    return content_key(__version__, config, options.steps, options.extent, resolve_backend(options.backend), initial.arrays(), inputs)


def _hashes(images: Images | None) -> list[str] | None:
    return None if images is None else [content_key(image) for image in images]


@dataclass(frozen=True, kw_only=True)
class _Saved:
    """One checkpoint on disk, unread."""

    record: Path

    @property
    def arrays(self) -> Path:
        return self.record.with_suffix(".safetensors")

    @property
    def step(self) -> int:
        return int(self.record.stem.removeprefix("step-"))

    def load(self) -> tuple[str, TrainState]:
        """Key of its run and its state; StoreDamaged or BadInput where it is not as written."""
        record = read_json(self.record, ("step", "key", "sha256"))
        if record["sha256"] != file_sha256(self.arrays):
            raise BadInput(f"{self.arrays} is not what was written: its hash differs.")
        arrays, about = load_arrays(self.arrays, SCHEMA, None)
        with name_file_in_errors(self.arrays):
            if (record["step"], record["key"]) != (about["step"], about["key"]) or record["step"] != self.step:
                raise BadInput(f"{self.record} speaks of another run or step.")
            return about["key"], TrainState(arrays=arrays, numbers=about["numbers"])

    def remove(self) -> None:
        # The record first: arrays without a record are ignored.
        self.record.unlink(missing_ok=True)
        self.arrays.unlink(missing_ok=True)


class CheckpointFolder:
    """The newest two states of one run in its own folder, made when the first is saved."""

    def __init__(
        self,
        folder: Path,
        key: str,
        *,
        every_s: float = 10.0,
        clock: Callable[[], float] = time.monotonic,
        warn: Callable[[str], None] = lambda message: None,
    ) -> None:
        """`key` of the run (`training_key`); `warn` receives a sentence per damaged or lost one."""
        if not every_s > 0:
            raise BadInput(f"checkpoints every {every_s} s: give a positive number of seconds.")
        self.folder = Path(folder)
        self._key, self._every_s, self._clock, self._warn = key, every_s, clock, warn
        self._due_s = clock() + every_s

    def load(self) -> TrainState | None:
        """The newest whole state, None without; a damaged one is removed with a warning. BadInput
        where the newest whole one is of another run."""
        self._clean()
        for saved in self._list_saved():
            try:
                key, state = saved.load()
            except RadiantError as error:
                self._warn(f"the checkpoint of step {saved.step} is damaged and was removed; training goes on from before it ({error})")
                saved.remove()
                continue
            if key != self._key:
                raise BadInput(
                    f"{self.folder} holds checkpoints of a training with other settings, photographs or software: repeat those settings, "
                    "or remove the folder to train from the start."
                )
            self._due_s = self._clock() + self._every_s
            return state
        return None

    def offer(self, step: int, state: Callable[[], TrainState]) -> None:
        """Save the state after `step` steps where one is due; a failure to write is a warning."""
        begun_s = self._clock()
        if begun_s < self._due_s:
            return
        try:
            self._save(step, state())
        except BadInput as error:
            self._warn(f"no checkpoint after step {step}: {str(error).rstrip('.')}. Training goes on")
        ended_s = self._clock()
        self._due_s = ended_s + max(self._every_s, (ended_s - begun_s) * (1 / MAX_SHARE - 1))

    def save(self, step: int, state: Callable[[], TrainState]) -> None:
        """Save the state after `step` steps now; a failure to write is a warning."""
        self._due_s = self._clock()
        self.offer(step, state)

    def remove(self) -> None:
        """Remove all checkpoints: the run is finished."""
        for saved in self._list_saved():
            saved.remove()
        self._clean()
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def remove_foreign(self) -> None:
        """Remove the checkpoints of other runs, and those whose record is damaged."""
        for saved in self._list_saved():
            try:
                is_same_run = read_json(saved.record, ("key",))["key"] == self._key
            except RadiantError:
                is_same_run = False
            if not is_same_run:
                saved.remove()

    def _save(self, step: int, state: TrainState) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"cannot make {self.folder}: {error.strerror or error}") from error
        saved = _Saved(record=self.folder / f"step-{step:08d}.json")
        stream_arrays(saved.arrays, SCHEMA, state.arrays, {"step": step, "key": self._key, "numbers": state.numbers})
        write_json(saved.record, {"step": step, "key": self._key, "sha256": file_sha256(saved.arrays)})
        for old in self._list_saved()[NUM_KEPT:]:
            old.remove()

    def _list_saved(self) -> list[_Saved]:
        """What has a record, the newest first."""
        checkpoints = [_Saved(record=path) for path in self.folder.glob("step-*.json") if path.stem.removeprefix("step-").isdecimal()]
        return sorted(checkpoints, key=lambda saved: saved.step, reverse=True)

    def _clean(self) -> None:
        """Remove what a kill left half-written: temporary files, and arrays without a record."""
        records = {saved.arrays.name for saved in self._list_saved()}
        for path in [*self.folder.glob(".*"), *self.folder.glob("step-*.safetensors")]:
            if path.name not in records and path.is_file():
                path.unlink(missing_ok=True)
