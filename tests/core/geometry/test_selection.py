"""Gaussians chosen by areas of a view, against a plain loop; and their file against strangers."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from matplotlib.path import Path as Outline

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.geometry.cleaning import Cleaning, SelectionStep, clean, describe, keeps
from radiant_core.geometry.cleaning_file import cleaning_path, load_cleaning, save_cleaning
from radiant_core.geometry.selection import Front, Stroke, chosen_by
from tests.core.geometry.test_cleaning import splats_of
from tests.seeds import for_seeds

POSE = (0.6, -0.8, 0.0, 1.0, 0.8, 0.6, 0.0, -2.0, 0.0, 0.0, 1.0, 25.0)
"""A turn about the axis of the view, and 25 m back."""
LASSO = ((-0.5, -0.4), (0.4, -0.3), (0.3, 0.5), (-0.2, 0.1))


def eye_of(means: np.ndarray) -> np.ndarray:
    pose = np.array(POSE).reshape(3, 4)
    return np.array([pose[:, :3] @ mean.astype(np.float64) + pose[:, 3] for mean in means])


def test_a_lasso_and_a_brush_choose_what_a_plain_loop_does() -> None:
    means = splats_of(4000).means
    seen = eye_of(means)
    ahead = seen[:, 2] > 0
    places = seen[:, :2] / seen[:, 2:]
    lasso = ahead & Outline(LASSO).contains_points(places)
    assert 50 < lasso.sum() < 3000
    np.testing.assert_array_equal(Stroke(cam_from_world=POSE, path=LASSO).chosen(means), lasso)
    path = np.array([(-0.3, -0.3), (0.0, 0.2), (0.4, 0.2)])
    away = np.full(len(means), np.inf)
    for start, end in pairwise(path):
        share = np.clip(((places - start) @ (end - start)) / np.sum((end - start) ** 2), 0, 1)[:, None]
        away = np.minimum(away, np.linalg.norm(places - start - share * (end - start), axis=1))
    brush = Stroke(cam_from_world=POSE, path=tuple(map(tuple, path)), radius=0.1).chosen(means)
    # Its round ends are polygons of 64 sides: up to 0.12 % within the circle.
    assert (brush <= (ahead & (away <= 0.1))).all() and (brush >= (ahead & (away <= 0.0995))).all() and brush.sum() > 50


def hand_drawn(rng: np.random.Generator) -> np.ndarray:
    """A line (40,2) around the middle of the view, or an eight that crosses itself there."""
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False) + rng.uniform(0, 0.1, 40)
    radius = rng.uniform(0.2, 0.5, 40)[:, None]
    is_eight = rng.random() < 0.5
    return 0.4 * np.column_stack([np.cos(turn), np.sin(2 * turn)]) if is_eight else radius * np.column_stack([np.cos(turn), np.sin(turn)])


@for_seeds(8)
def test_a_lasso_chooses_what_open3ds_volume_over_the_same_polygon_does(seed: int) -> None:
    means, path = splats_of(4000, seed=seed).means, hand_drawn(np.random.default_rng(seed))
    seen = eye_of(means)
    ahead = np.flatnonzero(seen[:, 2] > 0)
    volume = o3d.visualization.SelectionPolygonVolume()
    volume.orthogonal_axis, volume.axis_min, volume.axis_max = "Z", 0.0, float(seen[:, 2].max())
    volume.bounding_polygon = o3d.utility.Vector3dVector(np.column_stack([path, np.zeros(len(path))]))
    # It has parallel rays alone: the view's perspective is divided out before.
    flat = np.column_stack([seen[ahead, :2] / seen[ahead, 2:], seen[ahead, 2]])
    inside = volume.crop_in_polygon(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(flat)))
    chosen = np.flatnonzero(Stroke(cam_from_world=POSE, path=tuple(map(tuple, path))).chosen(means))
    np.testing.assert_array_equal(chosen, ahead[np.sort(np.asarray(inside, int))])
    assert len(chosen) > 50


def test_a_front_keeps_what_lies_behind_it() -> None:
    means = splats_of(4000, seed=1).means
    depth = eye_of(means)[:, 2]
    front = Front(box=(-1.0, -1.0, 1.0, 1.0), rows=2, columns=1, depths=(20.0, 0.0))
    whole = Stroke(cam_from_world=POSE, path=LASSO).chosen(means)
    near = Stroke(cam_from_world=POSE, path=LASSO, front=front, tolerance=0.1).chosen(means)
    upper = eye_of(means)[:, 1] / depth < 0
    np.testing.assert_array_equal(near, whole & (~upper | (depth <= 22.0)))
    assert 0 < near.sum() < whole.sum()


def test_strokes_add_and_take_away_in_their_order() -> None:
    means = splats_of(3000, seed=2).means
    first = Stroke(cam_from_world=POSE, path=LASSO)
    second = Stroke(cam_from_world=POSE, path=((0.0, 0.0), (0.4, 0.0)), radius=0.2, takes_away=True)
    np.testing.assert_array_equal(chosen_by([first, second], means), first.chosen(means) & ~second.chosen(means))
    np.testing.assert_array_equal(chosen_by([second, first], means), first.chosen(means))


def test_a_selection_is_a_step_like_others_and_comes_back_from_its_file(tmp_path: Path) -> None:
    splats = splats_of(2000, seed=3)
    front = Front(box=(-1.0, -1.0, 1.0, 1.0), rows=2, columns=2, depths=(20.0, 0.0, 21.5, 30.0))
    strokes = (Stroke(cam_from_world=POSE, path=LASSO, front=front), Stroke(cam_from_world=POSE, path=((0.1, 0.1),), radius=0.05))
    out, only = SelectionStep(strokes=strokes), SelectionStep(strokes=strokes, keep="inside")
    np.testing.assert_array_equal(keeps(out, splats), ~keeps(only, splats))
    cleaning = Cleaning(steps=(out, only)).undo()
    path = cleaning_path(tmp_path / "m.ply")
    save_cleaning(path, cleaning)
    assert load_cleaning(path) == cleaning
    assert clean(splats, load_cleaning(path)).num_left_out == chosen_by(strokes, splats.means).sum() > 0
    assert describe(out, "m") == "all but what 2 strokes in the 3D view chose"


@pytest.mark.parametrize(
    "change",
    [
        {"cam_from_world": [2.0, *POSE[1:]]},
        {"cam_from_world": list(POSE[:-1])},
        {"path": [[0.0, 0.0], [1.0, 0.0]]},
        {"path": [[0.0, 1e400], [1.0, 0.0], [1.0, 1.0]]},
        {"radius": -1.0},
        {"tolerance": 2.0},
        {"front": {"box": [0, 0, 1, 1], "rows": 2, "columns": 2, "depths": [1.0]}},
        {"front": {"box": [0, 0, 0, 1], "rows": 1, "columns": 1, "depths": [1.0]}},
        {"front": {"box": [0, 0, 1, 1], "rows": 1, "columns": 1, "depths": [-1.0]}},
        {"front": {"box": [0, 0, 1, 1], "rows": 10**6, "columns": 10**6, "depths": []}},
    ],
)
def test_a_file_of_a_stranger_ends_in_a_sentence(tmp_path: Path, change: dict[str, Any]) -> None:
    stroke = {"cam_from_world": list(POSE), "path": [list(place) for place in LASSO], "tolerance": 0.02, **change}
    record = {"schema": "radiant.cleaning", "version": 1, "steps": [{"kind": "selection", "strokes": [stroke]}]}
    (tmp_path / "cleaning.json").write_text(json.dumps(record))
    with pytest.raises(StoreDamaged):
        load_cleaning(tmp_path / "cleaning.json")


def test_no_stroke_is_no_selection() -> None:
    with pytest.raises(BadInput):
        SelectionStep(strokes=())
