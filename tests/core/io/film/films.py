"""Films made from the hamlet's photographs by OpenCV's writer, and subtitles as drones write them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

HAMLET = Path(__file__).parents[4] / "sample_scenes" / "hamlet" / "images"


def photographs() -> list[np.ndarray]:
    """The hamlet's photographs in the order of their flight, BGR."""
    pictures = [cv2.imread(str(path)) for path in sorted(HAMLET.iterdir())]
    assert all(picture is not None for picture in pictures)
    return [picture for picture in pictures if picture is not None]


def write_film(path: Path, frames: Iterable[np.ndarray], rate: float = 10.0) -> Path:
    """A film of these frames."""
    frames = list(frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, frames[0].shape[1::-1])
    assert film.isOpened()
    for frame in frames:
        film.write(frame)
    film.release()
    return path


def shaken(pictures: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Each picture three times, the first and the last time blurred."""
    return [each for picture in pictures for each in (_blurred(picture), picture, _blurred(picture))]


def panned(picture: np.ndarray, num_frames: int, step_px: float, blurred: Sequence[int] = ()) -> list[np.ndarray]:
    """A window of 160 × 120 px that moves over a picture by `step_px` a frame."""
    windows = [cv2.getRectSubPix(picture, (160, 120), (80 + step_px * index, 120.0)) for index in range(num_frames)]
    return [_blurred(window) if index in blurred else window for index, window in enumerate(windows)]


def _blurred(picture: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 3))


def srt(blocks: Iterable[tuple[float, str]]) -> str:
    """Subtitles with these texts from these seconds on."""
    lines = []
    for number, (time_s, text) in enumerate(blocks, start=1):
        begin = f"{int(time_s // 3600):02d}:{int(time_s // 60) % 60:02d}:{int(time_s) % 60:02d},{round(time_s % 1 * 1000):03d}"
        lines.append(f"{number}\n{begin} --> 00:00:60,000\n{text}\n")
    return "\n".join(lines)
