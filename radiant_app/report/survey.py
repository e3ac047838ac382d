"""What was surveyed, in one line: photographs, ground, resolution, date, frame. Once per report.

The ground is what two or more photographs show where structure from motion placed points, counted
in cells of 1/`CELLS` of the scene's longer side. The ground sampling distance of a photograph is
the median depth of the points that it shows, over its focal length in pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.evaluate.observed_ground import observed_coverage
from radiant_core.frames import Frame
from radiant_core.io.photos.listing import photograph_exposures
from radiant_core.map_projection import utm_epsg
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

CELLS = 80
REACH_CELLS = 2.0
"""So near must points lie to a cell that was observed."""
MIN_SHARE_OF_RANGE = 0.02
"""At either end this share of the points does not count: haze far beside the scene."""
MAX_DATED = 500
"""Of more photographs, evenly chosen ones are asked for their date."""


@dataclass(frozen=True, kw_only=True)
class Survey:
    """Facts of a survey; None where one is not known."""

    num_placed: int
    num_left_out: int
    frame: Frame
    area_m2: float | None = None
    gsd_m: float | None = None
    """Median ground sampling distance of the photographs, at the size they are trained from."""
    dates: tuple[str, str] | None = None
    """First and last day, by the clocks of the cameras."""
    epsg: int | None = None
    num_positions: tuple[int, int] | None = None
    """GPS positions that count, of all."""

    @property
    def line(self) -> str:
        """All that is known, as one sentence."""
        num_photographs = self.num_placed + self.num_left_out
        count = f"{self.num_placed} photographs" if not self.num_left_out else f"{self.num_placed} of {num_photographs} photographs"
        facts = [count + (f" of {area_text(self.area_m2)}" if self.area_m2 is not None else "")]
        if self.gsd_m is not None:
            facts.append(f"ground sampling distance {length_text(self.gsd_m)}")
        if self.dates is not None:
            first, last = self.dates
            facts.append(f"taken on {first}" if first == last else f"taken from {first} to {last}")
        return f"{', '.join([*facts, self._place()])}."

    def _place(self) -> str:
        if self.frame.kind == "unscaled":
            return "without scale or place: lengths are in units of their own"
        if self.frame.kind == "scaled":
            return "in metres by a known length, without a place on the globe"
        latitude, longitude = self.frame.origin_lat_lon_alt[:2]
        place = f"at {abs(latitude):.5f}° {'N' if latitude >= 0 else 'S'} {abs(longitude):.5f}° {'E' if longitude >= 0 else 'W'}"
        crs = "" if self.epsg is None else f" (WGS 84, exported in EPSG:{self.epsg})"
        residual_m = self.frame.residual_m
        if residual_m is None:
            return place + crs
        counting = "" if self.num_positions is None else f", of which {self.num_positions[0]} of {self.num_positions[1]} positions count"
        return f"{place}{crs}, cameras within {residual_m:.2f} m of GPS (median){counting}"


def survey_of(scene: SfmScene, num_left_out: int, photographs: Path | None, positions: Mapping[str, Any] | None = None) -> Survey:
    """Find the facts of a scene; `photographs`: their folder, None where they lie on devices;
    `positions`: the record of those of GPS that count."""
    metres = scene.frame.kind != "unscaled"
    return Survey(
        num_placed=len(scene.cameras),
        num_left_out=num_left_out,
        frame=scene.frame,
        area_m2=observed_area(scene) if metres else None,
        gsd_m=sampling_distance(scene) if metres else None,
        dates=None if photographs is None else _dates(photographs, scene.cameras.names),
        epsg=_epsg(scene.frame),
        num_positions=None if positions is None else (positions["num_counting"], positions["num_positions"]),
    )


def observed_area(scene: SfmScene) -> float | None:
    """Area of the observed ground in square units of the frame; None without points."""
    if len(scene.points) < len(scene.cameras):
        return None
    low, high = np.quantile(scene.points[:, :2], [MIN_SHARE_OF_RANGE, 1 - MIN_SHARE_OF_RANGE], axis=0)
    cell = float((high - low).max()) / CELLS
    if not cell > 0:
        return None
    axes = [np.arange(start + cell / 2, stop, cell) for start, stop in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return float((observed_coverage(places, scene, REACH_CELLS * cell) > 0).sum()) * cell**2


def sampling_distance(scene: SfmScene) -> float | None:
    """Median ground sampling distance in units per pixel; None without observed points."""
    if not len(scene.observations):
        return None
    points, views = scene.observations.T
    poses = scene.cameras.cam_from_world
    depths: FloatArray = np.einsum("ti,ti->t", poses[views, 2, :3], scene.points[points]) + poses[views, 2, 3]
    distances = [float(np.median(depths[views == view])) / scene.cameras.Ks[view, 0, 0] for view in np.unique(views)]
    return float(np.median(distances))


def _dates(folder: Path, names: tuple[str, ...]) -> tuple[str, str] | None:
    chosen = [names[int(index)] for index in np.linspace(0, len(names) - 1, min(len(names), MAX_DATED)).round()]
    taken_s = []
    for name in chosen:
        try:
            seconds, _ = photograph_exposures(folder / name)
        except (OSError, BadInput):
            continue
        if seconds is not None:
            taken_s.append(seconds)
    if not taken_s:
        return None
    first, last = (datetime.fromtimestamp(seconds, UTC).date().isoformat() for seconds in (min(taken_s), max(taken_s)))
    return first, last


def _epsg(frame: Frame) -> int | None:
    if frame.kind != "metric":
        return None
    try:
        return utm_epsg(float(frame.origin_lat_lon_alt[0]), float(frame.origin_lat_lon_alt[1]))
    except BadInput:
        return None


def area_text(square_metres: float) -> str:
    """An area for a person: 850 m², 1.8 ha, 12 km²."""
    if square_metres < 10_000:
        return f"{square_metres:,.0f} m²"
    return f"{square_metres / 1e4:.1f} ha" if square_metres < 1e6 else f"{square_metres / 1e6:.1f} km²"


def length_text(metres: float) -> str:
    """A small length for a person: 4.1 mm, 3.5 cm, 1.20 m."""
    if metres < 0.01:
        return f"{metres * 1000:.1f} mm"
    return f"{metres * 100:.1f} cm" if metres < 1 else f"{metres:.2f} m"
