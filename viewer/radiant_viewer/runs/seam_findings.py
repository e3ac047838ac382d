"""Seams at the borders of a plan: colour steps in the model, and what photographs show beyond them.

A seam is found where the colour step exceeds the texture (`border_figures`), or where the run's own
photographs show the ground beyond the border worse than the ground before it, by more than chance
(`radiant_core.evaluate.seam_excess`, which a run writes into its metrics). No finding proves no
absence. O(N) for the steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_core.io.run_store import read_json
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.pictures.measure import length_text
from radiant_viewer.runs.border_figures import MIN_OBSERVED_SHARE, VISIBLE_LEVELS, BorderFigures, border_figures
from radiant_viewer.runs.run_view import METRICS_NAME


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamFinding:
    """A border's figures, and the excess error beyond it in dB where photographs prove it."""

    figures: BorderFigures
    excess_db: float | None = None

    @property
    def has_seam(self) -> bool:
        """Whether colours step by more than texture, or photographs show the seam."""
        return self.figures.has_step or self.excess_db is not None


def seam_findings(
    scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, proven_db: Mapping[frozenset[str], float] | None = None
) -> list[SeamFinding]:
    """Return all borders, those with a verdict and the largest step first, with the excess of those
    in `proven_db` (`proven_excess_db`). Raises BadInput where the plan has one region only."""
    proven = proven_db or {}
    return [
        SeamFinding(figures=figures, excess_db=proven.get(frozenset(figures.names)))
        for figures in border_figures(scene, cloud_plan, splats)
    ]


def proven_excess_db(folder: Path) -> dict[frozenset[str], float]:
    """Return the excess error of a run's borders at which its photographs show a seam, by the names
    of both edges; empty where it was not measured."""
    borders = _metrics(folder).get("borders")
    rows = [row for row in borders if isinstance(row, dict) and row.get("seam_found")] if isinstance(borders, list) else []
    return {frozenset(row["between"]): float(row["seam_excess_db"]) for row in rows}


def verdict_text(findings: Sequence[SeamFinding], unit: str) -> str:
    """Return the verdict on all borders with their observed length, and the largest step of one
    beside its texture and of a piece, which has the brightest colour."""
    judged = [finding.figures for finding in findings if finding.figures.has_verdict]
    num_seams = sum(finding.has_seam for finding in findings)
    if not judged and not num_seams:
        return f"No verdict: less than {MIN_OBSERVED_SHARE:.0%} of each border was observed on both sides"
    if not judged:
        return f"Photographs show a seam at {num_seams} of {len(findings)} border{'s' * (len(findings) != 1)}"
    limit = max(figures.detectable_levels for figures in judged)
    verdict = (
        f"Seam found at {num_seams} of {len(findings)} border{'s' * (len(findings) != 1)}"
        if num_seams
        else f"No step of {math.ceil(limit)} levels of 255 or more could be told from texture"
    )
    observed = sum(figures.observed_length for figures in judged)
    total = sum(finding.figures.border.length_m for finding in findings)
    largest = f"largest over a border: {judged[0].title}, {_beside_texture(judged[0])}"
    piece = max(finding.figures.largest_piece_levels for finding in findings)
    return f"{verdict}; observed: {observed_text(observed, total, unit)}   ·   {largest}; over a piece: up to {piece:.1f}"


def excess_text(folder: Path) -> str:
    """Return what photographs show beyond the borders of a run; "" where it was not measured."""
    record = _metrics(folder)
    excess_db, has_seam = record.get("seam_excess_db"), record.get("seam_found")
    if not isinstance(excess_db, int | float):
        return ""
    return f"Photographs show the ground beyond borders {excess_db:+.2f} dB worse: {'a seam' if has_seam else 'no seam found'}."


def _metrics(folder: Path) -> dict[str, Any]:
    path = folder / METRICS_NAME
    record = read_json(path) if path.is_file() else {}
    return record if isinstance(record, dict) else {}


def step_text(figures: BorderFigures) -> str:
    """Return a border's step beside its texture, and whether it is visible, to end a sentence."""
    if not figures.has_verdict:
        return "too little observed for a verdict"
    size = "told from texture" if figures.has_step else "not visible" if figures.step_levels < VISIBLE_LEVELS else "not told from texture"
    return f"{_beside_texture(figures)}, {size}"


def _beside_texture(figures: BorderFigures) -> str:
    return f"{figures.step_levels:.1f} levels beside {figures.texture_levels:.1f} of texture"


def observed_text(observed: float, total: float, unit: str) -> str:
    """Return the observed length of the total: "31 m of 60 m"."""
    return (
        f"all {length_text(total, unit)}" if observed >= 0.999 * total else f"{length_text(observed, unit)} of {length_text(total, unit)}"
    )
