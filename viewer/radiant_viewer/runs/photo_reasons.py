"""Why a photograph may be rendered worse than others: what its camera saw. Once per selection.

points: sparse points placed from it; tilt: of its view from straight down, in degrees.
"""

from __future__ import annotations

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene


def tilts_deg(scene: SfmScene) -> FloatArray:
    """Return the angle (C,) of each camera's axis to straight down, 0 to 180 degrees; z is up."""
    downwards = -scene.cameras.cam_from_world[:, 2, 2]
    return np.degrees(np.arccos(np.clip(downwards, -1.0, 1.0)))


def reason_text(scene: SfmScene, index: int) -> str:
    """Return points seen and tilt of camera `index`, each with the median, and the distance to the
    nearest camera."""
    count = len(scene.cameras)
    points = np.bincount(scene.observations[:, 1], minlength=count)
    tilts = tilts_deg(scene)
    parts = [
        f"{points[index]:,} sparse points seen (median {np.median(points):,.0f})",
        f"tilted {tilts[index]:.0f}° (median {np.median(tilts):.0f}°)",
    ]
    if count > 1:
        away = np.linalg.norm(scene.cameras.centers - scene.cameras.centers[index], axis=1)
        away[index] = np.inf
        parts.append(f"next camera {away.min():.3g} {scene.frame.unit}")
    return "   ·   ".join(parts)
