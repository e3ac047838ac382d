"""How many Gaussians a training may grow to within a limit of memory. Once per model.

    memory(N) = base + (3 + m) Σ_v p_v (1 + s²) + kept + 112 max_v p_v
                + N (C · 4 (11 + 3 K) + 600)        bytes

base: what the process holds before, and BASE_BYTES of the first step; p_v pixels of view v, kept as
bytes, and again at the share s of its side that training begins with; m: 1 where photographs have
masks, a byte a pixel, else 0; kept: the loss' statistics, 24 bytes a pixel where there is room;
112: a step on the largest view. N Gaussians of K bases have 11 + 3 K float32 each, C times:
parameters, gradients, two moments, copies of an edit or a checkpoint; the mean of the last steps
takes more where no Gaussian went before it. 600 bytes are the rasterizer's and an edit's. Set so
that tests/stress/test_train_memory.py holds on the sample town
with planned growth: allowed 0.6, 1 and 2 GB, it peaked at 0.62, 1.00 and 2.14 GB.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.splats import SH_BASES
from radiant_core.train.config import TrainConfig
from radiant_core.train.needs import MIN_PLANNED, fit_dropping, fit_thinning, pixels_per_splat

BASE_BYTES = 95_000_000
COPIES, COPIES_OF_MEAN = 7.0, 1.5
RASTERIZER_BYTES_PER_SPLAT = 600
IMAGE_BYTES_PER_PX, MASK_BYTES_PER_PX, STEP_BYTES_PER_PX = 3, 1, 112
STATISTICS_BUDGET_BYTES = 1 << 30
"""Memory for what the loss of a training keeps of its views (a join: `join_memory`); without it the
loss takes 1.8 times as long."""
STATISTICS_BYTES_PER_PX = 24
"""Means and variances, three float32 each. The target itself is 12 more and comes from its bytes in
each step, to the same values."""
MAX_STATISTICS_SHARE = 0.25
"""At most this share of what photographs leave free keeps statistics, which only save time."""
VRAM_SHARE = 0.8
"""Of free GPU memory, for Gaussians and a step; what the loss keeps and the driver take the rest.
Never tried to its limit: a training of 264,000 Gaussians held 777 MB (docs/experiments/cuda.md)."""
PROCESS_BYTES = 300_000_000
"""What a device's process holds before its photographs, if unknown: 296 MB with its imports."""
MIN_SPLATS = 1_000
"""A limit that leaves room for fewer is refused."""


@dataclass(frozen=True, kw_only=True)
class MemoryPlan:
    """How a limit of memory is spent."""

    max_num_splats: int
    statistics_bytes: int
    """Budget of the kept statistics of the loss."""
    needed_bytes: int
    """The prediction of the model above for the two."""


def bytes_per_splat(sh_degree: int, *, validated: bool = False, averaged: bool = False) -> float:
    """Bytes of one Gaussian in training; `validated`: the best model so far is kept beside it;
    `averaged`: and the mean of models as large as any."""
    return (COPIES + validated + COPIES_OF_MEAN * averaged) * 4 * (11 + 3 * SH_BASES[sh_degree]) + RASTERIZER_BYTES_PER_SPLAT


def _is_averaged_whole(config: TrainConfig, num_photographs: int) -> bool:
    """Whether the models that are averaged have as many Gaussians as growth reached."""
    thinned = getattr(fit_thinning(config, num_photographs)[0].density, "thin_to", 1.0)
    return config.average_from < 1 and thinned >= 1


def fixed_bytes(config: TrainConfig, cameras: Cameras, base_bytes: int, *, masked: bool = False) -> int:
    """What photographs, their masks if any, one step and the process take, without Gaussians."""
    pixels = cameras.sizes_wh.prod(axis=1)
    masks = MASK_BYTES_PER_PX * _copies(config) * float(pixels.sum()) if masked else 0.0
    return round(_fixed_bytes(config, float(pixels.sum()), float(pixels.max(initial=0)), base_bytes) + masks)


def _fixed_bytes(config: TrainConfig, all_pixels: float, most_pixels: float, base_bytes: float) -> float:
    return base_bytes + BASE_BYTES + IMAGE_BYTES_PER_PX * _copies(config) * all_pixels + STEP_BYTES_PER_PX * most_pixels


def _copies(config: TrainConfig) -> float:
    return 1.0 + (config.start_scale**2 if config.start_scale < 1 else 0.0)


def most_cameras(config: TrainConfig, memory_bytes: float, splats_of: Callable[[int], float], num_cameras: int) -> int:
    """How many of `num_cameras` photographs fit into memory together with the Gaussians `splats_of`
    so many (rising): at least `MIN_SPLATS`, at most the configuration's limit. The model above on
    `PROCESS_BYTES`, without what the loss may keep; photographs of 4:3, as a plan is made before
    there are any. 0 where not even one fits."""
    pixels = 0.75 * config.long_side_px**2
    splat_bytes = bytes_per_splat(config.sh_degree)

    def fits(count: int) -> bool:
        splats = max(MIN_SPLATS, min(splats_of(count), config.max_num_splats))
        return _fixed_bytes(config, count * pixels, pixels, PROCESS_BYTES) + splats * splat_bytes <= memory_bytes

    low, high = 0, num_cameras + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


@dataclass(frozen=True, kw_only=True)
class TrainingMemory:
    """What one training takes, before there is any."""

    needed_bytes: int
    """With all the Gaussians that its photographs call for, where `memory_plan` limits what the
    loss keeps."""
    ample_bytes: int
    """With all that the loss would keep."""


def training_memory(config: TrainConfig, num_photographs: int, pixels_each: float | None = None) -> TrainingMemory:
    """What a training of so many photographs takes, by the model above on `PROCESS_BYTES`.

    Args:
        config: the training; growth goes as far as `needs.most_splats` lets it.
        num_photographs: all that it is trained on.
        pixels_each: of one at the size of the training, in the mean; None: 4:3.

    Returns:
        Its bytes, with little and with all that the loss keeps.
    """
    pixels = 0.75 * config.long_side_px**2 if pixels_each is None else pixels_each
    per_splat = pixels_per_splat(fit_dropping(config, num_photographs)[0], num_photographs)
    planned = config.max_num_splats if per_splat is None else max(MIN_PLANNED, int(num_photographs * pixels / per_splat))
    averaged = _is_averaged_whole(config, num_photographs)
    splats = min(config.max_num_splats, planned) * bytes_per_splat(config.sh_degree, averaged=averaged)
    fixed = _fixed_bytes(config, num_photographs * pixels, pixels, PROCESS_BYTES)
    statistics_bytes = min(STATISTICS_BYTES_PER_PX * num_photographs * pixels, STATISTICS_BUDGET_BYTES)
    needed = fixed + splats / (1 - MAX_STATISTICS_SHARE)
    return TrainingMemory(needed_bytes=round(needed), ample_bytes=round(max(needed, fixed + splats + statistics_bytes)))


def memory_plan(
    config: TrainConfig, cameras: Cameras, memory_bytes: int, base_bytes: int, *, validated: bool = False, masked: bool = False
) -> MemoryPlan:
    """The most Gaussians and the statistics that fit into `memory_bytes` with the photographs of
    `cameras`, at their training size; `base_bytes`: held before they are loaded. Raises BadInput
    where fewer than `MIN_SPLATS` fit, with what would do."""
    fixed = fixed_bytes(config, cameras, base_bytes, masked=masked)
    averaged = _is_averaged_whole(config, len(cameras))
    splat_bytes = bytes_per_splat(config.sh_degree, validated=validated, averaged=averaged)
    free = memory_bytes - fixed
    wanted = STATISTICS_BYTES_PER_PX * int(cameras.sizes_wh.prod(axis=1).sum())
    statistics = max(0, min(wanted, STATISTICS_BUDGET_BYTES, int(MAX_STATISTICS_SHARE * free)))
    count = int((free - statistics) // splat_bytes)
    if count < MIN_SPLATS:
        enough = fixed + MIN_SPLATS * splat_bytes / (1 - MAX_STATISTICS_SHARE)
        raise BadInput(
            f"{memory_bytes / 1e6:,.0f} MB of memory leave room for {max(0, count):,} Gaussians, expected {MIN_SPLATS:,} or more: "
            f"give {enough / 1e6:,.0f} MB, or lower the photographs' size by --long-side-px."
        )
    return MemoryPlan(max_num_splats=count, statistics_bytes=statistics, needed_bytes=round(fixed + statistics + count * splat_bytes))


def within_vram(config: TrainConfig, cameras: Cameras, free_bytes: int, stage: str) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The configuration whose Gaussians fit with one step into free memory of a CUDA device, and
    the decision where that is fewer; photographs stay in main memory but for what the loss keeps.
    BadInput as `memory_plan`."""
    step = STEP_BYTES_PER_PX * float(cameras.sizes_wh.prod(axis=1).max(initial=0))
    count = int((VRAM_SHARE * free_bytes - step) // bytes_per_splat(config.sh_degree))
    if count >= config.max_num_splats:
        return config, ()
    if count < MIN_SPLATS:
        raise BadInput(
            f"{free_bytes / 1e6:,.0f} MB of free GPU memory leave room for {max(0, count):,} Gaussians, expected {MIN_SPLATS:,} or more: "
            "end what else runs there, or lower the photographs' size by --long-side-px."
        )
    decision = Decision(
        stage=stage,
        topic="GPU memory",
        choice=f"at most {count:,} Gaussians instead of {config.max_num_splats:,}",
        figure=free_bytes / 1e6,
        unit="MB free",
        reason=f"each takes {bytes_per_splat(config.sh_degree):,.0f} bytes in training, and a fifth is left for everything else",
    )
    return replace(config, max_num_splats=count), (decision,)


def within_memory(
    config: TrainConfig, plan: MemoryPlan, memory_bytes: int, stage: str, requested: int | None
) -> tuple[TrainConfig, Decision]:
    """The configuration with the limit of Gaussians that a plan leaves, or the one `requested`
    where that is lower, and the decision."""
    count = plan.max_num_splats if requested is None else min(requested, plan.max_num_splats)
    decision = Decision(
        stage=stage,
        topic="memory",
        choice=f"at most {count:,} Gaussians, {plan.statistics_bytes / 1e6:,.0f} MB for the loss's statistics of the photographs",
        figure=memory_bytes / 1e6,
        unit="MB allowed",
        reason=f"{plan.max_num_splats:,} Gaussians are predicted to take {plan.needed_bytes / 1e6:,.0f} MB with everything else",
        forced=True,
    )
    return replace(config, max_num_splats=count), decision
