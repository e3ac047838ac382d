"""What all examples share: where the photographs are, where pictures go, and how large all is."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike

import radiant

ROOT = Path(__file__).parents[1]
PHOTOGRAPHS = Path(os.environ.get("PHOTOGRAPHS", ROOT / "sample_scenes/town/images"))
OUT = Path(os.environ.get("OUT", ROOT / "build/examples"))
SMALL = "SMALL" in os.environ
"""Seconds in place of minutes, for tests."""
LONG_SIDE_PX, STEPS = (96, 40) if SMALL else (384, 800)


def town() -> radiant.Scene:
    """The town, by structure from motion at the first call."""
    folder = Path(os.environ.get("SCENE", OUT / "town"))
    if (folder / "scene.safetensors").is_file():
        return radiant.load_scene(folder)
    with radiant.progress() as listen:
        return radiant.reconstruct(PHOTOGRAPHS, folder, listen)


def save_picture(name: str, *images: ArrayLike) -> None:
    """Write images (H,W,3) in 0..1 beside each other as PNG."""
    OUT.mkdir(parents=True, exist_ok=True)
    row = (np.clip(np.hstack([np.asarray(image, float) for image in images]), 0, 1) * 255).round().astype(np.uint8)
    cv2.imwrite(str(OUT / name), row[..., ::-1])
    print("written:", OUT / name)
