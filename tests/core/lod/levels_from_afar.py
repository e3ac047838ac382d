"""How far each level of a `radiant export --lod` folder is from its finest, seen from afar:
`python -m tests.core.lod.levels_from_afar FOLDER [METRES ...]`. Once by hand, for docs/sharing.md.

Level k is seen from 2ᵏ times each distance, obliquely and from above, at 320 × 240 px and 60°,
about the middle of its Gaussians and without the far field, through which one would look.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from radiant_core.io.lod_reader import load_lod_meta
from radiant_core.io.sog_reader import load_sog
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import Splats, concatenate_splats

TOWARDS = np.array([[0.6, 0.3, 0.74], [0.0, 0.05, 1.0]])


def psnr_db(finest: Splats, level: Splats, distance_m: float) -> list[float]:
    """Obliquely and from above."""
    middle = np.median(finest.means.astype(np.float64), axis=0)
    towards = TOWARDS / np.linalg.norm(TOWARDS, axis=1, keepdims=True)
    cameras = cameras_looking_at(middle + distance_m * towards, np.tile(middle, (2, 1)), Lens(size_wh=(320, 240)))
    pairs = zip(render_views(finest, cameras), render_views(level, cameras), strict=True)
    return [float(-10 * np.log10(((full.image - thin.image) ** 2).mean())) for full, thin in pairs]


def main(folder: Path, distances_m: list[float]) -> None:
    """Print a row per level."""
    meta = load_lod_meta(folder / "lod-meta.json")
    levels = [concatenate_splats([load_sog(folder / name) for name in files]) for files in meta.files]
    for k, level in enumerate(levels[1:], start=1):
        cells = (", ".join(f"{value:.1f}" for value in psnr_db(levels[0], level, 2**k * distance)) for distance in distances_m)
        print(f"| {k} | {len(level):,} | " + " | ".join(f"{cell} dB" for cell in cells) + " |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [float(value) for value in sys.argv[2:]] or [65.0, 90.0, 130.0])
