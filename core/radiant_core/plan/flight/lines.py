"""Straight lines of a flight, of which one can be held out whole. Once per scene.

Photographs in the order of their names or times are cut where the path turns: a line is a longest
run of steps that are each at most 30 degrees off the line's own direction, its first to its last
camera, and at most 2.5 times as long as the usual step. Directions count on the ground alone.
Runs of fewer than `MIN_LINE` photographs, such as turns, and a flight with a single line are none:
without a neighbouring line nothing shows the ground of one that is held out. A path around
something has none either: nearly all of its steps turn to the same side, once around or more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.numerics import FloatArray, check_array

MIN_LINE = 4
MAX_TURN_DEG = 30.0
MAX_STEP = 2.5
"""Longest step within a line, of the median step."""
MIN_ONE_WAY = 0.9
"""Share of steps that turn to one side on a path around something."""
MIN_AROUND_DEG = 300.0
"""A circle of which a photograph or two were not placed."""


def flight_lines(centers: ArrayLike) -> list[NDArray[np.int64]]:
    """Rows of the photographs of each line, of centres (C,3) in the order of the flight; lines in
    that order too, none shared. Raises BadInput for centres of another shape or not finite."""
    places = check_array("centers", centers, (None, 3))[:, :2]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if not len(steps) or not steps.max() > 0 or _goes_around(places):
        return []
    longest = MAX_STEP * float(np.median(steps[steps > 0]))
    lines: list[NDArray[np.int64]] = []
    start = 0
    while start + MIN_LINE <= len(places):
        end = start + 1
        while end < len(places) and steps[end - 1] <= longest and _is_straight(places[start : end + 1]):
            end += 1
        if end - start >= MIN_LINE:
            lines.append(np.arange(start, end))
            start = end
        else:
            start += 1
    return lines


def _goes_around(places: FloatArray) -> bool:
    """Whether the path (K,2) circles something."""
    steps = np.diff(places, axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > 0]
    steps = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    preceding, following = steps[:-1], steps[1:]
    turns: FloatArray = np.arctan2(
        preceding[:, 0] * following[:, 1] - preceding[:, 1] * following[:, 0], (preceding * following).sum(axis=1)
    )
    sides = [float(np.mean(turns * side > 1e-6)) for side in (1, -1)] if len(turns) else [0.0]
    return max(sides) >= MIN_ONE_WAY and bool(abs(turns.sum()) > np.radians(MIN_AROUND_DEG))


def _is_straight(places: FloatArray) -> bool:
    """Whether every step along places (K,2) is within the largest turn of the whole way's
    direction, which is that of the first step for two places."""
    whole = places[-1] - places[0]
    steps = np.diff(places, axis=0)
    lengths = np.linalg.norm(steps, axis=1) * np.linalg.norm(whole)
    return bool((lengths > 0).all() and (steps @ whole >= np.cos(np.radians(MAX_TURN_DEG)) * lengths).all())
