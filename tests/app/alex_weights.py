"""AlexNet with random weights and heads in one file, of the published shapes: enough to measure some LPIPS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

CONVS = ((0, 3, 64, 11), (3, 64, 192, 5), (6, 192, 384, 3), (8, 384, 256, 3), (10, 256, 256, 3))
"""Number among torchvision's features, channels in and out, side of the kernel."""


def write_alex_weights(path: Path) -> Path:
    """Write them as safetensors; returns `path`."""
    rng, arrays = np.random.default_rng(1), {}
    for tap, (number, fan_in, out, kernel) in enumerate(CONVS):
        spread = (2 / (fan_in * kernel**2)) ** 0.5
        arrays[f"features.{number}.weight"] = spread * rng.normal(size=(out, fan_in, kernel, kernel)).astype(np.float32)
        arrays[f"features.{number}.bias"] = np.zeros(out, np.float32)
        arrays[f"lin{tap}.model.1.weight"] = rng.random((1, out, 1, 1)).astype(np.float32)
    save_file(arrays, path)
    return path
