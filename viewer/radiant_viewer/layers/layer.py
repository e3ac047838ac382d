"""`Layer`: one thing to draw, in plain numbers, the same in window, pictures, report and tests.

A layer is independent of toolkits: points, segments and polygons in world coordinates (float64,
metres or the frame's unit, z up), colours (…,3) uint8, labels and legend. Built once per picture or
edit; N points, S segments, R polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_viewer.layers.palette import ColorArray

CLOUD_SIZE = 100
"""Least number of points of a cloud; fewer are markers, such as cameras and sites."""
REACH_POINTS = 200_000
"""Larger clouds are subsampled for their extent."""
MARGIN = 0.25
"""Margin around borders and markers in which clouds count for a frame, over their longest side."""
STRAYS = 0.005
"""Share of strays at each end of x and y: in the town 0.3 % of them doubled a picture's width."""
Marker = Literal["area", "line", "dot", "ring", "square"]
"""How a legend shows an entry: a box, a stroke, a dot, a dot or small square with a dark rim."""


@dataclass(frozen=True, kw_only=True)
class LegendEntry:
    """One line of the legend; the text has the unit of every figure."""

    text: str
    color: tuple[int, int, int]
    marker: Marker


@dataclass(frozen=True, kw_only=True)
class HeatScale:
    """A colour bar from `low` to `high`; the label names quantity and unit."""

    label: str
    low: float
    high: float
    start: float = 0.0
    """Share of the colour table at the lowest value: on dark ground the first colours vanish."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Label:
    """A text at a place (3,) of the world; strong ones are bold and placed first."""

    text: str
    position: FloatArray
    strong: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class LayerPicture:
    """image (H,W,4) uint8, rows downwards, and where its corners lie (4,3): upper left, upper
    right, lower right, lower left."""

    image: NDArray[np.uint8]
    corners: FloatArray

    def __post_init__(self) -> None:
        check_array("the picture of a layer", self.image, (None, None, 4), np.uint8)
        object.__setattr__(self, "corners", check_array("the corners of a layer's picture", self.corners, (4, 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """points (N,3), segments (S,2,3) and polygons R × (V,3), each with one colour; later layers lie
    over earlier ones on a map. Raises BadInput when a shape is wrong, colours do not match in
    number, or a coordinate is not finite."""

    name: str
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    point_colors: ColorArray = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    point_size_px: float = 3.0
    point_rim: bool = False
    """Whether each point has a dark rim, which sets off light colours; labels avoid such points."""
    square_points: bool = False
    """Whether points and rims are square instead of round."""
    ring_points: bool = False
    """Whether points are rings about their place: told by their shape from what they mark, which
    stays visible inside."""
    in_front: bool = False
    """Whether a 3D view draws it in front of everything, as borders below a model need."""
    behind: bool = False
    """Whether a 3D view draws it slightly farther away, so that a mark at the same place covers its
    middle."""
    segments: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    segment_colors: ColorArray = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    line_width_px: float = 1.5
    polygons: tuple[FloatArray, ...] = ()
    polygon_colors: ColorArray = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    pale_fills: bool = False
    """Whether fills are mixed with white, in a dark theme with its ground; other fills are data."""
    picture: LayerPicture | None = None
    """Drawn on maps alone, below the rest of the layer."""
    labels: tuple[Label, ...] = ()
    legend: tuple[LegendEntry, ...] = ()
    heat: HeatScale | None = None

    def __post_init__(self) -> None:
        points = check_array(f"points of layer {self.name!r}", self.points, (None, 3))
        segments = check_array(f"segments of layer {self.name!r}", self.segments, (None, 2, 3))
        polygons = tuple(check_array(f"a polygon of layer {self.name!r}", polygon, (None, 3)) for polygon in self.polygons)
        for name, positions in (("points", points), ("segments", segments), ("polygons", polygons)):
            object.__setattr__(self, name, positions)
            self._set_colors(f"{name[:-1]}_colors", len(positions))
        for label in self.labels:
            check_array(f"the place of label {label.text!r}", label.position, (3,))

    def _set_colors(self, name: str, count: int) -> None:
        object.__setattr__(self, name, check_array(f"{name} of layer {self.name!r}", getattr(self, name), (count, 3), np.uint8))


def framing_positions(layers: Sequence[Layer]) -> FloatArray:
    """Return the positions (K,3) that a picture must hold: ends, corners, markers, and the points
    of clouds near those. Clouds (of 100 points or more) hold strays, far ground and a sky; without
    anything else they count as far as Tukey's outer fence. Raises BadInput without any geometry."""
    # A subsample of ten million points gives the extent in a fiftieth of the time.
    clouds = [layer.points[:: 1 + len(layer.points) // REACH_POINTS] for layer in layers if len(layer.points) >= CLOUD_SIZE]
    markers = [layer.points for layer in layers if len(layer.points) < CLOUD_SIZE]
    lines = [part for layer in layers for part in (layer.segments.reshape(-1, 3), *layer.polygons)]
    lines += [layer.picture.corners for layer in layers if layer.picture is not None]
    firm = np.concatenate([np.zeros((0, 3)), *markers, *lines])
    cloud = np.concatenate([np.zeros((0, 3)), *clouds])
    if not len(firm) + len(cloud):
        raise BadInput("there is nothing to draw: the layers hold no points, segments or polygons.")
    if not len(cloud):
        return firm
    if len(firm):
        low, high = firm.min(axis=0), firm.max(axis=0)
        reach = MARGIN * (high - low).max()
    else:
        low, high = np.quantile(cloud, [0.25, 0.75], axis=0)
        reach = 3 * (high - low).max()
    # Equally wide on all axes, so that towers on flat ground stay.
    near = cloud[((cloud >= low - reach) & (cloud <= high + reach)).all(axis=1)]
    if not len(near):
        return firm
    # Not upwards: a single tower is no stray.
    low, high = np.quantile(near[:, :2], [STRAYS, 1 - STRAYS], axis=0)
    return np.concatenate([firm, near[((near[:, :2] >= low) & (near[:, :2] <= high)).all(axis=1)]])


def outline_segments(polygons: Sequence[NDArray[np.float64]]) -> FloatArray:
    """Return the sides (S,2,3) of closed polygons (V,3), in order."""
    sides = [np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1) for polygon in polygons if len(polygon)]
    return np.concatenate(sides) if sides else np.zeros((0, 2, 3))


def at_height(polygon: NDArray[np.float64], height: float) -> FloatArray:
    """Lift a polygon (V,2) of the map to one height, (V,3)."""
    return np.column_stack([polygon, np.full(len(polygon), height)])
