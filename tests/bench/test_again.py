"""The benchmark of second flights runs whole on a town of thumbnails, and resumes."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import again


def test_a_seed_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(again, "NUM_OFF_PATH", 4)
    monkeypatch.setattr(again, "NUM_ON_PATH", 4)
    rows, found = again.measure_seed(0, tmp_path, 64, 10)
    assert [row.arm for row in rows] == list(again.ARMS)
    assert all(len(row.psnr_db) == 8 and 0 <= row.holes <= 1 for row in rows)
    # Views are at least so far from the model; ten steps leave it beside the truth by some metres.
    assert all(row.clearance_m > 0 for row in rows)
    assert found.facets > 100
    # A later call reads what is there: no town is made.
    monkeypatch.setattr(again, "Town", None)
    assert again.measure_seed(0, tmp_path, 64, 10) == (rows, found)
