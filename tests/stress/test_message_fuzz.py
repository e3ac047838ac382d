"""20,000 mutated messages of each kind of the network: each is used or refused with a reason, soon."""

from __future__ import annotations

import pytest

from tests.memory_folder import memory_folder
from tests.stress.message_fuzz import KINDS, SEED, fuzz_messages


@pytest.mark.stress
@pytest.mark.parametrize("kind", KINDS)
def test_20_000_mutated_messages_surprise_nobody(kind: str) -> None:
    with memory_folder() as folder:
        report = fuzz_messages(kind, 20_000, SEED, folder)
    print(f"{kind}: {report.num_refused:,} of {report.count:,} refused in {report.seconds:.0f} s, the longest {report.longest_s:.2f} s")
    assert report.surprises == []
    assert report.longest_s < 2, "seconds of the processor; the machine may be busy"
