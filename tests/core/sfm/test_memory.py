"""Structure from motion within a limit of memory: threads go first, then pixels; what cannot be done is said."""

from __future__ import annotations

import pytest

from radiant_core.errors import BadInput
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.memory import LEAST_SIDE_PX, features_bytes, within_memory

WANTED = SfmConfig(num_threads=4)


def test_threads_go_first_then_pixels_and_what_is_chosen_fits() -> None:
    sizes_wh = [(800, 600), (6000, 4000)]
    before = (0, 0)
    for limit in range(250, 3000, 10):
        config, (decision,) = within_memory(SfmConfig(num_threads=4, memory_bytes=limit * 1e6), sizes_wh)
        assert features_bytes(config.threads, config.max_image_size_px, sizes_wh) <= limit * 1e6
        assert config.threads == 1 or config.max_image_size_px == WANTED.max_image_size_px
        assert (config.threads, config.max_image_size_px) >= before, "more memory never means less"
        before = (config.threads, config.max_image_size_px)
        assert decision.forced and f"{config.threads} of 4 threads" in decision.choice
    assert before == (4, WANTED.max_image_size_px)


def test_no_limit_decides_nothing_and_too_low_a_one_is_refused() -> None:
    assert within_memory(WANTED, [(6000, 4000)]) == (WANTED, ())
    with pytest.raises(BadInput, match=rf"too few to find features, even in photographs of {LEAST_SIDE_PX} px: give \d+ MB"):
        within_memory(SfmConfig(memory_bytes=150e6), [(6000, 4000)])
    with pytest.raises(BadInput, match="positive number of bytes"):
        SfmConfig(memory_bytes=0)
