"""Which training views constrain each Gaussian. One render and its backward per view, once a model.

    w_iv   = Σ over pixels of T_i α_i in view v, the pixels that Gaussian i makes there
    views  = number of views with w_iv ≥ `MIN_SHOWN_PX`
    angle  = largest angle at the Gaussian between two of these views' centres (its parallax)
    shown  = Σ over views of w_iv

A Gaussian of one view, or of several from one direction, may lie at any depth along their rays
without a photograph contradicting it: from elsewhere it hangs in the air. N Gaussians, V views.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.geometry.support import Support
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_C0, Splats

MIN_SHOWN_PX = 0.25
"""A view constrains a Gaussian of which it shows this many pixels."""


def support_of(
    splats: Splats, cameras: Cameras, backend: Backend = "auto", report: Callable[[int, int], None] = lambda num_done, total: None
) -> Support:
    """The support of N Gaussians by the V cameras that they were trained on, at their sizes;
    `report` hears how many of them are done."""
    shown_px = np.zeros(len(splats))
    rows_by_view: list[NDArray[np.int64]] = []
    # Grey, so that no colour is clamped, and with it the derivative.
    grey = replace(splats, sh0=np.zeros_like(splats.sh0), shN=np.zeros((len(splats), 0, 3), np.float32))
    tensors = SplatTensors.from_splats(grey, device=device_of(resolve_backend(backend)))
    tensors.sh0.requires_grad_()
    for index, (width, height) in enumerate(cameras.sizes_wh):
        one = slice(index, index + 1)
        viewmats, Ks = torch.tensor(cameras.cam_from_world[one]), torch.tensor(cameras.Ks[one])
        tensors.sh0.grad = None
        images = rasterize(tensors, viewmats, Ks, int(width), int(height), sh_degree=0, backend=backend).images
        images[..., 0].sum().backward()
        weights = np.zeros(len(splats)) if tensors.sh0.grad is None else tensors.sh0.grad[:, 0, 0].cpu().numpy() / SH_C0
        shown_px += weights
        # A view of a large scene sees a small part of it: rows take less than a table of all.
        rows_by_view.append(np.flatnonzero(weights >= MIN_SHOWN_PX))
        report(index + 1, len(cameras))
    return Support(
        num_views=_counts(rows_by_view, len(splats)),
        parallax_deg=largest_angles_deg(splats.means.astype(np.float64), cameras.centers, rows_by_view),
        shown_px=shown_px,
    )


def largest_angles_deg(places: FloatArray, centers: FloatArray, rows_by_view: Sequence[NDArray[np.int64]]) -> FloatArray:
    """Angle (N,) at places (N,3) between two of the centres (V,3) that see them; `rows_by_view`
    holds the rows of what each sees; 0 for fewer than two.

    From any seeing centre to the farthest one, and from that to its farthest: the largest angle of
    centres on an arc, and never less than half of it. O(V N).
    """
    reference = np.zeros(len(places), np.int64)
    for index in reversed(range(len(rows_by_view))):
        reference[rows_by_view[index]] = index
    angles = np.zeros(len(places))
    for _ in range(2):
        angles, reference = _farthest_from(places, centers, rows_by_view, reference)
    return np.where(_counts(rows_by_view, len(places)) > 1, angles, 0.0)


def _counts(rows_by_view: Sequence[NDArray[np.int64]], count: int) -> NDArray[np.int64]:
    """In how many of the lists each of the rows (N,) is."""
    counts = np.zeros(count, np.int64)
    for rows in rows_by_view:
        counts[rows] += 1
    return counts


def _farthest_from(
    places: FloatArray, centers: FloatArray, rows_by_view: Sequence[NDArray[np.int64]], start: NDArray[np.int64]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Per place the largest angle in degrees between centre `start` (N,) and one that sees it, and
    which that is."""
    best, farthest = np.zeros(len(places)), start.copy()
    for index, rows in enumerate(rows_by_view):
        toward_start, away = centers[start[rows]] - places[rows], centers[index] - places[rows]
        # By the sine as well: the cosine alone knows no angle below 1e-8.
        angle = np.arctan2(np.linalg.norm(np.cross(toward_start, away), axis=1), (toward_start * away).sum(axis=1))
        wider = angle > best[rows]
        best[rows[wider]], farthest[rows[wider]] = angle[wider], index
    return np.degrees(best), farthest
