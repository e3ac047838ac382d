"""Colours of edges stay apart for deuteranopes, by the simulation of Machado, Oliveira and Fernandes (2009)."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from radiant_viewer.layers.palette import CATEGORIES, ORANGE, VERMILLION

# Of linear RGB, severity 1, from the paper's table.
DEUTERANOPE_FROM_RGB = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]])
XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
D65 = np.array([0.9505, 1.0, 1.089])


def lab_seen(color: tuple[int, int, int], seen_from_rgb: np.ndarray) -> np.ndarray:
    """CIELAB of a colour of sRGB as an eye sees it."""
    share = np.array(color) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    roots = np.cbrt(XYZ_FROM_RGB @ np.clip(seen_from_rgb @ linear, 0, 1) / D65)
    return np.array([116 * roots[1] - 16, 500 * (roots[0] - roots[1]), 200 * (roots[1] - roots[2])])


def least_difference(colors: tuple[tuple[int, int, int], ...]) -> float:
    seen = [lab_seen(color, DEUTERANOPE_FROM_RGB) for color in colors]
    return min(float(np.linalg.norm(one - other)) for one, other in combinations(seen, 2))


@pytest.mark.parametrize(("count", "least"), [(3, 55.0), (4, 24.0), (7, 17.0)])
def test_colours_of_edges_differ_for_deuteranopes(count: int, least: float) -> None:
    # 2.3 is just noticeable side by side; dots of 7 px on a picture need some ten times that.
    assert least_difference(CATEGORIES[:count]) >= least


def test_the_colour_of_a_selection_alone_would_not_do() -> None:
    usual = np.linalg.norm(lab_seen(ORANGE, np.eye(3)) - lab_seen(VERMILLION, np.eye(3)))
    # Why selections are rings: half of the difference is lost.
    assert least_difference((ORANGE, VERMILLION)) < 0.6 * usual
