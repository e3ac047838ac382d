"""Measures what a step of a training together takes beside its views, on one machine.

    latency   half a round trip of 1 kB between two processes over gloo, the median of 200
    adding    rows of gradients in 16 bits added to a model's, seconds per byte, the median of 9

Over a wire a message takes longer: `latency_ms` in the system file says how long. Once per profile,
some 4 s, most of them the other process's start.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import StageFailed
from radiant_core.plan.together.costs import BESIDE_BYTES

MESSAGE_BYTES, NUM_MESSAGES, NUM_WARM_UP = 1024, 200, 20
NUM_FLOATS, NUM_ROWS, NUM_SPLATS, NUM_SUMS = 23, 20_000, 100_000, 9
WAIT_S = 60.0
"""How long the two processes wait for each other."""


@dataclass(frozen=True, kw_only=True)
class ExchangeTime:
    """What was measured."""

    latency_s: float
    """One way of a short message."""
    add_s_per_byte: float


def measure_exchange() -> ExchangeTime:
    """Measure both; StageFailed where the two processes cannot exchange messages."""
    with tempfile.TemporaryDirectory(prefix="radiant_exchange_") as name:
        store = Path(name) / "store"
        command = [sys.executable, "-m", "radiant_app.commands.machine.exchange_time", str(store)]
        peer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            round_trips_s = exchange_messages(store, rank=0)
            peer.wait(WAIT_S)
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            message = str(error).splitlines()[0]
            raise StageFailed(f"two processes of this machine cannot exchange messages over gloo: {message}") from error
        finally:
            peer.kill()
            peer.wait()
    return ExchangeTime(latency_s=float(np.median(round_trips_s)) / 2, add_s_per_byte=adding_time())


def exchange_messages(store: Path, *, rank: int) -> list[float]:
    """Send 1 kB there and back with the process of the other rank, 0 or 1, that has the same file;
    seconds of each round trip but the first. RuntimeError where it does not come."""
    import torch
    import torch.distributed as dist

    distributed: Any = dist  # gloo's devices are not in torch's stubs
    gloo = distributed.ProcessGroupGloo
    options = gloo._Options()
    options._devices = [gloo.create_device(hostname="127.0.0.1")]
    options._timeout = timedelta(seconds=WAIT_S)
    group = gloo(distributed.FileStore(str(store), 2), rank, 2, options)
    message = torch.zeros(MESSAGE_BYTES, dtype=torch.uint8)
    seconds: list[float] = []
    for _ in range(NUM_WARM_UP + NUM_MESSAGES):
        begun_s = time.perf_counter()
        for step in (rank, 1 - rank):
            call = group.send if step == 0 else group.recv
            call([message], 1 - rank, 0).wait()
        seconds.append(time.perf_counter() - begun_s)
    return seconds[NUM_WARM_UP:]


def adding_time() -> float:
    """Seconds for each byte of rows in 16 bits that are added to those of a model."""
    import torch

    random = torch.Generator().manual_seed(0)
    rows = torch.randperm(NUM_SPLATS, generator=random)[:NUM_ROWS].sort().values
    gradients = torch.randn(NUM_ROWS, NUM_FLOATS, generator=random).half()
    total = torch.zeros(NUM_SPLATS, NUM_FLOATS)
    seconds: list[float] = []
    for _ in range(NUM_SUMS):
        begun_s = time.perf_counter()
        total.index_add_(0, rows, gradients.float())
        seconds.append(time.perf_counter() - begun_s)
    return float(np.median(seconds)) / (NUM_ROWS * (2 * NUM_FLOATS + BESIDE_BYTES))


if __name__ == "__main__":
    exchange_messages(Path(sys.argv[1]), rank=1)
