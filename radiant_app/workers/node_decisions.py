"""What nodes decided, as the report lists it: one function per topic. Once per node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from radiant_app.workers.cloud_task import BY_PRESET
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision

if TYPE_CHECKING:
    from radiant_core.aggregate.synthetic_views import Rendered
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.shapes import ShapeCounts


def sky_decision(stage: str, share: float, *, wanted: bool) -> Decision:
    """How much of the pictures looks like sky, and whether a sky is built."""
    from radiant_core.train.initialize import MIN_SKY_SHARE

    looks_up = wanted and share >= MIN_SKY_SHARE
    return Decision(
        stage=stage,
        topic="sky",
        choice="Gaussians on a far half sphere were added" if looks_up else "no sky was added",
        figure=100 * share,
        unit="% above the horizon in the image that has most",
        reason=f"a sky is modelled from {100 * MIN_SKY_SHARE:.0f} % of one image on" if wanted else BY_PRESET,
        forced=not wanted,
        changes_nothing=not looks_up,
    )


def fill_decision(stage: str, num_filled: int, num_points: int, *, wanted: bool) -> Decision:
    """How many points were added where there is no sparse one."""
    return Decision(
        stage=stage,
        topic="fill-in points",
        choice=f"{num_filled:,} points were added to {num_points:,} sparse ones",
        figure=float(num_filled),
        unit="image cells without a sparse point" if wanted else "points",
        reason="places without sparse points would start empty" if wanted else BY_PRESET,
        forced=not wanted,
        changes_nothing=not num_filled,
    )


def teachers_decision(stage: str, rendered: Sequence[Rendered], cameras: Sequence[Cameras]) -> Decision:
    """How many views were rendered before the last device arrived."""
    num_early, num_views = sum(map(len, rendered)), sum(map(len, cameras))
    return Decision(
        stage=stage,
        topic="teachers",
        choice=f"{num_early} of {num_views} views were rendered before the last device arrived",
        figure=float(num_early),
        unit="views",
        reason="a device's views need no other device; the edge renders the rest itself",
        changes_nothing=not num_early,
    )


def density_decision(stage: str, counts: Any, num_before: int, num_after: int) -> Decision:
    """What densification and pruning did."""
    pruned = f"{counts.num_pruned_transparent:,} transparent and {counts.num_pruned_large:,} large ones pruned"
    refused = f"; the limit of Gaussians refused {counts.num_refused:,}" if counts.num_refused else ""
    return Decision(
        stage=stage,
        topic="densification",
        choice=f"{counts.num_cloned:,} Gaussians cloned, {counts.num_split:,} split, {pruned}{refused}",
        figure=float(num_after),
        unit=f"Gaussians from {num_before:,}",
        reason="adaptive density control follows the gradients of projected centres",
        changes_nothing=not any((counts.num_cloned, counts.num_split, counts.num_pruned_transparent, counts.num_pruned_large)),
    )


def shapes_decision(stage: str, config: TrainConfig, counts: ShapeCounts) -> Decision:
    """Gaussians held at the limits of size and elongation, and those that no pixel shows."""
    held = f"{counts.num_needles:,} needles and {counts.num_screen_filling:,} screen-filling Gaussians are held at their limits"
    limits = f"{config.max_elongation:.3g} times the second axis, {config.max_scale_per_distance:.3g} of the distance to the nearest camera"
    return Decision(
        stage=stage,
        topic="shapes",
        choice=f"{held}; {counts.num_dead:,} that no pixel shows are left out",
        figure=float(counts.num_needles + counts.num_screen_filling + counts.num_dead),
        unit="Gaussians",
        reason=f"beyond {limits}, a shape shows in views it was not fitted to; an opacity below 1/255 is never drawn",
    )


def blind_spots_decision(stage: str, merged: Any, *, wanted: bool) -> Decision:
    """What crop-merge kept outside its owner's region and dropped."""
    return Decision(
        stage=stage,
        topic="blind spots",
        choice=f"kept {merged.num_filled:,} Gaussians outside their own region and dropped {merged.num_dropped:,}",
        figure=100 * merged.num_filled / max(1, len(merged.splats)),
        unit="% of the scene",
        reason="the owner of that place has no Gaussian near it" if wanted else BY_PRESET,
        forced=not wanted,
        changes_nothing=not (merged.num_filled or merged.num_dropped),
    )


def join_memory_decision(stage: str, needed_bytes: float, statistics_bytes: int | None, memory_bytes: float) -> Decision:
    """What an edge's limit of memory made of joining; `statistics_bytes` is None where it made a cut."""
    choice = "models are cut at their borders instead of retrained"
    if statistics_bytes is not None:
        choice = f"models are retrained; {statistics_bytes / 1e6:,.0f} MB for what the loss keeps of its views"
    reason = f"retraining them is predicted to take {needed_bytes / 1e6:,.0f} MB"
    unit = "MB allowed"
    return Decision(stage=stage, topic="memory", choice=choice, figure=memory_bytes / 1e6, unit=unit, reason=reason, forced=True)
