"""What did the changes since another build bring? Run as
`python -m benchmarks.against --other OTHER/.venv/bin/radiant --scene PHOTOS --out OUT`.

The same command line, `radiant run PHOTOS` or another with `--command`, by this installation and
another, in turns: a slow minute of the machine meets both. CPU seconds are those of the command and
of every process that it began and waited for; memory is the largest sum of what the processes
together hold (proportional set size). Runs lie in OUT; a later call resumes after those that ended.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import rmtree
from statistics import median
from typing import Annotated

import psutil
import typer

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json, write_json

SAMPLED_EVERY_S = 1.0
BUILDS = ("other", "this")
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@dataclass(frozen=True, kw_only=True)
class Cost:
    """One run: seconds by the clock and of CPU, largest memory in bytes, PSNR of held-out
    photographs, Gaussians, and the load of the machine when it began."""

    wall_s: float
    cpu_s: float
    peak_bytes: int
    psnr_db: float
    psnr_cc_db: float
    num_gaussians: int
    load: float


@app.command()
def main(
    other: Annotated[Path, typer.Option(help="The `radiant` of the other installation.", exists=True, dir_okay=False)],
    scene: Annotated[Path, typer.Option(help="A folder of photographs.", exists=True, file_okay=False)],
    out: Annotated[Path, typer.Option(help="Folder of the runs and rows.")],
    rounds: Annotated[int, typer.Option(help="Runs of each build.", min=1)] = 3,
    command: Annotated[str, typer.Option(help="Arguments of both, FOLDER and --out come after them.")] = "run",
) -> None:
    """Run both builds in turns and print medians beside their ratio."""
    radiants = {"other": other.absolute(), "this": Path(sys.executable).with_name("radiant")}
    scene, out = scene.absolute(), out.absolute()
    costs: dict[str, list[Cost]] = {build: [] for build in BUILDS}
    for number in range(rounds):
        # The first of a round changes: what one leaves in the page cache serves the other.
        for build in BUILDS if number % 2 == 0 else BUILDS[::-1]:
            row = out / f"{build}_{number}.json"
            if not row.exists():
                cost = measure([str(radiants[build]), *command.split(), str(scene)], out / f"{build}_{number}")
                write_json(row, asdict(cost))
            costs[build].append(Cost(**read_json(row)))
            print(f"{build} {number}: {_sentence(costs[build][-1])}", flush=True)
    print(*_table(costs), sep="\n")


def measure(arguments: Sequence[str], folder: Path) -> Cost:
    """The cost of one command whose results come into `folder`; BadInput if it fails."""
    rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    load, before, begun_s = os.getloadavg()[0], _cpu_s(), time.monotonic()
    with folder.with_suffix(".log").open("w") as log:
        # Not where the command was typed: `python -m` would load the modules that lie there.
        command = [*arguments, "--out", str(folder)]
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, cwd=folder.parent)
        peak = _Peak(process.pid)
        peak.start()
        status = process.wait()
    wall_s = time.monotonic() - begun_s
    peak.join()
    if status != 0:
        raise BadInput(f"{' '.join(arguments)} ended with {status}: {log.name} holds its words.")
    figures = read_json(folder / "metrics.json")
    return Cost(
        wall_s=wall_s,
        cpu_s=_cpu_s() - before,
        peak_bytes=peak.bytes,
        psnr_db=figures["psnr_db"],
        psnr_cc_db=figures.get("psnr_cc_db", figures["psnr_db"]),
        num_gaussians=figures["num_gaussians"],
        load=load,
    )


class _Peak(threading.Thread):
    """The largest sum of what a process and those that it began hold, until it ends."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self.bytes = 0
        self._root = psutil.Process(pid)

    def run(self) -> None:
        # It may end, and be waited for, between any two of these calls.
        with suppress(psutil.NoSuchProcess):
            while self._root.status() != psutil.STATUS_ZOMBIE:
                self.bytes = max(self.bytes, sum(map(_held_bytes, [self._root, *self._root.children(recursive=True)])))
                time.sleep(SAMPLED_EVERY_S)


def _held_bytes(process: psutil.Process) -> int:
    try:
        return process.memory_full_info().pss
    except psutil.Error:  # it has ended meanwhile
        return 0


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _sentence(cost: Cost) -> str:
    return (
        f"{cost.wall_s:.1f} s, {cost.cpu_s:.1f} CPU s, {cost.peak_bytes / 1e6:.0f} MB,"
        f" {cost.psnr_db:.2f} dB ({cost.psnr_cc_db:.2f}), {cost.num_gaussians} Gaussians, load {cost.load:.1f}"
    )


def _table(costs: dict[str, list[Cost]]) -> list[str]:
    lines = ["| median | other | this | ratio |", "|---|---|---|---|"]
    for name in ("wall_s", "cpu_s", "peak_bytes", "psnr_db", "psnr_cc_db", "num_gaussians"):
        then, now = (median(getattr(cost, name) for cost in costs[build]) for build in BUILDS)
        lines.append(f"| {name} | {then:.6g} | {now:.6g} | {now / then:.2f} |")
    return lines


if __name__ == "__main__":
    try:
        app()
    except BadInput as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
