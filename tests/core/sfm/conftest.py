"""Where the real photographs are; tests that need them are skipped with the reason if absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def data_folder() -> Path:
    folder = Path(os.environ.get("RADIANT_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "brighton" / "images").is_dir():
        pytest.skip(f"the real photographs are not in {folder}: set RADIANT_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def hamlet() -> Path:
    return ROOT / "sample_scenes" / "hamlet"
