"""The renderer process (`splat_worker`), driven by Qt's event loop. Needs the `desktop` extra."""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, QProcess, Signal

from radiant_core.cameras import Cameras
from radiant_core.choices import Painter
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.pictures.images import Image

END_MS = 2000


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A picture (H,W,4) of colour and depth, the number of its request, and its drawing time. It
    is overwritten by the next frame but one."""

    request: int
    picture: Rgbd
    seconds: float

    @property
    def image(self) -> Image:
        """A copy of the colours (H,W,3) in 8 bits."""
        return np.rint(255 * self.picture[..., :3]).astype(np.uint8)


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """What of a model is drawn: inside a box (2,3), of a mask in a file (.npy, never changed), and
    at most so many Gaussians."""

    box: FloatArray | None = None
    max_gaussians: int | None = None
    keep_path: Path | None = None

    @property
    def key(self) -> bytes:
        """Equal for equal parts."""
        return (b"" if self.box is None else self.box.tobytes()) + f"{self.max_gaussians} {self.keep_path}".encode()


class SplatProcess(QObject):
    """Draws one picture at a time: do not call `ask` while `is_busy`. `failed` carries why the
    process ended by itself. Our renderer draws, unless another painter is asked for."""

    ready = Signal()
    frame_drawn = Signal(object)
    failed = Signal(str)

    def __init__(self, parent: QObject, ply_path: Path, painter: Painter = "radiant") -> None:
        super().__init__(parent)
        self.is_ready = self.is_busy = self._is_ending = False
        self.painter: Painter = painter
        self._slot = 0
        self._last_words = ""
        self._folder = tempfile.TemporaryDirectory(prefix="radiant-")
        self._frames = f"{self._folder.name}/frame"
        self._process = QProcess(self)
        self._process.readyReadStandardOutput.connect(self._on_output)
        self._process.readyReadStandardError.connect(self._on_error_text)
        self._process.finished.connect(self._on_finished)
        self._process.errorOccurred.connect(self._on_finished)
        arguments = [str(ply_path.resolve()), self._frames, painter]
        self._process.start(sys.executable, ["-m", "radiant_viewer.splats.splat_worker", *arguments])

    def ask(self, request: int, camera: Cameras, background: tuple[int, int, int], part: Part) -> None:
        """Request a picture of the one camera; `frame_drawn` carries the `Frame`."""
        assert self.is_ready and not self.is_busy
        self.is_busy = True
        # By turns, so that the last picture stays as it is while the next one is drawn.
        self._slot = 1 - self._slot
        message = {
            "id": request,
            "K": camera.Ks[0].tolist(),
            "cam_from_world": camera.cam_from_world[0].tolist(),
            "size_wh": camera.sizes_wh[0].tolist(),
            "background": list(background),
            "box": None if part.box is None else part.box.tolist(),
            "max_gaussians": part.max_gaussians,
            "kept": None if part.keep_path is None else str(part.keep_path),
            "slot": self._slot,
        }
        self._process.write(json.dumps(message).encode() + b"\n")

    def wait(self, seconds: float) -> None:
        """Wait for the process to get ready or to answer, without Qt's event loop."""
        self._process.waitForReadyRead(round(1000 * seconds))

    def end(self) -> None:
        """Stop the process; no signal follows."""
        self._is_ending = True
        self._process.closeWriteChannel()
        if self._process.state() != QProcess.ProcessState.NotRunning:
            # It has nothing to save.
            self._process.kill()
            self._process.waitForFinished(END_MS)
        self._folder.cleanup()

    def _on_output(self) -> None:
        while self._process.canReadLine():
            header: dict[str, Any] = json.loads(bytes(self._process.readLine().data()))
            if "ready" in header:
                self.is_ready = True
                self.ready.emit()
                continue
            width, height = (int(side) for side in header["size_wh"])
            picture = np.memmap(f"{self._frames}{self._slot}", np.float32, "r+", shape=(height, width, 4))
            self.is_busy = False
            self.frame_drawn.emit(Frame(request=int(header["id"]), picture=np.asarray(picture), seconds=float(header["seconds"])))

    def _on_error_text(self) -> None:
        self._last_words = (self._last_words + bytes(self._process.readAllStandardError().data()).decode(errors="replace"))[-2000:]

    def _on_finished(self, *_: object) -> None:
        if self._is_ending:
            return
        self._is_ending = True
        self.is_ready = self.is_busy = False
        reason = (self._last_words.strip() or "no message").splitlines()[-1]
        self.failed.emit(f"the renderer ended (exit code {self._process.exitCode()}): {reason}")
