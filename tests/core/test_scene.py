"""Scenes from structure from motion: observations are valid, seeing distributes over cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.scene import SfmScene


def some_scene(**changes: Any) -> SfmScene:
    rng = np.random.default_rng(0)
    cameras = Cameras(
        names=("a", "b", "c"),
        Ks=np.tile(np.diag([500.0, 500.0, 1.0]), (3, 1, 1)),
        cam_from_world=np.tile(np.eye(4), (3, 1, 1)),
        sizes_wh=np.full((3, 2), 100),
    )
    fields: dict[str, Any] = {
        "cameras": cameras,
        "points": rng.normal(size=(50, 3)),
        "colors": rng.integers(0, 256, (50, 3)),
        "observations": np.stack([rng.integers(0, 50, 80), rng.integers(0, 3, 80)], axis=1),
        "frame": Frame(kind="metric", origin_lat_lon_alt=np.zeros(3)),
    }
    return SfmScene(**{**fields, **changes})


def test_cameras_together_see_the_union_of_what_each_sees() -> None:
    scene = some_scene()
    each = [set(scene.seen_by(np.array([index])).tolist()) for index in range(3)]
    assert set(scene.seen_by(np.array([0, 2])).tolist()) == each[0] | each[2]
    assert set(scene.seen_by(np.arange(3)).tolist()) == set(scene.observations[:, 0].tolist())
    assert len(scene.seen_by(np.zeros(0, np.int64))) == 0


def test_seen_points_come_sorted_and_once() -> None:
    seen = some_scene().seen_by(np.arange(3))
    assert (np.diff(seen) > 0).all()


def test_a_scene_without_points_is_fine() -> None:
    empty = np.zeros((0, 3))
    assert len(some_scene(points=empty, colors=empty, observations=np.zeros((0, 2))).seen_by(np.arange(3))) == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"observations": [[50, 0]]},
        {"observations": [[0, 3]]},
        {"observations": [[-1, 0]]},
        {"observations": [[0, 0, 0]]},
        {"observations": [[0.5, 0]]},
        {"points": np.full((50, 3), np.nan)},
        {"points": np.zeros((50, 2))},
        {"colors": np.zeros((49, 3))},
        {"colors": np.full((50, 3), 256)},
        {"colors": np.full((50, 3), 0.5)},
    ],
)
def test_what_does_not_fit_together_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        some_scene(**wrong)
