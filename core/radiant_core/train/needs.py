"""What this training needs on this machine: skips and reductions as typed decisions. Once per run.

The reference backend is plain PyTorch: forward and backward took 0.13 CPU seconds for 5,000
Gaussians at 240×180 and 0.30 for 20,000 at 320×240 on one core. Full presets are therefore cut to what ends in minutes.
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


_REFERENCE_LIMITS = Overrides(long_side_px=240, num_steps=120, max_num_splats=8_000)
_UNITS = {"long_side_px": "px", "num_steps": "steps", "max_num_splats": "Gaussians"}


def fit_to_backend(config: TrainConfig, backend: str, overrides: Overrides) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The configuration that this backend can carry, and a decision for each number that differs from the preset."""
    decisions = []
    for field, unit in _UNITS.items():
        asked, wanted, limit = getattr(overrides, field), getattr(config, field), getattr(_REFERENCE_LIMITS, field)
        if asked is not None:
            chosen, reason = asked, "asked for on the command line"
        elif backend == "reference" and wanted > limit:
            chosen = limit
            reason = f"the preset's {wanted:,} {unit} would take hours on the plain PyTorch backend, some tenths of a second a step"
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
