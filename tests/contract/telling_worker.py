"""A worker as of a run, but that it tells of every step of a training, not of one a second."""

from __future__ import annotations

import math

from radiant_app.workers import worker
from radiant_core.train.trainer import ModelFit


def main(arguments: list[str]) -> int:
    """Run one node."""
    report = ModelFit._report

    def report_at_once(self: ModelFit) -> None:
        self._reported_s = -math.inf
        report(self)

    ModelFit._report = report_at_once
    return worker.main(arguments)
