"""A folder in memory where there is one: tests that write thousands of files would wait for a busy disk most of their time.

A run of the main job forces 400 files to disk in its first process alone, each for milliseconds.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from radiant_app.workers.memory import available_bytes

SHARED_MEMORY = Path("/dev/shm")
LEAST_BYTES = 8 << 30
"""Room for what all tests but those of stress write, some 20 MB a run, and for the processes that they start."""


@contextmanager
def memory_folder() -> Iterator[Path]:
    """An empty folder that goes away again."""
    with tempfile.TemporaryDirectory(prefix="radiant-", dir=SHARED_MEMORY if SHARED_MEMORY.is_dir() else None) as folder:
        yield Path(folder)


def root_in_memory() -> Path | None:
    """Where the temporary folders of all tests fit into memory; None where they do not, or no program may start from there."""
    if not SHARED_MEMORY.is_dir():
        return None
    place = os.statvfs(SHARED_MEMORY)
    if place.f_flag & os.ST_NOEXEC or min(place.f_bavail * place.f_frsize, available_bytes()) < LEAST_BYTES:
        return None
    return SHARED_MEMORY
