"""Adaptive density control of 3DGS (Kerbl 2023, Sec. 5): Gaussians are cloned, split and pruned.

    g_i = mean over the steps that saw i of ‖(W/2, H/2) ⊙ ∂loss/∂m_i‖,  m_i: projected centre in px
          or of ‖(W/2, H/2) ⊙ Σ_p |∂loss_p/∂m_i|‖ over pixels p, by absolute value (AbsGS, Ye 2024)
    g_i ≥ t:  longest axis ≤ 1 % of the extent (`extent.py`): cloned;
              longer: two drawn from N(μ_i, Σ_i) with scales / 1.6 in its place
    pruned:   opacity < `Adc.min_opacity`;  after the first reset also axes > 10 % of the extent,
              and what is wider than a limit on screen
    reset:    opacity ← min(opacity, 0.01), its moments ← 0

Planned growth has room for few: those whose gradients have the largest sum over the steps, so that
error which several views agree on comes before as much in one view.
Statistics once per step, an edit every `Adc.every` steps, O(N log N). `AdaptiveDensity` decides
when; the edits are plain functions of arrays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core.numerics import FloatArray
from radiant_core.render.contract import RenderOutput, SplatTensors
from radiant_core.splats import morton_order
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import RESET_OPACITY, Adc, DensityCounts
from radiant_core.train.densify.thinning import Thinning, rows_that_stay, squashed
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainResult
from radiant_core.train.shapes import without_dead

SPLIT_EXTENT = 0.01
"""Gaussians with an axis longer than this share of the extent are split, others cloned."""
CHILDREN = 2
CHILD_SCALE = 1 / (0.8 * CHILDREN)
MIN_OPACITY = 0.005
MAX_EXTENT = 0.1
"""Gaussians with an axis longer than this share of the extent are pruned."""


@dataclass(frozen=True, kw_only=True)
class DensityRules:
    """The limits of one edit."""

    min_gradient: float
    extent: float
    """Of the cameras, in the world's unit."""
    max_num_splats: int
    prune_large: bool
    prune_radius_px: float | None = None
    min_opacity: float = MIN_OPACITY


@dataclass(frozen=True, kw_only=True, eq=False)
class DensityEdit:
    """A model of M Gaussians after an edit: rows (M,) of the old one, fresh (M,) where a Gaussian
    is new; means and log_scales (M,3)."""

    rows: NDArray[np.int64]
    fresh: NDArray[np.bool_]
    means: NDArray[np.float32]
    log_scales: NDArray[np.float32]
    counts: DensityCounts


def density_edit(
    model: Mapping[str, NDArray[np.float32]],
    gradients: NDArray[np.floating],
    radii_px: NDArray[np.floating],
    rules: DensityRules,
    rng: np.random.Generator,
    ranks: NDArray[np.floating] | None = None,
) -> DensityEdit:
    """Clone, split and prune the model (means, quats, log_scales, logit_opacities of N rows) by
    mean gradients and radii (N,); `ranks` (N,) as of `select_growing`. The result is in Morton
    order; the most opaque Gaussian stays in any case."""
    clone, split, num_refused = select_growing(gradients, model["log_scales"].max(axis=1, initial=-np.inf), rules, ranks)
    parents = np.flatnonzero(split)
    offsets = split_offsets(model["quats"][parents], model["log_scales"][parents], rng)
    rows = np.concatenate([np.flatnonzero(~split), np.flatnonzero(clone), np.repeat(parents, CHILDREN)])
    num_kept, num_children = len(clone) - len(parents), CHILDREN * len(parents)
    means, log_scales = model["means"][rows], model["log_scales"][rows]
    children = slice(len(rows) - num_children, None)
    means[children] += offsets
    log_scales[children] += np.float32(math.log(CHILD_SCALE))
    seen_px = np.where(np.arange(len(rows)) < num_kept, radii_px[rows], 0)
    transparent, large = select_prunable(model["logit_opacities"][rows], log_scales.max(axis=1, initial=-np.inf), seen_px, rules)
    keep_mask = ~(transparent | large)
    if len(rows) and not keep_mask.any():
        keep_mask[np.argmax(model["logit_opacities"][rows])] = True
    order = np.flatnonzero(keep_mask)[morton_order(means[keep_mask])]
    return DensityEdit(
        rows=rows[order],
        fresh=order >= num_kept,
        means=means[order],
        log_scales=log_scales[order],
        counts=DensityCounts(
            num_cloned=int(clone.sum()),
            num_split=len(parents),
            num_pruned_transparent=int((transparent & ~keep_mask).sum()),
            num_pruned_large=int((large & ~transparent & ~keep_mask).sum()),
            num_refused=num_refused,
        ),
    )


def select_growing(
    gradients: NDArray[np.floating],
    largest_log: NDArray[np.floating],
    rules: DensityRules,
    ranks: NDArray[np.floating] | None = None,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Masks (N,) of what is cloned and what is split, by mean gradient and logarithm of the longest
    axis (N,), and how many are refused: where the limit leaves room for fewer, those of the highest
    `ranks` (N,) get it, by default of the strongest gradients. NaN never grows."""
    wanted = np.flatnonzero(gradients >= rules.min_gradient)
    room = max(0, rules.max_num_splats - len(gradients))
    order = np.argsort(-(gradients if ranks is None else ranks)[wanted], kind="stable")
    first = wanted[order[:room]]
    grows = np.zeros(len(gradients), dtype=bool)
    grows[first] = True
    small = largest_log <= math.log(SPLIT_EXTENT * rules.extent)
    return grows & small, grows & ~small, len(wanted) - len(first)


def split_offsets(quats: NDArray[np.float32], log_scales: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Where the children of K Gaussians lie relative to them (CHILDREN · K,3), drawn from their own
    N(0, Σ); 0 beyond float32."""
    limit = float(np.finfo(np.float32).max) / 4
    scales = np.exp(np.minimum(np.repeat(log_scales, CHILDREN, axis=0).astype(np.float64), math.log(limit)))
    offsets = rotate(np.repeat(quats, CHILDREN, axis=0).astype(np.float64), scales * rng.standard_normal(scales.shape))
    offsets[~(np.abs(offsets).max(axis=1, initial=0) < limit)] = 0
    return offsets.astype(np.float32)


def rotate(quats: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (K,3) turned by quaternions wxyz (K,4) of any length; a zero one turns nothing."""
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    unit = np.divide(quats, lengths, out=np.tile([1.0, 0, 0, 0], (len(quats), 1)), where=lengths > 0)
    w, xyz = unit[:, :1], unit[:, 1:]
    # R v = v + 2 w (q × v) + 2 q × (q × v) for a unit quaternion (w, q).
    across = np.cross(xyz, vectors)
    return vectors + 2 * (w * across + np.cross(xyz, across))


def select_prunable(
    logit_opacities: NDArray[np.floating], largest_log: NDArray[np.floating], radii_px: NDArray[np.floating], rules: DensityRules
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks (N,) of what is too transparent and what is too large, in the world or on screen."""
    transparent = logit_opacities < (_logit(rules.min_opacity) if rules.min_opacity > 0 else -math.inf)
    large = largest_log > math.log(MAX_EXTENT * rules.extent)
    if rules.prune_radius_px is not None:
        large |= radii_px > rules.prune_radius_px
    return transparent, large & rules.prune_large


class DensityStatistics:
    """What renderings say of N Gaussians: sums (N,) float32 of the lengths of their gradients, or,
    while thinning gathers, of what they show; view_counts (N,) int32 in how many, radii_px (N,)
    float32 the largest. numpy arrays on the CPU, tensors elsewhere."""

    def __init__(self, count: int, device: torch.device) -> None:
        self.sums, self.radii_px = (_as_plain(torch.zeros(count, dtype=torch.float32, device=device)) for _ in range(2))
        self.view_counts = _as_plain(torch.zeros(count, dtype=torch.int32, device=device))

    def add_gradient(self, visible: Any, size_wh: tuple[int, int], absgrad: Tensor | None, gradient: Tensor) -> None:
        """Add the gradient (1,N,2) of a rendering's projected centres, or its `absgrad`."""
        # numpy on the CPU, torch on a GPU: torch's threads would spin on after each (libgomp).
        means2d_gradient = _as_plain(gradient if absgrad is None else absgrad)
        across, down = (means2d_gradient[0, :, axis] * (side / 2) for axis, side in enumerate(size_wh))
        with np.errstate(over="ignore", invalid="ignore"):
            length = (across * across + down * down) ** 0.5
            # A step whose gradient is not finite is not taken nor counted in the statistics.
            _zero_not_finite(length)
            self.sums += length
        self.view_counts += visible

    def add_weights(self, visible: Any, weights: Tensor, gradient: Tensor) -> None:
        """Add what a rendering of `RenderOutput.weights` (1,N) shows."""
        shown = squashed(_as_plain(weights)[0])
        _zero_not_finite(shown)
        self.sums += shown
        self.view_counts += visible

    def add_rows(
        self, rows: NDArray[np.int64], sums: NDArray[np.float32], view_counts: NDArray[np.integer], radii_px: NDArray | None
    ) -> None:
        """Add what was gathered elsewhere of some rows (R,), each once."""
        if isinstance(self.sums, np.ndarray):
            self.sums[rows] += sums
            self.view_counts[rows] += view_counts.astype(np.int32)
            if radii_px is not None:
                self.radii_px[rows] = np.maximum(self.radii_px[rows], radii_px)
            return
        device = self.sums.device
        at = torch.from_numpy(rows).to(device)
        self.sums[at] += torch.from_numpy(sums).to(device)
        self.view_counts[at] += torch.from_numpy(view_counts.astype(np.int32)).to(device)
        if radii_px is not None:
            self.radii_px[at] = torch.maximum(self.radii_px[at], torch.from_numpy(radii_px).to(device))


class AdaptiveDensity(Part):
    """Gathers the gradients of a training and edits its model on schedule, with `counts` of it."""

    name = "density"

    def __init__(
        self, policy: Adc, config: TrainConfig, extent: float, splats: SplatTensors, num_views: int, views_per_step: int = 1
    ) -> None:
        """`extent` in world units; `splats`: the model before the first step; `num_views` of an
        epoch."""
        policy.require_resettable()
        self._policy, self._config, self._extent = policy, config, extent
        self._num_first = len(splats)
        self._last_reset = 0
        self._absolute = policy.gradient == "absolute"
        self._views_per_step = views_per_step
        self._thinning = Thinning(
            share=1.0 if policy.thin_to == "auto" else policy.thin_to,
            until_step=policy.until_step,
            schedule_steps=config.schedule_steps,
            num_views=num_views,
        )
        self.counts = DensityCounts()
        self.statistics = DensityStatistics(len(splats), splats.means.device)
        """What was gathered since the last edit."""

    def wants_absgrad(self, moment: Moment) -> bool:
        """Whether `before_backward` will look at `RenderOutput.absgrad`."""
        return self._absolute and moment.schedule_step < self._policy.until_step

    def wants_weights(self, moment: Moment) -> bool:
        """Whether `before_backward` will look at `RenderOutput.weights`."""
        return self._thinning.is_gathering

    def before_backward(self, moment: Moment, output: RenderOutput) -> None:
        """Add the gradients of a rendering of one camera to the statistics in its backward pass."""
        self.watch(moment, output, self.statistics)

    def watch(self, moment: Moment, output: RenderOutput, statistics: DensityStatistics) -> None:
        """The same, into `statistics` of as many rows."""
        if not output.means2d.requires_grad:
            return
        if self._thinning.is_gathering and output.weights is not None:
            output.means2d.register_hook(partial(statistics.add_weights, _as_plain(output.visible), output.weights))
        if moment.schedule_step >= self._policy.until_step:
            return
        height, width = output.images.shape[1:3]
        if self.measures_radii:
            statistics.radii_px = _elementwise_maximum(statistics.radii_px, _as_plain(output.radii_px)[0])
        if self._absolute and output.absgrad is None:
            raise ValueError("density control by absolute gradients needs a rendering with absgrad=True")
        absgrad = output.absgrad if self._absolute else None
        output.means2d.register_hook(partial(statistics.add_gradient, _as_plain(output.visible), (width, height), absgrad))

    @property
    def measures_radii(self) -> bool:
        """Whether Gaussians are pruned by their radii on screen."""
        return self._policy.prune_radius_px is not None

    def after_update(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """The model, cloned, split and pruned where an edit is due, its opacities reset likewise;
        after growth thinned."""
        policy, schedule_step = self._policy, moment.schedule_step
        if schedule_step >= policy.until_step:
            return self._thin(moment, splats, optimizer)
        # `every` is not scaled: a mean over few steps is noise. With an edit at every 7th of 2,000
        # steps, 27,000 Gaussians of the town were 150,000 after 98 steps.
        if schedule_step > policy.from_step and moment.step % policy.every == 0 and len(splats):
            splats = self._edit(moment, splats, optimizer)
        if schedule_step // policy.reset_opacity_every > self._last_reset:
            self._last_reset = int(schedule_step // policy.reset_opacity_every)
            reset_opacities(splats, optimizer)
            self.counts += DensityCounts(num_resets=1)
        return splats

    def _thin(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """The model, or at the end of a round of thinning its rows that stay. Rounds end where
        edits are looked for, so that machines that train together know it beforehand."""
        thinning = self._thinning
        if thinning.begins(moment.schedule_step):
            self.statistics = DensityStatistics(len(splats), splats.means.device)
            return splats
        if not thinning.is_gathering:
            return splats
        thinning.num_gathered += self._views_per_step
        if moment.step % self._policy.every or not thinning.has_enough(moment.schedule_step) or not thinning.ends(moment.schedule_step):
            return splats
        stays = rows_that_stay(_to_numpy(self.statistics.sums), _to_numpy(self.statistics.view_counts), thinning.share_of_round)
        rows = torch.from_numpy(stays).to(splats.means.device)
        thinned = replace(splats, **{name: tensor.detach()[rows] for name, tensor in splats.tensors().items()})
        optimizer.select_rows(thinned.tensors(), rows, torch.zeros(len(rows), dtype=torch.bool, device=rows.device))
        self.counts += DensityCounts(num_thinned=len(splats) - len(rows))
        self.statistics = DensityStatistics(len(thinned), splats.means.device)
        return thinned

    def finish(self, result: TrainResult) -> TrainResult:
        """The result with the counts, without the Gaussians that no pixel shows."""
        return finish_density(result, self.counts)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of the sums since the last edit, and what was at the start."""
        thinning = self._thinning
        rounds = np.array([thinning.num_begun, thinning.num_ended, thinning.num_gathered])
        since = {"num_first": np.array(self._num_first), "last_reset": np.array(self._last_reset), "thinning": rounds}
        return {**{name: _to_numpy(array).copy() for name, array in self._sums().items()}, **since}

    def state_numbers(self) -> dict[str, Any]:
        """The counts."""
        return asdict(self.counts)

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from sums and counts of a run whose model is now `splats`."""
        self.counts = DensityCounts(**numbers)
        self._num_first, self._last_reset = int(arrays["num_first"]), int(arrays["last_reset"])
        thinning = self._thinning
        thinning.num_begun, thinning.num_ended, thinning.num_gathered = map(int, arrays.get("thinning", np.zeros(3)))
        self.statistics = DensityStatistics(len(splats), splats.means.device)
        for name, array in self._sums().items():
            array[:] = arrays[name] if isinstance(array, np.ndarray) else torch.from_numpy(arrays[name]).to(array.device)

    def _sums(self) -> dict[str, Any]:
        """The statistics by their names in a checkpoint."""
        statistics = self.statistics
        return {"sums": statistics.sums, "seen": statistics.view_counts, "radii_px": statistics.radii_px}

    def _limit(self, schedule_step: float) -> int:
        """How many Gaussians there may be: all from the start, or planned growth on a line."""
        policy, most = self._policy, self._config.max_num_splats
        if policy.kind == "adc":
            return most
        share = min(1.0, max(0.0, (schedule_step - policy.from_step) / max(1, policy.until_step - policy.from_step)))
        return round(self._num_first + share * max(0, most - self._num_first))

    def _edit(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        rules = DensityRules(
            min_gradient=self._policy.min_absolute if self._absolute else self._policy.min_gradient,
            extent=self._extent,
            max_num_splats=self._limit(moment.schedule_step),
            prune_large=moment.schedule_step > self._policy.reset_opacity_every,
            prune_radius_px=self._policy.prune_radius_px,
            min_opacity=self._policy.min_opacity,
        )
        tensors = {name: tensor.detach() for name, tensor in splats.tensors().items()}
        model = {name: tensors[name].cpu().numpy() for name in ("means", "quats", "log_scales", "logit_opacities")}
        gathered = self.statistics
        sums, rng = _to_numpy(gathered.sums), np.random.default_rng((self._config.seed, moment.step))
        gradients = sums / np.maximum(_to_numpy(gathered.view_counts), 1)
        ranks = sums if self._policy.kind == "planned" else None
        edit = density_edit(model, gradients, _to_numpy(gathered.radii_px), rules, rng, ranks)
        self.counts += edit.counts
        device = splats.means.device
        rows, fresh = (torch.from_numpy(array).to(device) for array in (edit.rows, edit.fresh))
        moved = {"means": edit.means, "log_scales": edit.log_scales}
        edited = replace(
            splats,
            **{name: torch.from_numpy(moved[name]).to(device) if name in moved else tensor[rows] for name, tensor in tensors.items()},
        )
        optimizer.select_rows(edited.tensors(), rows, fresh)
        self.statistics = DensityStatistics(len(edited), device)
        return edited


def finish_density(result: TrainResult, counts: DensityCounts) -> TrainResult:
    """The result with the counts of density control, without the Gaussians that no pixel shows."""
    splats, num_dead = without_dead(result.splats)
    return replace(result, splats=splats, density=counts, shapes=replace(result.shapes, num_dead=num_dead))


@torch.no_grad()
def reset_opacities(splats: SplatTensors, optimizer: SelectiveAdam) -> None:
    """Lower opacities to at most `RESET_OPACITY`, in place, and zero their moments, if any."""
    splats.logit_opacities.clamp_(max=_logit(RESET_OPACITY))
    optimizer.zero_moments("logit_opacities")


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


def _as_plain(tensor: Tensor) -> Any:
    """A tensor on the CPU as numpy, sharing memory; any other as it is, without gradient."""
    return tensor.detach().numpy() if tensor.device.type == "cpu" else tensor.detach()


def _to_numpy(array: Any) -> NDArray[Any]:
    return array if isinstance(array, np.ndarray) else array.cpu().numpy()


def _zero_not_finite(lengths: Any) -> None:
    if isinstance(lengths, np.ndarray):
        finite = lengths < math.inf
        if not finite.all():
            lengths[~finite] = 0
    else:  # by a mask, torch would wait for the GPU
        lengths.nan_to_num_(nan=0.0, posinf=0.0)


def _elementwise_maximum(first: Any, second: Any) -> Any:
    return np.maximum(first, second) if isinstance(first, np.ndarray) else torch.maximum(first, second)
