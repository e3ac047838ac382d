"""What a frame of the 3D view costs while it moves, and how soon it is sharp at rest, in the real
window.

    xvfb-run -a -s "-screen 0 2400x1500x24" python -m tests.viewer.view_frames RUN [COUNT ...]

RUN is a run with a model; its Gaussians are repeated, a little aside, or thinned out to each count.
CPU is of the window and the renderer's process together; on N free cores a frame takes at least an
N-th of it. "empty" is a repaint without model and layers.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PySide6.QtCore import QProcess, QTimer
from PySide6.QtTest import QTest

from radiant_core.io.ply import load_ply, save_ply
from radiant_core.splats import Splats
from radiant_viewer.pictures.view_motion import orbit
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_user import PATIENCE_S, until, use_window

COUNTS, SIZES_WH = (40_000, 100_000, 200_000, 1_000_000), ((1280, 800), (1920, 1080))
MOVING_S, MOUSE_MS, RESTS, NUM_FLOORS = 4.0, 8, 5, 15


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


class Paints:
    """Counts what reaches the screen: paints of a view, and those with a new picture of the model."""

    def __init__(self, window: InspectorWindow) -> None:
        model = window.model
        assert model is not None
        self.num, self.num_new, self._shown = 0, 0, -1
        self._model = model
        window.view.plotter.frameSwapped.connect(self._count)

    def _count(self) -> None:
        self.num += 1
        self.num_new += self._model.num_drawn != self._shown
        self._shown = self._model.num_drawn


def move(window: InspectorWindow, paints: Paints) -> tuple[int, float]:
    """Orbit for some seconds as a mouse does; how many new pictures were painted, and the
    seconds."""
    hand = QTimer(interval=MOUSE_MS)
    hand.timeout.connect(lambda: (window.view.set_pose(orbit(window.view.pose, 0.3, 0.0)), window.view.render()))
    hand.start()
    before, began = paints.num_new, time.monotonic()
    QTest.qWait(round(1000 * MOVING_S))
    hand.stop()
    return paints.num_new - before, time.monotonic() - began


def floor_ms(window: InspectorWindow, paints: Paints) -> float:
    """Seconds of a repaint of the view without model and layers: Qt's and VTK's own, one sample."""
    props = [prop for prop in window.view.plotter.renderer.GetViewProps() if prop.GetVisibility()]
    for prop in props:
        prop.SetVisibility(False)
    window.view.plotter.render_window.SetMultiSamples(0)
    times_ms = []
    for _ in range(NUM_FLOORS):
        before, began = paints.num, time.monotonic()
        window.view.plotter.update()
        until_at_once(lambda before=before: paints.num > before)
        times_ms.append(1000 * (time.monotonic() - began))
    for prop in props:
        prop.SetVisibility(True)
    return float(np.median(times_ms))


def until_at_once(condition: Callable[[], bool]) -> None:
    """Let the window work until a condition holds, to the millisecond."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "no frame came"
        QTest.qWait(1)


def measure(window: InspectorWindow) -> None:
    """Print the frames of a view at each size."""
    model = window.model
    assert model is not None
    for dock in window.all_docks():
        dock.hide()
    window.map.frame.hide()
    worker = int(model.findChildren(QProcess)[0].processId())
    paints = Paints(window)
    for size in SIZES_WH:
        for _ in range(3):
            now = window.view.size_wh
            window.resize(window.width() + size[0] - now[0], window.height() + size[1] - now[1])
            QTest.qWait(200)
        until(lambda: model.shown_is_full, "the model was never drawn")
        full_ms = 1000 * model.last_seconds
        # The first time it finds out how coarse a moving picture must be.
        move(window, paints)
        before = cpu_s([os.getpid(), worker])
        frames, wall_s = move(window, paints)
        spent_s = cpu_s([os.getpid(), worker]) - before
        rests = []
        for _ in range(RESTS):
            window.view.set_pose(orbit(window.view.pose, 1.0, 0.0))
            began = time.monotonic()
            QTest.qWait(1)
            until_at_once(lambda: model.shown_is_full)
            seen = paints.num
            until_at_once(lambda seen=seen: paints.num > seen)
            rests.append(time.monotonic() - began)
        print(
            f"{model.num_gaussians:>9,}  {window.view.size_wh[0]}x{window.view.size_wh[1]}  {frames / wall_s:5.1f} frames/s"
            f"  {1000 * spent_s / frames:5.0f} ms CPU  sides / {model.coarse}  sharp in {np.median(rests):.2f} s"
            f"  full picture {full_ms:.0f} ms  empty {floor_ms(window, paints):.0f} ms  load {os.getloadavg()[0]:.1f}",
            flush=True,
        )


def main(run: Path) -> None:
    """Every count in a window of its own."""
    splats = load_ply(run / "scene.ply")
    with TemporaryDirectory() as temporary:
        for count in [int(text) for text in sys.argv[2:]] or COUNTS:
            copy = Path(temporary) / str(count)
            shutil.copytree(run, copy, ignore=shutil.ignore_patterns("devices", "edges", "cloud", "evaluation"))
            save_ply(copy / "scene.ply", of_size(splats, count))
            use_window(copy, measure)
            shutil.rmtree(copy)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
