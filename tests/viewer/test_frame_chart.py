"""The picture of a device's frame: GPS and cameras are drawn and joined, far ones stand out."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_viewer.charts.frame_chart import frame_picture
from radiant_viewer.layers.palette import BLUE, ORANGE, VERMILLION

GPS_M = np.array([[0.0, 0, 50], [20, 0, 50], [40, 10, 51], [0, 20, 50], [20, 20, 52]])


def has_color(picture: np.ndarray, rgb: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < 12).sum())


def test_gps_cameras_and_far_lines_are_drawn() -> None:
    near = frame_picture(GPS_M, GPS_M + 0.5, "Frame", "5 photographs")
    far = frame_picture(GPS_M, GPS_M + 60 * np.eye(5, 3, -2), "Frame", "5 photographs")
    assert near.shape == (560, 1100, 3) and near.dtype == np.uint8
    assert has_color(near, BLUE) > 50 and has_color(near, ORANGE) > 50
    assert has_color(far, VERMILLION) > 50 > has_color(near, VERMILLION)


def test_one_position_is_drawn_and_none_or_poison_is_refused() -> None:
    assert frame_picture(GPS_M[:1], GPS_M[:1], "Frame", "").std() > 0
    with pytest.raises(BadInput, match="without GPS positions"):
        frame_picture(np.zeros((0, 3)), np.zeros((0, 3)), "Frame", "")
    with pytest.raises(BadInput, match="cameras_m"):
        frame_picture(GPS_M, np.full((5, 3), np.nan), "Frame", "")
