"""`Cleaning`: rules by which Gaussians of a model are left out, in the order they were made.

    kept = ∧ over steps of what the step keeps

A step is a rule, not a list of Gaussians: it holds for a model that is trained again, and taking it
back brings everything back. Once per reading of a model and per change; N Gaussians, some 10 ns a
Gaussian and step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.geometry.selection import Stroke, chosen_by
from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS, Support, unconstrained
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

MAX_CORNERS = 10_000
MAX_STEPS = 1_000
MAX_STROKES = 500


@dataclass(frozen=True, kw_only=True)
class PolygonStep:
    """Keep what lies inside a polygon of the map, corners ((x, y), …), and between two heights; or
    what does not. BadInput where the sides cross, or nothing is inside."""

    corners: tuple[tuple[float, float], ...]
    keep: Literal["inside", "outside"] = "inside"
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        from shapely.geometry import Polygon

        corners = check_array("corners of a polygon", self.corners, (None, 2))
        if not 3 <= len(corners) <= MAX_CORNERS:
            raise BadInput(f"a polygon has {len(corners)} corners, expected 3 to {MAX_CORNERS}: click the corners of the ground to keep.")
        polygon = Polygon(corners)
        if not polygon.is_valid or not polygon.area > 0:
            raise BadInput("the sides of the polygon cross, or it has no area: draw its corners in order, around the ground.")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise BadInput(f"heights from {self.low:g} to {self.high:g} hold nothing: give the lower one first.")
        object.__setattr__(self, "corners", tuple((float(x), float(y)) for x, y in corners))


@dataclass(frozen=True, kw_only=True)
class RegionsStep:
    """Keep what lies in the plan's regions and `margin` (model's unit) around them."""

    margin: float = 0.0

    def __post_init__(self) -> None:
        _require(self.margin >= 0, f"a margin of {self.margin:g}", "0 or more")


@dataclass(frozen=True, kw_only=True)
class SupportStep:
    """Keep what so many photographs show from directions so far apart, and the background around
    the scene (`geometry.support`)."""

    num_views: int = MIN_VIEWS
    parallax_deg: float = MIN_PARALLAX_DEG

    def __post_init__(self) -> None:
        _require(self.num_views >= 1, f"{self.num_views} photographs", "1 or more")
        _require(0 <= self.parallax_deg <= 180, f"an angle of {self.parallax_deg:g}°", "0° to 180°")


@dataclass(frozen=True, kw_only=True)
class OpacityStep:
    """Keep Gaussians of this opacity (0 to 1) and more."""

    at_least: float

    def __post_init__(self) -> None:
        _require(0 < self.at_least < 1, f"an opacity of {self.at_least:g}", "more than 0 and less than 1")


@dataclass(frozen=True, kw_only=True)
class SizeStep:
    """Keep Gaussians whose longest standard deviation is at most this, in the model's unit."""

    at_most: float

    def __post_init__(self) -> None:
        _require(self.at_most > 0, f"a size of {self.at_most:g}", "more than 0")


@dataclass(frozen=True, kw_only=True)
class SelectionStep:
    """Leave out what strokes in views chose (`geometry.selection`), or keep only that. BadInput
    without a stroke, or for more than `MAX_STROKES`."""

    strokes: tuple[Stroke, ...]
    keep: Literal["inside", "outside"] = "outside"

    def __post_init__(self) -> None:
        _require(1 <= len(self.strokes) <= MAX_STROKES, f"a selection of {len(self.strokes)} strokes", f"1 to {MAX_STROKES}")


CleaningStep = PolygonStep | RegionsStep | SupportStep | OpacityStep | SizeStep | SelectionStep


@dataclass(frozen=True, kw_only=True)
class Cleaning:
    """The steps that hold, and those taken back, of which the last is the next to be made again.
    BadInput for more than `MAX_STEPS`."""

    steps: tuple[CleaningStep, ...] = ()
    undone: tuple[CleaningStep, ...] = ()

    def __post_init__(self) -> None:
        if len(self.steps) + len(self.undone) > MAX_STEPS:
            raise BadInput(f"a cleaning of more than {MAX_STEPS} steps: begin anew.")

    def add(self, *steps: CleaningStep) -> Cleaning:
        """With further steps; what was taken back is gone."""
        return Cleaning(steps=(*self.steps, *steps))

    def undo(self, count: int = 1) -> Cleaning:
        """Without the last `count` steps."""
        cut = max(0, len(self.steps) - count)
        return Cleaning(steps=self.steps[:cut], undone=(*self.undone, *reversed(self.steps[cut:])))

    def redo(self) -> Cleaning:
        """With the step that was taken back last."""
        return Cleaning(steps=(*self.steps, *self.undone[-1:]), undone=self.undone[:-1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Surroundings:
    """What steps need beyond the model: the plan's regions, each (V,2); sparse points (P,3); and
    the support of the whole model, measured or read when a step asks for it (BadInput if it cannot
    be)."""

    regions: tuple[FloatArray, ...] = ()
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    support: Callable[[], Support] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Cleaned:
    """kept (N,) of the whole model; removed: by each step, beyond the steps before it."""

    kept: NDArray[np.bool_]
    removed: tuple[int, ...]

    @property
    def num_left_out(self) -> int:
        """Gaussians that are left out."""
        return int((~self.kept).sum())


def clean(splats: Splats, cleaning: Cleaning, around: Surroundings = Surroundings()) -> Cleaned:
    """Apply all steps; BadInput where a step needs what is not there."""
    keep_mask, removed = np.ones(len(splats), bool), []
    for step in cleaning.steps:
        before = int(keep_mask.sum())
        keep_mask &= keeps(step, splats, around)
        removed.append(before - int(keep_mask.sum()))
    return Cleaned(kept=keep_mask, removed=tuple(removed))


def keeps(step: CleaningStep, splats: Splats, around: Surroundings = Surroundings()) -> NDArray[np.bool_]:
    """Which Gaussians (N,) one step keeps; BadInput as `clean`."""
    if isinstance(step, PolygonStep):
        return _polygon_keeps(step, splats.means)
    if isinstance(step, RegionsStep):
        return _regions_keep(step, splats.means, around.regions)
    if isinstance(step, SupportStep):
        return _support_keeps(step, splats, around)
    if isinstance(step, SelectionStep):
        return chosen_by(step.strokes, splats.means) == (step.keep == "inside")
    if isinstance(step, OpacityStep):
        # Compared as stored: no rounding of the logistic function decides.
        return splats.logit_opacities.astype(np.float64) >= np.log(step.at_least / (1 - step.at_least))
    return splats.log_scales.max(axis=1, initial=-np.inf).astype(np.float64) <= np.log(step.at_most)


def keeps_places(cleaning: Cleaning, places: FloatArray, regions: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    """Which places (N,3) the polygons and regions of a cleaning keep; its other steps are about
    Gaussians. Raises BadInput as `clean`."""
    keep_mask = np.ones(len(places), bool)
    for step in cleaning.steps:
        if isinstance(step, PolygonStep):
            keep_mask &= _polygon_keeps(step, places)
        elif isinstance(step, RegionsStep):
            keep_mask &= _regions_keep(step, places, regions)
    return keep_mask


def keeps_land(cleaning: Cleaning, places: FloatArray, regions: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    """On which land (N,2) something may be left at some height; BadInput as `clean`."""
    keep_mask = np.ones(len(places), bool)
    for step in cleaning.steps:
        if isinstance(step, PolygonStep):
            has_heights = step.low is not None or step.high is not None
            # What lies outside of the heights of a polygon that is taken out stays.
            keep_mask &= True if step.keep == "outside" and has_heights else _within(_polygon(step), places) == (step.keep == "inside")
        elif isinstance(step, RegionsStep):
            keep_mask &= _regions_keep(step, places, regions)
    return keep_mask


def describe(step: CleaningStep, unit: str) -> str:
    """What a step does, in a few words."""
    if isinstance(step, PolygonStep):
        heights = "" if step.low is None and step.high is None else f", heights {_number(step.low)} to {_number(step.high)} {unit}"
        return f"{step.keep} of a polygon of {len(step.corners)} corners{heights}"
    if isinstance(step, RegionsStep):
        return f"regions and {step.margin:g} {unit} around them"
    if isinstance(step, SupportStep):
        return f"seen by {step.num_views} photographs, {step.parallax_deg:g}° apart"
    if isinstance(step, SelectionStep):
        strokes = "a stroke" if len(step.strokes) == 1 else f"{len(step.strokes)} strokes"
        return f"{'only' if step.keep == 'inside' else 'all but'} what {strokes} in the 3D view chose"
    if isinstance(step, OpacityStep):
        return f"opacity {step.at_least:g} or more"
    return f"at most {step.at_most:g} {unit} wide"


def box_step(box: FloatArray) -> PolygonStep:
    """The inside of a box, lower and upper corner (2,3); BadInput where it has no volume."""
    if not (np.diff(box, axis=0) > 0).all():
        raise BadInput("the crop box holds no Gaussian: make it larger.")
    (west, south, low), (east, north, high) = np.asarray(box, np.float64).tolist()
    return PolygonStep(corners=((west, south), (east, south), (east, north), (west, north)), low=low, high=high)


def _polygon_keeps(step: PolygonStep, places: NDArray[Any]) -> NDArray[np.bool_]:
    inside = _within(_polygon(step), places)
    heights = places[:, 2].astype(np.float64)
    if step.low is not None:
        inside &= heights >= step.low
    if step.high is not None:
        inside &= heights <= step.high
    return inside if step.keep == "inside" else ~inside


def _polygon(step: PolygonStep) -> Any:
    from shapely.geometry import Polygon

    return Polygon(step.corners)


def _regions_keep(step: RegionsStep, places: NDArray[Any], regions: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    from shapely import union_all
    from shapely.geometry import Polygon

    polygons = [Polygon(region) for region in regions if len(region) >= 3]
    if not polygons:
        raise BadInput("there are no regions to keep: this model was made without a plan; use a polygon instead.")
    return _within(union_all([polygon.buffer(step.margin) for polygon in polygons]), places)


def _support_keeps(step: SupportStep, splats: Splats, around: Surroundings) -> NDArray[np.bool_]:
    if around.support is None:
        raise BadInput("how many photographs support a Gaussian is not known: a model alone has no cameras; leave that step out.")
    support = around.support()
    if len(support) != len(splats):
        raise BadInput(f"the support is of {len(support):,} Gaussians, and the model has {len(splats):,}: measure it again.")
    return ~unconstrained(splats, support, around.points, step.num_views, step.parallax_deg)


def _within(shape: Any, places: NDArray[Any]) -> NDArray[np.bool_]:
    """Which places (N,2 or more) lie inside of a shape."""
    from shapely import contains_xy, prepare

    prepare(shape)
    places = places[:, :2].astype(np.float64)
    west, south, east, north = shape.bounds
    near = ((places >= (west, south)) & (places <= (east, north))).all(axis=1)
    inside = np.zeros(len(places), bool)
    inside[near] = contains_xy(shape, places[near])
    return inside


def _number(value: float | None) -> str:
    return "any" if value is None else f"{value:g}"


def _require(fits: bool, rule: str, expected: str) -> None:
    if not fits:
        raise BadInput(f"{rule} is no rule of a cleaning: expected {expected}.")
