"""Bright balls in a model, where a screen is searched for them (`moved_views.py`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.splats import SH_C0, Splats, concatenate_splats
from tests.viewer.made_up_run import Town

BALL = np.array([255, 0, 255])
CORNER_AWAY_M, BALL_AWAY_M = 12.0, np.array([9.0, 12.0])
BALL_M, BALL_HEIGHT_M, MARK_HEIGHT_M = 1.7, 7.0, 4.0


def beacon_places(town: Town) -> tuple[np.ndarray, np.ndarray]:
    """Where the balls (K,3) and the marks (K,3) are: marks beside the corners of the regions and all
    over the ground; balls apart from them."""
    corners = np.unique(np.round(np.concatenate(town.cloud_plan.borders), 3), axis=0)
    inward = corners.mean(axis=0) - corners
    corners = corners + CORNER_AWAY_M * inward / np.linalg.norm(inward, axis=1, keepdims=True)
    grid = np.stack(np.meshgrid(np.linspace(-80, 80, 5), np.linspace(-44, 44, 3)), axis=-1).reshape(-1, 2)
    marks = np.concatenate([corners, grid])
    balls = marks + BALL_AWAY_M
    return np.column_stack([balls, np.full(len(balls), BALL_HEIGHT_M)]), np.column_stack([marks, np.full(len(marks), MARK_HEIGHT_M)])


def with_beacons(town: Town) -> Town:
    """The town with bright balls over its regions' corners."""
    places = beacon_places(town)[0]
    count = len(places)
    balls = Splats(
        means=places.astype(np.float32),
        quats=np.tile(np.array([1.0, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(BALL_M), np.float32),
        logit_opacities=np.full(count, 7.0, np.float32),
        sh0=np.tile(((BALL / 255 - 0.5) / SH_C0).astype(np.float32), (count, 1, 1)),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    return replace(town, splats=concatenate_splats([town.splats, balls]))
