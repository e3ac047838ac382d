"""A process that renders a stored model forward and backward and prints its peak memory's growth.

python -m benchmarks.raster.memory MODEL.npz S|M|L THREADS
"""

from __future__ import annotations

import sys

import numpy as np
import torch

from benchmarks.raster.accuracy import render
from benchmarks.raster.drone_scene import SIZES, drone_camera
from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_core.render.contract import SplatTensors


def main(file: str, size: str, threads: int) -> None:
    """Print the growth of the peak resident memory in bytes."""
    torch.set_num_threads(threads)
    before = reset_peak_bytes()
    with np.load(file) as arrays:
        leaves = SplatTensors(**{name: torch.from_numpy(arrays[name]).requires_grad_() for name in arrays}, antialiased=False)
    for _ in range(3):
        for leaf in leaves.tensors().values():
            leaf.grad = None
        render(leaves, drone_camera(SIZES[size])).images.sum().backward()
    print(peak_bytes() - before)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
