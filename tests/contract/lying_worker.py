"""A worker as of a run, but for one device: the gradients that it sends are 20 times its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_app.workers import worker
from radiant_core.train.together.gradients import StepGradients
from radiant_core.train.together.replica import Replica

LIAR, TIMES = "edge-1-2", np.float32(20)


def main(arguments: list[str]) -> int:
    """Run one node."""
    if Path(arguments[1]).name == LIAR:
        contribute = Replica.contribute

        def lie(self: Replica, step: int | None = None) -> StepGradients:
            honest = contribute(self, step)
            return replace(honest, values=TIMES * honest.values)

        Replica.contribute = lie
    return worker.main(arguments)
