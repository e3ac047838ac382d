"""Benchmark of structure from motion: seconds beside errors, GPS neighbours against all pairs.

The scene is one of the generator, whose cameras are known exactly. Errors are the residuals of the
best similarity to the known cameras: e = ‖s R c + t − c*‖ and the angle of R*ᵀ R R_c. Equal for
both: photographs, features, mapper, threads. Runs are interleaved (spatial, exhaustive, spatial, …)
so that a slow minute of the machine affects both; figures are medians of three. Quick: one run each
with 1,500 features, less accurate: compare quick figures with quick ones only.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from radiant_app.commands.demo import sample_scenes_folder
from radiant_app.report.progress import track_items
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.metric import Metric
from radiant_core.io.colmap.model import read_model
from radiant_core.numerics import FloatArray

MatchingKind = Literal["spatial", "exhaustive"]
NUM_RUNS = 3
QUICK_FEATURES = 1500
_TIME_TOLERANCE, _ERROR_TOLERANCE = 0.3, 0.5
"""Shares by which a time and an error (order of threads) may differ between runs."""


@dataclass(frozen=True, kw_only=True)
class SfmRun:
    """Time of one run and errors of its cameras, medians and maxima over the cameras."""

    seconds: float
    num_registered: int
    position_median_m: float
    position_max_percent: float
    rotation_median_deg: float


def bench_sfm(scene: Path | None, quick: bool) -> list[Metric]:
    """Keys `sfm.<scene>.<spatial|exhaustive>.…`: seconds, registered, position and rotation errors.

    `scene` holds images/ with GPS and known/ (a COLMAP model), else BadInput; None: the town.
    """
    from radiant_core.sfm.world_frame.world import cameras_of

    scene_folder = scene or sample_scenes_folder() / "town"
    if not (scene_folder / "known").is_dir():
        raise BadInput(f"{scene_folder} has no known/ cameras: give a scene of the generator, sample_scenes/town for example.")
    known = cameras_of(read_model(scene_folder / "known"))
    runs: dict[MatchingKind, list[SfmRun]] = {"spatial": [], "exhaustive": []}
    turns: list[MatchingKind] = ["spatial", "exhaustive"] * (1 if quick else NUM_RUNS)
    for matching in track_items(turns, "bench sfm"):
        runs[matching].append(_run(scene_folder / "images", matching, known, QUICK_FEATURES if quick else None))
    return [metric for matching, done in runs.items() for metric in _metrics(f"sfm.{scene_folder.name}.{matching}", done)]


def _run(images: Path, matching: MatchingKind, known: Cameras, num_features: int | None) -> SfmRun:
    from radiant_core.sfm.config import SfmConfig
    from radiant_core.sfm.reconstruct import reconstruct
    from radiant_core.sfm.world_frame.align import compare_centers

    config = SfmConfig(matching=matching)
    if num_features is not None:
        config = replace(config, max_num_features=num_features)
    with TemporaryDirectory(prefix="radiant-bench-sfm-") as work:
        start = time.perf_counter()
        result = reconstruct(images, Path(work), config, lambda _: None)
        seconds = time.perf_counter() - start
    cameras = result.scene.cameras
    truth = known.named(cameras.names)
    errors = compare_centers(cameras.centers, truth.centers)
    angles_deg = rotation_errors_deg(
        errors.reference_from_scene.apply_to_poses(cameras.cam_from_world)[:, :3, :3], truth.cam_from_world[:, :3, :3]
    )
    return SfmRun(
        seconds=seconds,
        num_registered=len(cameras),
        position_median_m=float(np.median(errors.errors)),
        position_max_percent=errors.max_percent,
        rotation_median_deg=float(np.median(angles_deg)),
    )


def rotation_errors_deg(rotations: FloatArray, truth: FloatArray) -> FloatArray:
    """Angles (C,) in degrees between rotations: 2 asin(‖A − B‖ / √8), exact for small ones too."""
    chord = np.linalg.norm(rotations - truth, axis=(1, 2))
    return np.degrees(2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1)))


def _metrics(key: str, runs: list[SfmRun]) -> list[Metric]:
    def median(field: str) -> float:
        return float(np.median([getattr(run, field) for run in runs]))

    seconds = median("seconds")
    errors = [
        ("position_error_m", "position_median_m", "m"),
        ("position_max_percent", "position_max_percent", "% of extent"),
        ("rotation_error_deg", "rotation_median_deg", "deg"),
    ]
    return [
        Metric(key=f"{key}.seconds", value=seconds, unit="s", direction="lower", tolerance=_TIME_TOLERANCE * seconds),
        Metric(key=f"{key}.registered", value=median("num_registered"), unit="1", direction="higher", tolerance=1),
        *(
            Metric(key=f"{key}.{name}", value=median(field), unit=unit, direction="lower", tolerance=_ERROR_TOLERANCE * median(field))
            for name, field, unit in errors
        ),
    ]
