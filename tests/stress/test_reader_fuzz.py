"""A million mutated PLY files and a hundred thousand of each other kind: read or refused with BadInput, quickly and in little memory."""

from __future__ import annotations

import pytest

from tests.memory_folder import memory_folder
from tests.stress.reader_fuzz import SEED, TARGETS, fuzz

MAX_S, MAX_GROWN_BYTES = 0.1, 32 * 2**20


@pytest.mark.stress
@pytest.mark.parametrize("name", list(TARGETS))
def test_mutated_files_are_read_or_refused(name: str) -> None:
    with memory_folder() as folder:
        report = fuzz(name, 10**6 if name == "ply" else 10**5, SEED, folder)
    assert report.surprises == [] and report.longest_s < MAX_S and report.grown_bytes < MAX_GROWN_BYTES, report


@pytest.mark.parametrize("name", list(TARGETS))
def test_a_sample_of_mutated_files_is_read_or_refused(name: str) -> None:
    count = {"exif": 200, "spz": 100, "sog": 4000, "lod": 3000, "glb": 3000}.get(name, 1000)
    with memory_folder() as folder:
        report = fuzz(name, count, 1, folder)
    # Some are read: a reader that refuses everything would pass the rest.
    assert report.surprises == [] and 0 < report.num_refused < count, report
    assert report.longest_s < MAX_S and report.grown_bytes < MAX_GROWN_BYTES, report
