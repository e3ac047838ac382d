"""The predicted memory of joining, at once and by tiles, against the peak of a process that does it."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from radiant_core.aggregate.join_memory import MOST_STATISTICS_BYTES
from radiant_core.train.memory import STATISTICS_BYTES_PER_PX

pytestmark = pytest.mark.stress

AMPLE = 10**11


def joined(num_splats: int, num_views: int, long_side_px: int, sh_degree: int, memory_bytes: int) -> dict[str, Any]:
    numbers = map(str, (num_splats, num_views, long_side_px, sh_degree, memory_bytes))
    done = subprocess.run([sys.executable, "-m", "tests.stress.retrain_memory", *numbers], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(("num_splats", "num_views", "long_side_px", "sh_degree"), [
    (300_000, 16, 320, 3), (200_000, 16, 320, 0), (20_000, 24, 1152, 3), (40_000, 24, 640, 3),
])  # fmt: skip
def test_the_prediction_at_once_is_above_the_peak_and_below_twice_it(
    num_splats: int, num_views: int, long_side_px: int, sh_degree: int
) -> None:
    made = joined(num_splats, num_views, long_side_px, sh_degree, AMPLE)
    predicted = made["needed_bytes"] + made["statistics_bytes"]
    assert made["num_tiles"] == 1 and made["peak_bytes"] <= predicted <= 2 * made["peak_bytes"], made


@pytest.mark.parametrize(("num_splats", "sh_degree", "share"), [(300_000, 3, 0.97), (300_000, 0, 0.9), (300_000, 1, 0.85)])
def test_by_tiles_a_join_stays_below_the_limit(num_splats: int, sh_degree: int, share: float, capsys: pytest.CaptureFixture[str]) -> None:
    at_once = joined(num_splats, 16, 320, sh_degree, AMPLE)
    limit = round(share * at_once["needed_bytes"])
    tiled = joined(num_splats, 16, 320, sh_degree, limit)
    with capsys.disabled():
        print(f"{tiled['num_tiles']} tiles: {limit / 1e6:,.0f} MB allowed, {tiled['peak_bytes'] / 1e6:,.0f} MB held at most")
    assert tiled["num_tiles"] > 1 and tiled["peak_bytes"] <= limit


def test_views_take_no_memory_beyond_what_the_loss_keeps() -> None:
    few, many = (joined(20_000, num_views, 640, 0, AMPLE) for num_views in (16, 96))
    assert few["statistics_bytes"] == 16 * STATISTICS_BYTES_PER_PX * 640 * 480
    assert many["statistics_bytes"] == MOST_STATISTICS_BYTES
    kept = many["statistics_bytes"] - few["statistics_bytes"]
    assert many["peak_bytes"] - few["peak_bytes"] <= kept + 5e7
