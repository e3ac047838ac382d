"""Frames (H,W,3) uint8 into a film, whole or not at all: MP4 or WebM by OpenCV, GIF by Pillow.

MP4 holds MPEG-4 Part 2, which desktop players show and browsers do not: OpenCV's wheel encodes
H.264 and H.265 only on a video chip, AV1 not at all, and VP9 in 118 s for 24 frames of 640×480.
WebM holds VP8 (1.5 s for the same), which browsers show; GIF has 256 colours a frame.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np

from radiant_core.errors import BadInput
from radiant_viewer.pictures.images import Image

CODECS = {".mp4": "mp4v", ".webm": "VP80"}
ENDINGS = (*CODECS, ".gif")
NOT_FOR_BROWSERS = "MPEG-4 Part 2, which desktop players show and browsers do not: let its name end in .webm for both"
"""The warning about MP4, given before one is made."""
MAX_GIF_BYTES = 1 << 30
"""Most bytes of a GIF's frames, which are kept in memory until the end."""


class MovieWriter:
    """A context manager: `add` frames of one size; if the block fails, nothing is left.

    Args:
        path: the film; its ending, one of `ENDINGS`, chooses the format.
        size_wh: of the frames, even and at least 16 px.
        frames_per_s: frames per second.

    Raises: BadInput for another ending or size, or a folder that cannot be written.
    """

    def __init__(self, path: Path, size_wh: tuple[int, int], frames_per_s: float) -> None:
        self.path, self.size_wh, self.frames_per_s = Path(path), size_wh, frames_per_s
        self.num_frames = 0
        suffix = self.path.suffix.lower()
        if suffix not in ENDINGS:
            raise BadInput(f"cannot write {self.path}: let the name of a film end in {', '.join(ENDINGS)}.")
        if any(side < 16 or side % 2 for side in size_wh):
            raise BadInput(f"a film of {size_wh[0]} × {size_wh[1]} px was asked for, expected even sides of 16 px or more.")
        if not self.path.parent.is_dir() or not os.access(self.path.parent, os.W_OK):
            raise BadInput(f"cannot write {self.path}: choose a folder that exists and can be written.")
        handle, part = tempfile.mkstemp(prefix=f".{self.path.stem}.", suffix=suffix, dir=self.path.parent)
        os.close(handle)
        self._part = Path(part)
        self._gif: list[Image] = []
        self._video = None if suffix == ".gif" else self._open_video(CODECS[suffix])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.finish()
        else:
            self.discard()

    def add(self, image: Image) -> None:
        """Append one frame."""
        width, height = self.size_wh
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise BadInput(f"a frame of shape {image.shape} and type {image.dtype} came, expected {(height, width, 3)} uint8.")
        if self._video is not None:
            self._video.write(np.ascontiguousarray(image[:, :, ::-1]))
        else:
            if (self.num_frames + 1) * image.nbytes > MAX_GIF_BYTES:
                raise BadInput(
                    f"a GIF of more than {self.num_frames} such frames is too large: write MP4 or WebM, or fewer or smaller frames."
                )
            self._gif.append(np.array(image))
        self.num_frames += 1

    def finish(self) -> None:
        """Close and rename the file; BadInput without frames."""
        if not self.num_frames:
            self.discard()
            raise BadInput(f"no frame came for {self.path}: nothing was written.")
        if self._video is not None:
            self._video.release()
        else:
            self._write_gif()
        # mkstemp makes files that only the owner reads.
        umask = os.umask(0)
        os.umask(umask)
        self._part.chmod(0o666 & ~umask)
        self._part.replace(self.path)

    def discard(self) -> None:
        """Delete the unfinished file; an older file of that name stays."""
        if self._video is not None:
            self._video.release()
        self._gif.clear()
        self._part.unlink(missing_ok=True)

    def _open_video(self, codec: str) -> cv2.VideoWriter:
        with _quiet_stderr():
            video = cv2.VideoWriter(str(self._part), cv2.VideoWriter.fourcc(*codec), self.frames_per_s, self.size_wh)
        if not video.isOpened():
            self._part.unlink(missing_ok=True)
            raise BadInput(f"OpenCV cannot encode {codec} here: write {self.path.with_suffix('.gif').name} instead.")
        return video

    def _write_gif(self) -> None:
        from PIL import Image as Pictures

        first, *others = (Pictures.fromarray(frame).quantize(colors=256, dither=Pictures.Dither.NONE) for frame in self._gif)
        # GIF counts hundredths of a second.
        first.save(self._part, format="GIF", save_all=True, append_images=others, duration=round(1000 / self.frames_per_s), loop=0)
        self._gif.clear()


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silence OpenCV's encoder, which prints from C that VP80 is no tag of WebM, yet writes it."""
    sys.stderr.flush()
    stderr_copy = os.dup(2)
    try:
        with Path(os.devnull).open("wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(stderr_copy, 2)
        os.close(stderr_copy)
