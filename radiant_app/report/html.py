"""report.html: one self-contained page of a finished run with its pictures. Once per run."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import jinja2
import markupsafe
import numpy as np

from radiant_app.events import UPLINK, Listener, StageDone, StageProgress, StageStarted
from radiant_app.files.run_folder import PLANNING_FOLDER, Manifest, software_versions
from radiant_app.files.system_file import load_system
from radiant_app.pace import clock_text
from radiant_app.report.advice import what_to_try
from radiant_app.report.gaps import gaps_of, notes_of
from radiant_app.report.ground_control import survey_lines, survey_of_run, survey_rows
from radiant_app.report.prediction_error import SYSTEM_NAME, gantt_rows
from radiant_app.report.survey import Survey, survey_of
from radiant_app.report.verdict import verdict_of
from radiant_app.together.places import GROUP_FOLDER
from radiant_app.workers.sources import POSITIONS
from radiant_core.aggregate.tree import refines_for
from radiant_core.errors import BadInput
from radiant_core.garbage import without_garbage_search
from radiant_core.io.records import load_plan, load_scene
from radiant_core.io.run_store import read_json, stays_inside, write_atomic
from radiant_core.plan.plans import CloudPlan, EdgePlan

if TYPE_CHECKING:
    from radiant_viewer.pictures.images import Image

MAX_COMPARISONS = 12
"""Photographs shown beside their renders: the worst, the best and some between."""

FLIGHT_NAME, MAX_FLIGHT_GAUSSIANS = "scene.html", 500_000
"""The page of the model beside the report, and up to which size a run makes it: some 15 MB."""
JPEG_QUALITY = 84
OF_THE_MODEL = ("seams",)
"""Pictures that are too large as PNG."""
NUM_SIDES, SIDE_WH = 24, (1080, 700)
"""Pictures of the model at the head of a report, all around it, to be turned by hand."""
NAMELESS = frozenset({"images", "image", "photos", "photographs", "pictures", "input", "dcim"})
"""Names of folders that say nothing of what is in them."""
TIERS = ("device", "edge", "cloud", "owner")
RECEIVED_TEXTS = {
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

REPORT, PARTS = "report", ("the plan and its borders", "the model from all around", "the page that flies through it")
"""What listeners hear: a stage that comes after those of a run, and its steps. Pictures of four
million Gaussians take a minute and a half."""

REFINING = {"devices": "refine", "edges": "average", "cloud": "finish"}
"""What the nodes of a tier do when the scene is refined."""

GANTT_TEXT = {
    False: "Predicted for machines that all work at once; measured here, where processes wait for a free core. Nothing was sent.",
    True: "Measured: machines and links as emulated here.",
}


def write_report(run: Path, manifest: Manifest, metrics: dict[str, Any], listen: Listener = lambda event: None) -> Path:
    """Make the pictures and the page; returns the page's path. `listen` hears how far it is."""
    begun_s = time.monotonic()
    listen(StageStarted(stage=REPORT))
    cloud_plan, edge_plans = load_plan(run / "plan.json")
    pictures = _save_pictures(run, manifest, listen, has_borders=sum(len(border) > 0 for border in cloud_plan.borders) > 1)
    sides, flight = _save_sides(run, listen), _save_flight(run, listen)
    survey = _survey(run, manifest)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("radiant_app"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["words"] = with_code
    page = environment.get_template("report.html.j2").render(
        title=title_of(manifest.config["source"]),
        survey=survey,
        verdict=verdict_of(metrics),
        advice=what_to_try(metrics, manifest.decisions),
        gaps=gaps_of(metrics, survey.frame),
        notes=notes_of(metrics, manifest.warnings),
        times=_times(manifest),
        sides=sides,
        flight=flight,
        duration=clock_text(manifest.ended_s) + (" min" if manifest.ended_s < 3600 else " h"),
        manifest=manifest,
        metrics=metrics,
        ground_control=None if (control := survey_of_run(run)) is None else (survey_lines(control), survey_rows(control)),
        unscored=describe_unscored(metrics),
        pooled=metrics.get("pooled", True),
        planned_by_raster=(run / PLANNING_FOLDER / "task.json").is_file(),
        access_tiers=access_by_tier(manifest.access_log, shared="leakage" not in metrics),
        pictures={name: _embed(path) for name, path in pictures.items()},
        comparisons=[_comparison(run, row) for row in select_images(metrics["images"]) if _has_pictures(run, row)],
        nodes=_node_rows(run, manifest, cloud_plan, edge_plans),
        plan=cloud_plan,
        settings=dict(_flat(manifest.config)),
        versions=software_versions(),
    )
    write_atomic(run / "report.html", page.encode())
    listen(StageDone(stage=REPORT, seconds=time.monotonic() - begun_s))
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
        rows_of_tier = [row for row in access_log if row["tier"] == tier]
        if rows_of_tier:
            sums = {key: sum(row[key] for row in rows_of_tier) for key in ("num_photographs", "photograph_bytes", "other_bytes")}
            nodes = {refines_for(row["node"].removesuffix("/score")) for row in rows_of_tier}
            rows.append({"tier": tier, "num_nodes": len(nodes), **sums, "given": RECEIVED_TEXTS[shared][tier]})
    return rows


def select_images(images: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """At most `MAX_COMPARISONS` rows, worst first, evenly over the range of PSNR."""
    ordered = sorted(images, key=lambda row: row["psnr_db"])
    if len(ordered) <= MAX_COMPARISONS:
        return ordered
    return [ordered[int(index)] for index in np.linspace(0, len(ordered) - 1, MAX_COMPARISONS).round()]


def _tell(listen: Listener, part: int, num_done: int, total: int) -> None:
    listen(StageProgress(stage=REPORT, done=num_done, total=total, phase=PARTS[part], step=part + 1, num_steps=len(PARTS)))


def _save_pictures(run: Path, manifest: Manifest, listen: Listener, *, has_borders: bool) -> dict[str, Path]:
    with without_garbage_search():
        from radiant_viewer.charts.charts import timeline_picture
        from radiant_viewer.charts.gantt_chart import gantt_picture
        from radiant_viewer.pictures.images import save_png
        from radiant_viewer.pictures.page import PHONE_SIZE_WH
        from radiant_viewer.runs.run_pictures import screenshot

    folder = run / "pictures"
    images: dict[str, Image] = {}
    if (run / SYSTEM_NAME).is_file():
        rows = gantt_rows(load_system(run / SYSTEM_NAME), load_plan(run / "plan.json")[1], run, manifest)
        images["gantt"] = gantt_picture(rows, "Predicted and measured", GANTT_TEXT[bool(manifest.emulated)])
    images["timeline"] = timeline_picture(_timeline_rows(manifest.stages), title="Measured on this machine")
    if manifest.emulated:
        images["timeline_emulated"] = timeline_picture(timeline_of_emulation(manifest), title="Emulated speeds and links")
    views = ("regions", "cameras", *(["seams"] if has_borders else []))
    for number, view in enumerate(views):
        _tell(listen, 0, number, len(views))
        images[view] = screenshot(run, view)
    images["regions_phone"] = screenshot(run, "regions", PHONE_SIZE_WH)
    _tell(listen, 0, len(views), len(views))
    folder.mkdir(exist_ok=True)
    for name, image in images.items():
        save_png(folder / f"{name}.png", image)
    return {name: folder / f"{name}.png" for name in images}


def _times(manifest: Manifest) -> dict[str, dict[str, Any]]:
    """The timelines as a phone shows them, by the name of their picture."""
    from radiant_app.report.phone import timeline_lines

    rows = {"timeline": _timeline_rows(manifest.stages), "timeline_emulated": timeline_of_emulation(manifest) if manifest.emulated else []}
    return {name: timeline_lines(node_rows) for name, node_rows in rows.items()}


def timeline_of_emulation(manifest: Manifest) -> list[Any]:
    """The rows of emulated machines, and of the cloud, which they wait for."""
    cloud = {stage: times for stage, times in manifest.stages.items() if refines_for(stage) == "cloud"}
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
        kind = REFINING[tier] if refines_for(stage) != stage else "evaluate" if part == "score" else kinds[tier]
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
    """Whether the run has the pictures of a scored photograph; a name that leads out of its folder
    has none."""
    return stays_inside(row["name"]) and (run / "pictures" / "photographs" / f"{row['name']}.png").is_file()


def _comparison(run: Path, row: dict[str, Any]) -> dict[str, Any]:
    from radiant_viewer.pictures.images import load_image

    name = f"{row['name']}.png"
    kinds = {"Photograph": "photographs", "Render": "renders", "Difference": "differences"}
    return {**row, "pictures": {kind: _jpeg(load_image(run / "pictures" / folder / name)) for kind, folder in kinds.items()}}


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
    summary = {**idle, **read_json(path)} if num_cameras and path.is_file() else idle
    return {
        "node": node,
        "num_cameras": num_cameras,
        # The time of a group is not that of its machines.
        "planned_s": None if (run / node / GROUP_FOLDER).is_dir() else planned_s,
        "measured_s": _seconds(manifest.stages, node),
        "emulated_s": _seconds(manifest.emulated, node),
        "sending_s": _seconds(manifest.emulated, node + UPLINK),
        "peak_mb": manifest.peak_bytes[node] / 1e6 if node in manifest.peak_bytes else None,
        "seconds_per_step": summary["train_s"] / max(1, summary["num_steps"]),
        **{key: summary[key] for key in ("num_splats", "num_steps", "model_bytes")},
    }


def _seconds(stages: Mapping[str, Mapping[str, float]], stage: str) -> float | None:
    return stages[stage]["ended_s"] - stages[stage]["started_s"] if stage in stages else None


def _survey(run: Path, manifest: Manifest) -> Survey:
    """The survey of a run; of photographs that lie on devices nothing but their poses is known."""
    if (run / "delivered").is_dir():
        return survey_of(load_scene(run / "delivered" / "scene.safetensors"), 0, None)
    scene = load_scene(run / "sfm" / "scene.safetensors")
    record = read_json(run / "sfm" / "result.json", ("unregistered",))
    photographs = _photographs_in(Path(manifest.config["source"]), scene.cameras.names)
    return survey_of(scene, len(record["unregistered"]), photographs, record.get(POSITIONS))


def _photographs_in(source: Path, names: Sequence[str]) -> Path | None:
    """Where under a source the photographs lie, whose undistorted copies have no EXIF."""
    folders = (source, source / "images", source.parent / "images")
    return next((folder for folder in folders if names and (folder / names[0]).is_file()), None)


def title_of(source: str) -> str:
    """The name of what was surveyed: of the folder of photographs, or of the one around it where
    that says no more than that photographs are in it."""
    path = Path(source)
    return (path.parent.name if path.name.lower() in NAMELESS else path.name) or "run"


def with_code(text: str) -> markupsafe.Markup:
    """Text for HTML, in which what stands between backticks is code."""
    parts = str(markupsafe.escape(text)).split("`")
    if len(parts) % 2 == 0:
        # One backtick is alone: they are all taken as they are.
        return markupsafe.Markup("`").join(map(markupsafe.Markup, parts))
    codes = (f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
    return markupsafe.Markup("").join(map(markupsafe.Markup, codes))


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The settings that have a value, by dotted path."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", value


def _save_sides(run: Path, listen: Listener) -> list[str]:
    """The model from all around as images for the page; the first one is kept as a file too."""
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.pictures.turntable import turntable
    from radiant_viewer.runs.run_view import load_run_view, require_splats
    from radiant_viewer.runs.shown_model import framed_box

    view = load_run_view(run)
    sides: list[str] = []
    _tell(listen, 1, 0, NUM_SIDES)
    for image in turntable(require_splats(view), framed_box(view.scene, view.cloud_plan), NUM_SIDES, SIDE_WH):
        if not sides:
            save_png(run / "pictures" / "model.png", image)
        sides.append(_jpeg(image))
        _tell(listen, 1, len(sides), NUM_SIDES)
    return sides


def _save_flight(run: Path, listen: Listener) -> str:
    """The page that flies through the model, one file beside the report; its name, or nothing where
    the model is large: `radiant inspect --page` streams it."""
    from radiant_app.report.known_scale import page_scale
    from radiant_viewer.runs.run_view import load_run_view, require_splats
    from radiant_viewer.share.folder import page_of_run, save_single_page

    _tell(listen, 2, 0, 1)
    view = load_run_view(run)
    if len(require_splats(view)) > MAX_FLIGHT_GAUSSIANS:
        (run / FLIGHT_NAME).unlink(missing_ok=True)
        return ""
    try:
        save_single_page(run / FLIGHT_NAME, page_of_run(view, with_photographs=False, scale=page_scale(view)))
    except BadInput:  # too large for one file after all: the run is done without it
        (run / FLIGHT_NAME).unlink(missing_ok=True)
        return ""
    return FLIGHT_NAME


def _jpeg(image: Image) -> str:
    encoded, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert encoded
    return _data_uri("image/jpeg", data.tobytes())


def _embed(path: Path) -> str:
    """A picture for the page: charts as they are, what shows the model as JPEG."""
    from radiant_viewer.pictures.images import load_image

    return _jpeg(load_image(path)) if path.stem in OF_THE_MODEL else _data_uri("image/png", path.read_bytes())


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
