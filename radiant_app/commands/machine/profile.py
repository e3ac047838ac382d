"""`radiant machine profile`: cost curves of this machine, from a short real run or a finished one's
times.

Without photographs the sample town is trained. A count of photographs in the middle is predicted
from the others and compared with its measurement; the written curves are fitted on all.
"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.commands.machine.exchange_time import ExchangeTime, measure_exchange
from radiant_app.commands.machine.profiling import STAGE, DeviceSample, EdgeSample, Measured, Measuring
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.steps import require_file_to_be, require_run, training_part, warn_of
from radiant_app.config.run_config import ExecutionOptions
from radiant_app.events import Listener, StageDone, StageStarted, Warned
from radiant_app.executors.fork_server import keep_servers
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.out_folder import folder_made_for
from radiant_app.files.profile_file import KIND, SUFFIXES, library_profiles, load_profile, save_profile
from radiant_app.files.run_folder import read_manifest, require_current
from radiant_app.run.predictions import planned_training, share_of_epochs, training_key_of
from radiant_app.workers.sources import detect_source, has_scene, images_folder_of, load_scene_of, sfm_task
from radiant_core.aggregate.config import EDGE_EPOCHS
from radiant_core.errors import BadInput, StageFailed
from radiant_core.hierarchy.codec import save_task, task_setting
from radiant_core.io.records import load_plan, load_scene
from radiant_core.io.run_store import read_json
from radiant_core.plan.profiles.curve_fit import FittedCurve, falls, fit_curve
from radiant_core.plan.profiles.profile import Profile, ProfileKey
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.config import Preset
from radiant_core.train.needs import Overrides

DEFAULT_TIME_S = 240.0
TABLE_COLUMNS = 80
_DEVICE_CURVES = ("init_s", "train_s", "model_bytes")


@dataclass(frozen=True, kw_only=True)
class ProfileRequest:
    """What `radiant machine profile` was asked for."""

    out: Path
    """The curve file to write, .toml or .json."""
    source: Path | None = None
    """Photographs, a COLMAP project, a folder of `radiant sfm` or a run; None: the sample town."""
    preset: Preset = "default"
    overrides: Overrides = Overrides()
    time_s: float = DEFAULT_TIME_S
    """Seconds of measuring; structure from motion, where there is no scene yet, comes on top."""
    num_workers: int = field(default_factory=lambda: ExecutionOptions().num_workers)
    """Processes side by side, as in the runs to be planned; of a device that works alone: 1."""
    num_threads: int | None = None
    """Threads of a process; None: as a run shares out the cores among its workers."""
    machine: str | None = None
    """Its name in warnings; None: processor, GPU, threads and processes."""

    def __post_init__(self) -> None:
        if not 0 < self.time_s < np.inf:
            raise BadInput(f"--time is {self.time_s}, expected a positive number of seconds.")
        if self.num_threads is not None and self.num_threads < 1:
            raise BadInput(f"--threads is {self.num_threads}, expected at least 1.")
        if self.num_workers < 1:
            raise BadInput(f"--workers is {self.num_workers}, expected at least 1.")
        _require_place(self.out)


def profile(request: ProfileRequest, listen: Listener, clock: Callable[[], float] = time.monotonic) -> dict[str, Any]:
    """Measure this machine and write its curve file; returns what the command line prints. Raises
    BadInput for unusable input, StageFailed when a training fails; no file is written then."""
    from radiant_core.render.backends import resolve_backend

    backend = resolve_backend("auto")
    train = planned_training(request.preset, request.overrides)
    with tempfile.TemporaryDirectory(prefix="radiant_profile_") as name:
        work = Path(name)
        scene, images = _scene(request.source, work, listen)
        training = training_part(scene)
        begun_s = clock()
        listen(StageStarted(stage=STAGE))
        nodes = Measuring(
            work=work,
            scene=training,
            images=images,
            train=train,
            backend=backend,
            num_workers=request.num_workers,
            num_threads=request.num_threads,
            listen=listen,
            clock=clock,
        )
        with keep_servers():
            measured = nodes.measure(request.time_s)
        exchange = _exchange(listen)
        seconds = clock() - begun_s
        listen(StageDone(stage=STAGE, seconds=seconds))
    subject = "the sample town" if request.source is None else f"{len(training.cameras)} photographs"
    joining = f"{measured.num_epochs} epochs of retraining at edges"
    source = f"radiant machine profile on {subject}, {measured.num_steps:,} steps, {joining}, {seconds:.0f} s"
    key = training_key_of(train, request.preset)
    machine = request.machine or machine_label(request.num_threads, request.num_workers)
    return _told(_write_profile(request.out, measured, key, machine, source, exchange), listen)


def _exchange(listen: Listener) -> ExchangeTime | None:
    """What machines that train together exchange a message in; None, and a warning, where two
    processes of this one cannot."""
    try:
        return measure_exchange()
    except StageFailed as error:
        listen(Warned(stage=STAGE, message=f"the time of an exchange is not measured: {error}"))
        return None


def profile_of_run(run: Path, out: Path, machine: str | None = None, listen: Listener = lambda _: None) -> dict[str, Any]:
    """As `profile`, from the stage times of a finished run on this machine; BadInput for an
    emulated run, whose times are played, and for one without a trained device."""
    _require_place(out)
    require_run(run, "metrics.json")
    require_run(run)
    require_current(run)
    manifest = read_manifest(run)
    if manifest.config["emulate"]:
        raise BadInput(f"{run} was emulated, its devices' times are played: give a run without --emulate.")
    stages, config = manifest.stages, manifest.config
    if config["frames"] == "gps":
        raise BadInput(
            f"{run} was made with --frames gps: how long its edges took to join models and how long to bring them into one frame is not "
            "told apart; give a run with --frames shared, or measure with `radiant machine profile PHOTOS`."
        )
    devices, edges, train, steps = [], [], {}, []
    for plan in load_plan(run / "plan.json")[1]:
        counts = {name: len(plan.cameras_of(name)) for name in plan.device_ids}
        for name, count in counts.items():
            seconds, folder = _seconds(stages, f"devices/{name}"), run / "devices" / name
            if not (count and seconds and (folder / "summary.json").is_file()):
                continue
            summary = read_json(folder / "summary.json", ("train_s", "model_bytes"))
            train = task_setting(folder, "train")
            train_s, init_s = summary["train_s"], seconds - summary["train_s"]
            model_bytes = float(summary["model_bytes"])
            steps.append(int(train["num_steps"]))
            devices.append(DeviceSample(num_cameras=count, init_s=init_s, train_s=train_s / steps[-1], model_bytes=model_bytes))
        seconds = _seconds(stages, f"edges/{plan.edge_id}")
        if seconds:
            working = sum(1 for count in counts.values() if count)
            if working > 1:
                epochs = _epochs(run / "edges" / plan.edge_id)
                seconds /= share_of_epochs(EDGE_EPOCHS if epochs is None else epochs, EDGE_EPOCHS)
            edges.append(EdgeSample(num_cameras=sum(counts.values()), num_devices=working, seconds=seconds))
    if not devices:
        raise BadInput(f"{run} keeps no times of a device's training: give the folder of a run with its devices/ and edges/.")
    # Of the mean device: each trained as many steps as its photographs asked for.
    num_steps = round(float(np.mean(steps)))
    devices = [replace(sample, train_s=sample.train_s * num_steps) for sample in devices]
    sizes = {name: int(train[name]) for name in ("long_side_px", "max_num_splats")}
    key = ProfileKey(preset=config["train"]["preset"], num_steps=num_steps, aggregate_preset=config["aggregate"]["preset"], **sizes)
    distinct = sorted({sample.num_cameras for sample in devices})
    held_out = distinct[len(distinct) // 2] if len(distinct) > 2 else None
    # Where the cloud fitted nothing, its time does not say what fitting takes.
    seconds = None if _epochs(run / "cloud") == 0 else _seconds(stages, "cloud")
    num_cameras = sum(sample.num_cameras for sample in edges)
    merges = (EdgeSample(num_cameras=num_cameras, num_devices=len(edges), seconds=seconds),) if seconds and num_cameras else ()
    measured = Measured(devices=tuple(devices), edges=tuple(edges), num_steps=key.num_steps, num_epochs=0, held_out=held_out, merges=merges)
    source = f"stage times of a run, {len(devices)} devices and {len(edges)} edges, run side by side as it did"
    return _told(_write_profile(out, measured, key, machine or machine_label(None), source), listen)


def _epochs(node: Path) -> int | None:
    """Epochs that a node's task asks for; None where it was asked nothing."""
    return (task_setting(node, "join") or {}).get("epochs")


def library_table() -> str:
    """The library's machines, a line each, their seconds beside the training that they are of; then
    what each is and the source of its figures, in lines of `TABLE_COLUMNS`."""
    listed = {name: load_profile(path, name) for name, path in library_profiles().items()}
    lines = [f"{'profile':<12} {'kind':<9} {'100 photographs':>15}  of the training"]
    for name, known in listed.items():
        total_s = float(known.init_s.curve(100) + known.train_s.curve(100))
        row = f"{name:<12} {known.kind:<9} {total_s:>13,.0f} s  "
        lines += textwrap.wrap(str(known.key), TABLE_COLUMNS, initial_indent=row, subsequent_indent=" " * len(row))
    lines += textwrap.wrap("Times of different trainings do not compare; a plan scales each to its own training.", TABLE_COLUMNS)
    for name, known in listed.items():
        lines += [
            "",
            *textwrap.wrap(f"{name}: {known.machine}. {known.source}", TABLE_COLUMNS, subsequent_indent="  ", break_on_hyphens=False),
        ]
    return "\n".join(lines)


def check_table(rows: Sequence[dict[str, Any]]) -> str:
    """What was predicted for a count left out of the fit, beside what was measured there."""
    lines = [f"{'':<24} {'photographs':>11} {'predicted':>12} {'measured':>12} {'error':>8}"]
    lines += [
        f"{row['quantity']:<24} {row['num_cameras']:>11} {row['predicted']:>10.2f} {row['unit']:<2}"
        f"{row['measured']:>10.2f} {row['unit']:<2} {100 * row['error']:>+6.1f} %"
        for row in rows
    ]
    return "\n".join(lines)


def machine_label(num_threads: int | None, num_workers: int = 1) -> str:
    """Processor, GPU where there is one, threads of a process, and processes side by side."""
    import torch

    info = Path("/proc/cpuinfo")
    text = info.read_text() if info.is_file() else ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    parts = [models[0] if models else platform.processor() or platform.machine()]
    if torch.cuda.is_available():
        parts.append(torch.cuda.get_device_name(0))
    threads = num_threads or max(1, (os.cpu_count() or 1) // num_workers)
    together = [f"{num_workers} processes side by side"] if num_workers > 1 else []
    return ", ".join([*parts, f"{threads} thread{'s' * (threads > 1)}", *together])


def _require_place(out: Path) -> None:
    if out.suffix not in SUFFIXES:
        raise BadInput(f"{out} is no name for a {KIND}: choose one that ends in {' or '.join(SUFFIXES)}.")
    require_file_to_be(out)


def _scene(source: Path | None, work: Path, listen: Listener) -> tuple[SfmScene, Path]:
    """The scene and its photographs' folder; made in `work` by structure from motion if need be."""
    if source is not None and has_scene(source):
        return load_scene_of(source), images_folder_of(source)
    if source is None:
        source = work / "town"
        town = sample_scenes_folder() / "town"
        shutil.copytree(town / "images", source / "images")
        shutil.copytree(town / "known", source / "sparse" / "0")
    detect_source(source)
    folder = work / "sfm"
    folder.mkdir()
    save_task(folder, sfm_task(source, SfmConfig(), None, Placement()))
    run_task(NodeTask(kind="sfm", stage="sfm", folder=folder, key="sfm"), listen)
    return load_scene(folder / "scene.safetensors"), folder / read_json(folder / "result.json", ("images",))["images"]


def _seconds(stages: dict[str, dict[str, float]], stage: str) -> float:
    return stages[stage]["ended_s"] - stages[stage]["started_s"] if stage in stages else 0.0


def _told(result: dict[str, Any], listen: Listener) -> dict[str, Any]:
    return {**result, "warnings": warn_of(STAGE, result["warnings"], listen)}


def _write_profile(
    out: Path, measured: Measured, key: ProfileKey, machine: str, source: str, exchange: ExchangeTime | None = None
) -> dict[str, Any]:
    joined = [sample for sample in measured.edges if sample.num_devices > 1]
    alone = [sample for sample in measured.edges if sample.num_devices == 1]
    result = Profile(
        name=out.name,
        kind="measured",
        machine="".join(character for character in machine if character.isprintable()).strip(),
        source=source,
        key=key,
        init_s=_device_curve(measured.devices, "init_s"),
        train_s=_device_curve(measured.devices, "train_s"),
        model_bytes=_device_curve(measured.devices, "model_bytes"),
        aggregate_s=_edge_curve(joined) if joined else None,
        aggregate_alone_s=_edge_curve(alone) if alone and joined else None,
        merge_s=_edge_curve(measured.merges) if measured.merges else None,
        sfm_s=fit_curve(*zip(*measured.sfm, strict=True), may_fall=True) if measured.sfm else None,
        measured_steps=measured.num_steps,
        frames_s=measured.frames_s,
        frames_alone_s=measured.frames_alone_s,
        latency_s=None if exchange is None else exchange.latency_s,
        add_s_per_byte=None if exchange is None else exchange.add_s_per_byte,
    )
    with folder_made_for(out):
        save_profile(out, result)
    fitted = {
        name: curve
        for name in (*_DEVICE_CURVES, "aggregate_s", "aggregate_alone_s", "merge_s", "sfm_s")
        if (curve := getattr(result, name)) is not None
    }
    frames = "not measured" if result.frames_s is None else f"{result.frames_s:.1f} s side by side, {result.frames_alone_s:.1f} s alone"
    return {
        "machine": result.machine,
        "training": str(key),
        "measured_steps": measured.num_steps,
        "largest_count": result.train_s.largest_count,
        "curves": {name: {**vars(curve.curve), "rmse": curve.rmse} for name, curve in fitted.items()},
        "frames": frames,
        "exchange": "not measured" if exchange is None else _exchange_text(exchange),
        "check": _check(measured, joined),
        "warnings": _noise(fitted),
        "profile": str(out),
    }


def _exchange_text(exchange: ExchangeTime) -> str:
    return f"{1e3 * exchange.latency_s:.2f} ms one way, {1e9 * exchange.add_s_per_byte:.2g} ms to add a megabyte"


def _noise(fitted: dict[str, FittedCurve]) -> list[str]:
    """What was measured and cannot be: costs do not fall with photographs."""
    fallen = [name for name, curve in fitted.items() if curve.samples and falls(*zip(*curve.samples, strict=True))]
    return [f"{name} falls with the number of photographs and was taken as flat: was the machine busy? Profile again." for name in fallen]


def _device_curve(samples: Sequence[DeviceSample], name: str) -> FittedCurve:
    return fit_curve([sample.num_cameras for sample in samples], [getattr(sample, name) for sample in samples], may_fall=True)


def _edge_curve(samples: Sequence[EdgeSample]) -> FittedCurve:
    return fit_curve([sample.num_cameras for sample in samples], [sample.seconds for sample in samples], may_fall=True)


def _check(measured: Measured, joined: Sequence[EdgeSample]) -> list[dict[str, Any]]:
    """A row per quantity for samples at the held-out count, predicted by curves of the others."""
    count = measured.held_out
    samples_of_count = [sample for sample in measured.devices if sample.num_cameras == count]
    other_samples = [sample for sample in measured.devices if sample.num_cameras != count]
    if count is None or not samples_of_count or not other_samples:
        return []
    curves = {name: _device_curve(other_samples, name) for name in _DEVICE_CURVES}
    predicted = {name: float(curve.curve(count)) for name, curve in curves.items()}
    mean = {name: float(np.mean([getattr(sample, name) for sample in samples_of_count])) for name in _DEVICE_CURVES}
    rows = [
        _row("start-up", "s", count, predicted["init_s"], mean["init_s"]),
        _row("training", "s", count, predicted["train_s"], mean["train_s"]),
        _row("device", "s", count, predicted["init_s"] + predicted["train_s"], mean["init_s"] + mean["train_s"]),
        _row("model", "MB", count, predicted["model_bytes"] / 1e6, mean["model_bytes"] / 1e6),
    ]
    # Two devices with that many photographs each.
    for quantity, samples in (("aggregation", joined), ("cloud", measured.merges)):
        held_joins = [sample.seconds for sample in samples if sample.num_cameras == 2 * count]
        others = [sample for sample in samples if sample.num_cameras != 2 * count]
        if held_joins and others:
            rows.append(_row(quantity, "s", 2 * count, float(_edge_curve(others).curve(2 * count)), float(np.mean(held_joins))))
    return rows


def _row(quantity: str, unit: str, num_cameras: int, predicted: float, measured: float) -> dict[str, Any]:
    error = predicted / measured - 1
    return {"quantity": quantity, "unit": unit, "num_cameras": num_cameras, "predicted": predicted, "measured": measured, "error": error}
