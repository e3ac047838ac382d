"""What a frame of the 3D view costs while it moves, and how soon it is sharp at rest, in the real
window.

    xvfb-run -a -s "-screen 0 2400x1500x24" python -m tests.viewer.view_frames RUN

RUN is a run with a model; its Gaussians are repeated, a little aside, or thinned out to each count.
CPU is of the window and the renderer's process together; on N free cores a frame takes at least an
N-th of it.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PySide6.QtCore import QProcess
from PySide6.QtTest import QTest

from radiant_core.io.ply import load_ply, save_ply
from radiant_core.splats import Splats
from radiant_viewer.pictures.view_motion import orbit
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_user import until, use_window

COUNTS, SIZES_WH, MOVING_S, RESTS = (40_000, 200_000, 1_000_000), ((1280, 800), (1920, 1080)), 4.0, 3


def of_size(splats: Splats, count: int) -> Splats:
    """The same scene with so many Gaussians: some of them, or each several times."""
    rng = np.random.default_rng(0)
    if count <= len(splats):
        return splats.select(np.sort(rng.permutation(len(splats))[:count]))
    times = splats.select(np.resize(np.arange(len(splats)), count))
    aside = np.exp(times.log_scales) * rng.normal(0, 0.5, (count, 3))
    return replace(times, means=(times.means + aside).astype(np.float32))


def cpu_s(pids: list[int]) -> float:
    """CPU seconds of processes so far."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split() for pid in pids]
    return sum(int(one[11]) + int(one[12]) for one in fields) / os.sysconf("SC_CLK_TCK")


def move(window: InspectorWindow) -> tuple[int, float]:
    """Orbit for some seconds; how many frames there were, and the seconds."""
    model = window.model
    assert model is not None
    frames, began = 0, time.monotonic()
    while time.monotonic() - began < MOVING_S:
        seen = model.num_drawn
        window.view.set_pose(orbit(window.view.pose, 1.0, 0.0))
        until(lambda seen=seen: model.num_drawn > seen, "no frame came")
        frames += 1
    return frames, time.monotonic() - began


def measure(window: InspectorWindow) -> None:
    """Print the frames of a view at each size."""
    model = window.model
    assert model is not None
    for dock in window.all_docks():
        dock.hide()
    window.map.frame.hide()
    worker = int(model.findChildren(QProcess)[0].processId())
    for size in SIZES_WH:
        for _ in range(3):
            now = window.view.size_wh
            window.resize(window.width() + size[0] - now[0], window.height() + size[1] - now[1])
            QTest.qWait(200)
        until(lambda: model.shown_is_full, "the model was never drawn")
        full_ms = 1000 * model.last_seconds
        # The first time it finds out how coarse a moving picture must be.
        move(window)
        before = cpu_s([os.getpid(), worker])
        frames, wall_s = move(window)
        spent_s = cpu_s([os.getpid(), worker]) - before
        rests = []
        for _ in range(RESTS):
            window.view.set_pose(orbit(window.view.pose, 1.0, 0.0))
            began = time.monotonic()
            QTest.qWait(1)
            until(lambda: model.shown_is_full, "it never got sharp")
            rests.append(time.monotonic() - began)
        print(
            f"{model.num_gaussians:>9,}  {window.view.size_wh[0]}x{window.view.size_wh[1]}  {frames / wall_s:5.1f} frames/s"
            f"  {1000 * spent_s / frames:5.0f} ms CPU  sides / {model.coarse}  sharp in {np.median(rests):.2f} s"
            f"  full picture {full_ms:.0f} ms  load {os.getloadavg()[0]:.1f}",
            flush=True,
        )


def main(run: Path) -> None:
    """Every count in a window of its own."""
    splats = load_ply(run / "scene.ply")
    with TemporaryDirectory() as temporary:
        for count in COUNTS:
            copy = Path(temporary) / str(count)
            shutil.copytree(run, copy, ignore=shutil.ignore_patterns("devices", "edges", "cloud", "evaluation"))
            save_ply(copy / "scene.ply", of_size(splats, count))
            use_window(copy, measure)
            shutil.rmtree(copy)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
