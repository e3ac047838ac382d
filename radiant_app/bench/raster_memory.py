"""A process of its own that renders one stored model forward and backward, and prints by how many bytes its memory has grown at most.

python -m radiant_app.bench.raster_memory MODEL.npz S|M|L THREADS
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

from radiant_app.bench.drone_scene import SIZES, drone_camera
from radiant_app.bench.raster_accuracy import render
from radiant_core.render.contract import SplatTensors


def main(file: str, size: str, threads: int) -> None:
    """Print the growth of the peak resident memory in bytes."""
    torch.set_num_threads(threads)
    before = reset_peak_bytes()
    with np.load(file) as arrays:
        leaves = SplatTensors(**{name: torch.from_numpy(arrays[name]).requires_grad_() for name in arrays})
    for _ in range(3):
        for leaf in leaves.tensors().values():
            leaf.grad = None
        render(leaves, drone_camera(SIZES[size])).images.sum().backward()
    print(peak_bytes() - before)


def reset_peak_bytes() -> int:
    """Resident bytes now; the peak is counted from here on, since imports alone may have peaked higher (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status_bytes("VmRSS")


def peak_bytes() -> int:
    """The highest resident bytes since `reset_peak_bytes`."""
    return _status_bytes("VmHWM")


def _status_bytes(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) * 1024


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
