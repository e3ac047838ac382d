"""What nodes decide, as the report lists it: one function per topic. Once per node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from radiant_core.decisions import Decision
from radiant_core.regimes import FILL_IN, SHAPES, SKY, require

if TYPE_CHECKING:
    from collections.abc import Sequence

    from radiant_core.aggregate.balance import Balance
    from radiant_core.aggregate.config import Join
    from radiant_core.aggregate.join import Check, Joined
    from radiant_core.hierarchy.recipe import Recipe
    from radiant_core.splats import Splats
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.shapes import ShapeCounts

BY_PRESET = "the preset follows 3DGS and the paper, which add and skip nothing here"


def step_decision(recipe: Recipe) -> Decision | None:
    """The steps of devices with photographs; None where each takes the same number."""
    if (law := recipe.step_law) is None:
        return None
    quotas = [len(plan.cameras_of(device)) for plan in recipe.edge_plans for device in plan.device_ids]
    steps = [law.steps(quota) for quota in quotas if quota]
    return Decision(
        stage="train",
        topic="steps of devices",
        choice=f"{min(steps):,} to {max(steps):,} steps, {sum(steps):,} in all",
        figure=law.per_photograph,
        unit="steps per photograph",
        reason=f"a device's time is proportional to its photographs, as planned; the mean of all devices is {law.num_steps:,} steps",
        changes_nothing=len(set(steps)) == 1,
    )


def joining_decision(recipe: Recipe) -> Decision | None:
    """In how many epochs tiers join, where devices refine what was joined; None where no model is
    joined or nothing is refined."""
    aggregate, trainings = recipe.aggregate, recipe.trainings
    if not aggregate.refine.is_asked_for or trainings.num_devices < 2 or "cloud" in recipe.groups:
        return None
    case, (at_edge, at_cloud) = trainings.joining, aggregate.epochs_after(trainings)
    return Decision(
        stage="edges",
        topic="epochs of joining",
        choice=f"{at_edge} at edges, {at_cloud} at the cloud",
        figure=trainings.photograph_shows,
        unit=f"times a training of {trainings.num_steps:,.0f} steps shows each photograph",
        reason=case.reason if None in (aggregate.edge.epochs, aggregate.cloud.epochs) else "asked for",
        row=case.row,
        forced=(aggregate.edge.epochs, aggregate.cloud.epochs) != (None, None),
    )


def sky_decision(stage: str, share: float, *, wanted: bool) -> Decision:
    """How much of the pictures looks like sky, and whether a sky is built."""
    case = require(SKY, {"share": share})
    looks_up = wanted and bool(case.values["built"])
    return Decision(
        stage=stage,
        topic="sky",
        choice="Gaussians on a far half sphere were added" if looks_up else "no sky was added",
        figure=100 * share,
        unit="% above the horizon in the image that has most",
        reason=case.reason if wanted else BY_PRESET,
        row=case.row if wanted else "",
        otherwise="--set train.sky=false" if looks_up else "",
        forced=not wanted,
        changes_nothing=not looks_up,
    )


def fill_decision(stage: str, num_filled: int, num_points: int, placed: str, *, wanted: bool) -> Decision:
    """How many points were added where there is no sparse one and nothing speaks against them, and
    how they were placed."""
    case = require(FILL_IN, {"contradicted": 0.0, "seen_through": 0.0})
    return Decision(
        stage=stage,
        topic="fill-in points",
        choice=f"{num_filled:,} points were added to {num_points:,} sparse ones" + (f", {placed}" if num_filled else ""),
        figure=float(num_filled),
        unit="image cells without a sparse point" if wanted else "points",
        reason=case.reason if wanted else BY_PRESET,
        row=case.row if wanted else "",
        otherwise="--set train.fill_in=false" if num_filled else "",
        forced=not wanted,
        changes_nothing=not num_filled,
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
    summary = f"{counts.num_needles:,} needles and {counts.num_screen_filling:,} screen-filling Gaussians are held at their limits"
    case = require(SHAPES)
    # The presets that follow 3DGS limit no shape.
    options = [(config.max_elongation, "times the second axis"), (config.max_scale_per_distance, "of the distance to the nearest camera")]
    limits = ", ".join(f"{limit:.3g} {unit}" for limit, unit in options if limit is not None)
    return Decision(
        stage=stage,
        topic="shapes",
        choice=f"{summary}; {counts.num_dead:,} that no pixel shows are left out",
        figure=float(counts.num_needles + counts.num_screen_filling + counts.num_dead),
        unit="Gaussians",
        reason=(f"beyond {limits}, {case.reason}; " if limits else "") + "an opacity below 1/255 is never drawn",
        row=case.row if limits else "",
        otherwise=_without_limit(config, counts),
    )


def _without_limit(config: TrainConfig, counts: ShapeCounts) -> str:
    """The option that lifts the limit at which most Gaussians are held."""
    if config.max_elongation is not None and counts.num_needles >= max(1, counts.num_screen_filling):
        return "--set train.max_elongation=none"
    fills_screen = config.max_scale_per_distance is not None and counts.num_screen_filling
    return "--set train.max_scale_per_distance=none" if fills_screen else ""


def refinement_decision(stage: str, counts: Sequence[int], scene: Splats) -> Decision:
    """How much of the scene devices have refined, by the Gaussians that each edge sent."""
    num_refined = sum(counts)
    return Decision(
        stage=stage,
        topic="refinement",
        choice=f"the scene is refined by the photographs below {len(counts)} edges",
        figure=float(num_refined),
        unit=f"refined Gaussians arrived, of {len(scene):,}",
        reason="joining fits models to renders of models only; refining fits the scene to the devices' photographs",
        changes_nothing=not num_refined,
    )


def check_decision(stage: str, check: Check) -> Decision:
    """Whether the joined model is kept, by some of the models' pictures."""
    chosen, rejected = ("joined", "cut") if check.keeps_joined else ("cut", "joined")
    kept_db, left_db = sorted((check.joined_db, check.cut_db), reverse=True)
    return Decision(
        stage=stage,
        topic="joined or cut",
        choice=f"the {chosen} model is kept",
        figure=kept_db - left_db,
        unit=f"dB over the {rejected} one",
        reason=f"{kept_db:.2f} dB in {check.num_views} of the models' own pictures",
        changes_nothing=check.keeps_joined,
    )


def join_decisions(stage: str, join: Join, num_models: int, joined: Joined) -> list[Decision]:
    """What was retrained of the joined models and what was skipped, with the deciding figures."""

    def decided(choice: str, figure: float, unit: str, reason: str) -> Decision:
        forced = join.method == "paper"
        return Decision(stage=stage, topic="retraining", choice=choice, figure=figure, unit=unit, reason=reason, forced=forced)

    steps = joined.trained.num_steps
    if num_models == 1 and not steps:
        return [decided("skipped", 1.0, "models", "a single model would only learn from its own pictures")]
    if join.method == "paper":
        return [decided(f"{steps:,} steps on all Gaussians and whole pictures", float(steps), "steps", BY_PRESET)]
    exposures = [] if joined.balance is None else [exposures_decision(stage, joined.balance)]
    checks = [] if joined.check is None else [check_decision(stage, joined.check)]
    if joined.is_unfitted:
        reduction = f"{joined.num_given:,} Gaussians became {len(joined.splats):,}"
        reason = "devices refine them next: after short trainings that gets as far as a join before it, and sooner"
        return [
            *exposures,
            decided(f"models fade where others own the place; {reduction}", 100 * joined.contested_share, "% contested", reason),
        ]
    if not joined.num_shown:
        reason = "no view shows enough that a second model knows: models are cut at their borders"
        return [*exposures, decided("skipped", 0.0, "% contested", reason)]
    if not steps and (joined.agreement_db or 0.0) < (join.agreement_db or float("inf")):
        reason = "no view shows enough of any tile: models are cut at their borders"
        return [*exposures, decided("skipped", joined.agreement_db or 0.0, "dB", reason)]
    if not steps:
        reason = f"models that agree to {join.agreement_db:g} dB have no seam that could be seen: they are cut at their borders"
        return [*exposures, decided("skipped", joined.agreement_db or 0.0, "dB", reason)]
    views = f"{joined.num_shown} of {joined.num_views} views"
    share = 100 * joined.contested_share
    reduction = f"{joined.num_given:,} Gaussians became {len(joined.splats):,}"
    reason = "joining improves only places that two models show"
    return [*exposures, decided(f"{steps:,} steps on {views}; {reduction}", share, "% contested", reason), *checks]


def exposures_decision(stage: str, balance: Balance) -> Decision:
    """Whether models were balanced, with how far the one that differs most is off."""
    choice = "models are balanced by a gain and an offset per channel" if balance.is_needed else "left as they are"
    if not balance.num_pairs:
        reason = "no two models show the same place"
    else:
        reason = f"{'more' if balance.is_needed else 'no more'} than models of one exposure differ"
    unit = "of 255 from the mean of all models, at mid grey"
    unchanged = not balance.is_needed
    topic = "exposures of the models"
    return Decision(stage=stage, topic=topic, choice=choice, figure=balance.levels, unit=unit, reason=reason, changes_nothing=unchanged)
