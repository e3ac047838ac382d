"""The pictures of the model at the head of a report: all around it, to be turned by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.render.trajectories import middle_box

if TYPE_CHECKING:
    from radiant_viewer.runs.run_view import RunView

NUM_SIDES = 24
SIZE_WH = (1080, 700)
HIGHEST_SHARE = 0.99
"""Of the points in the box: what stands higher is haze."""


def framed_box(run: RunView) -> FloatArray:
    """Return lower and upper corner (2,3) of what a run surveyed: its regions, or where most points
    lie where there is no border; from the ground to the highest points."""
    corners = np.concatenate([border.reshape(-1, 2) for border in run.cloud_plan.borders if len(border)] or [np.zeros((0, 2))])
    points = run.scene.points if len(run.scene.points) else run.scene.cameras.centers
    box = middle_box(points)
    if len(corners):
        box[:, :2] = corners.min(axis=0), corners.max(axis=0)
        inside = ((points[:, :2] >= box[0, :2]) & (points[:, :2] <= box[1, :2])).all(axis=1)
        if inside.any():
            low, high = np.quantile(points[inside, 2], [1 - HIGHEST_SHARE, HIGHEST_SHARE])
            box[:, 2] = low, high
    return box
