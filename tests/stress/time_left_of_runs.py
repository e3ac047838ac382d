"""How far off the time left of whole runs was: `python -m tests.stress.time_left_of_runs RUN …`.

For every run that ended without an interruption, and every tenth of its time: what was told to be
left, what was, and the error as a share of what was told; then what each phase was foreseen to take
and took. Reads events.jsonl, makes nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from radiant_app.events import PHASES, Foreseen, RunLeft, decode


def errors_of(told: list[RunLeft]) -> list[tuple[float, str, float, float]]:
    """Of each tenth of a run: the share that was over, the phase, seconds left as told and as it was."""
    whole_s = told[-1].elapsed_s
    rows = []
    for tenth in range(10):
        at = next((one for one in told if one.left_s is not None and one.elapsed_s >= tenth / 10 * whole_s), None)
        if at is not None and at.left_s is not None:
            rows.append((tenth / 10, at.phase, at.left_s, whole_s - at.elapsed_s))
    return rows


def main() -> int:
    """Print the errors of each run, and of all together the ninth of ten by phase."""
    off: dict[str, list[float]] = {phase: [] for phase in PHASES}
    for run in map(Path, sys.argv[1:]):
        events = [decode(line) for line in (run / "events.jsonl").read_text().splitlines()]
        told = [event for event in events if isinstance(event, RunLeft)]
        print(f"{run}: {told[-1].elapsed_s:.0f} s")
        for share, phase, said_s, was_s in errors_of(told):
            print(f"  {100 * share:3.0f} %  {phase:20}  told {said_s:7.1f} s  was {was_s:7.1f} s  off {100 * (was_s / said_s - 1):+5.0f} %")
            off[phase].append(abs(was_s / said_s - 1))
        begun_s = [next((one.elapsed_s for one in told if one.number > index), told[-1].elapsed_s) for index in range(len(PHASES) + 1)]
        foreseen = [event.phases_s for event in events if isinstance(event, Foreseen)]
        for index, phase in enumerate(PHASES):
            said = "  ".join(f"{one[index]:7.1f}" for one in foreseen)
            print(f"  {phase:20}  foreseen {said} s  took {begun_s[index + 1] - begun_s[index]:7.1f} s")
    for phase, shares in off.items():
        if shares:
            print(f"{phase:20}  {len(shares):3} estimates, nine of ten off by at most {100 * np.quantile(shares, 0.9):.0f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
