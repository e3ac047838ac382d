"""The upload protocol in a thousand bad networks, and a hundred thousand tampered or replayed uploads and tasks each."""

from __future__ import annotations

import pytest

from tests.app.test_task_schema import tampered_tasks
from tests.core.io.protocol_world import REASONS, played
from tests.core.io.test_delivery import tampered_uploads
from tests.memory_folder import memory_folder

pytestmark = pytest.mark.stress


def test_a_thousand_schedules_leave_one_accepted_upload_of_every_region() -> None:
    counts = played(range(1000))
    # The schedules do reach what they are made for.
    assert min(counts[status] for status in ("accepted", "duplicate", "rejected")) > 500
    assert min(counts[reason] for reason in REASONS) > 100


def test_of_a_hundred_thousand_tampered_or_replayed_uploads_none_is_accepted() -> None:
    with memory_folder() as folder:
        assert tampered_uploads(folder, count=100_000, seed=9) == []


def test_of_a_hundred_thousand_tampered_or_replayed_tasks_none_is_taken() -> None:
    with memory_folder() as folder:
        assert tampered_tasks(folder, count=100_000, seed=9) == []
