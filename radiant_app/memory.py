"""How much memory this process holds and has held at most."""

from __future__ import annotations

import sys
from pathlib import Path


def reset_peak_bytes() -> int:
    """Resident bytes now; the peak is counted from here on, since imports alone may have peaked higher (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status_bytes("VmRSS")


def resident_bytes() -> int:
    """Resident bytes now on Linux, elsewhere the highest so far."""
    return _status_bytes("VmRSS") if sys.platform == "linux" else peak_bytes()


def peak_bytes() -> int:
    """The highest resident bytes since the program began or, on Linux, since `reset_peak_bytes`."""
    if sys.platform == "linux":
        # getrusage's maximum would begin with what the parent held before this program was started.
        return _status_bytes("VmHWM")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _status_bytes(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) * 1024
