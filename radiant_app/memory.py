"""How much memory this process holds and has held at most, and how much is free."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json

BASE_NAME = "memory.json"


def reset_peak_bytes() -> int:
    """Resident bytes now; the peak is counted from here on, since imports alone may have peaked higher (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status_bytes("VmRSS")


def resident_bytes() -> int:
    """Resident bytes now on Linux, elsewhere the highest so far."""
    return _status_bytes("VmRSS") if sys.platform == "linux" else peak_bytes()


def base_bytes_in(folder: Path, now_bytes: int) -> int:
    """What the process that first trained in `folder` held before: `now_bytes` at the first call, from memory.json after that.

    A limit of memory leaves room for so many Gaussians beside it, and that number is in the key of the checkpoints: a process that goes on
    after a kill never holds just as much, and would begin anew.
    """
    path = folder / BASE_NAME
    try:
        base_bytes = read_json(path, ("base_bytes",))["base_bytes"] if path.is_file() else None
    except BadInput:
        base_bytes = None
    if type(base_bytes) is not int or base_bytes <= 0:
        write_json(path, {"base_bytes": now_bytes})
        return now_bytes
    return base_bytes


def peak_bytes() -> int:
    """The highest resident bytes since the program began or, on Linux, since `reset_peak_bytes`."""
    if sys.platform == "linux":
        # getrusage's maximum would begin with what the parent held before this program was started.
        return _status_bytes("VmHWM")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def available_bytes() -> int:
    """What programs can still take, page cache included; without Linux's own figure what lies wholly unused."""
    try:
        rows = dict(row.split(":") for row in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
        return int(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _status_bytes(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) * 1024
