"""Times, memory and sizes as typed on the command line: 90, 5m, 1.5h; 600MB, 1GiB; 1280x900."""

from __future__ import annotations

import math
import re

from radiant_core.errors import BadInput

SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
BYTES = {"": 1.0, "b": 1.0, "kb": 1e3, "mb": 1e6, "gb": 1e9, "kib": 2.0**10, "mib": 2.0**20, "gib": 2.0**30}
_NUMBER_AND_UNIT = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)\s*", re.IGNORECASE | re.ASCII)


def seconds_of(text: str) -> float:
    """Seconds of "90", "90s", "5m" or "1.5h"; BadInput for anything else and for none at all."""
    return _amount(text, SECONDS, "a time such as 90s, 5m or 1h")


def bytes_of(text: str) -> int:
    """Bytes of "600MB", "2GB" (10⁹ each) or "1GiB" (2³⁰); BadInput for anything else and 0."""
    return math.floor(_amount(text, BYTES, "an amount of memory such as 600MB, 2GB or 1GiB", least=1.0))


def _amount(text: str, units: dict[str, float], expected: str, least: float = 0.0) -> float:
    match = _NUMBER_AND_UNIT.fullmatch(text)
    unit = match.group(2).lower() if match else "?"
    amount = float(match.group(1)) * units[unit] if match and unit in units else math.nan
    if not (0 < amount < math.inf and amount >= least):
        raise BadInput(f"{text!r} is given, expected {expected}.")
    return amount


def size_wh_of(text: str) -> tuple[int, int]:
    """Width and height of "1280x900"; BadInput for anything else."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*[x×]\s*(\d{1,6})\s*", text, re.IGNORECASE)
    if match is None:
        raise BadInput(f"the size {text!r} is given, expected width x height in px, such as 1280x900.")
    return int(match.group(1)), int(match.group(2))
