"""The renderer process (`splat_worker`), driven by Qt's event loop. Needs the `desktop` extra."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PySide6.QtCore import QObject, QProcess, Signal

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_viewer.pictures.images import Image

Kind = Literal["own", "open3d"]
END_MS = 2000


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A picture (H,W,3), the number of its request, and its drawing time."""

    request: int
    image: Image
    seconds: float


class SplatProcess(QObject):
    """Draws one picture at a time: do not call `ask` while `is_busy`. `failed` carries why the
    process ended by itself."""

    ready = Signal()
    drawn = Signal(object)
    failed = Signal(str)

    def __init__(self, parent: QObject, kind: Kind, ply_path: Path) -> None:
        super().__init__(parent)
        self.kind: Kind = kind
        self.is_ready = self.is_busy = self._is_ending = False
        self._header: dict[str, Any] | None = None
        self._last_words = ""
        self._process = QProcess(self)
        self._process.readyReadStandardOutput.connect(self._on_output)
        self._process.readyReadStandardError.connect(self._on_error_text)
        self._process.finished.connect(self._on_finished)
        self._process.errorOccurred.connect(self._on_finished)
        self._process.start(sys.executable, ["-m", "radiant_viewer.splats.splat_worker", kind, str(ply_path.resolve())])

    def ask(self, request: int, camera: Cameras, background: tuple[int, int, int], box: FloatArray | None) -> None:
        """Request a picture of the one camera; `drawn` carries the `Frame`."""
        assert self.is_ready and not self.is_busy
        self.is_busy = True
        message = {
            "id": request,
            "K": camera.Ks[0].tolist(),
            "cam_from_world": camera.cam_from_world[0].tolist(),
            "size_wh": camera.sizes_wh[0].tolist(),
            "background": list(background),
            "box": None if box is None else box.tolist(),
        }
        self._process.write(json.dumps(message).encode() + b"\n")

    def end(self) -> None:
        """Stop the process; no signal follows."""
        self._is_ending = True
        self._process.closeWriteChannel()
        if self._process.state() != QProcess.ProcessState.NotRunning:
            # It has nothing to save.
            self._process.kill()
            self._process.waitForFinished(END_MS)

    def _on_output(self) -> None:
        while True:
            if self._header is None:
                if not self._process.canReadLine():
                    return
                self._header = json.loads(bytes(self._process.readLine().data()))
            assert self._header is not None, "every line is an object"
            if "ready" in self._header:
                self._header, self.is_ready = None, True
                self.ready.emit()
                continue
            width, height = self._header["size_wh"]
            if self._process.bytesAvailable() < width * height * 3:
                return
            pixels = np.frombuffer(self._process.read(width * height * 3).data(), np.uint8).reshape(height, width, 3)
            frame = Frame(request=int(self._header["id"]), image=pixels, seconds=float(self._header["seconds"]))
            self._header, self.is_busy = None, False
            self.drawn.emit(frame)

    def _on_error_text(self) -> None:
        self._last_words = (self._last_words + bytes(self._process.readAllStandardError().data()).decode(errors="replace"))[-2000:]

    def _on_finished(self, *_: object) -> None:
        if self._is_ending:
            return
        self._is_ending = True
        self.is_ready = self.is_busy = False
        name = "our renderer" if self.kind == "own" else "Open3D's renderer"
        reason = (self._last_words.strip() or "no message").splitlines()[-1]
        self.failed.emit(f"{name} ended (exit code {self._process.exitCode()}): {reason}")
