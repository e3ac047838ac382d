"""Calibration of the step detector: thresholds, false alarms and power on virtual borders.

`python -m radiant_app.bench.step_detector [--borders 40] MODEL.ply…` draws as many random straight
lines through each model, where nothing was joined. Thresholds are the quantiles of the scores at
which 5 % of all lines raise an alarm in any quantity, with the same share α for each quantity.
False alarms are cross-validated: counted on one half of the lines with the thresholds of the other.
Power is that of the printed thresholds on every fourth line, with a step planted in the model: the
Gaussians left of the line become brighter, higher or fewer, or those at the line are removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from radiant_app.report.progress import track_items
from radiant_core.errors import BadInput
from radiant_core.evaluate.step_detector import MIN_OPACITY, QUANTITIES, Quantity, border_steps
from radiant_core.io.ply import load_ply
from radiant_core.numerics import FloatArray
from radiant_core.splats import SH_C0, Splats

FALSE_ALARMS = 0.05
MIN_SPAN = 0.5
"""Shortest line, as a share of the box's diagonal over √2."""
Plant = Callable[[Splats, FloatArray], Splats]
"""Maps a model and a line (2,2) to the model with a step across the line."""


def plants() -> dict[tuple[Quantity, str], Plant]:
    """Planted steps by the quantity that should detect them."""
    return {
        **{("colour", f"{levels}/255"): _brighter(levels) for levels in (2, 5, 10, 20)},
        **{("height", f"{step_m * 100:g} cm"): _higher(step_m) for step_m in (0.05, 0.1)},
        **{("density", f"{share:.0%} fewer"): _fewer(share) for share in (0.4,)},
        **{("gap", f"{width_m * 100:g} cm"): _cut(width_m) for width_m in (0.3,)},
    }


def virtual_borders(splats: Splats, count: int, seed: int = 0) -> list[FloatArray]:
    """Random lines (2,2) m across the photographed region, which is the box of the middle 80 % in x
    and y of the smaller half of the opaque Gaussians; BadInput for an empty model."""
    shows = np.flatnonzero(splats.logit_opacities > np.log(MIN_OPACITY / (1 - MIN_OPACITY)))
    if len(shows) < 100:
        raise BadInput(f"the model has {len(shows)} Gaussians that show, expected 100 or more: train it first.")
    sizes = splats.log_scales[shows].max(axis=1)
    shown = splats.means[shows[sizes <= np.median(sizes)], :2].astype(np.float64)
    low, high = np.percentile(shown, [10, 90], axis=0)
    rng, lines = np.random.default_rng(seed), []
    while len(lines) < count:
        place, angle = rng.uniform(low, high), rng.uniform(0, np.pi)
        along = np.array([np.cos(angle), np.sin(angle)])
        crossings = np.sort(np.concatenate([(low - place) / along, (high - place) / along]))
        if crossings[2] - crossings[1] >= MIN_SPAN * np.hypot(*(high - low)) / np.sqrt(2):
            lines.append(np.array([place + crossings[1] * along, place + crossings[2] * along]))
    return lines


def thresholds_of(scores: FloatArray) -> FloatArray:
    """Thresholds (Q,) that 5 % of lines (L,Q) exceed, each on the same share; NaN is no alarm."""
    scores = np.nan_to_num(scores, nan=0.0)
    low, high = 0.0, FALSE_ALARMS
    for _ in range(30):
        middle = (low + high) / 2
        limits = np.quantile(scores, 1 - middle, axis=0)
        low, high = (low, middle) if (scores > limits).any(axis=1).mean() > FALSE_ALARMS else (middle, high)
    return np.quantile(scores, 1 - low, axis=0)


def cross_validated_false_alarms(scores: FloatArray) -> float:
    """Share of lines (L,Q) with an alarm by the thresholds of the other half of the lines."""
    halves = [scores[::2], scores[1::2]]
    alarms = [(np.nan_to_num(one) > thresholds_of(other)).any(axis=1) for one, other in (halves, halves[::-1])]
    return float(np.concatenate(alarms).mean())


def measure_step_detector(models: Sequence[Path], num_borders: int) -> str:
    """A report of thresholds, false alarms and power; BadInput for a model that cannot be read."""
    loaded = [load_ply(path) for path in models]
    cases = [(model, line) for seed, model in enumerate(loaded) for line in virtual_borders(model, num_borders, seed)]
    scores = np.array([_scores(model, line) for model, line in track_items(cases, "virtual borders")])
    limits = thresholds_of(scores)
    length_m = np.mean([np.hypot(*(line[1] - line[0])) for _, line in cases])
    unknown = zip(QUANTITIES, np.isnan(scores).mean(axis=0), strict=True)
    lines = [
        f"{len(cases)} virtual borders in {len(loaded)} models, {length_m:.0f} m long in the mean",
        "thresholds: " + ", ".join(f"{name} {limit:.2f}" for name, limit in zip(QUANTITIES, limits, strict=True)),
        f"false alarms, cross-validated: {cross_validated_false_alarms(scores):.1%}",
        "borders without a figure: " + ", ".join(f"{name} {share:.0%}" for name, share in unknown),
    ]
    tried = cases[::4]
    for (quantity, name), plant in plants().items():
        found = np.array([_scores(plant(model, line), line) for model, line in track_items(tried, f"planted {quantity} {name}")]) > limits
        own = found[:, QUANTITIES.index(quantity)]
        shares = f"{own.mean():.2f} by its own score, {found.any(axis=1).mean():.2f} by any"
        lines.append(f"power: {quantity} {name}: {shares} ({len(tried)} borders)")
        by_model = [own[[model is one for model, _ in tried]].mean() for one in loaded]
        lines.append("    " + ", ".join(f"{path.parent.name} {share:.2f}" for path, share in zip(models, by_model, strict=True)))
    return "\n".join(lines)


def _scores(splats: Splats, line: FloatArray) -> FloatArray:
    steps = border_steps(splats, line)
    return np.array([steps.scores[quantity] for quantity in QUANTITIES])


def _left_m(splats: Splats, line: FloatArray) -> FloatArray:
    along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    return (splats.means[:, :2] - line[0]) @ np.array([-along[1], along[0]])


def _brighter(levels: float) -> Plant:
    step = levels / 255 / SH_C0
    return lambda splats, line: replace(splats, sh0=splats.sh0 + (step * (_left_m(splats, line) > 0))[:, None, None])


def _higher(step_m: float) -> Plant:
    up = np.array([0.0, 0.0, 1.0])
    return lambda splats, line: replace(splats, means=splats.means + step_m * (_left_m(splats, line) > 0)[:, None] * up)


def _fewer(share: float) -> Plant:
    def plant(splats: Splats, line: FloatArray) -> Splats:
        dropped = (_left_m(splats, line) > 0) & (np.random.default_rng(0).random(len(splats)) < share)
        return splats.select(np.flatnonzero(~dropped))

    return plant


def _cut(width_m: float) -> Plant:
    return lambda splats, line: splats.select(np.flatnonzero(np.abs(_left_m(splats, line)) > width_m / 2))


def main(
    models: Annotated[list[Path], typer.Argument(help="Models of whole scenes, PLY, in metres.")],
    borders: Annotated[int, typer.Option(min=4, help="Virtual borders per model.")] = 40,
) -> None:
    """Print thresholds, false alarms and power of the step detector."""
    typer.echo(measure_step_detector(models, borders))


if __name__ == "__main__":
    typer.run(main)
