"""Mutated messages of each kind of the network: each is used or refused with a reason. Many more: tests/stress."""

from __future__ import annotations

import pytest

from tests.memory_folder import memory_folder
from tests.stress.message_fuzz import KINDS, fuzz_messages

COUNT = 200


@pytest.mark.parametrize("kind", KINDS)
def test_mutated_messages_surprise_nobody(kind: str) -> None:
    with memory_folder() as folder:
        report = fuzz_messages(kind, COUNT, 7, folder)
    assert report.surprises == [] and 0 < report.num_refused <= COUNT
