"""A million mutated PLY files and a hundred thousand of each other kind: read or refused with BadInput, quickly and in little memory."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.stress.reader_fuzz import SEED, TARGETS, fuzz

MAX_S, MAX_GROWN_BYTES = 0.1, 32 * 2**20


@pytest.mark.stress
@pytest.mark.parametrize("name", list(TARGETS))
def test_mutated_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    report = fuzz(name, 10**6 if name == "ply" else 10**5, SEED, tmp_path)
    assert report.surprises == [] and report.longest_s < MAX_S and report.grown_bytes < MAX_GROWN_BYTES, report


@pytest.mark.parametrize("name", list(TARGETS))
def test_a_sample_of_mutated_files_is_read_or_refused(name: str, tmp_path: Path) -> None:
    count = 200 if name == "exif" else 1000
    report = fuzz(name, count, int(os.environ.get("RADIANT_FUZZ_SEED", "1")), tmp_path)
    # Some are read: a reader that refuses everything would pass the rest.
    assert report.surprises == [] and 0 < report.num_refused < count, report
    assert report.longest_s < MAX_S and report.grown_bytes < MAX_GROWN_BYTES, report
