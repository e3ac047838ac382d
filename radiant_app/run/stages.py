"""What all sources of photographs share: the plan, the settings of training, the executor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Warned
from radiant_app.executors.emulated import EmulatedExecutor
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import Executor
from radiant_app.report.prediction_error import save_system
from radiant_app.run.cloud_planning import place_edges_by_raster, plan_at_cloud
from radiant_app.run.cutting import choose_cut, leave_whole, plan_places
from radiant_app.run.predictions import (
    planned_training,
    prediction_warnings,
    predicts_frames,
    training_key_of,
    with_camera_limits,
    with_fixed_steps,
    with_own_frames,
    with_short_joins,
    with_step_law,
)
from radiant_app.run.progress import Progress
from radiant_app.run.source import Plan
from radiant_app.run.time_left import TimeLeftListener
from radiant_app.run.training_costs import scaled_to_training
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.choices import UploadFormat
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.hierarchy.decisions import joining_decision, step_decision
from radiant_core.hierarchy.messages import Renderer
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_plan, load_plan_waypoints, save_plan
from radiant_core.io.transport.upload import BYTES_FACTORS
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.devices.idle import idle_reasons
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import distant_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.revision.captured import plan_captured, require_same_system
from radiant_core.plan.system import System
from radiant_core.plan.waypoints import Waypoints
from radiant_core.render.backends import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.needs import fit_to_backend

ATTEMPTS = 3
"""Starts of a node whose process or machine was lost; more failures are no chance."""
FRAMES_UNPREDICTED = (
    "what it takes to bring models that GPS has placed into one frame is in no profile: edges and the cloud will take longer than is "
    "predicted; make the profile anew with `radiant machine profile` and photographs that overlap, which measures that."
)
REFERENCE_RETRAIN_STEPS = 100
"""Limit of a retraining on the plain PyTorch backend."""


def list_nodes(system: System) -> tuple[str, ...]:
    """Ids of the nodes of a run before the plan: all of the system's, and the cloud."""
    return (*(f"devices/{device.id}" for device in system.devices), *(f"edges/{edge.id}" for edge in system.edges), "cloud")


def plan_stage(
    config: RunConfig,
    system: System,
    positions: FloatArray,
    origin: FloatArray | None,
    progress: Progress,
    scene: SfmScene | None = None,
) -> tuple[System, CloudPlan, tuple[EdgePlan, ...]]:
    """Plan positions (C,2) m about `origin` (3,) lat lon alt (None: no GPS); writes plan.json.

    `scene`: the same cameras with their sparse points; None where these are not known. Raises
    BadInput when no plan fits.
    """
    train = planned_training(config.train.preset, config.train.overrides)
    system, note = costs_of_run(config, system, len(positions))
    if config.plan.file is not None:
        # Captured photographs stay on their devices, whatever memory those have.
        system = place_edges_by_raster(system, positions, origin, config.cell_m, config.seed)
        planned, edge_plans, waypoints = load_plan_in_frame(config.plan.file, origin)
        # Only an owner of all photographs knows where they look.
        planned = planned if config.frames == "shared" else replace(planned, looks=None)
        cloud_plan, edge_plans = plan_captured(planned, edge_plans, waypoints, positions, system=system)
        warnings = note
    else:
        system, decision, warnings = with_camera_limits(system, train, len(positions), BYTES_FACTORS[config.upload])
        if decision is not None:
            progress.listen(Decided(decision=decision))
        warnings = (*note, *warnings)
        system, cloud_plan, edge_plans = _make_plan(config, system, (positions, origin, scene), progress)
    warnings = (*warnings, *distant_edges(system, origin))
    new_plan = cloud_plan if config.plan.file is None else None
    warnings = warn_about_predictions(config, system, edge_plans, progress, warnings, new_plan)
    save_plan(config.out / "plan.json", cloud_plan, edge_plans, warnings=warnings)
    save_system(config.out, system)
    return system, cloud_plan, edge_plans


def costs_of_run(config: RunConfig, system: System, num_cameras: int) -> tuple[System, tuple[str, ...]]:
    """The system with what profiles know of this run: its pixels, Gaussians, steps, epochs and
    frames; and what was made of profiles of other trainings."""
    train = planned_training(config.train.preset, config.train.overrides)
    scaled = scaled_to_training(system, train, config.train.preset, num_cameras)
    by_photographs = config.train.step_policy == "per_photograph"
    system = with_step_law(scaled.system, train, num_cameras) if by_photographs else with_fixed_steps(scaled.system, train)
    system = with_short_joins(system, train, num_cameras, config.joining)
    if config.frames != "shared":
        system = with_own_frames(system, num_cameras, known_poses=config.frames == "known")
    return system, () if scaled.note is None else (scaled.note,)


def _make_plan(
    config: RunConfig, system: System, cameras: tuple[FloatArray, FloatArray | None, SfmScene | None], progress: Progress
) -> tuple[System, CloudPlan, tuple[EdgePlan, ...]]:
    """Plan cameras at (C,2) m about an origin, of a scene where that is known."""
    positions, origin, scene = cameras

    def place(places: FloatArray) -> System:
        return place_edges_by_raster(system, places, origin, config.cell_m, config.seed)

    method, paper = config.plan.method, config.plan.paper
    if len(system.devices) == 1 and config.plan.cut_by == "auto":
        cut = leave_whole()
    else:
        cut = choose_cut(scene, config.plan.cut_by, method, lambda places: plan_places(places, place(places), method, paper))
    progress.listen(Decided(decision=cut.decision))
    places = cut.places_of(positions)
    system = place(places)
    if config.cell_m is not None:
        cloud_plan = plan_at_cloud(config, config.cell_m, system, places, progress)
    else:
        cloud_plan = plan_regions(places, system, method=method, paper=paper)
    if isinstance(cloud_plan, PlanInfeasible):
        raise BadInput(f"plan: {cloud_plan.reason} What is finished is kept: change {config.system_file} and add --resume.")
    return system, cut.mark(cloud_plan), split_edges(places, cloud_plan, system)


def warn_about_predictions(
    config: RunConfig,
    system: System,
    edge_plans: Sequence[EdgePlan],
    progress: Progress,
    more: tuple[str, ...] = (),
    cloud_plan: CloudPlan | None = None,
) -> tuple[str, ...]:
    """Emit and return the warnings about the plan's predicted times, after those in `more`, and, of
    a plan that was made here, about devices without work."""
    train = planned_training(config.train.preset, config.train.overrides)
    training = training_key_of(train, config.train.preset, config.aggregate.preset)
    warnings = (*more, *prediction_warnings(system, edge_plans, training), *_idle_warnings(cloud_plan, edge_plans, system))
    if config.frames == "gps" and not predicts_frames(system):
        warnings = (*warnings, FRAMES_UNPREDICTED)
    for message in warnings:
        progress.listen(Warned(stage="plan", message=message))
    return warnings


def _idle_warnings(cloud_plan: CloudPlan | None, edge_plans: Sequence[EdgePlan], system: System) -> tuple[str, ...]:
    if cloud_plan is None:
        return ()
    return tuple(f"device {name} gets no photographs: {reason}." for name, reason in idle_reasons(cloud_plan, edge_plans, system).items())


def load_plan_in_frame(path: Path, origin: FloatArray | None) -> tuple[CloudPlan, tuple[EdgePlan, ...], FloatArray]:
    """Load a plan made before capture and its waypoints (P,2), in metres about `origin` (3,) lat
    lon alt.

    Raises BadInput for a plan without waypoints, and where the photographs are not placed on the
    globe.
    """
    cloud_plan, edge_plans, waypoints = load_plan_before_capture(path)
    if origin is None:
        raise BadInput(f"{path} is on the globe and the photographs have no GPS frame: leave out --plan, or give photographs with GPS.")
    # Over a site, two local frames differ by a shift: their axes turn by 1e-4 per kilometre.
    shift = enu_from_geodetic(waypoints.origin[None], origin)[0, :2]
    edges = tuple(replace(plan, strips=tuple(strip + shift for strip in plan.strips)) for plan in edge_plans)
    return cloud_plan.moved(shift), edges, enu_from_geodetic(waypoints.lat_lon_alt, origin)[:, :2]


def require_plan(path: Path, system: System) -> None:
    """Raise BadInput for a plan without waypoints or for another system, before any stage runs."""
    _, edge_plans, _ = load_plan_before_capture(path)
    require_same_system(edge_plans, system)


def load_plan_before_capture(path: Path) -> tuple[CloudPlan, tuple[EdgePlan, ...], Waypoints]:
    """Load a plan made before capture, with its waypoints; BadInput if it has none."""
    cloud_plan, edge_plans = load_plan(path)
    waypoints = load_plan_waypoints(path)
    if waypoints is None:
        raise BadInput(f"{path} has no waypoints: make it by `radiant plan` from waypoints or from a folder of photographs with GPS.")
    return cloud_plan, edge_plans, waypoints


def make_recipe(config: RunConfig, plan: Plan, num_devices: int, progress: Progress) -> Recipe:
    """What a run by this plan has decided; emits the decisions."""
    train, aggregate, backend = resolve_training(config, progress)
    recipe = Recipe(
        system=plan.system,
        cloud_plan=plan.cloud,
        edge_plans=plan.edges,
        train=train,
        aggregate=aggregate,
        backend=backend,
        upload=config.upload,
        checkpoint_every_s=config.execution.checkpoint_every_s,
        num_devices=num_devices,
        step_policy=config.train.step_policy,
    ).with_groups(plan.groups, masked=config.plan.mask_gradients)
    for decision in (step_decision(recipe), joining_decision(recipe)):
        if decision is not None:
            progress.listen(Decided(decision=decision))
    return recipe


def workers_of(config: RunConfig, plan: Plan) -> int:
    """Processes at a time: as many as the user asks for, else as cores and memory allow."""
    execution = config.execution
    return execution.num_workers if execution.max_workers or plan.num_workers is None else min(execution.num_workers, plan.num_workers)


def make_executor(config: RunConfig, plan: Plan, clock: Callable[[], float], retry_policy: RetryPolicy) -> Executor:
    """Return the executor of a run: local, emulated or a Ray cluster."""
    retry_policy = replace(retry_policy, max_attempts=ATTEMPTS)
    if config.execution.address is not None:
        from radiant_app.executors.ray_cluster import LOG_NAME, RayExecutor

        return RayExecutor(address=config.execution.address, log=config.out / LOG_NAME, clock=clock, retry_policy=retry_policy)
    local = LocalExecutor(num_workers=workers_of(config, plan), clock=clock, retry_policy=retry_policy)
    return EmulatedExecutor(system=plan.system, local=local) if config.emulated else local


def begin_executor(config: RunConfig) -> None:
    """Have nodes' libraries loaded while photographs are located and a plan is made."""
    if config.execution.address is None and not config.emulated:
        LocalExecutor(num_workers=config.execution.num_workers).begin()


def make_time_left_listener(config: RunConfig, plan: Plan, progress: Progress) -> TimeLeftListener:
    """Return a listener that forwards events and adds the time left after devices and edges."""
    return TimeLeftListener(
        listen=progress.listen,
        system=plan.system,
        edge_plans=plan.edges,
        num_workers=workers_of(config, plan),
        emulated=config.emulated,
        clock=progress.clock,
        deadline_factor=config.execution.deadline_factor,
    )


def scale_for_uploads(system: System, upload: UploadFormat, progress: Progress) -> System:
    """Return the system with the model bytes of the upload format."""
    factor = BYTES_FACTORS[upload]
    if factor == 1:
        return system
    decision = Decision(
        stage="plan",
        topic="uploads",
        choice=f"{upload}: models count {factor:.2f} times their bytes",
        figure=100 * factor,
        unit="% of the bytes of float32",
        reason="the plan assumes float32 models, and uploads are smaller",
    )
    progress.listen(Decided(decision=decision))
    return system.with_uploads_of(factor)


def resolve_training(config: RunConfig, progress: Progress) -> tuple[TrainConfig, AggregateConfig, Renderer]:
    """Return how devices train and tiers join, and this machine's backend; emits the decisions."""
    backend = resolve_backend("auto")
    preset = replace(train_preset(config.train.preset), seed=config.seed)
    train, decisions = fit_to_backend(preset, backend, config.train.overrides)
    aggregate = config.joining
    if backend == "reference" and train.reduce_on_cpu:
        limited = {name: replace(getattr(aggregate, name), max_num_steps=REFERENCE_RETRAIN_STEPS) for name in ("edge", "cloud", "refine")}
        aggregate = replace(aggregate, **limited)
        decisions = (*decisions, _retrain_decision())
    for decision in decisions:
        progress.listen(Decided(decision=decision))
    return train, aggregate, backend


def _retrain_decision() -> Decision:
    return Decision(
        stage="edges",
        topic="retraining",
        choice=f"at most {REFERENCE_RETRAIN_STEPS} steps",
        figure=float(REFERENCE_RETRAIN_STEPS),
        unit="steps",
        reason="with the plain PyTorch backend all epochs would take most of the run",
    )
