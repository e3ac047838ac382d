"""What this training needs on this machine: skips and reductions as typed decisions. Once per run.

Without a GPU full presets are cut to what ends in minutes. CPU seconds of one step (render, loss, backward, Adam) on one core:
`native` 0.02 for 13,000 Gaussians at 480×270; `reference`, plain PyTorch, 0.26 for 5,000 at 240×180.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from radiant_core.decisions import Decision
from radiant_core.train.config import TrainConfig


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """What the user asked for by number; None leaves it to the preset and the backend."""

    long_side_px: int | None = None
    """Long side of the training images."""
    num_steps: int | None = None
    """Optimisation steps of a device."""
    max_num_splats: int | None = None
    """Upper limit of Gaussians of a device."""


_LIMITS = {
    "native": Overrides(long_side_px=576, num_steps=1_500, max_num_splats=100_000),
    "reference": Overrides(long_side_px=240, num_steps=120, max_num_splats=8_000),
}
_UNITS = {"long_side_px": "px", "num_steps": "steps", "max_num_splats": "Gaussians"}


def fit_to_backend(config: TrainConfig, backend: str, overrides: Overrides) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The configuration that this backend can carry, and a decision for each number that differs from the preset."""
    limits = _LIMITS.get(backend, Overrides()) if config.reduce_on_cpu else Overrides()
    decisions = []
    if backend in _LIMITS and not config.reduce_on_cpu:
        decisions.append(_unreduced_decision(overrides.num_steps or config.num_steps, backend))
    for field, unit in _UNITS.items():
        asked, wanted, limit = getattr(overrides, field), getattr(config, field), getattr(limits, field)
        if asked is not None:
            chosen, reason = asked, "asked for on the command line"
        elif limit is not None and wanted > limit:
            chosen = limit
            reason = f"the preset's {wanted:,} {unit} would take hours on a CPU with the {backend} renderer"
        else:
            continue
        config = replace(config, **{field: chosen})
        decisions.append(
            Decision(
                stage="train",
                topic=field,
                choice=f"{chosen:,} {unit} instead of {wanted:,}",
                figure=float(chosen),
                unit=unit,
                reason=reason,
                forced=asked is not None,
            )
        )
    return config, tuple(decisions)


def _unreduced_decision(num_steps: int, backend: str) -> Decision:
    return Decision(
        stage="train",
        topic="size",
        choice="nothing is reduced for a CPU",
        figure=float(num_steps),
        unit="steps",
        reason=f"the preset is to be followed as it is; with the {backend} renderer its full size takes hours",
        forced=True,
    )
