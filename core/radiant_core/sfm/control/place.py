"""The scene of a model that was adjusted to a survey: it is in place already. Once per scene."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from radiant_core.frames import Sim3
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.photos.listing import Photograph
from radiant_core.sfm.control.against_gps import against_gps
from radiant_core.sfm.control.quality import Summary
from radiant_core.sfm.control.survey import Surveyed
from radiant_core.sfm.world_frame.contradictions import settle
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import PlacedScene, cameras_of, move_scene

STAY = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


def place_surveyed(model: ColmapModel, surveyed: Surveyed, photographs: tuple[Photograph, ...], placement: Placement) -> PlacedScene:
    """The scene of the undistorted model, moved by nothing. BadInput where a list contradicts the
    photographs' GPS and that is to stop the work."""
    scene = move_scene(model, cameras_of(model), STAY, surveyed.frame)
    against: tuple[str, ...] = ()
    if placement.control is not None and surveyed.control is not None:
        against = settle(against_gps(scene.cameras, scene.frame, photographs, placement.control), placement.contradictions)
    return PlacedScene(
        scene=scene,
        world_from_model=STAY,
        decisions=(surveyed.decision(),),
        warnings=(*surveyed.warnings, *against),
        doubts=(*surveyed.doubts, *against),
    )


def survey_record(surveyed: Surveyed) -> dict[str, Any]:
    """What the report and metrics.json say of it, as plain values: metres, east north up."""
    return {
        "system": surveyed.system,
        "tie_sigma_px": surveyed.tie_sigma_px,
        "mark_sigma_px": surveyed.mark_sigma_px,
        "num_positions": surveyed.num_positions,
        "num_positions_counting": surveyed.num_positions_counting,
        "positions_rms_m": surveyed.positions_rms_m,
        "positions_shift_m": list(surveyed.shift_m),
        "scale_sigma": surveyed.scale_sigma,
        "control": _summary(surveyed.control),
        "check": _summary(surveyed.check),
        "points": [
            {**asdict(point), "residual_m": list(point.residual_m), "expected_m": list(point.expected_m)} for point in surveyed.points
        ],
    }


def _summary(summary: Summary | None) -> dict[str, Any] | None:
    if summary is None:
        return None
    return {
        "num_points": summary.num_points,
        "num_counting": summary.num_counting,
        "rms_m": list(summary.rms_m),
        "expected_m": list(summary.expected_m),
        "rms_axis_m": summary.rms_axis_m,
        "expected_axis_m": summary.expected_axis_m,
    }
