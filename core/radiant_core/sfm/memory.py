"""Structure from motion in limited memory: fewer threads, smaller photographs, fewer features.

    finding features   180 MB + t · 330 p + 7 q  bytes, t threads, p pixels of the largest
                       photograph, reduced to `max_image_size_px`
    undistorting       180 MB + u · 7 q          q pixels as stored, u threads: those of t that fit
    mapping            180 MB + 1,000 n f        n photographs with `max_num_features` f each; by
                                                 the global mapper 2,000 n f

Each thread holds the scale space of one photograph at twice its side; matching takes less. One
photograph at a time is decoded whole, and each thread that undistorts holds one before and after:
12 of 50 megapixels took 5.8 bytes a pixel to find features with one or two threads, 6.0 to
undistort with one and 5.9 with each of two. Mapping takes 110 bytes a keypoint and 950 an
observation. How many there will be is not known before; of each of 4,096 features asked for,
brighton, lewis, caliterra and the town took 530 to 900 bytes, by the global mapper lewis and
caliterra 1,030 and 1,780 (18 to 75 photographs; beyond that it is extrapolated). A mapper that
would not fit is not tried. tests/stress/test_sfm_memory.py measures the whole. Once per scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.sfm.config import Mapper, SfmConfig

Sizes = Sequence[tuple[int, int]]
"""Width and height in pixels of every photograph."""
PROCESS_BYTES = 180e6
"""The process with its libraries, 148 MB, and what stays of the first photographs."""
THREAD_BYTES_PER_PX = 330
WHOLE_BYTES_PER_PX = 7
LEAST_SIDE_PX = 400
"""Smaller photographs have too few features to be matched."""
MAPPING_BYTES_PER_FEATURE, GLOBAL_BYTES_PER_FEATURE = 1_000, 2_000
LEAST_FEATURES, FEATURES_STEP = 512, 64
"""With fewer, photographs of little texture find no place."""


def features_bytes(num_threads: int, side_px: float, sizes_wh: Sizes) -> float:
    """Peak bytes of finding features with so many threads, long sides reduced to `side_px`."""
    reduced = any(max(size_wh) > side_px for size_wh in sizes_wh)
    pixels = [float(width * height) * min(1.0, side_px / max(width, height)) ** 2 for width, height in sizes_wh]
    whole = WHOLE_BYTES_PER_PX * _most_pixels(sizes_wh) if reduced else 0.0
    return PROCESS_BYTES + num_threads * THREAD_BYTES_PER_PX * max(pixels, default=0.0) + whole


def undistorting_bytes(num_threads: int, sizes_wh: Sizes) -> float:
    """Peak bytes of undistorting with so many threads; with one, of decoding the largest."""
    return PROCESS_BYTES + num_threads * WHOLE_BYTES_PER_PX * _most_pixels(sizes_wh)


def undistorting_threads(config: SfmConfig, sizes_wh: Sizes) -> int:
    """How many threads may undistort photographs of these sizes in `memory_bytes`, one or more."""
    threads = config.threads
    while config.memory_bytes is not None and threads > 1 and undistorting_bytes(threads, sizes_wh) > config.memory_bytes:
        threads -= 1
    return threads


def _most_pixels(sizes_wh: Sizes) -> float:
    return max((float(width * height) for width, height in sizes_wh), default=0.0)


def mapping_bytes(num_photographs: int, num_features: int, mapper: Mapper = "incremental") -> float:
    """Peak memory in bytes of mapping so many photographs with so many features asked of each; of
    auto: of all that it may try."""
    feature_bytes = MAPPING_BYTES_PER_FEATURE if mapper == "incremental" else GLOBAL_BYTES_PER_FEATURE
    return PROCESS_BYTES + feature_bytes * float(num_photographs) * num_features


def limit_to_memory(config: SfmConfig, sizes_wh: Sizes) -> tuple[SfmConfig, tuple[Decision, ...]]:
    """The configuration within its `memory_bytes` for photographs of these sizes, and the decision
    if there is a limit. Raises BadInput where neither decoding one photograph fits, nor one thread
    at `LEAST_SIDE_PX`, nor mapping with `LEAST_FEATURES` each."""
    if config.memory_bytes is None:
        return config, ()
    _require_decoding(config.memory_bytes, sizes_wh)
    limit, threads, side_px = config.memory_bytes, config.threads, config.max_image_size_px
    while threads > 1 and features_bytes(threads, side_px, sizes_wh) > limit:
        threads -= 1
    while side_px > LEAST_SIDE_PX and features_bytes(threads, side_px, sizes_wh) > limit:
        side_px = max(LEAST_SIDE_PX, side_px - 16)
    needed_bytes = features_bytes(threads, side_px, sizes_wh)
    if needed_bytes > limit:
        raise BadInput(
            f"{limit / 1e6:,.0f} MB of memory are too few to find features, even in photographs of {side_px} px: "
            f"give {needed_bytes / 1e6:,.0f} MB."
        )
    least: Mapper = "global" if config.mapper == "global" else "incremental"
    features = _features_within(limit, len(sizes_wh), config.max_num_features, least)
    mapper = config.mapper if mapping_bytes(len(sizes_wh), features, config.mapper) <= limit else least
    mapped = mapping_bytes(len(sizes_wh), features, mapper)
    fewer = "" if features == config.max_num_features else f", {features:,} of {config.max_num_features:,} features each"
    only = "" if mapper == config.mapper else ", the incremental mapper alone"
    decision = Decision(
        stage="sfm",
        topic="memory",
        choice=f"{threads} of {config.threads} threads, photographs of {side_px:,} of {config.max_image_size_px:,} px{fewer}{only}",
        figure=limit / 1e6,
        unit="MB allowed",
        reason=f"finding features is predicted to take {needed_bytes / 1e6:,.0f} MB, mapping {mapped / 1e6:,.0f} MB",
        forced=True,
    )
    config = replace(config, num_threads=threads, max_image_size_px=side_px, max_num_features=features, mapper=mapper)
    return config, (decision,)


def _require_decoding(limit_bytes: float, sizes_wh: Sizes) -> None:
    """Raise BadInput where the largest photograph cannot be decoded and undistorted."""
    needed = undistorting_bytes(1, sizes_wh)
    if needed > limit_bytes:
        width, height = max(sizes_wh, key=lambda size_wh: size_wh[0] * size_wh[1])
        raise BadInput(
            f"{limit_bytes / 1e6:,.0f} MB of memory are too few to decode and undistort a photograph of {width:,} × {height:,} px: "
            f"give {needed / 1e6:,.0f} MB, or smaller photographs."
        )


def _features_within(limit_bytes: float, num_photographs: int, most: int, mapper: Mapper) -> int:
    """The most features per photograph, up to `most`, whose mapping fits; BadInput for too few."""
    features = most
    while features > LEAST_FEATURES and mapping_bytes(num_photographs, features, mapper) > limit_bytes:
        features = max(LEAST_FEATURES, features - FEATURES_STEP)
    needed = mapping_bytes(num_photographs, features, mapper)
    if needed > limit_bytes:
        raise BadInput(
            f"{limit_bytes / 1e6:,.0f} MB of memory are too few to place {num_photographs:,} photographs, even with {features:,} features "
            f"each: give {needed / 1e6:,.0f} MB, or fewer photographs."
        )
    return features
