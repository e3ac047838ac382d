"""Where the temporary folders of tests lie."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests import memory_folder
from tests.memory_folder import LEAST_BYTES, root_in_memory


def test_temporary_folders_lie_in_memory_that_has_room_and_may_start_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(memory_folder, "SHARED_MEMORY", tmp_path)
    place = SimpleNamespace(f_flag=0, f_bavail=LEAST_BYTES // 4096, f_frsize=4096)
    monkeypatch.setattr(os, "statvfs", lambda path: place)
    monkeypatch.setattr(memory_folder, "available_bytes", lambda: LEAST_BYTES)
    assert root_in_memory() == tmp_path
    for change in ({"f_flag": os.ST_NOEXEC}, {"f_bavail": LEAST_BYTES // 4096 - 1}):
        with monkeypatch.context() as patch:
            for name, value in change.items():
                patch.setattr(place, name, value)
            assert root_in_memory() is None, change
    monkeypatch.setattr(memory_folder, "available_bytes", lambda: LEAST_BYTES - 1)
    assert root_in_memory() is None
    monkeypatch.setattr(memory_folder, "SHARED_MEMORY", tmp_path / "nowhere")
    assert root_in_memory() is None
