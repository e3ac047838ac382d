"""What follows joining: every device fits the joined scene to its own photographs, edges and the
cloud average. In every round of a run.

    scene, photographs ── refine_device ───────→ Refinement       on each device
    scene, Refinements ── join_refinements ────→ Refinement       at each edge
    scene, Refinements ── refine_scene ────────→ scene            at the cloud (`averaging.py`)

Joining shows models only pictures of models, so that a scene is never sharper than those. Here the
photographs speak once more, where they are; what travels is what a model is. Nothing is added or
removed, so that a Gaussian keeps its row.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.averaging import Refinement, limit_changes
from radiant_core.aggregate.join_memory import plan_join_memory
from radiant_core.decisions import Decision
from radiant_core.geometry.coverage import reached_by
from radiant_core.hierarchy.messages import RefineTask
from radiant_core.hierarchy.refining_plan import MAX_STEPS, refining_steps, warning_of
from radiant_core.hierarchy.reporter import Machine, Reporter, fit_options
from radiant_core.light.lights import in_canonical_light
from radiant_core.light.solve import lights_from_model
from radiant_core.regimes import LIGHT_SPREAD
from radiant_core.splats import Splats
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import without_mean
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.memory import STATISTICS_BUDGET_BYTES
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews

RATE, RATE_END = 0.8, 0.3
"""Share of a training's rates, and what is left of it in the end: measured in
docs/experiments/aggregation.md."""
MIN_GAIN = 8 / 128
"""A device whose photographs are brighter or darker than the scene by this share at mid grey, as
`balance.MIN_LEVELS`, refines by photographs in the scene's light, whatever `light` is."""


def refine_device(task: RefineTask, scene: Splats, views: TrainingViews, reporter: Reporter, machine: Machine = Machine()) -> Refinement:
    """Fit the scene to a device's photographs.

    Args:
        task: settings and epochs.
        scene: the joined model, which all devices were sent.
        views: the device's training photographs; their cameras in the frame of the scene.
        reporter: hears decisions and progress.
        machine: checkpoints.

    Returns:
        The Gaussians that the photographs changed; none where the scene exceeds the memory.

    Raises:
        StageFailed: the fit diverges.
    """
    rows = np.flatnonzero(reached_by(scene, views.cameras))
    start = scene.select(rows)
    nothing = Refinement(rows=rows[:0], splats=start.select(rows[:0]), weights=np.zeros(0, np.float32))
    bare = FitOptions(backend=task.backend, steps=_steps())
    if task.memory_bytes is not None:
        # It trains: its photographs are shown more often than a join's views.
        most, side = STATISTICS_BUDGET_BYTES, task.train.long_side_px
        memory = plan_join_memory([start], [views.cameras], side, task.memory_bytes, most_tiles=1, most_statistics_bytes=most)
        if len(start) and not memory.fits:
            skipped = _skipped(reporter.stage, memory.needed_bytes, task.memory_bytes)
            reporter.decide(skipped)
            reporter.warn(warning_of(skipped))
            return nothing
        bare = replace(bare, statistics_bytes=memory.statistics_bytes)
    if not len(start):
        return nothing
    views = _in_light_of(start, views, task, reporter)
    num_steps = refining_steps(task.epochs, len(views))
    if num_steps < task.epochs * len(views):
        reporter.decide(_shortened(reporter.stage, num_steps / len(views), task.epochs))
    config = replace(
        task.train,
        num_steps=num_steps if task.max_num_steps is None else min(num_steps, task.max_num_steps),
        budget_s=None,
        sh_degree=start.sh_degree,
        sh_degree_every=0,
        density=NoDensification(),
        start_scale=1.0,
        background="black",
        drop_gaussians="none",
        settle_epochs=None,
        **without_mean(task.train),
    )
    options = fit_options(task.backend, reporter, machine, lambda: training_key(start, views, config, bare))
    fitted = fit_splats(start, views, config, replace(options, steps=bare.steps, statistics_bytes=bare.statistics_bytes)).splats
    fitted = limit_changes(start, fitted)
    changed = np.flatnonzero(_changed(start, fitted))
    # Its edge weighs it, by renders of its own.
    weights = np.full(len(changed), 1 / max(1, len(changed)), np.float32)
    return Refinement(rows=rows[changed], splats=fitted.select(changed), weights=weights)


def _shortened(stage: str, trained: float, epochs: int) -> Decision:
    return Decision(
        stage=stage,
        topic="refinement",
        choice=f"{trained:.1f} epochs instead of {epochs}",
        figure=trained,
        unit="epochs",
        reason=f"devices drift apart between two averages: beyond {MAX_STEPS} steps, or one epoch if that is more, nothing was gained",
    )


def _steps() -> Steps:
    rates = dict.fromkeys(("means", "quats", "log_scales", "logit_opacities", "sh0", "shN"), RATE)
    return Steps(**rates, end=RATE_END)


def _changed(before: Splats, after: Splats) -> NDArray[np.bool_]:
    """Which Gaussians (N,) the photographs moved."""
    pairs = zip(before.arrays().values(), after.arrays().values(), strict=True)
    return np.any([(old != new).reshape(len(before), -1).any(axis=1) for old, new in pairs], axis=0)


def _in_light_of(scene: Splats, views: TrainingViews, task: RefineTask, reporter: Reporter) -> TrainingViews:
    """The photographs in the scene's light: each where their light is modelled, else the device's
    as a whole where they are brighter or darker."""
    lights = lights_from_model(scene, views, task.backend).lights
    if not lights.is_known.any():
        return views
    shift = lights.log_gains[lights.is_known].mean(axis=0)
    if task.train.light == "none" or (task.train.light == "auto" and not lights.is_worth_modelling):
        lights = replace(lights, log_gains=np.tile(shift, (len(lights), 1)), vignettings=np.zeros_like(lights.vignettings))
        if np.abs(shift).max() < MIN_GAIN:
            return views
    else:
        # One that shows too little of the scene is as the others are.
        lights = replace(lights, log_gains=np.where(lights.is_known[:, None], lights.log_gains, shift))
    reporter.decide(
        Decision(
            stage=reporter.stage,
            topic="light of the photographs",
            choice="photographs are fitted in the light of the scene",
            figure=100 * float(np.expm1(np.abs(lights.log_gains).max())),
            unit="% brighter or darker in a channel",
            reason=f"from {MIN_GAIN:.0%} of a device or a spread of {LIGHT_SPREAD:.0%} on, photographs would change its light",
            row=lights.regime.row,
        )
    )
    return in_canonical_light(views, lights)


def _skipped(stage: str, needed_bytes: float, limit_bytes: float) -> Decision:
    return Decision(
        stage=stage,
        topic="refinement",
        choice="the scene is not refined by this device's photographs",
        figure=needed_bytes / 1e9,
        unit="GB needed",
        reason=f"memory_gb of the device allows {limit_bytes / 1e9:.2f}",
    )
