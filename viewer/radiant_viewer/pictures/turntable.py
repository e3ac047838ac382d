"""A model seen from all around, for pages that nobody has to install anything for. Once per report.

The cameras stand on a circle about the framed box, so that turning does not zoom, at `NEAR` of
the least distance from which all of its corners are in every picture:

    |x| ≤ (D − t) k  for a corner x across (or up) the picture and t towards the camera, slope k
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from radiant_core.geometry.cleaning import SizeStep, keeps
from radiant_core.numerics import FloatArray
from radiant_core.render.trajectories import Lens, box_corners, orbit
from radiant_core.splats import Splats
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.splat_picture import render_over_white

ELEVATION_DEG = 40.0
FIELD_OF_VIEW_DEG = 30.0
NEAR = 0.84
"""Nearer by so much, corners leave the picture from some sides and the middle is seen better."""
MARGIN = 0.02
"""Of the longest side of the box: what lies farther out is left out, mostly haze."""
LARGEST, LARGEST_MEDIANS = 0.02, 4.0
"""A Gaussian is haze too if its standard deviation is a larger share of that side and, in models of
few large ones, more times the median."""

RIM_SIGMAS = 2.0
"""So many standard deviations away from the rim a wide Gaussian ends."""
HAZE_TIMES = 3.0
"""Flights and pictures show Gaussians so many times as wide: without them walls that were seen
from afar have holes."""


def crop_to(splats: Splats, box: FloatArray) -> Splats:
    """Return the Gaussians whose middles lie in a box (2,3) widened by `MARGIN`, without haze."""
    return splats.select(in_scene(splats, box, HAZE_TIMES))


def haze_size(splats: Splats) -> float:
    """From which standard deviation on a Gaussian of a model is haze, by its middle nine tenths."""
    if not len(splats):
        return 1.0
    side = float(np.ptp(np.quantile(splats.means[:, :2], [0.05, 0.95], axis=0), axis=0).max())
    return max(_largest(splats, side, np.ones(len(splats), bool)), 1e-6)


def haze_size_in(splats: Splats, box: FloatArray) -> float:
    """From which standard deviation on a Gaussian is haze, by those with their middle in a box
    (2,3); infinite where there is none."""
    inside = ((splats.means >= box[0]) & (splats.means <= box[1])).all(axis=1)
    return _largest(splats, float((box[1] - box[0]).max()), inside) if inside.any() else np.inf


def in_scene(splats: Splats, box: FloatArray, times: float = 1.0) -> NDArray[np.bool_]:
    """Which Gaussians (N,) have their middle in a box (2,3) widened by `MARGIN`, and are at most so
    many times as wide as what counts as haze there; wider ones lie wholly inside."""
    side = float((box[1] - box[0]).max())
    low, high = box[0] - MARGIN * side, box[1] + MARGIN * side
    inside = ((splats.means >= low) & (splats.means <= high)).all(axis=1)
    if not inside.any():
        return inside
    largest = _largest(splats, side, inside)
    wide = inside & ~keeps(SizeStep(at_most=largest), splats)
    # A wide one at the rim is a smear into nothing: it must lie as far inside as it is wide.
    sizes = np.exp(splats.log_scales[wide].max(axis=1, keepdims=True).astype(np.float64))
    flat = splats.means[wide, :2].astype(np.float64)
    inside[wide] = ((flat - RIM_SIGMAS * sizes >= low[:2]) & (flat + RIM_SIGMAS * sizes <= high[:2])).all(axis=1)
    return inside & keeps(SizeStep(at_most=times * largest), splats)


def _largest(splats: Splats, side: float, inside: NDArray[np.bool_]) -> float:
    return max(LARGEST * side, LARGEST_MEDIANS * float(np.exp(np.median(splats.log_scales[inside].max(axis=1)))))


def turntable(splats: Splats, box: FloatArray, num_frames: int, size_wh: tuple[int, int]) -> Iterator[Image]:
    """Render the model in a box (2,3), cropped to it, from `num_frames` sides over white.

    Args:
        splats: the model.
        box: lower and upper corner of what is to be seen, in the model's frame.
        num_frames: evenly over a full turn, the first from the south.
        size_wh: of each picture, px.
    """
    lens = Lens(size_wh=size_wh, field_of_view_deg=FIELD_OF_VIEW_DEG)
    middle = box.mean(axis=0)
    toward_camera = orbit(middle, 1.0, ELEVATION_DEG, num_frames, lens)
    rotations = toward_camera.cam_from_world[:, :3, :3]
    across, down, ahead = np.moveaxis(np.einsum("fij,cj->fci", rotations, box_corners(box) - middle), -1, 0)
    slopes = np.asarray(size_wh) / 2 / lens.K[0, 0]
    nearest = np.maximum(np.abs(across) / slopes[0], np.abs(down) / slopes[1]) - ahead
    distance = NEAR * float(nearest.max())
    cameras = orbit(middle, distance, ELEVATION_DEG, num_frames, lens)
    cropped = crop_to(splats, box)
    for index in np.roll(np.arange(num_frames), num_frames // 2):
        yield render_over_white(cropped, cameras.select(np.array([index])))
