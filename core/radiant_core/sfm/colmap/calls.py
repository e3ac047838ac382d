"""Calls into pycolmap: logging, signals, progress and errors in one place.

Only pycolmap opens its database here, never Python's own sqlite3: pycolmap was seen to end the
process otherwise.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

from radiant_core.errors import BadInput, StageFailed
from radiant_core.extras import require_extra

require_extra("sfm", "photographs cannot be placed", "give a scene that is placed: a COLMAP project or a folder of `radiant sfm`")
try:
    import pycolmap
except (ImportError, RuntimeError, MemoryError) as error:
    # It takes half a gigabyte of addresses; where refused, its error names a broken installation.
    why = str(error.__cause__ or error).strip().split("\n")[0]
    raise BadInput(f"pycolmap cannot be loaded ({why}): allow more memory (ulimit -v), or run ./setup.sh again.") from error

__all__ = ["call_colmap", "pycolmap"]
TICK_S = 0.25
Result = TypeVar("Result")
# When imported, COLMAP's logging takes SIGTERM over and prints its stack; the handler is restored.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL.value)


def call_colmap(doing: str, call: Callable[..., Result], *args: Any, on_tick: Callable[[], None] | None = None, **options: Any) -> Result:
    """`call(*args, **options)` in a thread, so that Ctrl-C is heard; `on_tick` runs every 0.25 s. A
    `cancellation_token` among the options is cancelled on Ctrl-C. StageFailed, naming what it was
    `doing`, when pycolmap gives up."""
    token = options.get("cancellation_token")
    with ThreadPoolExecutor(max_workers=1) as pool:
        future = pool.submit(call, *args, **options)
        try:
            while wait([future], timeout=TICK_S).not_done:
                if on_tick is not None:
                    on_tick()
        except BaseException:
            if token is not None:
                token.cancel()
            raise
    try:
        return future.result()
    except (RuntimeError, ValueError) as error:
        raise StageFailed(f"structure from motion failed while {doing}: {str(error).strip()}") from error
