"""`Scrutiny`: which gradients of a step do not count, and who is left out of a training for good.

    shape         seen, growth and loss as renderings make them             each message alone
    limit         ‖∂loss/∂x‖ ≤ what any photograph can cause (below)        each message alone
    usual size    within a factor of the running median of all senders      three senders or more
    direction     the mean cosine to the others on rows that they show too  three senders or more
    contradiction a size or a direction that most do not share              a warning, all count

Once per step where messages of devices arrive, after `codec.py` refused what is damaged. Neighbours
judge: as with models that are joined, two that contradict each other both stay, and so do four of
whom two lie alike. A warning names all of them.

The limit is that of a loss of one view: E = (1 − λ) L1 + λ (1 − SSIM), means over pixels (weighted
ones too) and channels, x the rendered and y the photograph's values, 0 ≤ y ≤ 1.

    Σ |∂L1/∂x| ≤ 1
    SSIM of a window = l s, l = (2ab + C1) / (a² + b² + C1), s = (2 cov + C2) / (σx² + σy² + C2)
    |∂l/∂a| ≤ 1 / √C1, reached at a = 0, b = √C1
    Σ |∂s/∂x| ≤ 2 (σx + σy) / (σx² + σy² + C2) ≤ √2 / √C2            by Σ w |x − a| ≤ σx, |s| ≤ 1
    G = Σ |∂E/∂x| ≤ (1 − λ) + λ (1 / √C1 + √2 / √C2) = 30.2 with λ = 0.2

A pixel blends Σ w_i ≤ 1, w_i = α_i T_i, of colours c ≤ `MAX_COLOR`; α |∂x/∂α| ≤ w c, α being lit
where q = ½ dᵀΣ'⁻¹d ≤ ln 255. So sums over all Gaussians of one view are at most

    sh0                SH_C0 G
    shN                G max_d Σ_k |Y_k(d)| ≤ G √(n ((L + 1)² − 1) / 4π), n of degree 1 to L
    logit_opacities    MAX_COLOR G                                       ∂α/∂logit = α (1 − o)
    log_scales         2 ln 255 MAX_COLOR G                              Σ_k |∂q/∂log s_k| ≤ 2 q
    growth             ½ side_px √(2 ln 255 / 0.3) MAX_COLOR G           |Σ'⁻¹ d| ≤ √(2 q / 0.3 px²)

A length is at most such a sum. Centres and quaternions have no such limit: theirs grow with focal
length and elongation, and are compared with the usual size alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.render.contract import ALPHA_MIN, DILATION_PX2
from radiant_core.splats import SH_C0
from radiant_core.train.config import TrainConfig
from radiant_core.train.together.gradients import Layout, StepGradients

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
MAX_COLOR = 4.0
"""Times white: no model of photographs is brighter."""
FACTORS = {"logit_opacities": 16.0, "sh0": 8.0, "shN": 8.0, "growth": 8.0}
FACTOR = 40.0
"""By which a tensor's length, here of the others, may differ from the usual one in one step: single
needles that a view looks along have long gradients."""
STEADY_FACTOR = 4.0
"""By which lengths, the median over tensors, may differ in the mean over steps."""
STEADY_STEPS = 8
"""Before which nobody is left out for that."""
USUAL_STEPS = 16
"""Over which the usual length is the median of all senders'."""
MIN_SENDERS = 3
"""Fewer cannot say who of them is wrong: a warning names both."""
MIN_STEPS = 4
"""Before which nobody is left out for a direction."""
MIN_SPREAD = 0.05
"""A step's cosine is at least so uncertain, whatever few steps say."""
DIRECTION_STEPS = 200
"""Over which cosines are averaged, later steps counting more."""
MIN_SHARE = 0.3
"""A sender whose mean cosine is surely below this share of the median of all contradicts them."""
NUM_ERRORS = 3.0
"""Standard errors of a mean cosine that make it sure."""
TIE_COSINE = 0.02
"""Senders whose usual mean cosine is surely below it contradict each other: noise has 0; that of
two honest devices may be 0.146 or more in each step (docs/experiments/privacy.md)."""
SAMPLE = 16
"""Of so many Gaussians one is compared in a step, others in the next; a power of two."""
MIN_SHARED = 16
"""Gaussians compared that others show too; of fewer a direction says nothing."""
GROWTH = "growth"
_TINY = 1e-30
_ROWS_AT_ONCE = 64
"""Rows whose columns are summed beside each other: numpy is slow along 24 numbers."""


def pixel_limit(ssim_weight: float) -> float:
    """G: at most so much is Σ |∂loss/∂x| over pixels and channels of one view."""
    return (1 - ssim_weight) + ssim_weight * (1 / math.sqrt(SSIM_C1) + math.sqrt(2) / math.sqrt(SSIM_C2))


def view_limits(config: TrainConfig, layout: Layout) -> NDArray[np.float64]:
    """The most that ‖∂loss/∂x‖ of one view can be, by tensor of `layout`, then growth; inf: no
    limit is known."""
    whole = pixel_limit(config.ssim_weight)
    depth = 2 * math.log(1 / ALPHA_MIN)
    harmonics = config.sh_degree * (config.sh_degree + 2)
    limits = {
        "sh0": SH_C0 * whole,
        "shN": math.sqrt(harmonics * harmonics / (4 * math.pi)) * whole,
        "logit_opacities": MAX_COLOR * whole,
        "log_scales": depth * MAX_COLOR * whole,
        GROWTH: 0.5 * config.long_side_px * math.sqrt(depth / DILATION_PX2) * MAX_COLOR * whole,
    }
    return np.array([limits.get(name, math.inf) for name in tensor_names(layout)])


def tensor_names(layout: Layout) -> tuple[str, ...]:
    """Those of a layout, then growth."""
    return (*layout.shapes, GROWTH)


def tensor_lengths(values: NDArray[np.float32], layout: Layout) -> NDArray[np.float64]:
    """‖·‖ of values (R,K) by tensor, then growth."""
    rows, columns = values.shape
    whole = rows // _ROWS_AT_ONCE * _ROWS_AT_ONCE
    wide = values[:whole].reshape(-1, _ROWS_AT_ONCE * columns)
    squares = np.einsum("ij,ij->j", wide, wide).reshape(_ROWS_AT_ONCE, columns).sum(axis=0, dtype=np.float64)
    squares += np.einsum("ij,ij->j", values[whole:], values[whole:])
    starts = [columns.start for columns in layout.columns.values()]
    return np.sqrt(np.add.reduceat(squares, [*starts, layout.growth]))


def check_shape(gradients: StepGradients, config: TrainConfig, layout: Layout) -> str | None:
    """What no rendering makes in counts, growth, radii or loss, in words."""
    if not len(gradients.rows):
        return None
    growth, view_counts = gradients.values[:, layout.growth], gradients.view_counts
    lowest = float(growth.min())
    if lowest < 0:
        return f"a Gaussian's growth is {lowest:.3g}, expected a length, from 0 on"
    # Either all that is shown was counted, or, after the last edit, nothing is.
    least = int(view_counts.min())
    if least == 0 and (int(view_counts.max()) > 0 or float(growth.max()) > 0):
        return "Gaussians with a gradient are counted in no view, expected in one or more"
    if gradients.radii_px is not None and float(gradients.radii_px.min()) < 0:
        return "a radius is below 0 px"
    most = gradients.num_views * ((1 - config.ssim_weight) * MAX_COLOR + 2 * config.ssim_weight)
    if not 0 <= gradients.loss <= most:
        return f"the loss of {gradients.num_views} views is {gradients.loss:.3g}, expected 0 to {most:.3g}"
    return None


@dataclass(kw_only=True)
class Standing:
    """How a sender agrees with the others: decayed sums over steps of the cosine, its square and
    the logarithm of its lengths over the usual ones."""

    weight: float = 0.0
    total: float = 0.0
    squares: float = 0.0
    num_steps: int = 0
    sizes: float = 0.0
    num_sizes: int = 0

    def add_size(self, log: float) -> None:
        """Count a step's lengths; the mean is over the first steps, then it follows the later."""
        self.num_sizes += 1
        self.sizes += (log - self.sizes) / min(self.num_sizes, DIRECTION_STEPS)

    def add(self, cosine: float) -> None:
        """Count a step."""
        keep = 1 - 1 / DIRECTION_STEPS
        self.weight, self.total = keep * self.weight + 1, keep * self.total + cosine
        self.squares, self.num_steps = keep * self.squares + cosine * cosine, self.num_steps + 1

    @property
    def mean(self) -> float:
        """The mean cosine."""
        return self.total / max(self.weight, 1.0)

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        spread = max(self.squares / max(self.weight, 1.0) - self.mean**2, 0.0)
        return math.sqrt(max(spread, MIN_SPREAD**2) / max(self.weight, 1.0))


@dataclass(kw_only=True)
class Gap:
    """How two senders differ that are alone: by tensor the mean over steps, as in a `Standing`, of
    the logarithm of the first one's length over the second's."""

    num_steps: int = 0
    logs: list[float] = field(default_factory=list)

    def add(self, logs: NDArray[np.float64]) -> None:
        """Count a step."""
        self.num_steps += 1
        before = np.array(self.logs) if self.logs else np.zeros(len(logs))
        self.logs = (before + (logs - before) / min(self.num_steps, DIRECTION_STEPS)).tolist()

    def words(self, names: Sequence[str]) -> str | None:
        """In which tensor, of these names, the first is beyond a factor; "gradients" for most of
        them; None before enough steps and for none."""
        if self.num_steps < STEADY_STEPS:
            return None
        logs, most = np.array(self.logs), np.log([FACTORS.get(name, FACTOR) for name in names])
        usual = float(np.median(logs))
        if abs(usual) > math.log(STEADY_FACTOR):
            return f"gradients are {math.exp(usual):.3g} times as long"
        beyond = np.flatnonzero(np.abs(logs) > most)
        return f"{names[beyond[0]]} are {math.exp(logs[beyond[0]]):.3g} times as long" if len(beyond) else None


@dataclass(kw_only=True)
class Scrutiny:
    """What a machine that sums knows of its senders; the same messages in the same order end in the
    same decisions."""

    config: TrainConfig
    secret: int = 0
    """Draws which Gaussians are compared in a step. Whoever knows it can behave there."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Senders whose messages do not count any more, and why."""
    standings: dict[str, Standing] = field(default_factory=dict)
    recent: deque[list[list[float]]] = field(default_factory=lambda: deque(maxlen=USUAL_STEPS))
    """Lengths per view by tensor, of each sender, of the last steps."""
    gaps: dict[str, Gap] = field(default_factory=dict)
    """By the names of two senders that were alone in steps."""
    ties: dict[str, str] = field(default_factory=dict)
    """By the names of senders that contradict each other without a majority: how."""
    _unsaid: list[str] = field(default_factory=list)

    def take_warnings(self) -> list[str]:
        """What has been noticed since it was last asked for."""
        unsaid, self._unsaid = self._unsaid, []
        return unsaid

    def refuse(self, step: int, sent: Mapping[str, StepGradients], num_splats: int, layout: Layout) -> dict[str, str]:
        """Why messages of a step do not count, by sender, in words; none of those that do."""
        reasons = {name: self.left_out[name] for name in sent if name in self.left_out}
        judged = {name: gradients for name, gradients in sent.items() if name not in reasons and gradients.num_views}
        lengths = {name: tensor_lengths(gradients.values, layout) / gradients.num_views for name, gradients in judged.items()}
        limits = view_limits(self.config, layout)
        for name, gradients in judged.items():
            reason = check_shape(gradients, self.config, layout) or _beyond(lengths[name], limits, layout)
            if reason is not None:
                reasons[name] = reason
        reasons |= self._unusual(step, {name: device_lengths for name, device_lengths in lengths.items() if name not in reasons}, layout)
        self._compare(step, {name: gradients for name, gradients in judged.items() if name not in reasons}, num_splats, layout)
        reasons |= {name: self.left_out[name] for name in judged if name in self.left_out}
        return reasons

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, as JSON."""
        standings = {name: vars(standing).copy() for name, standing in self.standings.items()}
        gaps = {name: vars(gap).copy() for name, gap in self.gaps.items()}
        left_out, ties = dict(self.left_out), dict(self.ties)
        return {
            "secret": self.secret,
            "left_out": left_out,
            "standings": standings,
            "recent": list(self.recent),
            "gaps": gaps,
            "ties": ties,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`."""
        self.secret, self.left_out = int(state["secret"]), dict(state["left_out"])
        self.standings = {name: Standing(**record) for name, record in state["standings"].items()}
        self.recent = deque(state["recent"], maxlen=USUAL_STEPS)
        self.gaps, self.ties = {name: Gap(**record) for name, record in state["gaps"].items()}, dict(state["ties"])

    def _unusual(self, step: int, lengths: Mapping[str, NDArray[np.float64]], layout: Layout) -> dict[str, str]:
        """Those whose lengths differ by a factor from the median of all senders, in this step and
        in the last ones: sizes of photographs and numbers of Gaussians change for all at once."""
        if len(lengths) < MIN_SENDERS:
            self._compare_lengths(step, lengths, layout)
            return {}
        names, reasons = tensor_names(layout), dict[str, str]()
        factors = np.array([FACTORS.get(name, FACTOR) for name in names])
        now = np.array(list(lengths.values()))
        self.recent.append(now.tolist())
        usual = np.median(now, axis=0), np.median(np.concatenate([np.array(step_lengths) for step_lengths in self.recent]), axis=0)
        least, most = np.minimum(*usual) / factors, np.maximum(*usual) * factors
        for name, device_lengths in lengths.items():
            wrong = np.flatnonzero((device_lengths > most) | (device_lengths < least))
            if len(wrong):
                reasons[name] = f"its {names[wrong[0]]} are {device_lengths[wrong[0]]:.3g} long, usual are {usual[1][wrong[0]]:.3g}"
            standing = self.standings.setdefault(name, Standing())
            standing.add_size(float(np.median(_logs(device_lengths, usual[0]))))
            if standing.num_sizes >= STEADY_STEPS and abs(standing.sizes) > math.log(STEADY_FACTOR):
                times = math.exp(standing.sizes)
                self.left_out[name] = f"left out from step {step + 1} on: its gradients are {times:.3g} times as long as those of others"
        return reasons

    def _compare_lengths(self, step: int, lengths: Mapping[str, NDArray[np.float64]], layout: Layout) -> None:
        """Name two senders of whom one is much longer, step by step."""
        if len(lengths) != 2:
            return
        (first, first_lengths), (second, second_lengths) = lengths.items()
        gap = self.gaps.setdefault(f"{first} and {second}", Gap())
        gap.add(_logs(first_lengths, second_lengths))
        if (words := gap.words(tensor_names(layout))) is not None:
            self._tie(step, (first, second), f"{first}'s {words} as {second}'s")

    def _tie(self, step: int, senders: Sequence[str], how: str) -> None:
        """Note, once for the same senders, that nobody can say which of them are right."""
        names = f"{', '.join(senders[:-1])} and {senders[-1]}"
        if names in self.ties:
            return
        self.ties[names] = how
        self._unsaid.append(
            f"{names} contradict each other from step {step + 1} on: {how}. Without a majority nobody can say who is right, "
            "and all of them count: look at what each of them holds, or train with another device beside them."
        )

    def _compare(self, step: int, sent: Mapping[str, StepGradients], num_splats: int, layout: Layout) -> None:
        """Leave out whose directions, over many steps, are not those of the others; name all where
        most do not share one."""
        if len(sent) < 2:
            return
        phase = int(np.random.default_rng((self.secret, step)).integers(SAMPLE))
        for name, cosine in _cosines(sent, phase, num_splats, layout).items():
            self.standings.setdefault(name, Standing()).add(cosine)
        able = {name: self.standings[name] for name in sent if name in self.standings and self.standings[name].num_steps >= MIN_STEPS}
        if len(able) < 2:
            return
        most = float(np.median([standing.mean + NUM_ERRORS * standing.error for standing in able.values()]))
        usual = float(np.median([standing.mean for standing in able.values()]))
        if most < TIE_COSINE:
            self._tie(step, tuple(able), f"the mean cosine of their gradients of the same Gaussians is {usual:.3f}")
        if len(able) < MIN_SENDERS or usual <= 0:
            return
        for name, standing in able.items():
            if standing.mean + NUM_ERRORS * standing.error < MIN_SHARE * usual:
                self.left_out[name] = (
                    f"left out from step {step + 1} on: its gradients contradict those of others of the same Gaussians "
                    f"(mean cosine {standing.mean:.3f}, usual {usual:.3f})"
                )


def _beyond(lengths: NDArray[np.float64], limits: NDArray[np.float64], layout: Layout) -> str | None:
    wrong = np.flatnonzero(~(lengths <= limits))
    if not len(wrong):
        return None
    tensor = tensor_names(layout)[wrong[0]]
    return f"its {tensor} of one view are {lengths[wrong[0]]:.3g} long, a photograph causes at most {limits[wrong[0]]:.3g}"


def _logs(lengths: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """log (lengths / others), within 1.5 log `FACTOR`: a view of nothing is no constant lie."""
    most = 1.5 * math.log(FACTOR)
    first, second = (np.clip(array, _TINY, 1 / _TINY) for array in (lengths, others))
    return np.clip(np.log(first / second), -most, most)


def _cosines(sent: Mapping[str, StepGradients], phase: int, num_splats: int, layout: Layout) -> dict[str, float]:
    """cos of each sender's gradient of colour and opacity with the sum of the others', each of them
    scaled to length 1, over the Gaussians `phase` + k `SAMPLE` that others show too."""
    compared = [layout.columns[name] for name in ("logit_opacities", "sh0") if name in layout.columns]
    width = sum(columns.stop - columns.start for columns in compared)
    total = np.zeros((num_splats // SAMPLE + 1, width), np.float32)
    count = np.zeros(len(total), np.uint16)
    parts = {}
    for name, gradients in sent.items():
        sampled = np.flatnonzero((gradients.rows & (SAMPLE - 1)) == phase)
        at = gradients.rows.take(sampled) // SAMPLE
        whole = gradients.values.take(sampled, axis=0)
        part = np.concatenate([whole[:, columns] for columns in compared], axis=1)
        part /= max(math.sqrt(float(np.vdot(part, part))), _TINY)
        _native.add_rows(total, at, part)
        count[at] += 1
        parts[name] = at, part
    cosines = {}
    for name, (at, part) in parts.items():
        shared = np.flatnonzero(count.take(at) > 1)
        if len(shared) < MIN_SHARED:
            continue
        mine = part.take(shared, axis=0)
        others = total.take(at.take(shared), axis=0) - mine
        length = math.sqrt(float(np.vdot(mine, mine)) * float(np.vdot(others, others)))
        cosines[name] = float(np.vdot(mine, others)) / length if length > 0 else 0.0
    return cosines
