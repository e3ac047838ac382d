"""Whether models are retrained together, by memory and time (paper Sec. III-D). Once per join.

    memory = 0.39 GB + N (7 b + 500) + 4 Σ_v p_v + 136 max_v p_v        bytes, at least
    kept   = up to min(36 Σ_v p_v, 1 GiB) more, which saves time alone
    time   = Σ_e T_e N / N_e                                            seconds

N Gaussians of b bytes each, p_v pixels of view v, T_e seconds that edge e took (or is said to take)
to aggregate its N_e Gaussians: a step of dense Adam touches all of them. 0.39 GB is a worker with
its libraries and its inbox (three clouds of real sets held 356 to 383 MB beside the rest); seven
copies are the models, their sum, the tensors with gradient and two moments, and the result; 500
bytes are the rasterizer's; a view keeps 4 bytes a pixel, its step takes 100 and its loss 36, which
may be kept (`StatisticsCache`) in what memory is left. `python -m tests.stress.retrain_memory`
measures it; tests/stress/test_cloud_memory.py compares.

Views are never made smaller to fit: pictures of half the size teach about as much as a cut leaves,
smaller ones less (docs/experiments/aggregation.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.plan.system import Cloud
from radiant_core.splats import Splats
from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES

PROCESS_BYTES = 390_000_000
COPIES = 7
RASTERIZER_BYTES_PER_SPLAT = 500
VIEW_BYTES_PER_PX, STATISTICS_BYTES_PER_PX, STEP_BYTES_PER_PX = 4, 36, 100


@dataclass(frozen=True, kw_only=True)
class CloudNeeds:
    """What retraining at the cloud is predicted to take."""

    num_cameras: int
    memory_bytes: float
    time_s: float | None
    """None where no time of any edge is known."""


def retrain_memory_bytes(num_splats: int, bytes_per_splat: float, pixels_per_view: Sequence[int]) -> float:
    """Least peak bytes of a process that retrains N Gaussians on views of so many pixels."""
    models = num_splats * (COPIES * bytes_per_splat + RASTERIZER_BYTES_PER_SPLAT)
    step = (STEP_BYTES_PER_PX + STATISTICS_BYTES_PER_PX) * max(pixels_per_view, default=0)
    return PROCESS_BYTES + models + VIEW_BYTES_PER_PX * sum(pixels_per_view) + step


def kept_statistics_bytes(models: Sequence[Splats], cameras: Sequence[Cameras], long_side_px: int, memory_bytes: float) -> int | None:
    """What the loss may keep of its views within `memory_bytes`; None where nothing fits."""
    pixels = pixels_of(cameras, long_side_px)
    left = memory_bytes - retrain_memory_bytes(sum(map(len, models)), _bytes_per_splat(models), pixels)
    return None if left < 0 else int(min(STATISTICS_BYTES_PER_PX * sum(pixels), STATISTICS_BUDGET_BYTES, left))


def pixels_of(cameras: Sequence[Cameras], long_side_px: int) -> list[int]:
    """Pixels of every view at that long side."""
    return [int(width * height) for views in cameras for width, height in views.scaled(long_side_px).sizes_wh]


def _bytes_per_splat(models: Sequence[Splats]) -> float:
    return max((model.num_bytes / len(model) for model in models if len(model)), default=0.0)


def cloud_needs(
    models: Sequence[Splats], cameras: Sequence[Cameras], long_side_px: int, edge_times_s: Sequence[float] | None
) -> CloudNeeds:
    """Needs of retraining edge models at their virtual cameras; times (E,) of the edges."""
    counts = [len(model) for model in models]
    total = sum(counts)
    pixels = pixels_of(cameras, long_side_px)
    time_s = None
    if edge_times_s is not None:
        if len(edge_times_s) != len(models):
            raise BadInput(f"{len(edge_times_s)} times for {len(models)} edges: give one per edge.")
        time_s = sum(seconds * total / max(1, count) for seconds, count in zip(edge_times_s, counts, strict=True))
    return CloudNeeds(num_cameras=len(pixels), memory_bytes=retrain_memory_bytes(total, _bytes_per_splat(models), pixels), time_s=time_s)


def pooled_needs(models: Sequence[Splats], cameras: Sequence[Cameras], long_side_px: int, share: float) -> CloudNeeds:
    """The same of the whole scene, foreseen by an edge with a share (0 to 1] of its cameras."""
    own = cloud_needs(models, cameras, long_side_px, None)
    scene_bytes = (own.memory_bytes - PROCESS_BYTES) / share
    return CloudNeeds(num_cameras=round(own.num_cameras / share), memory_bytes=PROCESS_BYTES + scene_bytes, time_s=None)


def choose_at_cloud(needs: CloudNeeds, cloud: Cloud, stage: str, *, memory_of: str = "the cloud's limit") -> tuple[bool, Decision]:
    """Whether the cloud retrains (else it cuts), by the figure nearest to its limit or beyond;
    `memory_of` says in words whose limit that of memory is."""
    limit_gb = None if cloud.memory_bytes is None else cloud.memory_bytes / 1e9
    most_views = None if cloud.max_cameras is None else float(cloud.max_cameras)
    own = "the cloud's limit"
    figures = [
        ("memory", needs.memory_bytes / 1e9, limit_gb, "GB", memory_of),
        ("time", needs.time_s, cloud.time_s, "s", own),
        ("views", float(needs.num_cameras), most_views, "cameras", own),
    ]
    limited = [
        (name, figure, limit, unit, whose) for name, figure, limit, unit, whose in figures if limit is not None and figure is not None
    ]
    if not limited:
        name, figure, unit = "memory", needs.memory_bytes / 1e9, "GB"
        retrains, reason = True, "its predicted memory; the system file sets no limit, so that the cloud's machine decides"
    else:
        name, figure, limit, unit, whose = max(limited, key=lambda item: item[1] / item[2] if item[2] else float("inf"))
        retrains = figure <= limit
        word = "is within" if retrains else "exceeds"
        reason = f"the predicted {name} of retraining, {figure:.3g} {unit}, {word} {whose} of {limit:.3g} {unit}"
    choice = "retraining all models together" if retrains else "models are cut at their borders instead of retrained"
    return retrains, Decision(stage=stage, topic="aggregation", choice=choice, figure=figure, unit=f"{unit} predicted", reason=reason)
