"""The reference rasterizer and oracle: plain PyTorch, no early termination, autograd's gradients.

Per image: project all Gaussians (O(N)), list for each 8×8 tile the Gaussians whose box touches it
in order of depth, then blend groups of tiles with lists of similar length as one dense block (tiles
× pixels × list). Cost: pairs of pixel and Gaussian.
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from radiant_core.render.contract import ALPHA_MAX, ALPHA_MIN, DILATION_PX2, TRANSMITTANCE_CUT, RenderOutput, SplatTensors, ViewOptions
from radiant_core.render.harmonics import colors_from_sh

TILE_PX = 8
MAX_HALF_AXIS_PX = 1e9
"""Gaussians larger than this in the image are culled: their determinant leaves float32."""
PAIRS_PER_BLOCK = 2_000_000
"""Pixel–Gaussian pairs blended at once at most, unless one tile has more: bounds memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Projection:
    """N Gaussians in one image: means2d (N,2) px, conics (N,3) px⁻² (xx, xy, yy), log_opacities
    (N,), extents (N,2) px, depths (N,) m, visible (N,); absolute (N,2), where it is requested:
    zeros whose gradient is `RenderOutput.absgrad`."""

    means2d: Tensor
    conics: Tensor
    log_opacities: Tensor
    extents: Tensor
    depths: Tensor
    visible: Tensor
    absolute: Tensor | None = None


def rasterize_reference(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions) -> RenderOutput:
    """`rasterize` in plain PyTorch, one camera after another."""
    projections = [_project(splats, viewmat, K, view) for viewmat, K in zip(viewmats, Ks, strict=True)]
    # Stacked before blending, so that the returned tensor lies on the way of the gradients.
    means2d = torch.stack([projection.means2d for projection in projections])
    absgrad = torch.zeros_like(means2d, requires_grad=False) if view.absgrad else None
    centres, absolute = (means2d, None) if absgrad is None else _WithAbsolute.apply(means2d, absgrad)
    pictures = [
        _shade(
            splats,
            viewmats[index],
            replace(projection, means2d=centres[index], absolute=None if absolute is None else absolute[index]),
            view,
        )
        for index, projection in enumerate(projections)
    ]
    images, alphas, depths, weights = (torch.stack(parts) for parts in zip(*pictures, strict=True))
    radii_px = torch.stack([torch.where(p.visible, p.extents.amax(-1), 0).detach() for p in projections])
    return RenderOutput(
        images=images,
        alphas=alphas,
        depths=depths,
        radii_px=radii_px,
        means2d=means2d,
        absgrad=absgrad,
        weights=weights if view.weights else None,
    )


class _WithAbsolute(torch.autograd.Function):
    """means2d as it is, and zeros whose gradient is written into `absgrad`."""

    @staticmethod
    def forward(ctx: Any, means2d: Tensor, absgrad: Tensor) -> tuple[Tensor, Tensor]:
        ctx.absgrad = absgrad
        return means2d.view_as(means2d), torch.zeros_like(means2d)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, means2d: Tensor, absolute: Tensor) -> tuple[Tensor, None]:
        ctx.absgrad.copy_(absolute)
        return means2d, None


class _Watched(torch.autograd.Function):
    """ln α (tiles,K,P) as it is; `absolute` (tiles,K,2) gets as gradient Σ_p |∂loss/∂ln α ·
    slopes|, slopes (tiles,K,P,2) = ∂ln α/∂m."""

    @staticmethod
    def forward(ctx: Any, log_alphas: Tensor, absolute: Tensor, slopes: Tensor) -> Tensor:
        ctx.save_for_backward(slopes)
        return log_alphas.view_as(log_alphas)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, log_alphas: Tensor) -> tuple[Tensor, Tensor, None]:
        (slopes,) = ctx.saved_tensors
        return log_alphas, (log_alphas[..., None] * slopes).abs().sum(2), None


def _shade(splats: SplatTensors, viewmat: Tensor, projection: _Projection, view: ViewOptions) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Image (H,W,3), alpha (H,W) and expected depth (H,W) of one camera, and weights (N,), zeros
    unless they are requested."""
    center = -viewmat[:3, :3].T @ viewmat[:3, 3]
    directions = torch.nn.functional.normalize(splats.means - center, dim=-1)
    colors = colors_from_sh(directions, splats.sh0, splats.shN, view.sh_degree)
    ones = torch.ones_like(projection.depths).detach().requires_grad_(view.weights)
    features = torch.cat([colors, projection.depths[:, None], ones[:, None]], dim=1)
    blended = _blend(projection, features, view)
    alphas = blended[..., 4]
    images = blended[..., :3] + (1 - alphas)[..., None] * view.background.to(alphas)
    weights = torch.zeros_like(ones)
    if view.weights and alphas.requires_grad:
        (weights,) = torch.autograd.grad(alphas.sum(), ones, retain_graph=True)
    return images, alphas, blended[..., 3] / alphas.clamp_min(1e-10), weights.detach()


def _project(splats: SplatTensors, viewmat: Tensor, K: Tensor, view: ViewOptions) -> _Projection:
    """EWA projection (Zwicker 2002); a clamped Jacobian is differentiated, see `_jacobians`."""
    in_camera = splats.means @ viewmat[:3, :3].T + viewmat[:3, 3]
    depths = in_camera[:, 2]
    in_range = (depths > view.near_m) & (depths < view.far_m)
    z = torch.where(in_range, depths, torch.ones_like(depths))
    x_over_z, y_over_z = in_camera[:, 0] / z, in_camera[:, 1] / z
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    means2d = torch.stack([fx * x_over_z + cx, fy * y_over_z + cy], dim=-1)
    cov2d, bounded = _covariances_2d(splats, viewmat, _jacobians(K, x_over_z, y_over_z, z, view))
    conics, compensation, visible = _invert_dilated(cov2d)
    log_opacities = torch.nn.functional.logsigmoid(splats.logit_opacities)
    if view.antialiased:
        log_opacities = log_opacities + torch.log(compensation)
    extents = _extents(cov2d, log_opacities)
    low, high = means2d - extents, means2d + extents
    size = means2d.new_tensor([view.width, view.height])
    visible = visible & bounded & in_range & (extents > 0).all(-1) & (high > 0).all(-1) & (low < size).all(-1)
    return _Projection(means2d=means2d, conics=conics, log_opacities=log_opacities, extents=extents, depths=depths, visible=visible)


def _jacobians(K: Tensor, x_over_z: Tensor, y_over_z: Tensor, z: Tensor, view: ViewOptions) -> Tensor:
    """Jacobians (N,2,3) px/m at points clamped to a window 1.3 times the image.

    Beyond it EWA's linear projection is far from the true one and would smear a Gaussian over the
    picture. Clamped are x/z and y/z, not x and y: J_xz = −fx clamp(x/z) / z still depends on z, and
    autograd follows it. The kernel of 3DGS holds the clamped x fixed, so that its gradient of J_xz
    by z is twice the picture's; and its window lies evenly about the optical axis for any principal
    point.
    """
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin_x, margin_y = 0.15 * view.width / fx, 0.15 * view.height / fy
    x = torch.clamp(x_over_z, -cx / fx - margin_x, (view.width - cx) / fx + margin_x)
    y = torch.clamp(y_over_z, -cy / fy - margin_y, (view.height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    return torch.stack([fx / z, zero, -fx * x / z, zero, fy / z, -fy * y / z], dim=-1).reshape(-1, 2, 3)


def _covariances_2d(splats: SplatTensors, viewmat: Tensor, jacobians: Tensor) -> tuple[Tensor, Tensor]:
    """(N,3) xx, xy, yy of J W R S Sᵀ Rᵀ Wᵀ Jᵀ, before dilation, and whether in bounds (N,)."""
    scaled_axes = _rotations(splats.quats) * torch.exp(splats.log_scales)[:, None, :]
    half = jacobians @ viewmat[:3, :3] @ scaled_axes
    # Zeroed before it is squared: an overflow would become NaN going back, even if culled later.
    bounded = half.detach().abs().amax((1, 2)) < MAX_HALF_AXIS_PX
    row_x, row_y = torch.where(bounded[:, None, None], half, 0.0).unbind(1)
    return torch.stack([(row_x * row_x).sum(-1), (row_x * row_y).sum(-1), (row_y * row_y).sum(-1)], dim=-1), bounded


def _rotations(quats: Tensor) -> Tensor:
    """Rotation matrices (N,3,3) of quaternions wxyz (N,4) of any length; scaled by the largest
    entry first, so that none overflows."""
    largest = quats.detach().abs().amax(-1, keepdim=True)
    identity = quats.new_tensor([1.0, 0.0, 0.0, 0.0])
    safe = torch.where(largest > 0, quats / torch.where(largest > 0, largest, 1.0), identity)
    w, x, y, z = torch.nn.functional.normalize(safe, dim=-1).unbind(-1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, dim=-1).reshape(-1, 3, 3)


def _invert_dilated(cov2d: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Inverse (N,3) of the dilated covariance, √(det Σ / det Σ') (N,); whether they are usable."""
    xx, xy, yy = cov2d.unbind(-1)
    dilated_xx, dilated_yy = xx + DILATION_PX2, yy + DILATION_PX2
    # det(Σ + sI) = det Σ + s·tr Σ + s²: xx·yy − xy² alone cancels for long thin Gaussians.
    determinant = (xx * yy - xy * xy).clamp_min(0.0)
    dilated = determinant + DILATION_PX2 * (xx + yy) + DILATION_PX2**2
    usable = torch.isfinite(dilated) & torch.isfinite(1 / dilated)
    divisor = torch.where(usable, dilated, torch.ones_like(dilated))
    conics = torch.stack([dilated_yy, -xy, dilated_xx], dim=-1) / divisor[:, None]
    ratio = torch.where(usable, determinant, torch.zeros_like(determinant)) / divisor
    # √ has an infinite slope at 0: flat Gaussians get a floor far under one 8-bit step.
    return conics, ratio.clamp_min(1e-12).sqrt(), usable


def _extents(cov2d: Tensor, log_opacities: Tensor) -> Tensor:
    """Half sides (N,2) px of the box where α ≥ α_min: √(2 (ln o − ln α_min) Σ'_ii), else 0."""
    reach = 2 * (log_opacities.detach() - math.log(ALPHA_MIN)).clamp_min(0.0)
    variances = cov2d.detach()[:, [0, 2]] + DILATION_PX2
    return torch.sqrt(reach[:, None] * variances)


def _blend(projection: _Projection, features: Tensor, view: ViewOptions) -> Tensor:
    tiles_x, tiles_y = -(-view.width // TILE_PX), -(-view.height // TILE_PX)
    lists, starts, counts = _tile_lists(projection, tiles_x, tiles_y)
    tile_order = torch.argsort(counts, descending=True)
    tile_order = tile_order[: int((counts > 0).sum())]
    blocks = [
        _blend_block(projection, features, lists, starts[tiles], counts[tiles], _tile_centres(tiles, tiles_x, features))
        for tiles in _blocks_of_tiles(tile_order, counts)
    ]
    canvas = features.new_zeros(tiles_x * tiles_y, TILE_PX * TILE_PX, features.shape[1])
    # Where nothing is drawn the picture still depends on all six tensors, with gradients of 0.
    for part in (features, projection.means2d, projection.conics, projection.log_opacities):
        canvas = canvas + part[:0].sum()
    if blocks:
        canvas = canvas.index_copy(0, tile_order, torch.cat(blocks))
    rows = canvas.reshape(tiles_y, tiles_x, TILE_PX, TILE_PX, -1).permute(0, 2, 1, 3, 4)
    return rows.reshape(tiles_y * TILE_PX, tiles_x * TILE_PX, -1)[: view.height, : view.width]


def _tile_lists(projection: _Projection, tiles_x: int, tiles_y: int) -> tuple[Tensor, Tensor, Tensor]:
    """Gaussian indices by tile, front to back, start and count per tile; ties in input order."""
    visible = projection.visible.nonzero().squeeze(-1)
    order = visible[torch.argsort(projection.depths.detach()[visible], stable=True)]
    means2d, extents = projection.means2d.detach()[order], projection.extents[order]
    limit = means2d.new_tensor([tiles_x - 1, tiles_y - 1])
    zero = torch.zeros_like(limit)
    first = torch.minimum(torch.maximum(((means2d - extents) / TILE_PX).floor(), zero), limit).long()
    last = torch.minimum(torch.maximum(((means2d + extents) / TILE_PX).floor(), zero), limit).long()
    spans = last - first + 1
    per_gaussian = spans.prod(-1)
    owner = torch.repeat_interleave(torch.arange(len(order), device=order.device), per_gaussian)
    within = torch.arange(len(owner), device=owner.device) - torch.repeat_interleave(per_gaussian.cumsum(0) - per_gaussian, per_gaussian)
    tile_x = first[owner, 0] + within % spans[owner, 0]
    tile_y = first[owner, 1] + within // spans[owner, 0]
    tile = tile_y * tiles_x + tile_x
    by_tile = torch.argsort(tile, stable=True)
    counts = torch.bincount(tile, minlength=tiles_x * tiles_y)
    return order[owner[by_tile]], counts.cumsum(0) - counts, counts


def _blocks_of_tiles(tile_order: Tensor, counts: Tensor) -> list[Tensor]:
    """Cut tiles, longest list first, so that a block pads no list to more than 1.5 times and stays
    under the pair limit."""
    lengths = counts[tile_order].tolist()
    blocks, start = [], 0
    for stop in range(1, len(lengths) + 1):
        pairs = (stop - start) * lengths[start] * TILE_PX * TILE_PX
        if stop == len(lengths) or lengths[stop] * 1.5 < lengths[start] or pairs >= PAIRS_PER_BLOCK:
            blocks.append(tile_order[start:stop])
            start = stop
    return blocks


def _blend_block(projection: _Projection, features: Tensor, lists: Tensor, starts: Tensor, counts: Tensor, centres: Tensor) -> Tensor:
    """Blend lists of Gaussians into tiles around `centres` (tiles,2) px: (tiles,P,F). ln α is
    quadratic in the pixel: all pairs come from one product of coefficients and monomials."""
    slots = torch.arange(int(counts.max()), device=counts.device)
    present = slots < counts[:, None]
    chosen = lists[torch.where(present, starts[:, None] + slots, starts[:, None])]
    coefficients = _log_alpha_coefficients(projection, chosen, centres, present)
    log_alphas = coefficients @ _monomials(coefficients).T
    if projection.absolute is not None:
        log_alphas = _Watched.apply(log_alphas, projection.absolute[chosen], _slopes(projection, chosen, centres))
    alphas = torch.exp(log_alphas).clamp_max(ALPHA_MAX)
    alphas = torch.where(alphas >= ALPHA_MIN, alphas, 0.0)
    transmittance_after = torch.cumprod(1 - alphas, dim=1)
    transmittance = torch.cat([torch.ones_like(alphas[:, :1]), transmittance_after[:, :-1]], dim=1)
    weights = torch.where(transmittance_after.detach() > TRANSMITTANCE_CUT, alphas * transmittance, 0.0)
    return weights.mT @ features[chosen]


def _log_alpha_coefficients(projection: _Projection, chosen: Tensor, centres: Tensor, present: Tensor) -> Tensor:
    """Coefficients (tiles,K,6) of 1, u, v, u², uv, v² in ln α; (u, v) from the tile's centre."""
    x, y = (projection.means2d[chosen] - centres[:, None]).unbind(-1)
    xx, xy, yy = projection.conics[chosen].unbind(-1)
    constant = projection.log_opacities[chosen] - 0.5 * (xx * x * x + yy * y * y) - xy * x * y
    # Slots that only fill up a short list get an α of 0; the value survives every floating type.
    constant = torch.where(present, constant, -1e4)
    return torch.stack([constant, xx * x + xy * y, yy * y + xy * x, -0.5 * xx, -xy, -0.5 * yy], dim=-1)


def _slopes(projection: _Projection, chosen: Tensor, centres: Tensor) -> Tensor:
    """∂ln α/∂m = Σ'⁻¹ (p − m) at every pixel p of the tiles (tiles, K, P, 2)."""
    pixels = _monomials(centres)[:, 1:3]
    offsets = pixels - (projection.means2d[chosen] - centres[:, None])[:, :, None].detach()
    x, y = offsets.unbind(-1)
    xx, xy, yy = projection.conics.detach()[chosen][:, :, None].unbind(-1)
    return torch.stack([xx * x + xy * y, xy * x + yy * y], dim=-1)


def _monomials(like: Tensor) -> Tensor:
    """(P, 6): 1, u, v, u², uv, v² of the pixel centres of a tile relative to its centre."""
    inside = torch.arange(TILE_PX * TILE_PX, device=like.device)
    u = (inside % TILE_PX).to(like) + 0.5 - TILE_PX / 2
    v = (inside // TILE_PX).to(like) + 0.5 - TILE_PX / 2
    return torch.stack([torch.ones_like(u), u, v, u * u, u * v, v * v], dim=-1)


def _tile_centres(tiles: Tensor, tiles_x: int, like: Tensor) -> Tensor:
    return (torch.stack([tiles % tiles_x, tiles // tiles_x], dim=-1).to(like) + 0.5) * TILE_PX
