"""What is known of a run's surface, as a layer of maps and 3D views. Read once per view."""

from __future__ import annotations

from pathlib import Path

from radiant_core.frames import Frame
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.ortho_layer import map_picture_layer
from radiant_viewer.layers.palette import VERMILLION, YELLOW

NAME = "What is known"
KNOWN_MAP = "known/known_map.tif"
"""Its file in the folder of a run."""
KNOWN_BLUE, WALL_BLACK = (165, 205, 232), (0, 0, 0)
KINDS = (
    ("known", KNOWN_BLUE),
    ("fewer than 2 views or 2° parallax", YELLOW),
    ("no photograph", VERMILLION),
    ("wall that no photograph shows", WALL_BLACK),
)
"""The kinds of cells and their colours."""


def known_layer(run: Path, frame: Frame, height: float) -> Layer | None:
    """The layer at the `height` of the ground; None where the run has no such map, BadInput where
    that cannot be read or lies elsewhere."""
    legend = tuple(LegendEntry(text=f"{name[0].upper()}{name[1:]}", color=color, marker="area") for name, color in KINDS)
    return map_picture_layer(run / KNOWN_MAP, run, frame, height, Layer(name=NAME, legend=legend))
