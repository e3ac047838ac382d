"""How models are joined within a limit of memory: all at once, or tile after tile. Once per join.

    at once   0.39 GB + N (7 b + 650) + 164 max_v p_v                   bytes, at least
    by tiles  0.39 GB + 6 N b + max_t N_t (4 b + 650) + 164 max_v p_v
    kept      up to min(24 Σ_v p_v, 0.27 GB) more, which saves time alone

N Gaussians of b bytes each, N_t that tile t and its surroundings take, p_v pixels of view v. 0.39
GB is a worker with its libraries and its inbox (three clouds of real sets held 356 to 383 MB beside
the rest); three copies are the models, their sum and the result, four more the tensors that move
with gradient and two moments; tiles hold their parts, what became of them and what the allocator
keeps between two of them besides; 650 bytes are the rasterizer's; the step on a view takes 140
bytes a pixel and its loss 24, which it may keep of every view (`StatisticsCache`) in what memory is
left. Views lie in a file. `python -m tests.stress.retrain_memory` measures it.

Views are never made smaller to fit: pictures of half the size teach about as much as a cut leaves,
smaller ones less (docs/experiments/aggregation.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.aggregate.config import MAX_TILES
from radiant_core.aggregate.tiles import most_fitted, tiles_of
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.memory import STATISTICS_BYTES_PER_PX

PROCESS_BYTES = 390_000_000
COPIES, COPIES_BY_TILES, COPIES_OF_A_TILE = 3, 6, 4
RASTERIZER_BYTES_PER_SPLAT = 650
STEP_BYTES_PER_PX = 140
MOST_STATISTICS_BYTES = 267_000_000
"""Memory for what the loss keeps of a join's views: of 100 at 384 px, 44 at 576. Others are
prepared anew whenever they are shown. Up to 0.7 GB saved 0 to 3 % of the time of edges that show
350 views twice (docs/experiments/paper_size.md); joins of 10 epochs were not timed."""


@dataclass(frozen=True, kw_only=True)
class JoinMemory:
    """Into how many tiles a join is divided, and what its loss may keep of the views."""

    num_tiles: int
    needed_bytes: float
    statistics_bytes: int
    fits: bool
    """Whether so many tiles are within the limit; else it is the smallest need there is."""


def join_bytes(
    num_splats: int, num_fitted: int, bytes_per_splat: float, pixels_per_view: Sequence[int], *, by_tiles: bool = False
) -> float:
    """Least peak memory in bytes of a process that joins N Gaussians, so many of them at a time."""
    models = (COPIES_BY_TILES if by_tiles else COPIES) * num_splats * bytes_per_splat
    fitted = num_fitted * (COPIES_OF_A_TILE * bytes_per_splat + RASTERIZER_BYTES_PER_SPLAT)
    step = (STEP_BYTES_PER_PX + STATISTICS_BYTES_PER_PX) * max(pixels_per_view, default=0)
    return PROCESS_BYTES + models + fitted + step


def plan_join_memory(
    models: Sequence[Splats],
    cameras: Sequence[Cameras],
    long_side_px: int,
    memory_bytes: float,
    most_tiles: int = MAX_TILES,
    most_statistics_bytes: int = MOST_STATISTICS_BYTES,
) -> JoinMemory:
    """The fewest tiles that join models (M), asked at `cameras` (M), within `memory_bytes`."""
    pixels = pixels_of(cameras, long_side_px)
    total = sum(map(len, models))
    splat_bytes = max((model.num_bytes / len(model) for model in models if len(model)), default=0.0)
    needed, num_tiles = join_bytes(total, total, splat_bytes, pixels), 1
    if needed > memory_bytes and total and most_tiles > 1:
        merged, views = concatenate_splats(models), concatenate_cameras(cameras).scaled(long_side_px)
        while needed > memory_bytes and num_tiles < most_tiles:
            num_tiles *= 2
            fitted = most_fitted(merged, views, tiles_of(merged.means, views, num_tiles))
            needed = min(needed, join_bytes(total, fitted, splat_bytes, pixels, by_tiles=True))
    statistics_bytes = min(STATISTICS_BYTES_PER_PX * sum(pixels), most_statistics_bytes, max(0.0, memory_bytes - needed))
    return JoinMemory(num_tiles=num_tiles, needed_bytes=needed, statistics_bytes=int(statistics_bytes), fits=needed <= memory_bytes)


def pixels_of(cameras: Sequence[Cameras], long_side_px: int) -> list[int]:
    """Pixels of every view at that long side."""
    return [int(width * height) for views in cameras for width, height in views.scaled(long_side_px).sizes_wh]
