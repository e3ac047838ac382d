"""The default against the same training without any helper, on every kind of scene. Some minutes.

Radiant's generator makes the scenes, so that nothing has to be downloaded. `RADIANT_KINDS` names a
folder that keeps them and their rows, so that an interrupted test goes on.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from radiant_app.bench.kind_scenes import KINDS
from radiant_app.bench.kinds import MARGIN_DB, PLAIN, KindsBench, bench_kinds, gains_of

SEEDS = (0, 1)


@pytest.mark.stress
@pytest.mark.parametrize("number", [12, 30, 90])
@pytest.mark.parametrize("kind", list(KINDS))
def test_the_default_is_never_worse_than_plain(kind: str, number: int, tmp_path: Path) -> None:
    out = Path(os.environ.get("RADIANT_KINDS", tmp_path))
    rows, _ = bench_kinds(KindsBench(out=out, kinds=(kind,), numbers=(number,), helpers=(), seeds=SEEDS))
    (gain,) = gains_of(rows)
    assert gain.helper == PLAIN
    difference = gain.psnr_db
    print(f"{kind}, {number}: default − plain {difference.mean:+.2f} dB ({difference.low:+.2f} … {difference.high:+.2f})")
    # The mean of few images and seeds is worse than the margin by chance, so what is refused is
    # a loss of which the bounds are sure, or one of more than the bounds of most kinds.
    assert difference.high >= -MARGIN_DB and difference.mean >= -5 * MARGIN_DB
