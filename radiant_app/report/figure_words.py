"""What commands print of their figures: words and units in place of the keys of `--json`.

    margin_db = 3.47   →   predicted errors, nine of ten cells at most so much worse: 3.47 dB

A key without an entry is printed as its words, with the unit that it ends with. Once per command.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

WORDS: Mapping[str, str] = {
    # Plans.
    "lower_bound_s": "no plan is faster than",
    "refining_s": "then refining",
    "counts": "positions of each edge",
    "cut": "cut by",
    "gantt": "timeline",
    "slack_picture": "picture of slack",
    "planned": "positions planned",
    "makespan_before_s": "makespan before",
    "fewest_moves_proved": "proved to be the fewest moves",
    "moved_list": "list of moved positions",
    "forecast": "forecast of seams",
    "waypoints": "lists of waypoints",
    "methods_left_out": "not compared",
    # What is known of a surface.
    "cells": "cells, east by north",
    "resolution": "side of a cell",
    "surface": "surface of the model",
    "hole_ground": "ground and roofs that no photograph shows",
    "hole_walls": "walls that no photograph shows",
    "weak_ground": "ground and roofs seen too little",
    "weak_walls": "walls seen too little",
    "capture": "faults of the capture",
    "error_cells": "predicted errors, judged in cells",
    "error_photographs": "predicted errors, judged on held-out photographs",
    "rank": "predicted errors, rank correlation with the true ones (1: the same order)",
    "good": "predicted errors, cells at least as good as promised (90 % are meant)",
    "margin_db": "predicted errors, nine of ten cells at most so much worse",
    "take_off": "height of take-off",
    "lists": "flight lists",
    # Scores.
    "psnr_db": "PSNR",
    "ssim": "SSIM",
    "psnr_cc_db": "PSNR after colour correction",
    "ssim_cc": "SSIM after colour correction",
    "flip": "FLIP",
    "flip_reason": "FLIP",
    "lpips": "LPIPS",
    "lpips_reason": "LPIPS",
    "lpips_network": "network of LPIPS",
    "num_gaussians": "Gaussians",
    "num_images": "photographs scored",
    "long_side_px": "long side of the pictures",
    "seconds": "time",
    # Models and their files.
    "gaussians": "Gaussians",
    "num_splats": "Gaussians",
    "model_bytes": "size of the model",
    "num_steps": "steps",
    "num_rolled_back": "steps undone",
    "num_refused": "Gaussians refused by the limit",
    "train_s": "training",
    "retrain_s": "retraining",
    "bytes": "size",
    "left_out": "Gaussians left out",
    "left_out_by_cleaning": "Gaussians left out by the cleaning",
    "left_out_around": "Gaussians left out around the scene",
    "left_out_share_of_pixels": "share of the pixels left out",
    "left_out_file": "file of those left out",
    "undone": "steps undone, which --redo makes again",
    "num_left_out": "Gaussians that the format cannot hold",
    "num_shrunk": "Gaussians made smaller to fit the format",
    "num_grown": "Gaussians made larger to fit the format",
    "num_clamped": "Gaussians of which a value was limited",
    "position_max_error": "largest error of a position",
    "position_max_m": "largest error of a position",
    "log_scale_rms": "RMS error of the logarithms of sizes",
    "sh0_rms": "RMS error of colours",
    "shN_rms": "RMS error of colours by direction",
    "levels": "Gaussians by level of detail",
    "far_field": "Gaussians of the far field",
    "margin_m": "half width of the fitted strip",
    "held_out": "held-out photographs",
    "unplaced": "photographs without a place",
    "places": "places to fly to",
    "open": "to open",
    # Models that are extended.
    "new_photographs": "new photographs",
    "cells_scored": "cells of held-out photographs",
    "cells_better": "of these, better than before",
    "cells_median_db": "median change of these",
    # Maps and surfaces.
    "crs": "coordinate system",
    "seen": "share of cells that photographs show",
    "filled": "share of cells filled in",
    "seen_by_one_photograph": "of these by one photograph only",
    "known": "share of cells with a height",
    "measured": "share of cells measured",
    "sigma": "median standard deviation of heights",
    "lowest": "lowest height",
    "highest": "highest height",
    "no_data": "value of cells without a height",
    "interval": "between contours",
    "ground": "share of points on the ground",
    "offset": "offset",
    "georeference": "files that place it",
    "aligned_by_points": "points that both dates are aligned by",
    "points_followed": "points followed between the dates",
    "left_between_points": "median distance of these points afterwards",
    "height_taken_out": "height taken out",
    "comparable": "share of cells that can be compared",
    "patches": "patches that changed",
    "changed_area": "area that changed",
    # Profiles.
    "measured_steps": "steps measured",
    "largest_count": "photographs of the largest training",
}

OF_POSITIONS: Mapping[str, str] = {"moved": "positions moved", "captured": "positions captured", "lost": "captured positions lost"}
"""Of a plan after another, in place of `WORDS`."""
OF_GAUSSIANS: Mapping[str, str] = {
    name: f"Gaussians {name}" for name in ("moved", "unchanged", "added", "replaced", "filled", "new", "fitted", "kept")
}
"""Of a model made of another."""
_LENGTHS = frozenset(
    {"resolution", "sigma", "lowest", "highest", "interval", "take_off", "left_between_points", "height_taken_out", "margin_m"}
)
_AREAS = frozenset({"surface", "hole_ground", "hole_walls", "weak_ground", "weak_walls", "changed_area"})
_SHARES = frozenset(
    {
        "known",
        "measured",
        "filled",
        "seen",
        "seen_by_one_photograph",
        "ground",
        "comparable",
        "good",
        "cells_better",
        "left_out_share_of_pixels",
    }
)
_ENDINGS = {"_s": " s", "_db": " dB", "_px": " px", "_deg": "°", "_m2": "", "_m": ""}


def figure_lines(result: Mapping[str, Any], words: Mapping[str, str] | None = None) -> Iterator[str]:
    """A line for each figure or sentence of a result; rows, the unit of the others, warnings (which
    were shown as they came) and what was not measured have none. `words` go before `WORDS`."""
    unit, names = str(result.get("unit", "m")), {**WORDS, **(words or {})}
    for key, value in result.items():
        if value is not None and key not in ("unit", "warnings") and not isinstance(value, list | dict):
            for part in value if isinstance(value, tuple) else (value,):
                yield f"{names.get(key) or _plain(key)}: {_text(key, part, unit)}"


def _plain(key: str) -> str:
    for ending in _ENDINGS:
        key = key.removesuffix(ending)
    return key.removeprefix("num_").replace("_", " ")


def _text(key: str, value: Any, unit: str) -> str:
    """A value as people read it, with its unit."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, int | float):
        return str(value)
    # Counts, which are whole, may have the names of shares.
    if key in _SHARES and isinstance(value, float):
        return f"{100 * value:.3g} %"
    if key == "no_data":
        return f"{value:g}"
    if key.endswith("bytes"):
        return f"{value / 1e6:.1f} MB"
    return number_text(value) + _unit_of(key, unit)


def _unit_of(key: str, unit: str) -> str:
    if key in _LENGTHS or key.endswith("_m"):
        return f" {unit}"
    if key in _AREAS or key.endswith("_m2"):
        return f" {unit}²"
    return next((text for ending, text in _ENDINGS.items() if key.endswith(ending)), " s" * (key == "seconds"))


def number_text(value: float) -> str:
    """A count with its thousands; of others tenths, hundredths, or three digits of less than 1."""
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if abs(value) < 1 else f"{value:,.2f}" if abs(value) < 1000 else f"{value:,.1f}"
