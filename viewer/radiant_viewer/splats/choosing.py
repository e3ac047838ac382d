"""Which painter draws the model of a main view: a measured `Decision`, once when it is opened.

Ours draws at first. Where there is a graphics card, VTK's Gaussians and then Open3D's scene are
measured beside it, each in a process of its own (`measuring`), and the first draws on that is
faster and shows the same picture at the same depths, by which layers are hidden. Without a card
ours stays, and VTK's is measured only for who asks.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from radiant_core.choices import Painter
from radiant_core.decisions import Decision

LEAST_DB = 40.0
"""PSNR of a painter's picture against ours: differences of 1 % are not seen."""
MAX_DEPTH_ERROR = 0.01
"""Of the distance: half a metre at 50 m, from where a camera at a wall would be hidden wrongly."""
PAINTERS: Mapping[Painter, str] = {"radiant": "our renderer", "vtk": "VTK's Gaussians", "open3d": "Open3D's scene"}
OTHERS: tuple[Painter, ...] = ("vtk", "open3d")
"""In the order in which they are measured."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Two pictures of 640 × 400 px by our renderer and by another painter: mean time, and the worse
    of the differences."""

    backend: str
    ours_s: float
    other_s: float
    psnr_db: float
    depth_error: float
    """What nine in ten depths differ by at most, as a share of the distance."""


def has_graphics_card() -> bool:
    """Whether a device that draws is there, as far as the system tells."""
    if sys.platform != "linux":
        return True
    return Path("/dev/nvidia0").exists() or any(Path("/dev/dri").glob("renderD*"))


def choose_painter(rival: Painter, measured: Measured | str, *, has_card: bool) -> tuple[Painter, Decision]:
    """Ours or another painter, by what was measured of both, or by why nothing was."""
    name = PAINTERS[rival]
    if isinstance(measured, str):
        return "radiant", _decision("our renderer", None, f"{_without_card(has_card)}{name} drew nothing: {measured}")
    figures = f"{name}: {measured.other_s:.3f} s, {measured.psnr_db:.1f} dB from ours"
    is_same = measured.psnr_db >= LEAST_DB and measured.depth_error <= MAX_DEPTH_ERROR
    if has_card and is_same and measured.other_s < measured.ours_s:
        reason = f"our renderer ({measured.backend}) takes {measured.ours_s:.3f} s; {figures}, depths within {_share(measured.depth_error)}"
        return rival, _decision(name, measured.other_s, reason)
    if measured.psnr_db < LEAST_DB:
        fault = f", and {LEAST_DB:.0f} dB are needed"
    elif measured.depth_error > MAX_DEPTH_ERROR:
        fault = f", but depths are off by up to {_share(measured.depth_error)} of the distance, and layers are hidden by depth"
    else:
        fault = ""
    return "radiant", _decision(f"our renderer ({measured.backend})", measured.ours_s, f"{_without_card(has_card)}{figures}{fault}")


def forced_painter(painter: Painter) -> Decision:
    """The decision of who asked for a painter."""
    return _decision(PAINTERS[painter], None, f"--painter {painter} asks for it", forced=True)


def _decision(choice: str, seconds: float | None, reason: str, *, forced: bool = False) -> Decision:
    return Decision(
        stage="view",
        topic="painter",
        choice=choice,
        figure=None if seconds is None else round(seconds, 4),
        unit="s a picture of 640 × 400",
        reason=reason,
        otherwise="--painter",
        forced=forced,
    )


def _without_card(has_card: bool) -> str:
    return "" if has_card else "there is no graphics card; "


def _share(error: float) -> str:
    return f"{100 * error:.1f} %" if error < 1 else "100 %"
