"""Predicted against measured times of a finished run, for metrics.json, report and Gantt chart.

Measured: a device's `train_s` of its summary, and what its process needed beside it as initialising
(start, reading, first Gaussians, writing; with `--frames gps` and `known` its own structure from
motion too); an edge's process; sending only where it was emulated. Machines that train together
have one time, from the start of the first until the last is done. Once per run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import UPLINK
from radiant_app.executors.emulated import RESUMED
from radiant_app.files.run_folder import Manifest
from radiant_app.files.system_file import dump_system, even_system, load_system
from radiant_app.together.places import GROUP_FOLDER
from radiant_core.aggregate.tree import refined_at
from radiant_core.io.run_store import read_json, write_atomic
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import Device, System
from radiant_core.plan.timeline.prediction import (
    PlannedStage,
    StageError,
    correct_system,
    curve_shape,
    makespan_error,
    planned_stages,
    stage_errors,
)
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from radiant_core.plan.together.groups import GroupPlan

MAX_NAMES = 6
"""The most machines that a sentence names."""
SYSTEM_NAME = "system.toml"
"""The system a run or plan was planned for, edges placed: in a run's folder."""


def save_system(run: Path, system: System) -> None:
    """Write the system of the plan to the run's folder, for comparisons and re-plans."""
    write_atomic(run / SYSTEM_NAME, dump_system(system).encode())


def prediction_of(
    run: Path, manifest: Manifest, edge_plans: Sequence[EdgePlan], law: RefiningLaw | None = None, groups: Sequence[GroupPlan] = ()
) -> dict[str, Any]:
    """The predictions for metrics.json: stages, groups, the makespan where models are joined,
    refining, the error with corrections.

    `law`: how the scene is refined; None where its machines' times beside training hold more, as
    those that place their own photographs.
    """
    system, members = load_system(run / SYSTEM_NAME), {node for group in groups for node in _members(group)}
    measured = {key: seconds for key, seconds in measured_seconds(run, manifest).items() if key[0] not in members}
    errors = stage_errors(planned_stages(system, edge_plans), measured)
    whole, together = makespan_error(errors, edge_plans), _group_errors(manifest, groups)
    return {
        "curves": curves_note(system),
        "emulated": bool(manifest.emulated),
        "stages": [_row(error) for error in errors],
        "together": [_row(error) for error in together],
        "makespan": None if whole is None else _row(whole),
        "refining": None if law is None else _refining_error(system, edge_plans, manifest, law),
        "median_error_percent": _median_error([*errors, *together]),
        "online": _online_errors(system, edge_plans, manifest, measured),
    }


def measured_seconds(run: Path, manifest: Manifest) -> dict[tuple[str, str], float]:
    """(node, stage) → seconds of every device and edge that is known to have run."""
    times = manifest.emulated or manifest.stages
    seconds_of: dict[tuple[str, str], float] = {}
    for node, span in times.items():
        kind = node.split("/")[0]
        seconds = span["ended_s"] - span["started_s"]
        if kind not in ("devices", "edges", "cloud") or node.count("/") != (kind != "cloud") or seconds <= 0:
            continue
        if (sending := times.get(node + UPLINK)) is not None:
            seconds_of[node, "send"] = sending["ended_s"] - sending["started_s"]
            seconds -= seconds_of[node, "send"]
        if kind != "devices":
            seconds_of[node, "aggregate" if kind == "edges" else "merge"] = seconds
        elif (summary := run / node / "summary.json").is_file():
            train_s = min(seconds, float(read_json(summary, ("train_s",))["train_s"]))
            seconds_of[node, "initialise"], seconds_of[node, "train"] = seconds - train_s, train_s
    return seconds_of


def _members(group: GroupPlan) -> list[str]:
    """Nodes of a group; with all edges of a run, the cloud too."""
    cloud = ["cloud"] if group.level == "cloud" else []
    return [*cloud, *(f"edges/{name}" for name in group.edges), *(f"devices/{name}" for name in group.views)]


def _group_errors(manifest: Manifest, groups: Sequence[GroupPlan]) -> list[StageError]:
    """All steps of each group, with what is before and after them; not of one with a node whose
    time is not known, as after a resumed run."""
    times, rows = {**manifest.stages, **manifest.emulated}, list[StageError]()
    for group in groups:
        spans = [times[node] for node in _members(group) if node in times]
        resumed = any(f"{node}: {RESUMED}" in manifest.warnings for node in _members(group))
        if resumed or not spans or any(span["ended_s"] <= span["started_s"] for span in spans):
            continue
        measured_s = max(span["ended_s"] for span in spans) - min(span["started_s"] for span in spans)
        node = "cloud" if group.level == "cloud" else f"edges/{group.edges[0]}"
        rows.append(
            StageError(node=node, stage="together", num_cameras=group.num_photographs, predicted_s=group.seconds, measured_s=measured_s)
        )
    return rows


def _refining_error(system: System, edge_plans: Sequence[EdgePlan], manifest: Manifest, law: RefiningLaw) -> dict[str, Any] | None:
    """All rounds if every machine works for itself; None where none were taken, a node's time is
    not known (a resumed run), or machines are emulated, whose cloud is not."""
    nodes = [f"edges/{plan.edge_id}" for plan in edge_plans] + [f"devices/{name}" for plan in edge_plans for name in plan.device_ids]
    measured_s, number = 0.0, 0
    while refined_at("cloud", number + 1) in manifest.stages:
        number += 1
        spans = {node: manifest.stages.get(refined_at(node, number)) for node in ("cloud", *nodes)}
        spent_s = {node: span["ended_s"] - span["started_s"] for node, span in spans.items() if span is not None}
        if min(spent_s.values()) <= 0:
            return None
        measured_s += spent_s["cloud"] + max(
            max((spent_s.get(f"devices/{name}", 0.0) for name in plan.device_ids), default=0.0) + spent_s.get(f"edges/{plan.edge_id}", 0.0)
            for plan in edge_plans
        )
    if not number or manifest.emulated:
        return None
    predicted_s = predict_refining(system, edge_plans, replace(law, num_rounds=number), with_sending=False)
    num_cameras = sum(len(plan.camera_indices) for plan in edge_plans)
    return _row(StageError(node="all", stage="refine", num_cameras=num_cameras, predicted_s=predicted_s, measured_s=measured_s))


def curves_note(system: System) -> str:
    """Describe the curves of the predictions, in a sentence for each kind."""
    standard = even_system(1, 1)
    shape = curve_shape((standard.devices[0].init_s, standard.devices[0].train_s))
    groups: dict[str, list[str]] = {"default": [], "own": []}
    for machine in (*system.devices, *system.edges):
        is_default = (
            curve_shape((machine.init_s, machine.train_s)) == shape
            if isinstance(machine, Device)
            else machine.aggregate_s == standard.edges[0].aggregate_s
        )
        groups.setdefault(machine.origin or ("default" if is_default else "own"), []).append(machine.id)
    sentences: list[str] = []
    for origin, names in groups.items():
        if not names:
            continue
        machines = "all machines" if len(names) == len(system.devices) + len(system.edges) else _list_names(names)
        kind, _, name = origin.partition(" ")
        origin_text = {
            "default": "are a system file's defaults: guesses, not measured on this machine (`radiant machine profile` measures it)",
            "own": "are those of the system file; that they were measured on this machine and for this training is for it to say",
            "measured": f"were measured, profile {name}",
            "estimate": f"are estimates, never measured, profile {name}",
        }
        sentences.append(f"The curves of {machines} {origin_text[kind]}.")
    return " ".join(sentences)


def _list_names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= MAX_NAMES else f"{', '.join(names[:MAX_NAMES])} and {len(names) - MAX_NAMES} more"


def gantt_rows(system: System, edge_plans: Sequence[EdgePlan], run: Path | None = None, manifest: Manifest | None = None) -> list[Any]:
    """Rows of `gantt_picture`, edges above devices; with a run, measured bars from its start,
    and of machines that train together one bar each, measured alone."""
    from radiant_viewer.charts.charts import TimelineSpan
    from radiant_viewer.charts.gantt_chart import GanttRow

    planned = planned_stages(system, edge_plans)
    planned_of: dict[str, list[PlannedStage]] = {}
    for row in planned:
        planned_of.setdefault(row.node, []).append(row)
    bars: dict[str, tuple[Any, ...]] = {}
    if run is not None and manifest is not None:
        bars = _measured_bars(run, manifest)
    rows: list[Any] = []
    for plan in edge_plans:
        for node in (f"edges/{plan.edge_id}", *(f"devices/{name}" for name in plan.device_ids)):
            of_node = [] if run is not None and (run / node / GROUP_FOLDER).is_dir() else planned_of.get(node, [])
            predicted = tuple(TimelineSpan(stage=row.stage, start_s=row.start_s, stop_s=row.stop_s) for row in of_node)
            if predicted or node in bars:
                rows.append(GanttRow(name=node, predicted=predicted, measured=bars.get(node, ()), strong=node.startswith("edges/")))
    predicted = tuple(TimelineSpan(stage=row.stage, start_s=row.start_s, stop_s=row.stop_s) for row in planned_of.get("cloud", ()))
    if predicted or "cloud" in bars:
        rows.insert(0, GanttRow(name="cloud", predicted=predicted, measured=bars.get("cloud", ()), strong=True))
    return rows


def _measured_bars(run: Path, manifest: Manifest) -> dict[str, tuple[Any, ...]]:
    from radiant_viewer.charts.charts import TimelineSpan

    measured = measured_seconds(run, manifest)
    times: Mapping[str, Mapping[str, float]] = {**manifest.stages, **manifest.emulated}
    began_s = min((times[node]["started_s"] for node, _ in measured if node.startswith("devices/")), default=0.0)
    bars: dict[str, tuple[Any, ...]] = {}
    for node in dict.fromkeys(node for node, _ in measured if node != "cloud"):
        at_s = max(0.0, times[node]["started_s"] - began_s)
        spans: list[Any] = []
        stages = {stage: measured.get((node, stage)) for stage in ("initialise", "train", "aggregate", "send")}
        if (run / node / GROUP_FOLDER).is_dir():
            # It waits for others in every step.
            stages = {"train": sum(seconds or 0.0 for seconds in stages.values())}
        for stage, seconds in stages.items():
            if seconds is not None:
                spans.append(TimelineSpan(stage=stage, start_s=at_s, stop_s=at_s + seconds))
                at_s += seconds
        bars[node] = tuple(spans)
    if bars and (cloud := manifest.stages.get("cloud")) is not None and cloud["ended_s"] > cloud["started_s"] >= began_s:
        bars["cloud"] = (TimelineSpan(stage="merge", start_s=cloud["started_s"] - began_s, stop_s=cloud["ended_s"] - began_s),)
    return bars


def _online_errors(
    system: System, edge_plans: Sequence[EdgePlan], manifest: Manifest, measured: Mapping[tuple[str, str], float]
) -> list[dict[str, Any]]:
    """The error of what remained after each machine, as planned and as corrected by then."""
    planned = planned_stages(system, edge_plans)
    times = manifest.emulated or manifest.stages
    order = sorted({row.node for row in planned if any(node == row.node for node, _ in measured)}, key=lambda node: times[node]["ended_s"])
    rows: list[dict[str, Any]] = []
    for position, node in enumerate(order[:-1]):
        so_far = {key: seconds for key, seconds in measured.items() if key[0] in order[: position + 1]}
        corrected = planned_stages(correct_system(system, planned, so_far), edge_plans)
        remaining = set(order[position + 1 :])
        before, after = (_node_errors(stages, measured, remaining) for stages in (planned, corrected))
        rows.append({"after": node, "remaining": len(remaining), "planned_percent": before, "corrected_percent": after})
    return rows


def _node_errors(stages: Sequence[PlannedStage], measured: Mapping[tuple[str, str], float], nodes: set[str]) -> float:
    """Median |error| in % of the whole times of nodes."""
    errors = [row for row in stage_errors(stages, measured) if row.node in nodes]
    totals = [
        StageError(
            node=node,
            stage="all",
            num_cameras=0,
            predicted_s=sum(row.predicted_s for row in errors if row.node == node),
            measured_s=sum(row.measured_s for row in errors if row.node == node),
        )
        for node in sorted(nodes)
    ]
    return _median_error(totals) or 0.0


def _median_error(errors: Sequence[StageError]) -> float | None:
    percents = [abs(error.error_percent) for error in errors if error.error_percent is not None]
    return float(np.median(percents)) if percents else None


def _row(error: StageError) -> dict[str, Any]:
    return {**asdict(error), "error_percent": error.error_percent}
