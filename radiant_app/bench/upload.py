"""Benchmark of upload formats: bytes per Gaussian beside what they cost in dB, on the device models of a finished run.

Two errors: renders of the decoded model against renders of the float32 model at the device's own cameras, equal pictures counting as
100 dB; and the PSNR of the run's held-out photographs when every upload, device to edge and edge to cloud, went through the format. Equal
for all formats: device models, cameras, retraining, seeds. Encoding and decoding: best of three, file included. `quick`: two
devices, no retraining, hence no held-out figure.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

import numpy as np

from radiant_app.commands.steps import require_run
from radiant_app.report.progress import tracked
from radiant_app.workers.nodes import load_images
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.metric import Metric
from radiant_core.io.records import load_cameras, load_plan, load_splats
from radiant_core.io.run_store import read_json
from radiant_core.io.transport.upload import UploadFormat, load_upload, save_upload
from radiant_core.splats import Splats

_REPEATS = 3
_FORMATS: tuple[UploadFormat, ...] = get_args(UploadFormat)


@dataclass(frozen=True, kw_only=True)
class EdgeOfRun:
    """One edge of a finished run: its devices' float32 models with their cameras at training size, and how it joined them."""

    name: str
    models: tuple[Splats, ...]
    cameras: tuple[Cameras, ...]
    task: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class _Coded:
    """One model through one format."""

    num_splats: int
    num_bytes: int
    encode_s: float
    decode_s: float
    psnr_db: tuple[float, ...]


def bench_upload(run: Path, quick: bool) -> list[Metric]:
    """`upload.<run>.<format>.<bytes_per_gaussian|share|psnr_db|psnr_min_db|encode_ms|decode_ms|held_out_psnr_db|held_out_change_db>`.

    `run` is a finished run with its device models. Raises BadInput when it is not.
    """
    edges = edges_of_run(run)
    pairs = [pair for edge in edges for pair in zip(edge.models, edge.cameras, strict=True)][: 2 if quick else None]
    coded: dict[UploadFormat, list[_Coded]] = {name: [] for name in _FORMATS}
    with TemporaryDirectory(prefix="radiant-bench-upload-") as folder:
        path = Path(folder) / "upload.safetensors"
        for model, cameras in tracked(pairs, "bench upload"):
            for name in _FORMATS:
                coded[name].append(_coded(model, cameras, name, path))
        held_out = {} if quick else {name: _held_out_psnr_db(run, edges, name, path) for name in tracked(_FORMATS, "retraining")}
    exact_bytes = sum(one.num_bytes for one in coded["float32"])
    metrics = []
    for name, models in coded.items():
        key = f"upload.{run.name}.{name}"
        metrics += _format_metrics(key, models, exact_bytes)
        if name in held_out:
            metrics.append(Metric(key=f"{key}.held_out_psnr_db", value=held_out[name], unit="dB", direction="higher", tolerance=0.05))
            change = held_out[name] - held_out["float32"]
            metrics.append(Metric(key=f"{key}.held_out_change_db", value=change, unit="dB", direction="higher", tolerance=0.05))
    return metrics


def edges_of_run(run: Path) -> list[EdgeOfRun]:
    """The edges of a finished run in the order of its plan; BadInput when it has none or misses a model."""
    require_run(run)
    edges = []
    for plan in load_plan(run / "plan.json")[1]:
        folder = run / "edges" / plan.edge_id
        if not len(plan.camera_indices):
            continue
        task = read_json(folder / "task.json", ("devices", "train", "aggregate"))
        side_px = task["train"]["long_side_px"]
        cameras = [load_cameras(folder / "inbox" / device / "cameras.safetensors").scaled(side_px) for device in task["devices"]]
        models = [load_splats(run / "devices" / device / "model.safetensors") for device in task["devices"]]
        edges.append(EdgeOfRun(name=plan.edge_id, models=tuple(models), cameras=tuple(cameras), task=task))
    if not edges:
        raise BadInput(f"{run} has no edge with photographs: give the folder of a finished run.")
    return edges


def _coded(model: Splats, cameras: Cameras, upload_format: UploadFormat, path: Path) -> _Coded:
    from radiant_core.evaluate.image_error import psnr_db
    from radiant_core.render.rendered_view import render_views

    encode_s, _ = _best_s(lambda: save_upload(path, model, upload_format))
    decode_s, decoded = _best_s(lambda: load_upload(path))
    pairs = zip(render_views(decoded, cameras), render_views(model, cameras), strict=True)
    return _Coded(
        num_splats=len(model),
        num_bytes=path.stat().st_size,
        encode_s=encode_s,
        decode_s=decode_s,
        psnr_db=tuple(psnr_db(view.image, exact.image) for view, exact in pairs),
    )


def _best_s(work: Callable[[], Any]) -> tuple[float, Any]:
    seconds, result = [], None
    for _ in range(_REPEATS):
        start_s = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - start_s)
    return min(seconds), result


def _held_out_psnr_db(run: Path, edges: Sequence[EdgeOfRun], upload_format: UploadFormat, path: Path) -> float:
    """PSNR of the run's held-out photographs after joining what the edges and the cloud received in this format."""
    from radiant_core.aggregate.config import AggregateConfig
    from radiant_core.aggregate.crop_merge import crop_merge
    from radiant_core.aggregate.retrain import retrain_on_synthetic_views
    from radiant_core.aggregate.synthetic_views import Teacher
    from radiant_core.evaluate.image_error import psnr_db
    from radiant_core.render.rendered_view import render_views
    from radiant_core.train.config import TrainConfig
    from radiant_core.train.trainer import FitOptions

    def received(model: Splats) -> Splats:
        save_upload(path, model, upload_format)
        return load_upload(path)

    models = []
    for edge in edges:
        train, aggregate = TrainConfig(**edge.task["train"]), AggregateConfig(**edge.task["aggregate"])
        teachers = [Teacher(splats=received(model), cameras=own) for model, own in zip(edge.models, edge.cameras, strict=True)]
        joined = retrain_on_synthetic_views(teachers, train, aggregate, FitOptions())
        models.append(received(joined.splats))
    plan, _ = load_plan(run / "plan.json")
    rows = [plan.edge_ids.index(edge.name) for edge in edges]
    scene = crop_merge(models, plan.sites[rows], plan.weights[rows]).splats
    cameras = load_cameras(run / "evaluation" / "cameras.safetensors")
    photographs = load_images(run / "evaluation" / "photos", cameras)
    views = render_views(scene, cameras)
    return float(np.mean([psnr_db(view.image, photo / 255) for view, photo in zip(views, photographs, strict=True)]))


def _format_metrics(key: str, models: Sequence[_Coded], exact_bytes: int) -> list[Metric]:
    num_bytes, num_splats = sum(one.num_bytes for one in models), sum(one.num_splats for one in models)
    psnrs_db = [figure for one in models for figure in one.psnr_db]
    encode_ms, decode_ms = (1e3 * sum(getattr(one, name) for one in models) for name in ("encode_s", "decode_s"))
    return [
        Metric(key=f"{key}.bytes_per_gaussian", value=num_bytes / num_splats, unit="bytes", direction="lower", tolerance=1),
        Metric(key=f"{key}.share", value=num_bytes / exact_bytes, unit="1", direction="lower", tolerance=0.01),
        Metric(key=f"{key}.psnr_db", value=float(np.mean(psnrs_db)), unit="dB", direction="higher", tolerance=0.5),
        Metric(key=f"{key}.psnr_min_db", value=min(psnrs_db), unit="dB", direction="higher", tolerance=1),
        Metric(key=f"{key}.encode_ms", value=encode_ms, unit="ms", direction="lower", tolerance=encode_ms),
        Metric(key=f"{key}.decode_ms", value=decode_ms, unit="ms", direction="lower", tolerance=decode_ms),
    ]
