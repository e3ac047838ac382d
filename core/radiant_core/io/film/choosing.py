"""Which frames of films become photographs: the sharpest of every stretch of equal motion.

    M_i = Σ motion up to frame i        stretch of frame i = ⌊M_i / step⌋

`step` is a tenth of the picture, so that neighbours overlap by about nine tenths, unless that makes
fewer than 60 frames or more than 400; below a hundredth two frames show the same. A frame is
blurred where its sharpness is below half of the median around it; a stretch that has only blurred
ones keeps the sharpest of them, since a gap would cost its neighbours their overlap. Once per
source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.film.watching import WatchedFrame
from radiant_core.numerics import FloatArray

STEP, LEAST_STEP = 0.1, 0.01
LEAST_FRAMES, MOST_FRAMES = 60, 400
AROUND_S = 1.5
BLURRED = 0.5


@dataclass(frozen=True, kw_only=True)
class ChosenFrames:
    """Film → the frames to take, in their order; how far the picture moves between two, and why."""

    frames: Mapping[str, tuple[WatchedFrame, ...]]
    step: float
    reason: str
    num_watched: int
    num_blurred: int
    """Of the watched ones."""
    num_blurred_taken: int

    @property
    def num_taken(self) -> int:
        """Of all films."""
        return sum(map(len, self.frames.values()))


def choose_frames(watched: Mapping[str, Sequence[WatchedFrame]], num_frames: int | None = None) -> ChosenFrames:
    """The frames of films to take, about `num_frames` of them in all if given."""
    total = sum(frame.motion for frames in watched.values() for frame in frames)
    num_watched = sum(map(len, watched.values()))
    wanted, reason = _wanted(total, num_watched, num_frames)
    step = total / wanted
    if step < LEAST_STEP:
        step, reason = LEAST_STEP, f"{reason}, and frames less than a hundredth of the picture apart show the same"
    frames_by_film, num_blurred, num_blurred_taken = {}, 0, 0
    for name, frames in watched.items():
        blurred = blurred_frames(frames)
        chosen = _sharpest_of_stretches(frames, blurred, step)
        frames_by_film[name] = tuple(frames[index] for index in chosen)
        num_blurred += int(blurred.sum())
        num_blurred_taken += int(blurred[chosen].sum())
    return ChosenFrames(
        frames=frames_by_film,
        step=step,
        reason=reason,
        num_watched=num_watched,
        num_blurred=num_blurred,
        num_blurred_taken=num_blurred_taken,
    )


def blurred_frames(frames: Sequence[WatchedFrame]) -> NDArray[np.bool_]:
    """Which frames (F,) are blurred beside those around them."""
    times_s, sharpness = np.array([frame.time_s for frame in frames]), np.array([frame.sharpness for frame in frames])
    first, last = np.searchsorted(times_s, times_s - AROUND_S), np.searchsorted(times_s, times_s + AROUND_S, "right")
    around = np.array([np.median(sharpness[a:b]) if b > a else 0.0 for a, b in zip(first, last, strict=True)])
    return sharpness < BLURRED * around


def _wanted(total_motion: float, num_watched: int, num_frames: int | None) -> tuple[int, str]:
    if num_frames is not None:
        return max(1, min(num_frames, num_watched)), f"--film-frames is {num_frames}"
    by_motion = max(1, round(total_motion / STEP))
    if by_motion > MOST_FRAMES:
        return MOST_FRAMES, f"a tenth of the picture would take {by_motion:,} frames, and {MOST_FRAMES} are the most without --film-frames"
    if by_motion < LEAST_FRAMES:
        return min(LEAST_FRAMES, num_watched), f"a tenth of the picture would take {by_motion} frames, fewer than {LEAST_FRAMES}"
    return by_motion, "neighbours overlap by nine tenths"


def _sharpest_of_stretches(frames: Sequence[WatchedFrame], blurred: NDArray[np.bool_], step: float) -> list[int]:
    moved: FloatArray = np.cumsum([frame.motion for frame in frames])
    # A film is a whole number of steps long up to rounding, and its last frame begins no other.
    stretches = np.minimum(np.floor(moved / step), max(1, round(moved[-1] / step)) - 1).astype(np.int64)
    sharpness = np.array([frame.sharpness for frame in frames])
    chosen = []
    for stretch in np.unique(stretches):
        inside = np.flatnonzero(stretches == stretch)
        sharp = inside[~blurred[inside]]
        candidates = sharp if len(sharp) else inside
        chosen.append(int(candidates[sharpness[candidates].argmax()]))
    return chosen
