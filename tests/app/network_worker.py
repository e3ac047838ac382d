"""A worker with one core, for runs over a network that are compared to the bit: structure from motion
with several threads differs in the last digits from run to run, wherever it runs.

Where RADIANT_TEST_STARTS names a file, a line there tells of each training that begins: the kind of
the node and the step that it goes on from. Where RADIANT_TEST_HOLD names one, the training of a
device waits after its first checkpoint until that file is gone.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from radiant_app.executors.protocol import NodeTask
from radiant_app.workers import worker
from radiant_core.train.checkpoint import CheckpointFolder

STARTS, HOLD = "RADIANT_TEST_STARTS", "RADIANT_TEST_HOLD"


def command(task: NodeTask) -> list[str]:
    """What starts a node anew, from the root of the repository."""
    return [sys.executable, "-m", "tests.app.network_worker", task.kind, str(task.folder), task.stage, task.key]


def main(arguments: list[str]) -> int:
    """Run one node; see `worker.main`."""
    os.cpu_count = lambda: 1
    if STARTS in os.environ:
        _trace(arguments[0], Path(os.environ[STARTS]), Path(os.environ[HOLD]))
    return worker.main(arguments)


def _trace(kind: str, starts: Path, hold: Path) -> None:
    load, offer = CheckpointFolder.load, CheckpointFolder.offer

    def load_and_write(self: CheckpointFolder):
        state = load(self)
        with starts.open("a") as file:
            file.write(f"{kind} {0 if state is None else self._list_saved()[0].step}\n")
        return state

    def offer_and_wait(self: CheckpointFolder, step: int, state) -> None:
        offer(self, step, state)
        while kind == "own_field" and hold.exists() and any(self.folder.glob("*.json")):
            time.sleep(0.01)

    vars_of = {"load": load_and_write, "offer": offer_and_wait}
    for name, function in vars_of.items():
        setattr(CheckpointFolder, name, function)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
