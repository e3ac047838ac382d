"""Quality against cost: each variant has its colour, labels do not overlap, poison is refused."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.charts.curve_chart import CurvePoint, _spread_labels, curve_picture
from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import BLUE, ORANGE


def points(offset_db: float) -> list[CurvePoint]:
    return [CurvePoint(cpu_s=seconds, num_gaussians=1e4 * seconds, psnr_db=20 + offset_db + np.log(seconds)) for seconds in (10, 20, 180)]


def test_both_variants_are_drawn_in_their_colours() -> None:
    picture = curve_picture({"default": points(2), "standard": points(0)}, "Training", "town")
    assert picture.shape == (520, 1100, 3)
    for rgb in (BLUE, ORANGE):
        for half in (picture[:, :550], picture[:, 550:]):
            assert (np.abs(half.astype(int) - rgb).max(axis=2) < 12).sum() > 100


def test_labels_keep_apart_and_the_smallest_is_there() -> None:
    kept = _spread_labels([49_000, 68_000, 120_000, 130_000, 140_000, 150_000, 160_000, 200_000])
    assert kept[0] == 49_000 and (np.diff(np.log(kept)) > 0.14 * np.log(200 / 49)).all() and len(kept) >= 4
    assert _spread_labels([5.0]) == [5.0] and _spread_labels([5.0, 5.0]) == [5.0]


def test_a_single_point_is_drawn_and_nothing_or_poison_is_refused() -> None:
    assert curve_picture({"default": points(0)[:1]}, "Training", "").std() > 0
    with pytest.raises(BadInput, match="no curve"):
        curve_picture({"default": []}, "Training", "")
    with pytest.raises(BadInput, match="three positive numbers"):
        CurvePoint(cpu_s=1, num_gaussians=1, psnr_db=float("nan"))
