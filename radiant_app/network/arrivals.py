"""Files that arrive in parts: appended at the offset that is there, or not at all. Once per part.

    incoming/<digest of the task>/<number of the file>.part    its length is the offset to go on at

The core of tus 1.0 (offset, append, conflict) with one law more: a part is written only after the
request that carries it proved to be its sender's, whole and new. So no byte of a dead connection
comes late, and nothing is kept of somebody without a key. Files are those of the announcement, to
the name and the byte.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_core.io.run_store import file_sha256
from radiant_core.io.transport.delivery import SentFile
from radiant_core.io.transport.envelope import Envelope

INCOMING = "incoming"
PART_BYTES = 4 << 20
"""Most bytes of one request: a part is checked in memory."""
SPARE_BYTES = 64 << 20
"""What stays free on the disk, for the records of what arrives."""


class DiskFull(Exception):
    """There is no room for what was announced."""


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

    def begin(self, task: str, envelope: Envelope, *, anew: bool) -> list[int]:
        """Make room for what was announced; `anew`: it is something else than before. Raises
        DiskFull before a byte is taken."""
        place = self.place(task)
        if anew:
            shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True, exist_ok=True)
        offsets = self.offsets(task, envelope)
        if shutil.disk_usage(self.folder).free < envelope.num_bytes - sum(offsets) + SPARE_BYTES:
            raise DiskFull
        for number, (_, file) in enumerate(sorted(envelope.files.items())):
            if not file.bytes:
                self._part(task, number).touch()
        return offsets

    def append(self, task: str, number: int, offset: int, data: bytes, file: SentFile) -> int | None:
        """Append a part at `offset` and return the new one; None where another one is there, or the
        part would go beyond the end. Raises DiskFull; then nothing was written."""
        part = self._part(task, number)
        if offset != self._length(task, number) or offset + len(data) > file.bytes or not part.parent.is_dir():
            return None
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            _write_whole(descriptor, data, offset)
        except OSError as error:
            os.ftruncate(descriptor, offset)
            raise DiskFull from error
        finally:
            os.close(descriptor)
        return offset + len(data)

    def damaged(self, task: str, envelope: Envelope) -> list[str] | None:
        """Names of files with other bytes than announced, whose parts are removed; None where
        files are not whole yet."""
        files = sorted(envelope.files.items())
        if self.offsets(task, envelope) != [file.bytes for _, file in files]:
            return None
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
                part.replace(target / name)
        return names

    def remove(self, task: str) -> None:
        """Forget what arrived for a task."""
        shutil.rmtree(self.place(task), ignore_errors=True)

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
    os.fdatasync(descriptor)
