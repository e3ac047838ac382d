"""The plan of a memory limit: laws for every limit, and one sentence where nothing fits."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiant_core.errors import BadInput
from radiant_core.train.config import TrainConfig
from radiant_core.train.memory import (
    MIN_SPLATS,
    STATISTICS_BUDGET_BYTES,
    bytes_per_splat,
    fixed_bytes,
    memory_plan,
    within_memory,
    within_vram,
)
from tests.core.scenes import cameras_above

CAMERAS = cameras_above([(x, 0.0) for x in range(40)], size_wh=(640, 480))
CONFIG = TrainConfig()
BASE = 400_000_000


@given(st.integers(700_000_000, 10**12), st.integers(0, 3), st.booleans(), st.booleans())
def test_a_plan_fills_its_limit_and_never_exceeds_it(memory_bytes: int, sh_degree: int, validated: bool, masked: bool) -> None:
    config = replace(CONFIG, sh_degree=sh_degree)
    plan = memory_plan(config, CAMERAS, memory_bytes, BASE, validated=validated, masked=masked)
    each = bytes_per_splat(sh_degree, validated=validated)
    assert 0 <= memory_bytes - plan.needed_bytes <= each + 1
    needed = fixed_bytes(config, CAMERAS, BASE, masked=masked) + plan.statistics_bytes + plan.max_num_splats * each
    assert needed == pytest.approx(plan.needed_bytes, abs=1)
    assert 0 <= plan.statistics_bytes <= STATISTICS_BUDGET_BYTES


def test_masks_take_a_byte_a_pixel_at_each_size_that_is_kept() -> None:
    pixels = 40 * 640 * 480
    for start_scale, copies in ((1.0, 1.0), (0.5, 1.25)):
        config = replace(CONFIG, start_scale=start_scale)
        assert fixed_bytes(config, CAMERAS, BASE, masked=True) - fixed_bytes(config, CAMERAS, BASE) == pixels * copies


def test_more_memory_more_degrees_and_more_photographs_pull_as_they_should() -> None:
    def count(memory_bytes: int, config: TrainConfig = CONFIG, num_cameras: int = 40) -> int:
        return memory_plan(config, CAMERAS.select(range(num_cameras)), memory_bytes, BASE).max_num_splats

    assert count(10**9) < count(2 * 10**9)
    assert count(10**9, replace(CONFIG, sh_degree=3)) < count(10**9)
    assert count(10**9, replace(CONFIG, start_scale=0.5)) < count(10**9) < count(10**9, num_cameras=10)


@pytest.mark.parametrize("memory_bytes", [1, 10**6, BASE, 500_000_000])
def test_too_little_memory_is_one_sentence_that_says_what_would_do(memory_bytes: int) -> None:
    with pytest.raises(BadInput, match=r"give ([\d,]+) MB, or lower") as error:
        memory_plan(CONFIG, CAMERAS, memory_bytes, BASE)
    (enough,) = re.findall(r"give ([\d,]+) MB", str(error.value))
    # Rounded to whole megabytes, and a Gaussian's rest.
    assert memory_plan(CONFIG, CAMERAS, (int(enough.replace(",", "")) + 1) * 10**6, BASE).max_num_splats >= MIN_SPLATS


def test_the_lower_of_two_limits_of_gaussians_counts() -> None:
    plan = memory_plan(CONFIG, CAMERAS, 10**9, BASE)
    config, decision = within_memory(CONFIG, plan, 10**9, "train", None)
    assert config.max_num_splats == plan.max_num_splats and f"{plan.max_num_splats:,}" in decision.choice
    assert within_memory(CONFIG, plan, 10**9, "train", 5_000)[0].max_num_splats == 5_000
    assert within_memory(CONFIG, plan, 10**9, "train", 10**9)[0].max_num_splats == plan.max_num_splats


def test_a_small_gpu_limits_the_gaussians_and_a_large_one_decides_nothing() -> None:
    config, decisions = within_vram(CONFIG, CAMERAS, 80 * 10**9, "train")
    assert config == CONFIG and decisions == ()
    config, (decision,) = within_vram(CONFIG, CAMERAS, 5 * 10**8, "train")
    taken = config.max_num_splats * bytes_per_splat(CONFIG.sh_degree) + 100 * 640 * 480
    assert 0.99 * 0.4e9 < taken <= 0.4e9 and decision.figure == 500 and f"{config.max_num_splats:,}" in decision.choice
    with pytest.raises(BadInput, match="30 MB of free GPU memory leave room for 0 Gaussians, expected 1,000 or more: end"):
        within_vram(CONFIG, CAMERAS, 30 * 10**6, "train")
