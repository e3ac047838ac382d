"""The default against the same training without any helper, on every kind of scene. Some minutes.

Radiant's generator makes the scenes, so that nothing has to be downloaded. `RADIANT_KINDS` names a
folder that keeps them and their rows, so that an interrupted test goes on.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from benchmarks.kinds.bench import MARGIN_DB, PLAIN, KindsBench, bench_kinds, gains_of
from benchmarks.kinds.scenes import KINDS

SEEDS = (0,)
FEWEST_SURE = 4
"""Of fewer held-out photographs a mean says too little to be held against the margin."""


@pytest.mark.stress
@pytest.mark.parametrize("number", [12, 30, 90])
@pytest.mark.parametrize("kind", list(KINDS))
def test_the_default_is_never_worse_than_plain(kind: str, number: int, tmp_path: Path) -> None:
    out = Path(os.environ.get("RADIANT_KINDS", tmp_path))
    rows, _ = bench_kinds(KindsBench(out=out, kinds=(kind,), numbers=(number,), helpers=(), seeds=SEEDS))
    gains = {gain.helper: gain.psnr_db for gain in gains_of(rows)}
    for name, gain in gains.items():
        print(f"{kind}, {number}: default − {name} {gain.mean:+.2f} dB ({gain.low:+.2f} … {gain.high:+.2f})")
    sure = gains[PLAIN].num_images >= FEWEST_SURE
    assert (gains[PLAIN].mean if sure else gains[PLAIN].high) >= -MARGIN_DB
