"""Resident, peak and available memory of this process."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json

BASE_NAME = "memory.json"
EDGES_AT_ONCE = "RADIANT_EDGES_AT_ONCE"
"""Variable of a worker: how many edges may join side by side on its machine."""
UNKNOWN_BYTES = 2**62
"""Free memory where the system does not tell it: no limit."""
OUT_OF_MEMORY = "not enough memory: lower --max-splats or --long-side-px, free some, or raise the limit (ulimit -v)."


def reset_peak_bytes() -> int:
    """Reset the peak, since imports may have peaked higher (Linux); returns the resident bytes."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status_bytes("VmRSS")


def resident_bytes() -> int:
    """Resident bytes now on Linux, elsewhere the highest so far."""
    return _status_bytes("VmRSS") if sys.platform == "linux" else peak_bytes()


def base_bytes_in(folder: Path, now_bytes: int) -> int:
    """Bytes that the first process to train in `folder` held before, as memory.json keeps them:
    they limit the Gaussians; with the bytes of a later process its checkpoints would not fit."""
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


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory is exhausted: torch raises a RuntimeError, numpy and Python a MemoryError."""
    return isinstance(error, MemoryError) or "can't allocate memory" in str(error)


def _status_bytes(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) * 1024


def available_bytes(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> int:
    """Bytes that this process can still allocate: those free, or fewer in a limited container."""
    return max(0, min([_machine_bytes(proc), *_container_bytes(proc, groups)]))


def _machine_bytes(proc: Path) -> int:
    try:
        rows = dict(row.split(":") for row in (proc / "meminfo").read_text(encoding="ascii").splitlines())
        return int(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        # Without Linux's own figure: what lies wholly unused.
        with contextlib.suppress(AttributeError, ValueError, OSError):
            return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return UNKNOWN_BYTES


def _container_bytes(proc: Path, groups: Path) -> Iterator[int]:
    """Bytes that the control groups (v2, v1) of this process and those around them leave of their
    limits; cached files count as free."""
    try:
        lines = [line.split(":", 2) for line in (proc / "self" / "cgroup").read_text().splitlines()]
    except OSError:
        return
    for number, controllers, group in (line for line in lines if len(line) == 3):
        if number == "0":
            # Where the older version has controllers too, this one is mounted beside them.
            for root in (groups, groups / "unified"):
                yield from _group_bytes(root, group, ("memory.max", "memory.high"), ("memory.current", "inactive_file"))
        elif "memory" in controllers.split(","):
            yield from _group_bytes(groups / "memory", group, ("memory.limit_in_bytes",), ("memory.usage_in_bytes", "total_inactive_file"))


def _group_bytes(root: Path, group_path: str, limits: Sequence[str], use: tuple[str, str]) -> Iterator[int]:
    # A container sees its own group at the root, whatever path the group has outside.
    group = root / group_path.strip("/")
    for folder in (group, *group.parents):
        if not folder.is_relative_to(root):
            return
        # Beyond memory.high nothing is refused, but everything slows down to a standstill.
        least = min((limit for name in limits if (limit := _figure(folder / name)) is not None), default=None)
        if least is not None:
            yield least - (_figure(folder / use[0]) or 0) + (_figure(folder / "memory.stat", use[1]) or 0)


def _figure(path: Path, row: str | None = None) -> int | None:
    """The number in a file of the kernel, or in one of its rows; None without one: no limit
    ("max"), or no such group here."""
    try:
        text = path.read_text(encoding="ascii")
        return int(text if row is None else dict(line.split() for line in text.splitlines())[row])
    except (OSError, KeyError, ValueError):
        return None
