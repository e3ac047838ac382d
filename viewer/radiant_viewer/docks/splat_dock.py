"""The splat view: the model from the camera of the 3D view, coarse while it moves, full at rest.

The choice of renderer is a `Decision`: our own is exact and starts at once; after its first full
picture Open3D's is started, both draw the same picture, and the faster one is kept. A crop box is
always drawn by our own. Needs the `desktop` extra.
"""

from __future__ import annotations

import tempfile
import time
from functools import cached_property, partial
from pathlib import Path
from typing import get_args

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QComboBox, QDockWidget, QHBoxLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.io.ply import save_ply
from radiant_core.splats import Splats
from radiant_viewer.host.picture_label import PictureLabel
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.images import Image
from radiant_viewer.splats.splat_process import Frame, Kind, SplatProcess

POLL_MS, REST_S = 60, 0.4
COARSE = 3
"""Divisor of the picture's sides while the view moves."""
TRIALS = 3
"""Pictures per renderer in the timing; the last counts, since the first ones fill caches."""
NAMES: dict[Kind, str] = {"own": "Own renderer", "open3d": "Open3D"}
CHOICES = ("Automatic", *NAMES.values())


class SplatDock(QDockWidget):
    """Draws what the 3D view sees; hidden, it draws nothing."""

    def __init__(self, host: Host, splats: Splats) -> None:
        super().__init__("Splats")
        self.setObjectName("splats")
        self._host = host
        # A copy of what the strict reader accepted: the run's file may change meanwhile.
        self._folder = tempfile.TemporaryDirectory(prefix="radiant-")
        self._splats = splats
        self.picture = PictureLabel()
        self.picture.message = "Starting the renderer…"
        self.note = _note()
        self.choice = QComboBox()
        self.choice.addItems(CHOICES)
        self.choice.setToolTip("Who draws the splats; automatic takes the faster of the two for this model on this machine")
        self.choice.currentIndexChanged.connect(self._on_choice)
        row = QHBoxLayout()
        row.addWidget(self.note, stretch=1)
        row.addWidget(self.choice)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addWidget(self.picture, stretch=1)
        layout.addLayout(row)
        self.setWidget(body)
        self.decision: Decision | None = None
        self.shown_is_full = False
        self.last_image: Image | None = None
        self._processes: dict[Kind, SplatProcess] = {}
        self._seconds: dict[Kind, float] = {}
        self._trial: tuple[Kind, int] | None = None
        self._asked: tuple[bytes, bool] | None = None
        self._drawn: tuple[bytes, bool] | None = None
        self._last_key, self._moved_s = b"", 0.0
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._tick)
        self._timer.start(POLL_MS)

    @cached_property
    def ply_path(self) -> Path:
        """The model as a file for the renderer processes; written at its first use."""
        path = Path(self._folder.name) / "model.ply"
        save_ply(path, self._splats)
        return path

    @property
    def kind(self) -> Kind:
        """The renderer in use."""
        index = self.choice.currentIndex()
        if self._host.crop_box is not None:
            return "own"
        if index > 0:
            return get_args(Kind)[index - 1]
        return "open3d" if self.decision is not None and self.decision.choice == NAMES["open3d"] else "own"

    def end(self) -> None:
        """Stop the renderer processes; call it when the window closes."""
        self._timer.stop()
        for process in self._processes.values():
            process.end()
        self._processes.clear()
        self._folder.cleanup()

    def _tick(self) -> None:
        if not self.isVisible() or self.picture.visibleRegion().isEmpty():
            return
        process = self._process(self.kind)
        camera, key = self._camera(1)
        if key != self._last_key:
            self._last_key, self._moved_s = key, time.monotonic()
            self.shown_is_full = False
        if not process.is_ready or process.is_busy:
            return
        rests = time.monotonic() - self._moved_s > REST_S
        if rests and self._drawn == (key, True):
            self._compare()
        elif rests or (self._drawn is None or self._drawn[0] != key):
            # Open3D makes a new renderer for another size: it draws all pictures in full.
            full = rests or process.kind == "open3d"
            self._asked = (key, full)
            process.ask(0, camera if full else self._camera(COARSE)[0], self._host.theme.view, self._host.crop_box)

    def _camera(self, coarse: int) -> tuple[Cameras, bytes]:
        """Return the 3D view's camera at the dock's size over `coarse`, and the picture's key."""
        scale = self.picture.devicePixelRatioF() / coarse
        size = max(32, round(self.picture.width() * scale)), max(32, round(self.picture.height() * scale))
        camera = self._host.view.pose.camera(size)
        box = self._host.crop_box
        key = camera.cam_from_world.tobytes() + camera.Ks.tobytes() + self._host.theme.name.encode() + self.kind.encode()
        return camera, key + (b"" if box is None else box.tobytes())

    def _process(self, kind: Kind) -> SplatProcess:
        if kind not in self._processes:
            process = SplatProcess(self, kind, self.ply_path)
            process.drawn.connect(partial(self._on_drawn, kind))
            process.failed.connect(partial(self._on_failed, kind))
            self._processes[kind] = process
        return self._processes[kind]

    def _on_drawn(self, kind: Kind, frame: Frame) -> None:
        if frame.request == 1:
            self._on_trial(kind, frame)
            return
        self.last_image = frame.image
        self.picture.show_picture(frame.image)
        self._drawn = self._asked
        # The view may have moved since this picture was requested.
        self.shown_is_full = self._drawn == (self._last_key, True)
        width, height = frame.image.shape[1], frame.image.shape[0]
        detail = "full" if self._drawn is not None and self._drawn[1] else "coarse while moving"
        self.note.setText(f"{NAMES[kind]}, {width}×{height} px, {1000 * frame.seconds:.0f} ms\n{detail}{self._reason_text()}")
        reason = "" if self.decision is None else f"\n{self.decision.reason}"
        self.note.setToolTip(f"{self.note.text()}{reason}")

    def _reason_text(self) -> str:
        """Return the times that decided between the renderers, empty where the user chose."""
        if self.decision is None or self.choice.currentIndex():
            return ""
        others = [
            f"{NAMES[kind]} {1000 * seconds:.0f} ms" for kind, seconds in self._seconds.items() if NAMES[kind] != self.decision.choice
        ]
        return f" ({', '.join(others) or 'the other does not run here'})"

    def _compare(self) -> None:
        """Time both renderers on the full picture in turn, and keep the faster one."""
        if self.decision is not None or self.choice.currentIndex() or self._host.crop_box is not None:
            return
        kind, number = self._trial or ("own", 0)
        process = self._process(kind)
        if process.is_ready and not process.is_busy:
            self._trial = (kind, number)
            process.ask(1, self._camera(1)[0], self._host.theme.view, None)

    def _on_trial(self, kind: Kind, frame: Frame) -> None:
        if self._trial is None:
            # The user chose a renderer during the timing.
            return
        self._seconds[kind] = frame.seconds
        number = self._trial[1] + 1
        if number < TRIALS:
            self._trial = (kind, number)
        elif kind == "own":
            self._trial = ("open3d", 0)
            self._process("open3d")
        else:
            self._decide((frame.image.shape[1], frame.image.shape[0]))

    def _decide(self, size_wh: tuple[int, int]) -> None:
        own_ms, open3d_ms = (1000 * self._seconds[kind] for kind in get_args(Kind))
        faster: Kind = "own" if own_ms <= open3d_ms else "open3d"
        self.decision = Decision(
            stage="inspector",
            topic="splat renderer",
            choice=NAMES[faster],
            figure=own_ms,
            unit="ms for our own picture",
            reason=f"at {size_wh[0]}×{size_wh[1]} px our renderer takes {own_ms:.0f} ms, Open3D's {open3d_ms:.0f} ms",
        )
        idle: Kind = "open3d" if faster == "own" else "own"
        self._end_process(idle)
        # Draw again, so that the note shows the decision.
        self._drawn = None

    def _on_failed(self, kind: Kind, reason: str) -> None:
        self._end_process(kind)
        if kind == "open3d" and self.choice.currentIndex() != 2:
            own_ms = 1000 * self._seconds.get("own", 0.0)
            self.decision = Decision(
                stage="inspector",
                topic="splat renderer",
                choice=NAMES["own"],
                figure=own_ms,
                unit="ms for our own picture",
                reason=f"Open3D's renderer does not run here, ours takes {own_ms:.0f} ms",
            )
            self._drawn = None
            return
        self._timer.stop()
        self.picture.show_picture(None, message=f"The splats cannot be drawn: {reason}. Choose the other renderer, or reopen the run.")

    def _end_process(self, kind: Kind) -> None:
        process = self._processes.pop(kind, None)
        if process is not None:
            process.end()
            process.deleteLater()

    def _on_choice(self) -> None:
        self._drawn = None
        self._trial = None
        self._timer.start(POLL_MS)


def _note() -> QLabel:
    """Return a label of fixed height: resizing the picture above it would count as a movement."""
    note = QLabel("")
    note.setProperty("soft", "true")
    note.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
    note.setFixedHeight(2 * note.fontMetrics().lineSpacing())
    return note
