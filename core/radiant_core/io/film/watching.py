"""What a film shows of its own motion and sharpness, by OpenCV. Once per film.

    motion      median way of corners that are tracked from one watched frame to the next (Lucas and
                Kanade), as a share of the picture's long side; 1 where they are lost, as at a cut
    sharpness   mean square of the Laplacian of the picture reduced to 1,920 px

Frames are counted by decoding: the number that a container promises is wrong where a film was
trimmed, and looking one up by its number where the rate varies. OpenCV turns frames upright.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput

WATCHED_PER_S = 10.0
"""Frames a second that are looked at: motion within a tenth of a second is small, and so is what a
sharper neighbour would gain."""
MOTION_PX, SHARPNESS_PX = 480, 1920
"""Long sides to which frames are reduced."""
MAX_CORNERS, LEAST_TRACKED = 300, 20
ABRUPT = 1.0


@dataclass(frozen=True, kw_only=True)
class WatchedFrame:
    """One frame that was looked at: its number from 0, time, and what it shows."""

    index: int
    time_s: float
    sharpness: float
    motion: float
    """Since the watched frame before; 0 of the first."""


@contextmanager
def opened_film(path: Path) -> Iterator[cv2.VideoCapture]:
    """A film at its first frame; BadInput where OpenCV cannot open it."""
    film = cv2.VideoCapture(str(path))
    try:
        if not film.isOpened():
            raise BadInput(f"the film {path} cannot be opened: save it as MP4 with H.264, or give its frames as photographs.")
        yield film
    finally:
        film.release()


def watch_film(path: Path, report: Callable[[int, int], None]) -> tuple[WatchedFrame, ...]:
    """About ten frames a second in their order; `report(done, total)` counts frames. BadInput for a
    film without any that can be decoded."""
    watched = list[WatchedFrame]()
    with opened_film(path) as film:
        rate = film.get(cv2.CAP_PROP_FPS)
        stride = max(1, round(rate / WATCHED_PER_S)) if math.isfinite(rate) and rate > 0 else 1
        promised = max(1, int(film.get(cv2.CAP_PROP_FRAME_COUNT)))
        index, before = 0, None
        while film.grab():
            if index % stride == 0:
                whole, picture = film.retrieve()
                if whole:
                    grey = _reduced(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), SHARPNESS_PX)
                    small = _reduced(grey, MOTION_PX)
                    motion = 0.0 if before is None else motion_between(before, small)
                    time_s = film.get(cv2.CAP_PROP_POS_MSEC) / 1000
                    watched.append(WatchedFrame(index=index, time_s=time_s, sharpness=sharpness_of(grey), motion=motion))
                    before = small
            index += 1
            report(min(index, promised), promised)
    if not watched:
        raise BadInput(f"the film {path} has no frame that can be decoded: it is cut off or damaged, fetch it again.")
    return tuple(watched)


def sharpness_of(grey: NDArray[np.uint8]) -> float:
    """Mean square of the Laplacian of a grey picture (H,W)."""
    return float(np.square(cv2.Laplacian(grey, cv2.CV_32F)).mean())


def motion_between(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> float:
    """How far corners move between two grey pictures (H,W), as a share of the long side."""
    corners = cv2.goodFeaturesToTrack(before, MAX_CORNERS, 0.01, 8)
    if corners is None or len(corners) < LEAST_TRACKED:
        return ABRUPT
    moved, status, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, np.empty(0))
    tracked = status.ravel() == 1
    if tracked.sum() < LEAST_TRACKED:
        return ABRUPT
    ways_px = np.linalg.norm((moved - corners).reshape(-1, 2)[tracked], axis=1)
    return float(min(ABRUPT, np.median(ways_px) / max(before.shape)))


def _reduced(picture: NDArray[Any], long_side_px: int) -> NDArray[np.uint8]:
    scale = long_side_px / max(picture.shape[:2])
    if scale >= 1:
        return np.asarray(picture, np.uint8)
    size_wh = max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0]))
    return np.asarray(cv2.resize(picture, size_wh, interpolation=cv2.INTER_AREA), np.uint8)
