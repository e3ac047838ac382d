"""Seams at the borders of a plan in a model: colour steps, and the detector at the largest.

A seam is found where the colour step exceeds the texture (`border_figures`), or where the step
detector responds to colour, height, density or a gap on the observed part. No finding proves no
absence: the detector misses grey steps below some 20/255 and plain cuts, which a run's photographs
show (`excess_text`). O(N) for the steps, a second per examined border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_core.evaluate.step_detector import Quantity, border_steps
from radiant_core.io.run_store import read_json
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.pictures.measure import length_text
from radiant_viewer.runs.border_figures import MIN_OBSERVED_SHARE, VISIBLE_LEVELS, BorderFigures, border_figures
from radiant_viewer.runs.run_view import METRICS_NAME

NUM_EXAMINED = 6
MAX_EXAMINED_M = 2000.0
"""Longer borders get no step detector: their strip would have millions of pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamFinding:
    """The figures of a border, and the quantities in which the step detector found a step."""

    figures: BorderFigures
    quantities: tuple[Quantity, ...]

    @property
    def found(self) -> bool:
        """Whether a seam was distinguished from the texture beside it."""
        return self.figures.has_verdict and (bool(self.quantities) or self.figures.has_step)


def seam_findings(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, num_examined: int = NUM_EXAMINED) -> list[SeamFinding]:
    """Return all borders, those with a verdict and the largest step first; the first `num_examined`
    also examined by the step detector if the scene is metric. Raises BadInput where the plan has
    one region only."""
    findings = []
    for rank, figures in enumerate(border_figures(scene, cloud_plan, splats)):
        can_be_examined = figures.has_verdict and scene.frame.unit == "m" and figures.border.length_m <= MAX_EXAMINED_M
        examined = rank < num_examined and can_be_examined
        quantities = border_steps(splats, figures.observed_ends).found if examined else ()
        findings.append(SeamFinding(figures=figures, quantities=quantities))
    return findings


def verdict_text(findings: Sequence[SeamFinding], unit: str) -> str:
    """Return the verdict on all borders with their observed length, and the largest step beside its
    texture."""
    judged = [finding.figures for finding in findings if finding.figures.has_verdict]
    if not judged:
        return f"No verdict: less than {MIN_OBSERVED_SHARE:.0%} of each border was observed on both sides"
    found = sum(finding.found for finding in findings)
    limit = max(figures.detectable_levels for figures in judged)
    verdict = (
        f"Seam found at {found} of {len(findings)} border{'s' * (len(findings) != 1)}"
        if found
        else f"No step of {limit:.0f} levels of 255 or more could be told from texture"
    )
    observed = sum(figures.observed_length for figures in judged)
    total = sum(finding.figures.border.length_m for finding in findings)
    return f"{verdict}; observed: {observed_text(observed, total, unit)}   ·   largest: {judged[0].title}, {_beside_texture(judged[0])}"


def excess_text(folder: Path) -> str:
    """Return what photographs show beyond the borders of a run; "" where it was not measured."""
    path = folder / METRICS_NAME
    record = read_json(path) if path.is_file() else {}
    excess_db, found = (record.get(key) if isinstance(record, dict) else None for key in ("seam_excess_db", "seam_found"))
    if not isinstance(excess_db, int | float):
        return ""
    return f"Photographs show the ground beyond borders {excess_db:+.2f} dB worse: {'a seam' if found else 'no seam found'}."


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
