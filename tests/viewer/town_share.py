"""How much of the first picture of a run is the town: `python -m tests.viewer.town_share RUN`.

Of the 3D view at 640 × 480, as *F* aims it: the share of the pixels inside of the regions' outline on the ground that the
model covers by half and more, and of those outside of their box, farther than a twentieth of the picture's height from
it, that it covers by a tenth and more; with and without what lies around the scene.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_viewer.pictures.offscreen import fitting_pose
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.runs.shown_model import framed_positions, shown_of_run

SIZE_WH = (640, 480)


def shares(run: RunView, splats: Splats) -> tuple[float, float]:
    """Covered inside, and smeared outside."""
    framed = framed_positions(run.scene, run.cloud_plan)
    camera = fitting_pose(framed, SIZE_WH, 30.0).camera(SIZE_WH)
    view = next(render_views(splats, camera))
    ground = np.column_stack([framed[:, :2], np.full(len(framed), ground_height(run.scene))])
    inside, within = (_filled(camera, places) for places in (ground, framed))
    near = cv2.dilate(within, np.ones((SIZE_WH[1] // 10 + 1,) * 2, np.uint8))
    return float((view.alpha[inside == 1] >= 0.5).mean()), float((view.alpha[near == 0] >= 0.1).mean())


def _filled(camera: Cameras, places: np.ndarray) -> np.ndarray:
    """The hull of places (K,3) in the picture (H,W), 0 and 1."""
    in_camera = places @ camera.cam_from_world[0, :3, :3].T + camera.cam_from_world[0, :3, 3]
    pixels = (in_camera @ camera.Ks[0].T)[:, :2] / in_camera[:, 2:]
    picture = np.zeros(SIZE_WH[::-1], np.uint8)
    cv2.fillConvexPoly(picture, cv2.convexHull(pixels.astype(np.float32)).round().astype(np.int32), 1)
    return picture


def main(folder: str) -> None:
    """Print both."""
    run = load_run_view(Path(folder))
    assert run.splats is not None
    for name, splats in (("as trained", run.splats), ("shown", shown_of_run(run).splats)):
        covered, smeared = shares(run, splats)
        print(f"{name}: {100 * covered:.1f} % of the outline covered, {100 * smeared:.1f} % of the rest smeared")


if __name__ == "__main__":
    main(*sys.argv[1:])
