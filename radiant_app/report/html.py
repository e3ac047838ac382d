"""report.html: one self-contained page of a finished run with its pictures. Once per run."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import jinja2
import numpy as np

from radiant_app.events import UPLINK
from radiant_app.files.run_folder import Manifest, software_versions
from radiant_app.files.system_file import load_system
from radiant_app.run.cloud_planning import STAGE
from radiant_app.run.prediction_error import SYSTEM_NAME, gantt_rows
from radiant_core.aggregate.tree import refined_at
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import read_json, write_atomic
from radiant_core.plan.plans import CloudPlan, EdgePlan

if TYPE_CHECKING:
    from radiant_viewer.pictures.images import Image

MAX_COMPARISONS = 12
"""Photographs shown beside their renders: the worst, the best and some between."""

TIERS = ("device", "edge", "cloud", "owner")
GIVEN = {
    True: {
        "device": "its photographs, their poses and the points they see",
        "edge": "its devices' models and cameras",
        "cloud": "edges' models and borders; virtual cameras where it retrains",
        "owner": "all photographs: places them, plans, deals them out, scores",
    },
    False: {
        "device": "beside its own photographs, the finished scene and its borders",
        "edge": "its devices' models and poses, under numbers",
        "cloud": "edges' models, virtual cameras and borders; where it plans, counts in cells",
        "owner": "what devices sent for the plan",
    },
}
"""What the nodes of a tier were given, by whether one owner pooled the photographs."""

REFINING = {"devices": "refine", "edges": "average", "cloud": "finish"}
"""What the nodes of a tier do when the scene is refined."""

GANTT_TEXT = {
    False: "Predicted for machines that all work at once; measured here, where processes wait for a free core. Nothing was sent.",
    True: "Measured: machines and links as emulated here.",
}


def write_report(run: Path, manifest: Manifest, metrics: dict[str, Any]) -> Path:
    """Make the pictures and the page; returns the page's path."""
    cloud_plan, edge_plans = load_plan(run / "plan.json")
    pictures = _save_pictures(run, manifest, has_borders=sum(len(border) > 0 for border in cloud_plan.borders) > 1)
    template = jinja2.Environment(
        loader=jinja2.PackageLoader("radiant_app"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).get_template("report.html.j2")
    page = template.render(
        title=Path(manifest.config["source"]).parent.name or "run",
        manifest=manifest,
        metrics=metrics,
        unscored=describe_unscored(metrics),
        frame=_frame_facts(run),
        pooled=metrics.get("pooled", True),
        planned_by_raster=(run / STAGE / "task.json").is_file(),
        access_tiers=access_by_tier(manifest.access_log, shared="leakage" not in metrics),
        pictures={name: _embed(path) for name, path in pictures.items()},
        comparisons=[_comparison(run, row) for row in select_images(metrics["images"]) if _has_pictures(run, row)],
        nodes=_node_rows(run, manifest, cloud_plan, edge_plans),
        plan=cloud_plan,
        versions=software_versions(),
    )
    write_atomic(run / "report.html", page.encode())
    return run / "report.html"


def describe_unscored(metrics: Mapping[str, Any]) -> str:
    """Return where the held-out photographs are that have no figures, as the end of a sentence."""
    causes = [
        f"lie on {kind} ({', '.join(devices)})"
        for kind, devices in (
            ("missing devices", metrics.get("missing", ())),
            ("devices that ended without figures when they scored the scene", metrics.get("failed_scoring", ())),
        )
        if devices
    ]
    return f"the others {' or '.join([*causes, 'have no known pose'])}"


def access_by_tier(access_log: Sequence[Mapping[str, Any]], *, shared: bool) -> list[dict[str, Any]]:
    """A row per tier, devices to owner: what its nodes received together, in bytes and in words."""
    rows = []
    for tier in TIERS:
        own = [row for row in access_log if row["tier"] == tier]
        if own:
            sums = {key: sum(row[key] for row in own) for key in ("num_photographs", "photograph_bytes", "other_bytes")}
            nodes = {row["node"].removesuffix("/score").removesuffix("/refine") for row in own}
            rows.append({"tier": tier, "num_nodes": len(nodes), **sums, "given": GIVEN[shared][tier]})
    return rows


def select_images(images: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """At most `MAX_COMPARISONS` rows, worst first, evenly over the range of PSNR."""
    ordered = sorted(images, key=lambda row: row["psnr_db"])
    if len(ordered) <= MAX_COMPARISONS:
        return ordered
    return [ordered[int(index)] for index in np.linspace(0, len(ordered) - 1, MAX_COMPARISONS).round()]


def _save_pictures(run: Path, manifest: Manifest, *, has_borders: bool) -> dict[str, Path]:
    from radiant_viewer.charts.charts import timeline_picture
    from radiant_viewer.charts.gantt_chart import gantt_picture
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.run_pictures import screenshot

    folder = run / "pictures"
    images: dict[str, Image] = {}
    if (run / SYSTEM_NAME).is_file():
        rows = gantt_rows(load_system(run / SYSTEM_NAME), load_plan(run / "plan.json")[1], run, manifest)
        images["gantt"] = gantt_picture(rows, "Predicted and measured", GANTT_TEXT[bool(manifest.emulated)])
    images["timeline"] = timeline_picture(_timeline_rows(manifest.stages), title="Measured on this machine")
    if manifest.emulated:
        images["timeline_emulated"] = timeline_picture(timeline_of_emulation(manifest), title="Emulated speeds and links")
    for view in ("regions", "cameras", "splats", *(["seams"] if has_borders else [])):
        images[view] = screenshot(run, view)
    folder.mkdir(exist_ok=True)
    for name, image in images.items():
        save_png(folder / f"{name}.png", image)
    return {name: folder / f"{name}.png" for name in images}


def timeline_of_emulation(manifest: Manifest) -> list[Any]:
    """The rows of emulated machines, and of the cloud, which they wait for."""
    cloud = {stage: manifest.stages[stage] for stage in ("cloud", refined_at("cloud")) if stage in manifest.stages}
    return _timeline_rows({**manifest.emulated, **cloud})


def _timeline_rows(stages: Mapping[str, Mapping[str, float]]) -> list[Any]:
    """One row per process in the order they started; sending in the end is a span of its own."""
    from radiant_viewer.charts.charts import TimelineRow, TimelineSpan

    kinds = {
        "devices": "train",
        "edges": "aggregate",
        "cloud": "merge",
        "evaluation": "evaluate",
        "sfm": "structure from motion",
        "positions": "plan",
        "planning": "plan",
    }
    rows = []
    nodes = {stage: times for stage, times in stages.items() if not stage.endswith(UPLINK)}
    for stage, times in sorted(nodes.items(), key=lambda item: item[1]["started_s"]):
        tier, part = stage.split("/")[0], stage.rsplit("/", 1)[-1]
        kind = {"score": "evaluate", "refine": REFINING.get(tier)}.get(part) or kinds[tier]
        sending = stages.get(stage + UPLINK, {"started_s": times["ended_s"], "ended_s": times["ended_s"]})
        parts = ((kind, times["started_s"], sending["started_s"]), ("send", sending["started_s"], sending["ended_s"]))
        spans = tuple(
            TimelineSpan(stage=name, start_s=start_s, stop_s=stop_s)
            for name, start_s, stop_s in parts
            if name != "send" or stop_s > start_s
        )
        rows.append(TimelineRow(name=stage, spans=spans, strong=not stage.startswith("devices/")))
    return rows


def _has_pictures(run: Path, row: dict[str, Any]) -> bool:
    return (run / "pictures" / "photographs" / f"{row['name']}.png").is_file()


def _comparison(run: Path, row: dict[str, Any]) -> dict[str, Any]:
    from radiant_viewer.pictures.images import load_image

    name = f"{row['name']}.png"
    folder = run / "pictures"
    strip = np.hstack([load_image(folder / kind / name) for kind in ("photographs", "renders", "differences")])
    encoded, data = cv2.imencode(".jpg", strip[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    assert encoded
    return {**row, "picture": _data_uri("image/jpeg", data.tobytes())}


def _node_rows(run: Path, manifest: Manifest, cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan]) -> list[dict[str, Any]]:
    rows = []
    for index, plan in enumerate(edge_plans):
        for device, planned_s in zip(plan.device_ids, plan.device_time_s, strict=True):
            rows.append(_node_row(run, manifest, f"devices/{device}", len(plan.cameras_of(device)), float(planned_s)))
        edge = cloud_plan.edge_ids[index]
        rows.append(_node_row(run, manifest, f"edges/{edge}", len(plan.camera_indices), float(cloud_plan.edge_time_s[index])))
    return rows


def _node_row(run: Path, manifest: Manifest, node: str, num_cameras: int, planned_s: float) -> dict[str, Any]:
    idle = {"num_splats": 0, "num_steps": 0, "train_s": 0.0, "model_bytes": 0}
    path = run / node / "summary.json"
    summary = read_json(path, tuple(idle)) if num_cameras and path.is_file() else idle
    return {
        "node": node,
        "num_cameras": num_cameras,
        "planned_s": planned_s,
        "measured_s": _seconds(manifest.stages, node),
        "emulated_s": _seconds(manifest.emulated, node),
        "sending_s": _seconds(manifest.emulated, node + UPLINK),
        "peak_mb": manifest.peak_bytes[node] / 1e6 if node in manifest.peak_bytes else None,
        "seconds_per_step": summary["train_s"] / max(1, summary["num_steps"]),
        **{key: summary[key] for key in ("num_splats", "num_steps", "model_bytes")},
    }


def _seconds(stages: Mapping[str, Mapping[str, float]], stage: str) -> float | None:
    return stages[stage]["ended_s"] - stages[stage]["started_s"] if stage in stages else None


def _frame_facts(run: Path) -> dict[str, Any]:
    from radiant_core.io.records import load_scene

    in_the_field = (run / "delivered").is_dir()
    scene = load_scene(run / ("delivered" if in_the_field else "sfm") / "scene.safetensors")
    unregistered = [] if in_the_field else read_json(run / "sfm" / "result.json", ("unregistered",))["unregistered"]
    return {
        "kind": scene.frame.kind,
        "unit": scene.frame.unit,
        "residual_m": scene.frame.residual_m,
        "num_cameras": len(scene.cameras),
        "num_points": None if in_the_field else len(scene.points),
        "unregistered": unregistered,
    }


def _embed(path: Path) -> str:
    return _data_uri("image/png", path.read_bytes())


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
