"""Gaussians chosen by areas of a view: a lasso's polygon or a brush's path, through the whole depth
or only up to what is seen there.

    p = R x + t,  u = p_x / p_z,  v = p_y / p_z          x: a Gaussian's middle
    chosen by a stroke:  p_z > 0,  (u, v) in its area,  p_z ≤ (1 + tolerance) front(u, v)

`front` is the depth that was rendered for that view, on a coarse grid over the area, so that a
stroke is a rule of its own: it holds for a model that is trained again. Strokes add to what those
before them chose, or take away from it. Once per stroke and reading of a model; N Gaussians, some
20 ns a Gaussian and stroke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

MAX_CORNERS = 10_000
MAX_CELLS = 96
"""Cells of a front along a side."""
TOLERANCE = 0.02
"""Share of its depth that a surface reaches behind what is rendered of it: 1 m at 50 m."""


@dataclass(frozen=True, kw_only=True)
class Front:
    """What is seen in an area: rendered depths, rows downwards, over `box` (u and v of the upper
    left, of the lower right); 0 where nothing is. BadInput where that is no grid of depths."""

    box: tuple[float, float, float, float]
    rows: int
    columns: int
    depths: tuple[float, ...]

    def __post_init__(self) -> None:
        depths = check_array("depths of a front", self.depths, (None,))
        if not (1 <= self.rows <= MAX_CELLS and 1 <= self.columns <= MAX_CELLS and len(depths) == self.rows * self.columns):
            raise BadInput(
                f"a front of {self.rows} × {self.columns} cells has {len(depths)} depths, expected one for each of 1 to {MAX_CELLS}."
            )
        u_min, v_min, u_max, v_max = check_array("the box of a front", self.box, (4,))
        if not (u_min < u_max and v_min < v_max) or (depths < 0).any():
            raise BadInput("a front has no area, or depths behind its eye: make the selection again.")
        object.__setattr__(self, "box", (float(u_min), float(v_min), float(u_max), float(v_max)))
        object.__setattr__(self, "depths", tuple(float(depth) for depth in depths))

    def at(self, places: FloatArray) -> FloatArray:
        """Depths (N,) at places (N,2) of the view, infinite where nothing is seen and outside."""
        u_min, v_min, u_max, v_max = self.box
        grid = np.array(self.depths).reshape(self.rows, self.columns)
        column = np.floor((places[:, 0] - u_min) / (u_max - u_min) * self.columns)
        row = np.floor((places[:, 1] - v_min) / (v_max - v_min) * self.rows)
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        nearest = np.full(len(places), np.inf)
        nearest[inside] = grid[row[inside].astype(int), column[inside].astype(int)]
        return np.where(nearest > 0, nearest, np.inf)


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """One stroke in a view. cam_from_world: the twelve numbers of R|t by rows; path ((u, v), …): a
    polygon's corners, or where a brush of this `radius` went. BadInput where it has no area or no
    rigid view."""

    cam_from_world: tuple[float, ...]
    path: tuple[tuple[float, float], ...]
    radius: float = 0.0
    """Of a brush; 0: the path is a polygon."""
    takes_away: bool = False
    front: Front | None = None
    """What is seen in the area; None: the whole depth counts."""
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        pose = check_array("the view of a stroke", self.cam_from_world, (12,)).reshape(3, 4)
        if not np.allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-6):
            raise BadInput("the view of a stroke is no rotation and place: make the selection again.")
        path = check_array("the path of a stroke", self.path, (None, 2))
        if not (1 if self.radius > 0 else 3) <= len(path) <= MAX_CORNERS or not 0 <= self.radius < np.inf:
            raise BadInput(f"a stroke has {len(path)} places, expected 3 to {MAX_CORNERS} of a polygon, or 1 and a radius: draw it again.")
        if not 0 <= self.tolerance <= 1:
            raise BadInput(f"a tolerance of {self.tolerance:g} came, expected a share of 0 to 1.")
        object.__setattr__(self, "cam_from_world", tuple(float(value) for value in pose.ravel()))
        object.__setattr__(self, "path", tuple((float(u), float(v)) for u, v in path))

    def chosen(self, means: NDArray[Any]) -> NDArray[np.bool_]:
        """Which middles (N,3) lie in its area, in front of what is seen there."""
        from shapely import contains_xy, prepare

        area = _area(self)
        pose = np.array(self.cam_from_world).reshape(3, 4)
        in_camera = means.astype(np.float64) @ pose[:, :3].T + pose[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            places = in_camera[:, :2] / in_camera[:, 2:]
        u_min, v_min, u_max, v_max = area.bounds
        with np.errstate(invalid="ignore"):
            near = np.flatnonzero((in_camera[:, 2] > 0) & ((places >= (u_min, v_min)) & (places <= (u_max, v_max))).all(axis=1))
        prepare(area)
        near = near[contains_xy(area, places[near])]
        if self.front is not None:
            near = near[in_camera[near, 2] <= (1 + self.tolerance) * self.front.at(places[near])]
        chosen = np.zeros(len(means), bool)
        chosen[near] = True
        return chosen


def chosen_by(strokes: Sequence[Stroke], means: NDArray[Any]) -> NDArray[np.bool_]:
    """Which middles (N,3) the strokes choose, one after another."""
    chosen = np.zeros(len(means), bool)
    for stroke in strokes:
        picked = stroke.chosen(means)
        chosen = chosen & ~picked if stroke.takes_away else chosen | picked
    return chosen


def bounds_of(path: FloatArray, radius: float) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a stroke's area."""
    low, high = path.min(axis=0) - radius, path.max(axis=0) + radius
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _area(stroke: Stroke) -> Any:
    from shapely import make_valid
    from shapely.geometry import LineString, Point, Polygon

    if stroke.radius > 0:
        line = Point(stroke.path[0]) if len(stroke.path) == 1 else LineString(stroke.path)
        return line.buffer(stroke.radius)
    # A hand's line may cross itself: both loops are meant.
    return make_valid(Polygon(stroke.path))
