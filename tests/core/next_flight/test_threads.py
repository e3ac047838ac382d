"""The surface of a model and its errors are the same to the bit by one thread and by several."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from radiant_core.next_flight.model_surface import MapView, facets_of_model
from radiant_core.next_flight.predicted_error import errors_in_views
from radiant_core.next_flight.sightings import Sights
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import MOST_AT_ONCE, render_views, use_views
from radiant_core.scene import SfmScene
from radiant_core.survey.map_grid import grid_over
from radiant_core.survey.seen_ground import seen_ground
from tests.core.next_flight.block import FRAME
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-1.5, -0.5, 0.5, 1.5) for y in (-1.0, 0.0, 1.0)], size_wh=(96, 72))
SPLATS = ground_splats(2000)


def photograph(index: int) -> NDArray[np.uint8]:
    width, height = CAMERAS.sizes_wh[index].tolist()
    return np.random.default_rng(index).integers(0, 255, (height, width, 3), np.uint8)


def known() -> list[FloatArray]:
    """Heights, places of facets, and their errors in each photograph."""
    scene = SfmScene(
        cameras=CAMERAS, points=SPLATS.means.astype(np.float64), colors=np.zeros((len(SPLATS), 3), np.uint8),
        observations=np.zeros((0, 2), np.int64), frame=FRAME.frame,
    )  # fmt: skip
    ground = seen_ground(scene, FRAME)
    facets = facets_of_model(
        SPLATS, scene, ground, grid_over(ground.low, ground.high, 0.25, FRAME), MapView(map_frame=FRAME, long_side_px=96)
    )
    sightings = Sights(facets, FRAME).all_of(CAMERAS)
    return [facets.surface.heights, facets.places, *errors_in_views(SPLATS, CAMERAS, photograph, sightings, 0.25)]


def test_threads_do_not_change_a_bit() -> None:
    before, results = torch.get_num_threads(), list[list[FloatArray]]()
    try:
        for num_threads in (1, 3, 2 * MOST_AT_ONCE):
            torch.set_num_threads(num_threads)
            results.append(known())
    finally:
        torch.set_num_threads(before)
    assert np.isfinite(results[0][0]).mean() > 0.5
    assert all(len(errors) > 100 for errors in results[0][2:])
    for other in results[1:]:
        for one, same in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_views_come_in_the_order_of_their_cameras_as_drawn_one_by_one() -> None:
    used = list(use_views(SPLATS, CAMERAS, lambda index, view: (index, view)))
    assert [index for index, _ in used] == list(range(len(CAMERAS)))
    for (_, view), alone in zip(used, render_views(SPLATS, CAMERAS), strict=True):
        assert view.name == alone.name
        for name in ("image", "alpha", "depth"):
            np.testing.assert_array_equal(getattr(view, name), getattr(alone, name))


def test_an_error_of_one_view_ends_all() -> None:
    def fail_at_third(index: int, _view: object) -> int:
        if index == 2:
            raise OSError("the third photograph cannot be read")
        return index

    with pytest.raises(OSError, match="the third photograph"):
        list(use_views(SPLATS, CAMERAS, fail_at_third))
