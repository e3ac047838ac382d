"""What scoring a scene leaves in a folder, and what its figures come to. Once per machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from radiant_core.choices import Version
from radiant_core.evaluate.image_error import FIGURES, NO_FLIP_REASON, NO_LPIPS_REASON, ImageErrors, mean_errors, median_errors

LPIPS_NAME = "lpips.safetensors"
"""Weights of LPIPS in the folder where a scene is scored."""
SCORES_NAME = "scores.json"
"""Figures that a machine reports of its held-out photographs."""
SCENE_NAME = "scene.ply"
PICTURE_KINDS = ("photographs", "renders", "differences", "canonical")
"""Folders with one PNG per held-out photograph; the last where light is modelled."""


def version_file(name: Version) -> str:
    """The file of another version of the scene than that in scene.ply, beside it."""
    return f"{name}.ply"


def summarize_scores(rows: Sequence[Mapping[str, Any]], *, lpips_network: str | None) -> dict[str, Any]:
    """Summarize rows of `score_images`: means, medians, reasons for missing figures, the rows."""
    errors = [ImageErrors(name=row["name"], **{figure: row[figure] for figure in FIGURES}) for row in rows]
    mean, median = mean_errors(errors), median_errors(errors)
    return {
        **mean.figures(),
        "median": median.figures(),
        "flip_reason": NO_FLIP_REASON if mean.flip is None else None,
        "lpips_reason": NO_LPIPS_REASON if mean.lpips is None else None,
        "lpips_network": lpips_network,
        "images": list(rows),
    }
