"""Structure from motion within a limit of memory: fewer threads, then pixels, then features."""

from __future__ import annotations

import pytest

from radiant_core.errors import BadInput
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.memory import (
    LEAST_FEATURES,
    LEAST_SIDE_PX,
    features_bytes,
    limit_to_memory,
    mapping_bytes,
    undistorting_bytes,
    undistorting_threads,
)

WANTED = SfmConfig(num_threads=4)


def test_threads_go_first_then_pixels_and_what_is_chosen_fits() -> None:
    sizes_wh = [(800, 600), (6000, 4000)]
    before = (0, 0)
    # 6000 × 4000 px take 348 MB to be decoded and undistorted.
    for limit in range(390, 3000, 10):
        config, (decision,) = limit_to_memory(SfmConfig(num_threads=4, memory_bytes=limit * 1e6), sizes_wh)
        assert features_bytes(config.threads, config.max_image_size_px, sizes_wh) <= limit * 1e6
        assert config.threads == 1 or config.max_image_size_px == WANTED.max_image_size_px
        assert (config.threads, config.max_image_size_px) >= before, "more memory never means less"
        before = (config.threads, config.max_image_size_px)
        assert decision.forced and f"{config.threads} of 4 threads" in decision.choice
    assert before == (4, WANTED.max_image_size_px)


def test_mapping_fits_by_fewer_features_of_each_photograph() -> None:
    sizes_wh, before = [(640, 480)] * 200, LEAST_FEATURES
    for limit in range(290, 1600, 10):
        config, (decision,) = limit_to_memory(SfmConfig(num_threads=1, memory_bytes=limit * 1e6), sizes_wh)
        assert LEAST_FEATURES <= before <= config.max_num_features, "more memory never means less"
        assert mapping_bytes(len(sizes_wh), config.max_num_features) <= limit * 1e6
        assert ("features each" in decision.choice) == (config.max_num_features < WANTED.max_num_features)
        before = config.max_num_features
    assert before == WANTED.max_num_features
    # 200 photographs of 6,144 features: 1,409 MB for the incremental mapper, 2,638 with the global
    # one.
    for limit, mapper in ((1_500, "incremental"), (2_700, "auto")):
        assert limit_to_memory(SfmConfig(memory_bytes=limit * 1e6), sizes_wh)[0].mapper == mapper
    by_global = limit_to_memory(SfmConfig(memory_bytes=1_100e6, mapper="global"), sizes_wh)[0]
    assert by_global.mapper == "global" and mapping_bytes(200, by_global.max_num_features, "global") <= 1_100e6
    with pytest.raises(BadInput, match=r"too few to place 2,000 photographs, even with 512 features each: give 1,204 MB"):
        limit_to_memory(SfmConfig(num_threads=1, memory_bytes=1200e6), sizes_wh * 10)


def test_no_limit_decides_nothing_and_too_low_a_one_is_refused() -> None:
    assert limit_to_memory(WANTED, [(6000, 4000)]) == (WANTED, ())
    with pytest.raises(BadInput, match=rf"too few to find features, even in photographs of {LEAST_SIDE_PX} px: give \d+ MB"):
        limit_to_memory(SfmConfig(memory_bytes=190e6), [(640, 480)])
    with pytest.raises(BadInput, match=r"too few to decode and undistort a photograph of 6,000 × 4,000 px: give 348 MB, or smaller"):
        limit_to_memory(SfmConfig(memory_bytes=340e6), [(640, 480), (6000, 4000)])
    with pytest.raises(BadInput, match="positive number of bytes"):
        SfmConfig(memory_bytes=0)


def test_photographs_of_fifty_megapixels_are_counted_as_they_are_stored() -> None:
    sizes_wh = [(8192, 6144)] * 12
    # Measured with these, over the process: 330 MB to find features at 400 px, 302 MB and 593 MB to
    # undistort by 1 and 2 threads.
    assert features_bytes(1, 400, sizes_wh) >= 148e6 + 330e6
    assert undistorting_bytes(1, sizes_wh) >= 139e6 + 302e6 and undistorting_bytes(2, sizes_wh) >= 139e6 + 593e6
    config, _ = limit_to_memory(SfmConfig(num_threads=4, memory_bytes=700e6), sizes_wh)
    assert features_bytes(config.threads, config.max_image_size_px, sizes_wh) <= 700e6
    assert undistorting_threads(config, sizes_wh) == 1
    assert undistorting_threads(SfmConfig(num_threads=4, memory_bytes=1_300e6), sizes_wh) == 3
    assert undistorting_threads(SfmConfig(num_threads=4), sizes_wh) == 4
