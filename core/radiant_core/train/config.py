"""`TrainConfig`: every knob of training, and the presets. A sentence under a field is also its help text."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from radiant_core.errors import BadInput

NEVER = 10**9
"""Steps that no schedule reaches."""
Preset = Literal["draft", "default", "standard", "paper"]
"""draft: a quick look; default: our best; standard: plain 3DGS with its 30,000 steps; paper: plain 3DGS with the paper's
20,000 steps, densified from step 500 to 15,000 every 100 (its Sec. IV-B), not reduced on a CPU."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How one model is fitted to one set of views. Learning rates are those of 3DGS (Kerbl 2023) unless said otherwise."""

    num_steps: int = 7_000
    """Optimisation steps, one image each; schedules are scaled to this number."""
    max_epochs: int | None = None
    """A longer run, by steps or by time, ends after so many steps per photograph, but not before 1,500; None: never."""
    long_side_px: int = 1_152
    """Photographs are reduced until their long side is at most this."""
    max_num_splats: int = 1_000_000
    """Upper limit of Gaussians; more sparse points than that are thinned out evenly."""
    sh_degree: int = 1
    """Degree 0 to 3 of the view dependence of colour."""
    ssim_weight: float = 0.2
    """λ of (1 − λ) L1 + λ (1 − SSIM) (paper Eqn. 4)."""
    max_scale_per_distance: float | None = 1 / 3
    """A Gaussian's axes stay below this share of its distance to the nearest camera: a larger one hangs as haze before views whose
    cameras it never troubled, because its centre lay behind them. Infinity leaves every size alone."""
    max_elongation: float | None = 10.0
    """A Gaussian's longest axis stays below this many times its second longest: a longer one is a needle; None for no limit."""
    means_lr: float = 1.6e-4
    """Learning rate of the centres, in units of the cameras' extent."""
    means_lr_end: float = 0.01
    """Share of `means_lr` to which it falls over the run, exponentially."""
    settle_epochs: int | None = None
    """A run of more steps per photograph than this, and of more than 700, ends with smaller learning rates, those of centres and exposures
    apart (`trainer.settled`); None: rates keep their size."""
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
    sh_degree_every: int = 0
    """Steps after which the next degree of colour joins in, as 3DGS does; 0: all degrees from the start."""
    densify: Literal["none", "adc", "planned", "mcmc"] = "none"
    """none: as many Gaussians as at the start; adc: the adaptive density control of 3DGS clones, splits and prunes them; planned: the same
    with a number of Gaussians that grows evenly to `max_num_splats`; mcmc: they are relocated and added by sampling, to that limit."""
    pixels_per_splat: int | None = 80
    """Training pixels for each Gaussian that planned growth may reach (docs/experiments/training.md); None: any number."""
    densify_from_step: int = 500
    """Density control begins after this step."""
    densify_until_step: int = 15_000
    """Density control, with its resets of opacity, ends before this step."""
    reset_opacity_every: int = 3_000
    """Steps between two resets of all opacities to at most 0.01."""
    schedule_steps: int = 30_000
    """Length of the run for which the four numbers of steps above are meant; a run of another length scales them."""
    densify_every: int = 100
    """Steps between two rounds of density control; not scaled, since a mean over fewer steps is noise."""
    densify_min_gradient: float = 2e-4
    """A Gaussian is cloned or split when its projected centre's mean gradient, in half image sides, is at least this."""
    densify_gradient: Literal["mean", "absolute"] = "mean"
    """mean: gradients of a centre are summed over pixels with their signs, as 3DGS does; absolute: without, so that pixels which pull a
    large Gaussian to opposite sides do not cancel (AbsGS, Ye 2024), and `densify_min_absolute` is the threshold."""
    densify_min_absolute: float = 8e-4
    """The threshold in place of `densify_min_gradient` where `densify_gradient` is absolute; gsplat's for it."""
    prune_radius_px: float | None = None
    """A Gaussian wider than this on screen is pruned after the first reset of opacities. The code of 3DGS passes 20 but clears the
    radii before it looks at them, so that nothing is pruned by this rule; None is what it does."""
    budget_s: float | None = None
    """Seconds of training after which the run ends, if the steps have not ended it; every schedule follows what is spent of either."""
    start_scale: float = 1.0
    """Share of the image size that training begins with."""
    full_size_from: float = 0.4
    """Share of the run from which images have their full size."""
    exposure: Literal["none", "affine", "auto"] = "none"
    """affine: every photograph has an affine map of the colours of its own, learnt with the model; auto: where exposures differ."""
    exposure_lr: float = 1e-3
    """Learning rate of the exposures at the start; it falls to a tenth."""
    num_looks: int = 6
    """How often validation views are looked at in the second half of a run."""
    sky: bool = True
    """Whether Gaussians on a far half sphere are added where photographs look above the horizon."""
    antialiased: bool = False
    """Whether opacities fade where a Gaussian is smaller than a pixel (Mip-Splatting): for views from distances that differ."""
    background: Literal["black", "random"] = "black"
    """What training sees behind the Gaussians; random: another colour at each step, which no half-transparent Gaussian can imitate."""
    fill_in: bool = True
    """Whether places that structure from motion left empty get starting points."""
    skip_images: Literal["none", "auto"] = "none"
    """auto: photographs that repeat another one, and blurred ones of which others show the same, are left out."""
    reduce_on_cpu: bool = True
    """Whether size, steps and Gaussians are cut to what a CPU ends in minutes."""
    seed: int = 0
    """Seed of the order of images and of every random choice."""

    def __post_init__(self) -> None:
        for name in ("num_steps", "long_side_px", "max_num_splats", "densify_every", "reset_opacity_every", "schedule_steps", "num_looks"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name} is {getattr(self, name)}, expected at least 1.")
        for name in ("sh_degree_every", "densify_from_step", "densify_until_step", "densify_min_gradient", "densify_min_absolute"):
            if not getattr(self, name) >= 0:
                raise BadInput(f"{name} is {getattr(self, name)}, expected at least 0.")
        if not 0 < self.means_lr_end <= 1:
            raise BadInput(f"means_lr_end is {self.means_lr_end}, expected above 0 and at most 1.")
        for name in ("max_scale_per_distance", "max_elongation", "prune_radius_px"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise BadInput(f"{name} is {value}, expected a positive number, or None for no limit.")
        for name in ("pixels_per_splat", "max_epochs", "settle_epochs"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadInput(f"{name} is {value}, expected at least 1, or None for no limit.")
        if not 0 <= self.sh_degree <= 3:
            raise BadInput(f"sh_degree is {self.sh_degree}, expected 0 to 3.")
        if not 0 <= self.ssim_weight <= 1:
            raise BadInput(f"ssim_weight is {self.ssim_weight}, expected 0 to 1.")
        if self.adam not in ("visible", "dense"):
            raise BadInput(f"adam is {self.adam!r}, expected 'visible' or 'dense'.")
        if not (0 < self.start_scale <= 1 and 0 <= self.full_size_from <= 1):
            raise BadInput(f"start_scale is {self.start_scale} and full_size_from {self.full_size_from}, expected shares of at most 1.")
        if self.budget_s is not None and not 0 < self.budget_s < math.inf:
            raise BadInput(f"budget_s is {self.budget_s}, expected a positive number of seconds, or None for no limit.")
        if not 0 < self.exposure_lr < math.inf:
            raise BadInput(f"exposure_lr is {self.exposure_lr}, expected a positive number.")
        choices_of = {
            "densify": ("none", "adc", "planned", "mcmc"),
            "densify_gradient": ("mean", "absolute"),
            "exposure": ("none", "affine", "auto"),
            "background": ("black", "random"),
            "skip_images": ("none", "auto"),
        }
        for name, choices in choices_of.items():
            if getattr(self, name) not in choices:
                raise BadInput(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(choices)}.")


# Short runs have no time for small steps: rates, Adam and growth were found on validation photographs (docs/experiments/training.md).
_SHORT = TrainConfig(
    max_epochs=120,
    settle_epochs=12,
    means_lr=6.4e-4,
    scales_lr=2e-2,
    quats_lr=5e-3,
    opacities_lr=5e-2,
    sh0_lr=1e-2,
    adam="dense",
    densify="planned",
    reset_opacity_every=NEVER,
    start_scale=0.5,
    skip_images="auto",
)
_PLAIN = TrainConfig(
    sh_degree=3,
    sh_degree_every=1_000,
    max_scale_per_distance=None,
    max_elongation=None,
    adam="dense",
    densify="adc",
    sky=False,
    fill_in=False,
)
_PRESETS: dict[str, TrainConfig] = {
    "draft": replace(_SHORT, num_steps=2_000, long_side_px=576),
    "default": _SHORT,
    "standard": replace(_PLAIN, num_steps=30_000),
    # The paper's own numbers at its 20,000 steps; 3DGS would reach a hundredth of the rate at 30,000. No limit of Gaussians is named
    # there: this one keeps a mistaken run from filling the memory, 236 bytes times four for Adam and gradients each.
    "paper": replace(
        _PLAIN, num_steps=20_000, schedule_steps=20_000, means_lr_end=0.01 ** (2 / 3), max_num_splats=5_000_000, reduce_on_cpu=False
    ),
}


def train_preset(name: str) -> TrainConfig:
    """The configuration of a preset; BadInput lists the names there are."""
    if name not in _PRESETS:
        raise BadInput(f"train preset {name!r} is unknown: use one of {', '.join(get_args(Preset))}.")
    return _PRESETS[name]
