"""Colours of edges stay apart for colour-blind readers, by the simulation of Machado, Oliveira and Fernandes (2009)."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from radiant_viewer.layers.palette import CATEGORIES, WHITE
from radiant_viewer.layers.themes import DARK

# Of linear RGB, severity 1, from the paper's table.
DEUTERANOPE_FROM_RGB = np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]])
PROTANOPE_FROM_RGB = np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]])
XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
D65 = np.array([0.9505, 1.0, 1.089])


def linear_rgb(color: tuple[int, int, int]) -> np.ndarray:
    share = np.array(color) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab_seen(color: tuple[int, int, int], seen_from_rgb: np.ndarray) -> np.ndarray:
    """CIELAB of a colour of sRGB as an eye sees it."""
    roots = np.cbrt(XYZ_FROM_RGB @ np.clip(seen_from_rgb @ linear_rgb(color), 0, 1) / D65)
    return np.array([116 * roots[1] - 16, 500 * (roots[0] - roots[1]), 200 * (roots[1] - roots[2])])


def contrast(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
    """Of luminances, as WCAG 2 has it."""
    low, high = sorted(float(XYZ_FROM_RGB[1] @ linear_rgb(color)) + 0.05 for color in (one, other))
    return high / low


def least_difference(colors: tuple[tuple[int, int, int], ...], seen_from_rgb: np.ndarray) -> float:
    seen = [lab_seen(color, seen_from_rgb) for color in colors]
    return min(float(np.linalg.norm(one - other)) for one, other in combinations(seen, 2))


@pytest.mark.parametrize(
    ("eye", "count", "least"),
    [(DEUTERANOPE_FROM_RGB, 3, 55.0), (DEUTERANOPE_FROM_RGB, 7, 27.0), (PROTANOPE_FROM_RGB, 7, 25.0), (np.eye(3), 7, 31.0)],
    ids=["deuteranopes, three", "deuteranopes", "protanopes", "usual"],
)
def test_colours_of_edges_differ(eye: np.ndarray, count: int, least: float) -> None:
    # 2.3 is just noticeable side by side; dots of 7 px on a picture need some ten times that.
    assert least_difference(CATEGORIES[:count], eye) >= least


def test_colours_of_edges_stand_out_from_both_grounds() -> None:
    on_white, on_dark = ([contrast(color, ground) for color in CATEGORIES] for ground in (WHITE, DARK.view))
    # Orange, sky and yellow are bright: they have rims on white, and 3 : 1 on a dark view.
    assert min(on_dark) > 2.95
    assert sum(ratio > 2.95 for ratio in on_white) == 4 and min(on_white) > 1.25
