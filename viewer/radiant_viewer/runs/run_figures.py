"""Image errors of each held-out photograph, from a run's metrics.json. Once per window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_core.errors import StoreDamaged
from radiant_core.io.run_store import read_json
from radiant_viewer.runs.run_view import METRICS_NAME

ImageFigures = Mapping[str, Mapping[str, float]]
"""Name of a photograph → key of a figure → value."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure of a picture: key in metrics.json, heading with unit, meaning, decimals to show."""

    key: str
    heading: str
    meaning: str
    decimals: int


FIGURES = (
    Figure(key="psnr_db", heading="PSNR (dB)", meaning="Peak signal-to-noise ratio; higher is better", decimals=2),
    Figure(key="ssim", heading="SSIM", meaning="Structural similarity, 1 for the same picture; higher is better", decimals=3),
    Figure(key="flip", heading="FLIP", meaning="Visible difference, 0 for the same picture; lower is better", decimals=3),
    Figure(key="lpips", heading="LPIPS", meaning="Distance of learned features; lower is better", decimals=3),
    Figure(key="psnr_cc_db", heading="PSNR cc (dB)", meaning="PSNR after an affine correction of colour; higher is better", decimals=2),
)


def image_figures(folder: Path) -> ImageFigures:
    """Return the finite figures by photograph, empty before evaluation. StoreDamaged for a broken
    metrics.json."""
    path = folder / METRICS_NAME
    if not path.is_file():
        return {}
    record: Any = read_json(path)
    rows = record.get("images") if isinstance(record, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) and isinstance(row.get("name"), str) for row in rows):
        raise StoreDamaged(f"{path} has no list 'images' of names and figures: run the evaluation again.")
    return {row["name"]: {figure.key: float(row[figure.key]) for figure in FIGURES if _is_number(row.get(figure.key))} for row in rows}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
