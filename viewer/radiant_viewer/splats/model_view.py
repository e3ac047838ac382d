"""`ModelView`: the model in both views, by one renderer process. Needs the `desktop` extra.

    3D    for the camera as it moves, coarse only where that is needed for `MOVING_S` a frame; in
          full `REST_MS` after its last movement. The view is drawn when a picture came, and for
          that picture's camera, so that layers and model never part.
    map   from straight above once the map rests; the last picture moves along with it.

Events drive it: nothing is polled, and the next picture is requested before the last one is shown.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QTimer, Signal

from radiant_core.cameras import Cameras
from radiant_core.choices import Painter
from radiant_core.decisions import Decision
from radiant_core.io.ply import save_ply
from radiant_core.splats import Splats
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.splat_picture import Ground, camera_above
from radiant_viewer.splats.choosing import PAINTERS, forced_painter
from radiant_viewer.splats.painter_choice import PainterChoice
from radiant_viewer.splats.splat_process import Frame, Part, SplatProcess

MOVING_S, REST_MS, MAP_REST_MS = 0.04, 80, 160
COARSEST = 4
"""Largest divisor of the picture's sides while the view moves."""
MOVING_GAUSSIANS = 200_000
"""Most Gaussians while the view moves, where the coarsest picture of all is too slow."""
MAP_FILL = 0.35
"""Opacity of regions over the model."""
WAIT_S = 60.0
VIEW, MAP = 0, 1


class ModelView(QObject):
    """Draws a model behind the layers of the 3D view and the map while `is_shown`. `failed` carries
    a sentence when the renderer ended; from then on nothing is drawn."""

    failed = Signal(str)
    sharpened = Signal()
    """The 3D view shows the model in full."""

    def __init__(self, host: Host, splats: Splats, keep_mask: NDArray[np.bool_], painter: Painter | None = None) -> None:
        super().__init__()
        self._host, self._splats = host, splats
        self._num_kept, self._num_masks = len(splats), 0
        self.kept_path: Path | None = None
        """The mask of what is drawn, None for the whole model."""
        self.is_shown = True
        self.has_failed = False
        self._folder = tempfile.TemporaryDirectory(prefix="radiant-")
        # A copy of what the strict reader accepted: the run's file may change while this is open.
        self.ply_path = Path(self._folder.name) / "model.ply"
        save_ply(self.ply_path, splats)
        self._keep(keep_mask)
        self.decision: Decision | None = None
        """Which painter draws and why, once that is known."""
        self._process = self._start(painter or "radiant")
        self._next_process: SplatProcess | None = None
        """Of another painter, which takes over once it is ready."""
        self._choice: PainterChoice | None = None
        if painter is not None:
            self._tell(forced_painter(painter))
        else:
            self._choice = PainterChoice(host.view.note, self.ply_path)
            self._choice.decided.connect(self._on_decided)
            host.view.note.setToolTip(self._choice.first_words)
        self._wanted, self._asked_picture, self._drawn_picture = b"", (b"", False), (b"", False)
        self._map_asked, self._map_drawn = b"", b""
        self._map_extent = (0.0, 0.0, 1.0, 1.0)
        self.last_seconds, self.num_drawn = 0.0, 0
        """Of the renderer's last picture for the 3D view, and how many there were."""
        self.coarse, self._is_thinned = 2, False
        self._rest, self._map_rest = QTimer(self), QTimer(self)
        for timer, interval in ((self._rest, REST_MS), (self._map_rest, MAP_REST_MS)):
            timer.setSingleShot(True)
            timer.setInterval(interval)
            timer.timeout.connect(self._ask)
        self._is_looking = False
        for canvas in (host.view, host.map):
            canvas.watch_camera(self._look_soon)
        host.view.plotter.waits = lambda: self.is_drawn_by_us and self._process.is_busy and self._asked_picture[0] != self._drawn_picture[0]
        host.view.before_screenshot = host.map.before_screenshot = self.sharpen

    @property
    def is_drawn_by_us(self) -> bool:
        """Whether the views show the model."""
        return self.is_shown and not self.has_failed and self._drawn_picture[0] != b""

    @property
    def shown_is_full(self) -> bool:
        """Whether the 3D view shows the model in full for its camera."""
        return self._drawn_picture == (self._key(), True)

    @property
    def num_gaussians(self) -> int:
        """Gaussians that are drawn."""
        return self._num_kept

    def set_seen(self, keep_mask: NDArray[np.bool_]) -> None:
        """Draw those of a mask (N,) from now on; nothing where it is empty."""
        if keep_mask.any() and not np.array_equal(keep_mask, self._keep_mask):
            self._keep(keep_mask)
            self.look()
        self.set_shown(bool(keep_mask.any()))

    def set_shown(self, is_shown: bool) -> None:
        """Show or hide the model in both views."""
        if is_shown == self.is_shown:
            return
        self.is_shown = is_shown
        self._drawn_picture, self._map_drawn = (b"", False), b""
        if not is_shown:
            self._hide()
        self.look()

    def look(self) -> None:
        """Compare what is shown with what should be, and request what is missing."""
        self._is_looking = False
        if not self.is_shown or self.has_failed:
            return
        self._place_map()
        key = self._key()
        if key != self._wanted:
            self._wanted = key
            self._rest.start()
        if self._map_key() != self._map_drawn:
            self._map_rest.start()
        self._ask()

    def sharpen(self) -> None:
        """Wait until both views show the model in full."""
        if not self.is_shown or self.has_failed or not self._host.view.plotter.isVisible():
            return
        for _ in range(8):
            # An answer makes them run again.
            for timer in (self._rest, self._map_rest):
                timer.stop()
            self._wanted = self._key()
            self._ask()
            if not self._process.is_ready or self._process.is_busy:
                self._process.wait(WAIT_S)
            if self.has_failed or (self.shown_is_full and self._map_drawn == self._map_key()):
                return

    def end(self) -> None:
        """Stop the renderer; call it when the window closes."""
        self._rest.stop()
        self._map_rest.stop()
        self.is_shown = False
        if self._choice is not None:
            self._choice.end()
        for process in (self._process, self._next_process):
            if process is not None:
                process.end()
        self._folder.cleanup()

    @property
    def painter(self) -> Painter:
        """Who draws now."""
        return self._process.painter

    def _start(self, painter: Painter) -> SplatProcess:
        process = SplatProcess(self, self.ply_path, painter)
        process.frame_drawn.connect(self._on_drawn)
        process.ready.connect(lambda: self._on_ready(process))
        process.failed.connect(lambda reason: self._on_failed(process, reason))
        return process

    def _on_decided(self, painter: Painter, decision: Decision) -> None:
        self._tell(decision)
        if painter != self.painter:
            self._next_process = self._start(painter)

    def _tell(self, decision: Decision) -> None:
        self.decision = decision
        figure = "" if decision.figure is None else f", {decision.figure} {decision.unit}"
        self._host.view.note.setToolTip(f"Drawn by {decision.choice}{figure}: {decision.reason}.")

    def _look_soon(self) -> None:
        # A camera moves in steps, between which it may look nowhere.
        if not self._is_looking:
            self._is_looking = True
            QTimer.singleShot(0, self.look)

    def _keep(self, keep_mask: NDArray[np.bool_]) -> None:
        self._keep_mask, self._num_kept = keep_mask, int(keep_mask.sum())
        self._ground = Ground.of(self._splats if keep_mask.all() else self._splats.select(keep_mask))
        # A new file each time: the renderer knows parts by the file's name.
        self._num_masks += 1
        self.kept_path = None if keep_mask.all() else Path(self._folder.name) / f"kept{self._num_masks}.npy"
        if self.kept_path is not None:
            np.save(self.kept_path, keep_mask)

    def _part(self) -> Part:
        return Part(box=self._host.crop_box, keep_path=self.kept_path)

    def _key(self) -> bytes:
        view = self._host.view
        camera = view.pose.camera(view.size_wh)
        return camera.cam_from_world.tobytes() + camera.Ks.tobytes() + self._host.theme.name.encode() + self._part().key

    def _map_key(self) -> bytes:
        extent = np.array([*self._host.map.extent, *self._host.map.size_wh])
        return extent.tobytes() + self._host.theme.name.encode() + self._part().key

    def _ask(self) -> None:
        """Request the most wanted picture, if the renderer is free."""
        if not self._process.is_ready or self._process.is_busy or not self.is_shown or not self._host.view.plotter.isVisible():
            return
        rests = not self._rest.isActive()
        if self._wanted and (self._drawn_picture[0] != self._wanted or (rests and not self._drawn_picture[1])):
            self._ask_view(rests)
        elif rests and not self._map_rest.isActive() and self._map_drawn != self._map_key():
            self._ask_map()

    def _ask_view(self, rests: bool) -> None:
        view, part = self._host.view, self._part()
        width, height = view.size_wh
        coarse = 1 if rests else self.coarse
        thinned = self._is_thinned and not rests
        camera = view.pose.camera((max(32, round(width / coarse)), max(32, round(height / coarse))))
        self._asked_picture = (self._wanted, coarse == 1 and not thinned)
        view.plotter.keep_camera()
        if thinned:
            part = replace(part, max_gaussians=MOVING_GAUSSIANS)
        self._process.ask(VIEW, camera, self._host.theme.view, part)

    def _ask_map(self) -> None:
        self._map_asked, self._map_extent = self._map_key(), self._host.map.extent
        camera, part = self._above()
        self._process.ask(MAP, camera, self._host.theme.view, part)

    def _above(self) -> tuple[Cameras, Part]:
        """The camera over the map, and the part of the model below roofs and trees."""
        part = self._part()
        low, high = np.full(3, -np.inf), np.array([np.inf, np.inf, self._ground.ceiling])
        if part.box is not None:
            low, high = np.maximum(low, part.box[0]), np.minimum(high, part.box[1])
        x_min, y_min, x_max, y_max = self._host.map.extent
        return camera_above((x_min, x_max, y_min, y_max), self._host.map.size_wh, self._ground.height), replace(
            part, box=np.stack([low, high])
        )

    def _on_ready(self, process: SplatProcess) -> None:
        if process is self._next_process:
            self._process.end()
            self._process, self._next_process = process, None
            self._drawn_picture, self._map_drawn = (self._drawn_picture[0], False), b""
        self.look()

    def _on_drawn(self, frame: Frame) -> None:
        if not self.is_shown:
            return
        if frame.request == MAP:
            self._map_drawn = self._map_asked
            # Above everything: on the map heights only order the layers.
            frame.picture[..., 3] = 0
            self._host.map.backdrop.show(frame.picture)
            self._host.map.set_fill_opacity(MAP_FILL)
            self._place_map()
            self._host.map.plotter.update()
        else:
            self._drawn_picture, self.last_seconds = self._asked_picture, frame.seconds
            self.num_drawn += 1
            self._tune(frame.seconds)
            self._host.view.show_model(frame.picture, is_coarse=not self._drawn_picture[1])
            self._note(frame)
        self.look()
        if self.shown_is_full:
            if self._choice is not None:
                self._choice.on_first_picture()
            self.sharpened.emit()

    def _tune(self, seconds: float) -> None:
        """Choose how coarse the next picture of a moving view is by how long this one took."""
        if self._drawn_picture[1] and self.coarse != 1:
            return
        if seconds > 1.25 * MOVING_S:
            self._is_thinned = self._is_thinned or (self.coarse == COARSEST and self._num_kept > MOVING_GAUSSIANS)
            self.coarse = min(self.coarse + 1, COARSEST)
        elif seconds < 0.4 * MOVING_S:
            self.coarse = max(self.coarse - 1, 1)

    def _note(self, frame: Frame) -> None:
        height, width = frame.picture.shape[:2]
        detail = "" if self._drawn_picture[1] else ", coarse while moving"
        self._host.view.note.setText(f"{self._num_kept:,} Gaussians, {width} × {height} px in {1000 * frame.seconds:.0f} ms{detail}")

    def _place_map(self) -> None:
        x_min, y_min, x_max, y_max = self._map_extent
        left, bottom, right, top = self._host.map.extent
        width, height = x_max - x_min, y_max - y_min
        shift = ((left + right - x_min - x_max) / 2 / width, (bottom + top - y_min - y_max) / 2 / height)
        self._host.map.backdrop.place(shift, ((right - left) / width, (top - bottom) / height), self._host.theme.view)

    def _on_failed(self, process: SplatProcess, reason: str) -> None:
        if process.painter != "radiant":
            # A graphics driver ended it: ours draws on.
            self._host.view.note.setToolTip(f"Drawn by our renderer: with {PAINTERS[process.painter]}, {reason}.")
            self._next_process = None
            if process is self._process:
                process.end()
                self._process = self._start("radiant")
            return
        self.has_failed = True
        self._hide()
        self.failed.emit(f"The model cannot be drawn: {reason}. Its Gaussians are shown as points; reopen the run to try again.")

    def _hide(self) -> None:
        for canvas in (self._host.view, self._host.map):
            canvas.show_layers_alone()
        self._host.map.set_fill_opacity(1.0)
        self._host.view.note.setText("")
