"""How many Gaussians a compressed file may say that it holds. Once per file.

A file that says too much would have its textures or streams unpacked to gigabytes. Real files take
5 to 20 bytes a Gaussian, and equal ones pack to little: below `FREE_COUNT` any count is believed,
above it one for every `1 / PER_BYTE` bytes.
"""

from __future__ import annotations

from radiant_core.errors import BadInput

FREE_COUNT = 1 << 18
"""Some 100 MB while they are unpacked."""
PER_BYTE = 2


def most_gaussians(num_bytes: int) -> int:
    """The most Gaussians that so many bytes are believed to hold."""
    return FREE_COUNT + PER_BYTE * num_bytes


def require_believable(count: int, num_bytes: int) -> None:
    """Raise BadInput, which does not name the file, for a count beyond what its bytes can hold."""
    if count > most_gaussians(num_bytes):
        raise BadInput(f"it says {count:,} Gaussians in {num_bytes:,} bytes, expected at most {most_gaussians(num_bytes):,}")
