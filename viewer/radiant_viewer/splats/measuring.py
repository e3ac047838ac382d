"""Another painter measured against our renderer: `python -m radiant_viewer.splats.measuring
MODEL.ply vtk|open3d` prints the fields of `Measured` as one JSON line.

Both draw two pictures twice, of which the second counts: the first compiles shaders. A graphics
driver or Open3D may end its process, and here that takes nothing with it.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.choices import Painter
from radiant_core.io.ply import load_ply
from radiant_core.render.backends import resolve_backend
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.splats.choosing import Measured, has_graphics_card
from radiant_viewer.splats.drawers import Drawer, make_drawer

SIZE_WH = (640, 400)
NEAR_SHARE = 0.15
"""Of the distance from which all of it is seen: the second picture is from within."""
WORST_DB, WORST_ERROR = 0.0, 1e9
"""Where two pictures show different pixels."""


def measure(splats: Splats, painter: Painter) -> Measured:
    """Draw a model of at least one Gaussian by ours and by another painter, from outside and from
    within; the mean time, and the worse of the differences."""
    from radiant_viewer.pictures.splat_picture import fit_camera

    low, high = np.quantile(splats.means.astype(np.float64), [0.05, 0.95], axis=0)
    outside = fit_camera(np.stack([low, high]), SIZE_WH)
    pose = outside.cam_from_world.copy()
    pose[0, :3, 3] = NEAR_SHARE * pose[0, :3, 3] - (1 - NEAR_SHARE) * pose[0, :3, :3] @ ((low + high) / 2)
    drawers = [make_drawer("radiant", splats), make_drawer(painter, splats)]
    pairs = [[_drawn(drawer, camera) for drawer in drawers] for camera in (outside, replace(outside, cam_from_world=pose))]
    return Measured(
        backend=resolve_backend("auto"),
        ours_s=float(np.mean([ours_s for (_, ours_s), _ in pairs])),
        other_s=float(np.mean([other_s for _, (_, other_s) in pairs])),
        psnr_db=min(picture_psnr_db(rival, ours) for (ours, _), (rival, _) in pairs),
        depth_error=max(depth_error(rival, ours) for (ours, _), (rival, _) in pairs),
    )


def picture_psnr_db(picture: Rgbd, ours: Rgbd) -> float:
    """PSNR of colours, at most 100 dB."""
    mean_square = float(np.mean((picture[..., :3].astype(np.float64) - ours[..., :3]) ** 2))
    return float(-10 * np.log10(max(mean_square, 1e-10))) if np.isfinite(mean_square) else WORST_DB


def depth_error(picture: Rgbd, ours: Rgbd) -> float:
    """What nine in ten pixels' depths differ by at most, as a share of the distance; `WORST_ERROR`
    where the two show different pixels."""
    both = (picture[..., 3] > 0) & (ours[..., 3] > 0)
    if not both.any() or both.sum() < 0.9 * (ours[..., 3] > 0).sum():
        return WORST_ERROR
    return float(np.quantile(np.abs(picture[both][:, 3] / ours[both][:, 3] - 1), 0.9))


def _drawn(drawer: Drawer, camera: Cameras) -> tuple[Rgbd, float]:
    picture: Rgbd = np.zeros((SIZE_WH[1], SIZE_WH[0], 4), np.float32)
    drawer.draw(camera, (0, 0, 0), picture)
    began = time.monotonic()
    drawer.draw(camera, (0, 0, 0), picture)
    return picture, time.monotonic() - began


def main() -> int:
    """Measure and print, and end at once: the answer is out before a renderer is torn down."""
    # Graphics drivers write to standard output: it becomes standard error; answers keep the pipe.
    pipe = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    if not has_graphics_card():
        # Then the figure is for reading alone, and the views come first.
        os.nice(19)
    painter: Painter = "open3d" if sys.argv[2] == "open3d" else "vtk"
    pipe.write(json.dumps(asdict(measure(load_ply(Path(sys.argv[1])), painter))) + "\n")
    pipe.flush()
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
