"""Work that leaves no cycles, done without the search for them."""

from __future__ import annotations

import gc
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def without_garbage_search() -> Generator[None]:
    """Nothing is searched for cycles within the block. Where libraries load, the search takes a
    sixth of the time and finds hardly any; where a million features are parsed, 5 of 7 s."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
