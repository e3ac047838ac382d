"""`TrainConfig`: every knob of training, and the presets. A sentence under a field is also its help text."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from radiant_core.errors import BadInput

Preset = Literal["draft", "default", "standard", "paper"]
"""draft: a quick look; default: our best; standard: plain 3DGS with its 30,000 steps; paper: the paper's 20,000 steps."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How one model is fitted to one set of views. Learning rates are those of 3DGS (Kerbl 2023) unless said otherwise."""

    num_steps: int = 7_000
    """Optimisation steps, one image each; schedules are scaled to this number."""
    long_side_px: int = 1_152
    """Photographs are reduced until their long side is at most this."""
    max_num_splats: int = 1_000_000
    """Upper limit of Gaussians; more sparse points than that are thinned out evenly."""
    sh_degree: int = 1
    """Degree 0 to 3 of the view dependence of colour."""
    ssim_weight: float = 0.2
    """λ of (1 − λ) L1 + λ (1 − SSIM) (paper Eqn. 4)."""
    max_scale_per_distance: float = 1 / 3
    """A Gaussian's axes stay below this share of its distance to the nearest camera: a larger one hangs as haze before views whose
    cameras it never troubled, because its centre lay behind them. Infinity leaves every size alone."""
    means_lr: float = 1.6e-4
    """Learning rate of the centres, in units of the cameras' extent; falls to a hundredth over the run."""
    scales_lr: float = 5e-3
    """Learning rate of the logarithmic scales."""
    quats_lr: float = 1e-3
    """Learning rate of the quaternions."""
    opacities_lr: float = 5e-2
    """Learning rate of the opacity logits."""
    sh0_lr: float = 2.5e-3
    """Learning rate of the base colour; the higher harmonics get a twentieth."""
    adam: Literal["visible", "dense"] = "visible"
    """visible: a step moves the Gaussians that its image shows; dense: all of them by their moments, as 3DGS does."""
    seed: int = 0
    """Seed of the order of images and of every random choice."""

    def __post_init__(self) -> None:
        for name in ("num_steps", "long_side_px", "max_num_splats"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name} is {getattr(self, name)}, expected at least 1.")
        if not self.max_scale_per_distance > 0:
            raise BadInput(f"max_scale_per_distance is {self.max_scale_per_distance}, expected a positive number.")
        if not 0 <= self.sh_degree <= 3:
            raise BadInput(f"sh_degree is {self.sh_degree}, expected 0 to 3.")
        if not 0 <= self.ssim_weight <= 1:
            raise BadInput(f"ssim_weight is {self.ssim_weight}, expected 0 to 1.")
        if self.adam not in ("visible", "dense"):
            raise BadInput(f"adam is {self.adam!r}, expected 'visible' or 'dense'.")


# Short runs have no time for small steps: `draft` and `default` start from rates found on the sample scene's validation images.
_SHORT = TrainConfig(means_lr=3.2e-4, scales_lr=2e-2, quats_lr=5e-3, opacities_lr=1e-1, sh0_lr=2e-2)
_PRESETS: dict[str, TrainConfig] = {
    "draft": replace(_SHORT, num_steps=2_000, long_side_px=576),
    "default": _SHORT,
    "standard": TrainConfig(num_steps=30_000, sh_degree=3, max_scale_per_distance=math.inf, adam="dense"),
    "paper": TrainConfig(num_steps=20_000, sh_degree=3, max_scale_per_distance=math.inf, adam="dense"),
}


def train_preset(name: str) -> TrainConfig:
    """The configuration of a preset; BadInput lists the names there are."""
    if name not in _PRESETS:
        raise BadInput(f"train preset {name!r} is unknown: use one of {', '.join(get_args(Preset))}.")
    return _PRESETS[name]
