"""The predicted memory of retraining at the cloud against the peak of a process that does it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from radiant_core.aggregate.cloud_choice import PROCESS_BYTES, STATISTICS_BYTES_PER_PX, retrain_memory_bytes
from radiant_core.splats import SH_BASES

pytestmark = pytest.mark.stress


@pytest.mark.parametrize(("num_splats", "num_views", "long_side_px", "sh_degree"), [
    (400_000, 4, 320, 3), (200_000, 4, 320, 0), (20_000, 24, 1152, 3), (20_000, 4, 1152, 3),
])  # fmt: skip
def test_the_prediction_is_above_the_peak_and_below_twice_it(num_splats: int, num_views: int, long_side_px: int, sh_degree: int) -> None:
    command = [sys.executable, "-m", "tests.stress.retrain_memory", *map(str, (num_splats, num_views, long_side_px, sh_degree))]
    measured = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    pixels = [long_side_px * (long_side_px * 3 // 4)] * num_views
    kept = STATISTICS_BYTES_PER_PX * sum(pixels)
    predicted = retrain_memory_bytes(num_splats, 4 * (11 + 3 * SH_BASES[sh_degree]), pixels) + kept - PROCESS_BYTES
    assert measured <= predicted <= 2 * measured, f"{measured / 1e6:.0f} MB measured, {predicted / 1e6:.0f} MB predicted"


@pytest.mark.parametrize(("share", "num_splats"), [(0.5, 20_000), (0.0, 20_000), (0.0, 150_000)])
def test_joining_with_a_share_of_what_the_loss_would_keep_stays_below_the_limit(
    share: float, num_splats: int, capsys: pytest.CaptureFixture[str]
) -> None:
    num_views, long_side_px, sh_degree = 24, 1152, 3
    pixels = [long_side_px * (long_side_px * 3 // 4)] * num_views
    kept = share * STATISTICS_BYTES_PER_PX * sum(pixels)
    limit = round(retrain_memory_bytes(num_splats, 4 * (11 + 3 * SH_BASES[sh_degree]), pixels) + kept) + 1
    numbers = (num_splats, num_views, long_side_px, sh_degree, limit)
    command = [sys.executable, "-m", "tests.stress.retrain_memory", *map(str, numbers)]
    measured = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    with capsys.disabled():
        allowed = f"{limit / 1e6:,.0f} MB allowed ({share:.0%} of what the loss would keep)"
        print(f"{num_splats:,} Gaussians, {allowed}: {measured / 1e6:,.0f} MB held at most")
    assert measured <= limit
