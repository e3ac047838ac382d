"""Every call that writes fails once, and all after it: the previous state loads and the job goes on. A thousand flipped bits are found."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.core.io.store_faults import every_failing_call
from tests.core.io.test_store_faults import undiscovered_flips

pytestmark = pytest.mark.stress


def test_each_failing_write_leaves_the_previous_state(tmp_path: Path) -> None:
    assert every_failing_call(tmp_path) == []


def test_a_thousand_flipped_bits_are_all_found(tmp_path: Path) -> None:
    assert undiscovered_flips(tmp_path, count=1000) == []
