"""Depth views are fused by forks of a process that has imported Open3D, which takes a second. What
fuses them, and how it ends, is tested by tests/core/geometry/test_fusion.py with processes that start anew."""

from __future__ import annotations

import pytest

from radiant_core.geometry import fusion
from tests.forked_workers import client, server_address

WORKER = "tests.fusion_worker"


@pytest.fixture(autouse=True)
def fused_by_forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Surfaces that a test makes are fused by forks."""
    monkeypatch.setattr(fusion, "worker_command", lambda folder: client(server_address(("open3d", WORKER)), WORKER, str(folder.resolve())))
