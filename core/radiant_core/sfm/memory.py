"""How structure from motion keeps to a limit of memory: fewer threads, then smaller photographs, while it finds features. Once per scene.

    peak = 180 MB + t · 330 p        bytes, t threads and p pixels of the largest photograph, reduced to `max_image_size_px`

Each thread holds the scale space of one photograph at twice its side; matching takes less. What mapping holds grows with the scene and
is not limited: a scene too large for that is one for several devices. tests/stress/test_sfm_memory.py measures the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.sfm.config import SfmConfig

Sizes = Sequence[tuple[int, int]]
"""Width and height in pixels of every photograph."""
PROCESS_BYTES = 180e6
"""The process with its libraries, 148 MB, and what stays of the first photographs."""
THREAD_BYTES_PER_PX = 330
LEAST_SIDE_PX = 400
"""Smaller photographs have too few features to be matched."""


def features_bytes(num_threads: int, side_px: float, sizes_wh: Sizes) -> float:
    """Peak memory in bytes of finding features with so many threads in photographs of these sizes, reduced to a long side of `side_px`."""
    pixels = [float(width * height) * min(1.0, side_px / max(width, height)) ** 2 for width, height in sizes_wh]
    return PROCESS_BYTES + num_threads * THREAD_BYTES_PER_PX * max(pixels, default=0.0)


def within_memory(config: SfmConfig, sizes_wh: Sizes) -> tuple[SfmConfig, tuple[Decision, ...]]:
    """The configuration within its `memory_bytes` for photographs of these sizes, and the decision where there is a limit.

    Raises BadInput where not even one thread on photographs of 400 px fits.
    """
    if config.memory_bytes is None:
        return config, ()
    limit, threads, side_px = config.memory_bytes, config.threads, config.max_image_size_px
    while threads > 1 and features_bytes(threads, side_px, sizes_wh) > limit:
        threads -= 1
    while side_px > LEAST_SIDE_PX and features_bytes(threads, side_px, sizes_wh) > limit:
        side_px = max(LEAST_SIDE_PX, side_px - 16)
    needed = features_bytes(threads, side_px, sizes_wh)
    if needed > limit:
        raise BadInput(
            f"{limit / 1e6:,.0f} MB of memory are too few to find features, even in photographs of {side_px} px: "
            f"give {needed / 1e6:,.0f} MB."
        )
    decision = Decision(
        stage="sfm",
        topic="memory",
        choice=f"{threads} of {config.threads} threads, photographs of {side_px:,} of {config.max_image_size_px:,} px",
        figure=limit / 1e6,
        unit="MB allowed",
        reason=f"finding features is predicted to take {needed / 1e6:,.0f} MB; what mapping takes is not limited",
        forced=True,
    )
    return replace(config, num_threads=threads, max_image_size_px=side_px), (decision,)
