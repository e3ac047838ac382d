"""Every call that writes fails once, and all after it: the previous state loads and the job goes on. A thousand flipped bits are found."""

from __future__ import annotations

import pytest

from tests.core.io.store_faults import every_failing_call
from tests.core.io.test_store_faults import undiscovered_flips
from tests.memory_folder import memory_folder

pytestmark = pytest.mark.stress


def test_each_failing_write_leaves_the_previous_state() -> None:
    with memory_folder() as folder:
        assert every_failing_call(folder) == []


def test_a_thousand_flipped_bits_are_all_found() -> None:
    with memory_folder() as folder:
        assert undiscovered_flips(folder, count=1000) == []
