"""What `radiant plan` says of footprints before capture: its borders' forecast, buffer captures.

Waypoints have an altitude, but not the ground's: it is 0 unless given, as for heights above
take-off. Where the altitudes cannot be heights above that ground nothing is forecast, with the
reason. A scene has its cameras' poses and sparse points instead.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.plan_content import content_record
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.buffers import BufferRule, EdgeBuffer, plan_buffers
from radiant_core.plan.borders.footprints import Optics, Views, ground_footprints, region_shares, views_before_capture, views_of_cameras
from radiant_core.plan.borders.forecast import BorderForecast, forecast_borders
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene

MAX_IMAGES = 2_000_000
_SHARE, _METRES = re.compile(r"(\d+(?:\.\d+)?)\s*%"), re.compile(r"(\d+(?:\.\d+)?)\s*m")


@dataclass(frozen=True, kw_only=True)
class ContentRequest:
    """What is known of cameras and ground, and which buffer captures are wanted."""

    ground_m: float | None = None
    """Altitude of the ground where the waypoints' altitudes count from; None: 0."""
    optics: Optics = field(default_factory=Optics)
    buffer: BufferRule | None = None

    def __post_init__(self) -> None:
        if self.ground_m is not None and not np.isfinite(self.ground_m):
            raise BadInput(f"--ground is {self.ground_m}, expected an altitude in metres.")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanContent:
    """Forecasts, buffers, and what was assumed or why there is no forecast."""

    forecasts: tuple[BorderForecast, ...] = ()
    buffers: tuple[EdgeBuffer, ...] = ()
    assumed: str = ""
    reason: str | None = None
    """Why nothing was forecast, a whole sentence."""

    def record(self) -> dict[str, Any]:
        """For plan.json; empty where nothing was forecast or buffered."""
        if self.reason is not None and not self.buffers:
            return {}
        return content_record(self.forecasts, self.buffers, self.assumed)

    def summary(self) -> dict[str, Any]:
        """What the command line prints: one line of text a key, and the borders as rows."""
        borders = {risk: sum(forecast.risk == risk for forecast in self.forecasts) for risk in ("low", "medium", "high")}
        figures: dict[str, Any] = {"forecast": self.reason or f"{_risks_text(borders)}; {self.assumed}"}
        if self.buffers:
            figures["buffers"] = _buffers_text(self.buffers)
        if self.forecasts:
            figures["borders"] = [_row(forecast) for forecast in self.forecasts]
        return figures


def buffer_rule(text: str | None, deadline_s: float | None) -> BufferRule | None:
    """`--buffer` as a rule: "20%" of the footprint, or "15m" from the region; else BadInput."""
    if text is None:
        if deadline_s is not None:
            raise BadInput("--deadline bounds buffer captures: give --buffer as well, such as 20% or 15m.")
        return None
    share, metres = _SHARE.fullmatch(text.strip()), _METRES.fullmatch(text.strip())
    if share is not None:
        return BufferRule(min_share=float(share[1]) / 100, deadline_s=deadline_s)
    if metres is not None:
        return BufferRule(within_m=float(metres[1]), deadline_s=deadline_s)
    raise BadInput(f"--buffer is {text!r}: give a least share of the footprint such as 20%, or a distance such as 15m.")


def content_request(
    ground_m: float | None, field_of_view_deg: float | None, buffer: str | None, deadline_s: float | None
) -> ContentRequest:
    """What the command line was asked for; BadInput where an option is none."""
    optics = Optics() if field_of_view_deg is None else Optics(field_of_view_deg=field_of_view_deg)
    return ContentRequest(ground_m=ground_m, optics=optics, buffer=buffer_rule(buffer, deadline_s))


def content_of_waypoints(
    waypoints: Waypoints, cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, request: ContentRequest
) -> PlanContent:
    """Forecasts and buffers of a plan of waypoints; system as planned."""
    positions, heights_m = waypoints.positions_m[:, :2], _forecast_heights(waypoints)
    if isinstance(heights_m, str):
        return PlanContent(buffers=_near_buffers(positions, cloud, edges, system, request, heights_m), reason=heights_m)
    looks = waypoints.heading_pitch_deg
    views = views_before_capture(positions, heights_m, request.optics, looks)
    aimed = "straight down" if looks is None else "as the flight plan says, else straight down"
    lens = f"{request.optics.field_of_view_deg:.4g}° across images of {1 / request.optics.aspect:.3g} : 1"
    assumed = f"assumed: ground at {waypoints.ground_m or 0.0:g} m, cameras {aimed}, {lens}"
    return _content(views, cloud, edges, system, request, assumed)


def content_of_scene(scene: SfmScene, cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, request: ContentRequest) -> PlanContent:
    """Forecasts and buffers of posed cameras over the median height of their sparse points.
    BadInput for buffers in metres of a scene that has none."""
    if request.buffer is not None and request.buffer.within_m is not None and scene.frame.kind == "unscaled":
        raise BadInput(
            f"--buffer {request.buffer.within_m:g}m is in metres, and the scene has no scale: give a share of the footprint such as 20%."
        )
    if not len(scene.points):
        return PlanContent(reason="not made, for the scene has no points to estimate the ground from.")
    ground_m = float(np.median(scene.points[:, 2])) if request.ground_m is None else request.ground_m
    views = views_of_cameras(scene.cameras, ground_m)
    return _content(views, cloud, edges, system, request, f"cameras as posed, ground at {ground_m:.3g} {scene.frame.unit}")


def border_table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows of the forecast, aligned, the weakest borders first; thirty at most."""
    order = {"high": 0, "medium": 1, "low": 2}
    listed = sorted(rows, key=lambda row: (order[row["risk"]], row["support"]))[:30]
    width = max(len("border"), *(len(row["border"]) for row in listed))
    head = f"{'border':<{width}}  {'risk':<6} {'images a side':>13} {'per spot':>8} {'of interior':>11} {'forward':>7} {'side':>5}"
    lines = [
        f"{row['border']:<{width}}  {row['risk']:<6} {row['num_images'][0]:>6} {row['num_images'][1]:>6} {row['support']:>8.1f} "
        f"{row['coverage']:>11.0%} {_percent(row['forward_overlap']):>7} {_percent(row['side_overlap']):>5}"
        for row in listed
    ]
    more = [f"… and {len(rows) - len(listed)} more in the plan"] if len(rows) > len(listed) else []
    return "\n".join([head, *lines, *more])


def _content(
    views: Views, cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, request: ContentRequest, assumed: str
) -> PlanContent:
    footprints = ground_footprints(views)
    buffers: tuple[EdgeBuffer, ...] = ()
    if request.buffer is not None:
        shares = region_shares(footprints, cloud.borders) if request.buffer.min_share is not None else None
        buffers = plan_buffers(views.positions, shares, cloud, edges, system, request.buffer)
    forecasts = forecast_borders(cloud, views, footprints, buffers=buffers)
    return PlanContent(forecasts=forecasts, buffers=buffers, assumed=assumed)


def _near_buffers(
    positions: Any, cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, request: ContentRequest, reason: str
) -> tuple[EdgeBuffer, ...]:
    if request.buffer is None:
        return ()
    if request.buffer.min_share is not None:
        raise BadInput(f"buffer captures by what they see cannot be planned: the forecast was {reason}")
    return plan_buffers(positions, None, cloud, edges, system, request.buffer)


def _forecast_heights(waypoints: Waypoints) -> FloatArray | str:
    if len(waypoints) > MAX_IMAGES:
        return f"not made, for {len(waypoints)} positions are more than {MAX_IMAGES}."
    heights_m = waypoints.heights_m
    if heights_m is None and not waypoints.altitude_known:
        return "not made, for no position has an altitude."
    if heights_m is None:
        kind = "are" if waypoints.absolute else "look like"
        high = waypoints.lat_lon_alt[:, 2].max()
        return f"not made, for altitudes up to {high:.0f} m {kind} heights above the sea: give the ground's altitude with --ground."
    if np.isnan(heights_m).any():
        return f"not made, for {int(np.isnan(heights_m).sum())} of {len(waypoints)} positions have no height above take-off: give --height."
    if heights_m.min() <= 0:
        return f"not made, for the lowest position is {-heights_m.min():.3g} m below the ground or on it: give its altitude with --ground."
    return heights_m


def _row(forecast: BorderForecast) -> dict[str, Any]:
    return {
        "border": " | ".join(forecast.edge_ids),
        "risk": forecast.risk,
        "num_images": list(forecast.num_images),
        "support": min(forecast.support),
        "coverage": forecast.coverage,
        "forward_overlap": forecast.forward_overlap,
        "side_overlap": forecast.side_overlap,
    }


def _risks_text(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    if not total:
        return "no border"
    return f"{total} border{'s' if total > 1 else ''}, risk " + ", ".join(f"{risk} {count}" for risk, count in counts.items() if count)


def _buffers_text(buffers: Sequence[EdgeBuffer]) -> str:
    planned_s, now_s = max(buffer.planned_edge_time_s for buffer in buffers), max(buffer.edge_time_s for buffer in buffers)
    device_texts = ", ".join(
        f"{buffer.edge_id} {len(buffer.camera_indices)} (+{buffer.edge_time_s - buffer.planned_edge_time_s:.1f} s"
        + (f", {buffer.num_refused} did not fit)" if buffer.num_refused else ")")
        if buffer.device_ids
        else f"{buffer.edge_id} none, it deals its own"
        for buffer in buffers
    )
    return f"{device_texts}; makespan {planned_s:.1f} s becomes {now_s:.1f} s"


def _percent(share: float | None) -> str:
    return "none" if share is None else f"{share:.0%}"
