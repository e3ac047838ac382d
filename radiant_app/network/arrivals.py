"""Files that arrive in parts: appended at the offset that is there, or not at all. Once per part.

    incoming/<digest of the task>/<number of the file>.part    its length is the offset to go on at

The core of tus 1.0 (offset, append, conflict) with one law more: a part is written only after the
request that carries it proved to be its sender's, whole and new. So no byte of a dead connection
comes late, and nothing is kept of somebody without a key. Files are those of the announcement, to
the name and the byte.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_core.io.run_store import atomic_path, file_sha256, force_to_disk
from radiant_core.io.transport.delivery import SentFile
from radiant_core.io.transport.envelope import Envelope

INCOMING = "incoming"
PART_BYTES = 4 << 20
"""Most bytes of one request: a part is checked in memory."""
FORCED_BYTES = 64 << 20
"""Bytes that are forced to the disk at once: a part that a power cut took from a file is found by
the file's hash, so that nobody has to wait for the disk after each."""
SPARE_BYTES = 64 << 20
"""What an announcement leaves free on the disk, for the records of what arrives."""
PART_SPARE_BYTES = SPARE_BYTES // 2
"""What a part leaves free: the database needs it, without which nothing could be answered."""


FULL = "the disk there is full: it is tried again, free space meanwhile."
RESERVED = "the disk there has no room beside results of others that arrive now: it is tried again when those are there."


class DiskFull(Exception):
    """There is no room for what was announced, or for a part of it; why is in one sentence."""

    def __init__(self, reason: str = FULL) -> None:
        super().__init__(reason)


@dataclass(frozen=True, kw_only=True)
class Arrivals:
    """The files that arrive at a node."""

    folder: Path
    """The node's incoming/."""

    def place(self, task: str) -> Path:
        """Where what answers a task arrives."""
        return self.folder / task

    def offsets(self, task: str, envelope: Envelope) -> list[int]:
        """How many bytes of each announced file are there, by their sorted names."""
        return [self._length(task, number) for number in range(len(envelope.files))]

    def begin(self, task: str, envelope: Envelope, *, anew: bool, promised: int = 0) -> list[int]:
        """Make room for what was announced; `anew`: it is something else than before. Raises
        DiskFull before a byte is taken, where it has no room beside `promised` bytes of others."""
        place = self.place(task)
        if anew:
            shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True, exist_ok=True)
        offsets = self.offsets(task, envelope)
        self._require_room(envelope.num_bytes - sum(offsets) + SPARE_BYTES, promised)
        for number, (_, file) in enumerate(sorted(envelope.files.items())):
            if not file.bytes:
                self._part(task, number).touch()
        return offsets

    def append(self, task: str, number: int, offset: int, data: bytes, file: SentFile) -> int | None:
        """Append a part at `offset` and return the new one; None where another one is there, or the
        part would go beyond the end. Raises DiskFull; then nothing was written."""
        part = self._part(task, number)
        if offset != self._length(task, number) or offset + len(data) > file.bytes:
            return None
        self._require_room(len(data) + PART_SPARE_BYTES)
        is_new = not part.exists()
        part.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            _write_whole(descriptor, data, offset)
            if (offset + len(data)) // FORCED_BYTES != offset // FORCED_BYTES:
                os.fdatasync(descriptor)
        except OSError as error:
            os.ftruncate(descriptor, offset)
            raise DiskFull from error
        finally:
            os.close(descriptor)
        if is_new:
            # Else a power cut may leave a result that counts as received without its file.
            force_to_disk(part.parent)
        return offset + len(data)

    @property
    def free_bytes(self) -> int:
        """Bytes of the disk that parts may fill."""
        return max(0, shutil.disk_usage(self.folder).free - PART_SPARE_BYTES)

    def _require_room(self, num_bytes: int, promised: int = 0) -> None:
        free = shutil.disk_usage(self.folder).free
        if free < num_bytes + promised:
            raise DiskFull(FULL if free < num_bytes else RESERVED)

    def damaged(self, task: str, envelope: Envelope) -> list[str] | None:
        """Names of files with other bytes than announced, whose parts are removed; None where
        files are not whole yet."""
        files = sorted(envelope.files.items())
        if self.offsets(task, envelope) != [file.bytes for _, file in files]:
            return None
        if not all(self._part(task, number).is_file() for number in range(len(files))):
            # An empty file that was said to have a hash which no empty file has: it was removed.
            return None
        for number in range(len(files)):
            force_to_disk(self._part(task, number))
        wrong = [number for number, (_, file) in enumerate(files) if file_sha256(self._part(task, number)) != file.sha256]
        for number in wrong:
            self._part(task, number).unlink()
        return [files[number][0] for number in wrong]

    def install(self, task: str, envelope: Envelope, target: Path) -> Sequence[str]:
        """Move what arrived whole into a folder; the names. May be repeated after an end between
        two files."""
        names = sorted(envelope.files)
        for number, name in enumerate(names):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            if (part := self._part(task, number)).is_file():
                _move(part, target / name)
        return names

    def remove(self, task: str) -> None:
        """Forget what arrived for a task."""
        shutil.rmtree(self.place(task), ignore_errors=True)

    def num_bytes(self, task: str) -> int:
        """How many bytes arrived for a task."""
        return sum(path.stat().st_size for path in self.place(task).glob("*.part"))

    def remove_all_but(self, tasks: Collection[str]) -> None:
        """Forget what arrived for others than these tasks."""
        for place in self.folder.iterdir():
            if place.name not in tasks:
                shutil.rmtree(place, ignore_errors=True)

    def _part(self, task: str, number: int) -> Path:
        return self.place(task) / f"{number}.part"

    def _length(self, task: str, number: int) -> int:
        try:
            return self._part(task, number).stat().st_size
        except FileNotFoundError:
            return 0


def _write_whole(descriptor: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        written = os.pwrite(descriptor, view, offset)
        view, offset = view[written:], offset + written


def _move(part: Path, target: Path) -> None:
    """Move a file, to another disk too; it is whole at one of the two places at any moment."""
    try:
        part.replace(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with atomic_path(target) as temporary:
            shutil.copyfile(part, temporary)
        part.unlink()
