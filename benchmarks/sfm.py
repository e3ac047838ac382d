"""Benchmark of structure from motion: seconds of each phase beside errors.

    default      as `radiant sfm` does it
    spatial      sfm.effort=thorough: COLMAP's features and adjustments, all GPS neighbours
    exhaustive   the same with all pairs of photographs

The reference is the truth of a scene of the generator (known/) or any COLMAP model of the same
photographs (sparse/0). Errors are the residuals of the best robust similarity to its cameras,
e = ‖s R c + t − c*‖, and the angle of R*ᵀ R R_c. CPU seconds are those of this process. Equal for
all: photographs, threads, number of features. Runs are interleaved so that a slow minute of the
machine affects all; figures are medians of three. `left_ratio`: the time left that was shown when a
fifth of the run was over, as a share of what it then took. Quick: one run each with 1,500 features,
less accurate: compare quick figures with quick ones only.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
import typer

from benchmarks.metric import Metric
from benchmarks.tracking import track_items
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.numerics import FloatArray

if TYPE_CHECKING:
    from radiant_core.sfm.config import SfmConfig, SfmProgress

ARMS = ("default", "spatial", "exhaustive")
NUM_RUNS = 3
QUICK_FEATURES = 1500
LOOKED_AT = 0.2
"""Share of the run at which the time left is compared with the truth."""
_TIME_TOLERANCE, _ERROR_TOLERANCE = 0.3, 0.5
"""Shares by which a time (load) and an error (order of threads) may differ between runs."""


@dataclass(frozen=True, kw_only=True)
class SfmRun:
    """Time of one run and errors of its cameras, medians and maxima over the cameras."""

    seconds: float
    cpu_s: float
    phases_s: dict[str, float]
    """CPU seconds of each phase."""
    left_ratio: float
    num_registered: int
    position_median_m: float
    """In the unit of the reference: metres where that is the truth."""
    position_median_percent: float
    position_max_percent: float
    rotation_median_deg: float


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


@dataclass(kw_only=True)
class _Clock:
    """Hears the progress of a run and times its phases."""

    begun_s: float = field(default_factory=time.perf_counter)
    cpu_s: float = field(default_factory=_cpu_s)
    phase: str = "checking photographs"
    phases_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    estimates: list[tuple[float, float]] = field(default_factory=list)
    """Seconds since the beginning, and the time left that was shown."""

    def __call__(self, progress: SfmProgress) -> None:
        self.end(progress.phase)
        if progress.left_s is not None:
            self.estimates.append((time.perf_counter() - self.begun_s, progress.left_s))

    def end(self, following: str) -> None:
        """End the current phase where another one follows."""
        if following != self.phase:
            now_s = _cpu_s()
            self.phases_s[self.phase] += now_s - self.cpu_s
            self.phase, self.cpu_s = following, now_s

    def left_ratio(self, seconds: float) -> float:
        """What was shown last before a fifth of so many seconds was over, as a share of what was
        left when it was; not a number where nothing had been shown."""
        before = [(at_s, left_s) for at_s, left_s in self.estimates if at_s <= LOOKED_AT * seconds]
        return before[-1][1] / (seconds - before[-1][0]) if before else float("nan")


def bench_sfm(scene: Path | None, quick: bool, arms: tuple[str, ...] = ()) -> list[Metric]:
    """Keys `sfm.<scene>.<arm>.…`: CPU seconds in all and by phase, seconds, registered photographs,
    errors of position and rotation. `scene` holds images/ and known/ or sparse/0, else BadInput;
    None: the town. `arms`: some of the list above, empty for all."""
    if unknown := sorted(set(arms) - set(ARMS)):
        raise BadInput(f"sfm has no arm {unknown[0]!r}: use {', '.join(ARMS)}.")
    scene_folder = scene or sample_scenes_folder() / "town"
    reference = _reference(scene_folder)
    runs: dict[str, list[SfmRun]] = {arm: [] for arm in arms or ARMS}
    for arm in track_items([*runs] * (1 if quick else NUM_RUNS), "bench sfm"):
        runs[arm].append(_run(scene_folder / "images", _config_of(arm, quick), reference))
    typer.echo(_table(runs))
    return [metric for arm, arm_runs in runs.items() for metric in _metrics(f"sfm.{scene_folder.name}.{arm}", arm_runs)]


def _reference(scene: Path) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names of C cameras, their centres (C,3) and rotations (C,3,3) from the world."""
    folder = next((scene / name for name in ("known", "sparse/0") if (scene / name).is_dir()), None)
    if folder is None:
        raise BadInput(f"{scene} has no known/ cameras and no sparse/0: give a scene of the generator, sample_scenes/town for example.")
    images = read_model(folder).images
    poses = np.array([image.cam_from_world for image in images]).reshape(-1, 4, 4)
    centers = np.asarray(np.linalg.inv(poses)[:, :3, 3], np.float64)
    return tuple(image.name for image in images), centers, poses[:, :3, :3]


def _config_of(arm: str, quick: bool) -> SfmConfig:
    from radiant_core.sfm.config import SfmConfig

    config = SfmConfig()
    if arm != "default":
        config = replace(config, effort="thorough", matching="exhaustive" if arm == "exhaustive" else "spatial")
    return replace(config, max_num_features=QUICK_FEATURES) if quick else config


def _run(images: Path, config: SfmConfig, reference: tuple[tuple[str, ...], FloatArray, FloatArray]) -> SfmRun:
    from radiant_core.sfm.reconstruct import reconstruct

    with TemporaryDirectory(prefix="radiant-bench-sfm-") as work:
        clock = _Clock()
        start_cpu_s = clock.cpu_s
        result = reconstruct(images, Path(work), config, clock)
        seconds = time.perf_counter() - clock.begun_s
    clock.end("")
    position, rotation_deg = camera_errors(result.scene.cameras, reference)
    extent = float(np.linalg.norm(np.ptp(reference[1], axis=0)))
    return SfmRun(
        seconds=seconds,
        cpu_s=_cpu_s() - start_cpu_s,
        phases_s=dict(clock.phases_s),
        left_ratio=clock.left_ratio(seconds),
        num_registered=len(result.scene.cameras),
        position_median_m=float(np.median(position)),
        position_median_percent=100 * float(np.median(position)) / extent,
        position_max_percent=100 * float(position.max()) / extent,
        rotation_median_deg=float(np.median(rotation_deg)),
    )


def camera_errors(cameras: Cameras, reference: tuple[tuple[str, ...], FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Errors of position (N,), in the unit of the reference, and rotation (N,) in degrees of those
    cameras that the reference has, after the best robust similarity; not a number without one."""
    from radiant_core.geometry.align import robust_sim3

    names, centers, rotations = reference
    row_of = {name: row for row, name in enumerate(names)}
    rows = [index for index, name in enumerate(cameras.names) if name in row_of]
    of_reference = [row_of[cameras.names[index]] for index in rows]
    fit = robust_sim3(cameras.centers[rows], centers[of_reference], 0)
    if fit.target_from_source is None:
        return np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    moved = fit.target_from_source.apply_to_poses(cameras.cam_from_world[rows])[:, :3, :3]
    return np.asarray(fit.residuals, np.float64), rotation_errors_deg(moved, rotations[of_reference])


def rotation_errors_deg(rotations: FloatArray, truth: FloatArray) -> FloatArray:
    """Angles (C,) in degrees between rotations: 2 asin(‖A − B‖ / √8), exact for small ones too."""
    chord = np.linalg.norm(rotations - truth, axis=(1, 2))
    return np.degrees(2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1)))


def _median(runs: list[SfmRun], name: str) -> float:
    return float(np.median([getattr(run, name) for run in runs]))


def _phase_medians(runs: list[SfmRun]) -> dict[str, float]:
    phases = list(dict.fromkeys(phase for run in runs for phase in run.phases_s))
    return {phase: float(np.median([run.phases_s.get(phase, 0.0) for run in runs])) for phase in phases}


def _table(runs: dict[str, list[SfmRun]]) -> str:
    """One line per arm: CPU seconds of each phase and in all, registered, errors, time left."""
    lines = []
    for arm, arm_runs in runs.items():
        phases = ", ".join(f"{phase} {seconds:.1f}" for phase, seconds in _phase_medians(arm_runs).items())
        lines.append(
            f"{arm}: {_median(arm_runs, 'cpu_s'):.1f} CPU s ({phases}); {_median(arm_runs, 'num_registered'):.0f} registered; position "
            f"{_median(arm_runs, 'position_median_m'):.4f} ({_median(arm_runs, 'position_median_percent'):.3f} % of the extent, at most "
            f"{_median(arm_runs, 'position_max_percent'):.2f} %), rotation {_median(arm_runs, 'rotation_median_deg'):.4f}°; time left "
            f"shown after a fifth, as a share of what was left: {_median(arm_runs, 'left_ratio'):.2f}"
        )
    return "\n".join(lines)


def _metrics(key: str, runs: list[SfmRun]) -> list[Metric]:
    seconds, cpu_s = _median(runs, "seconds"), _median(runs, "cpu_s")
    errors = [
        ("position_error_m", "position_median_m", "m"),
        ("position_error_percent", "position_median_percent", "% of extent"),
        ("position_max_percent", "position_max_percent", "% of extent"),
        ("rotation_error_deg", "rotation_median_deg", "deg"),
    ]
    return [
        Metric(key=f"{key}.seconds", value=seconds, unit="s", direction="lower", tolerance=_TIME_TOLERANCE * seconds),
        Metric(key=f"{key}.cpu_s", value=cpu_s, unit="s", direction="lower", tolerance=_TIME_TOLERANCE * cpu_s),
        *(
            Metric(key=f"{key}.{phase.replace(' ', '_')}_s", value=value, unit="s", direction="info", tolerance=0)
            for phase, value in _phase_medians(runs).items()
        ),
        *(
            Metric(key=f"{key}.left_ratio", value=ratio, unit="1", direction="info", tolerance=0)
            for ratio in [_median(runs, "left_ratio")]
            if np.isfinite(ratio)
        ),
        Metric(key=f"{key}.registered", value=_median(runs, "num_registered"), unit="1", direction="higher", tolerance=1),
        *(
            Metric(
                key=f"{key}.{name}",
                value=_median(runs, field_name),
                unit=unit,
                direction="lower",
                tolerance=_ERROR_TOLERANCE * _median(runs, field_name),
            )
            for name, field_name, unit in errors
        ),
    ]
