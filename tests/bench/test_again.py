"""The benchmark of second flights runs whole on a town of thumbnails, and resumes."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import again


def test_a_seed_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
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
    # What is printed compares pairs of views, over seeds.
    again.again(tmp_path, seeds=1, width_px=64, steps=10)
    printed = capsys.readouterr().out
    differences = [float(row[0].psnr_db[i] - row[1].psnr_db[i]) for row in [rows] for i in range(8)]
    assert f"proposed − grid: {sum(differences) / 8:+.2f} dB" in printed
    assert "rank in views like those flown" in printed
