"""`TrainConfig`: every knob of training; a sentence under a field is also its help text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_type_hints

from pydantic import TypeAdapter, ValidationError

from radiant_core.choices import LightMode
from radiant_core.errors import BadInput
from radiant_core.train.densify.policies import (
    POLICIES,
    Adc,
    Densification,
    DensityKind,
    NoDensification,
    densification_of,
    require_at_least,
    require_one_of,
    require_positive_or_none,
)

NEVER = 10**9
"""Steps that no schedule reaches."""
LAST_STEP_MEANS_END, LAST_STEP_SCALES_LR = 0.01, 2e-2
"""Where the last step is the result; joins were measured with these."""
CHECKPOINT_EVERY_S = 10.0
"""Seconds between two checkpoints of a training, unless a user says otherwise."""
Preset = Literal["draft", "default", "standard", "paper"]
"""draft: a quick look; default: our best; standard: plain 3DGS with its 30,000 steps; paper: plain
3DGS with the paper's 20,000 steps, densified from step 500 to 15,000 every 100 (its Sec. IV-B), not
reduced on a CPU."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """How one model is fitted to one set of views. Learning rates are those of 3DGS otherwise.

    `train_preset` makes one whose settings fit each other; change single ones of that.

    Example:
        >>> config = replace(radiant.train_preset("default"), sh_degree=2, light="none")
        >>> config.ssim_weight
        0.2
    """

    num_steps: int = 7_000
    """Optimisation steps, one image each; schedules are scaled to this number."""
    max_epochs: int | None = None
    """A longer run ends after so many steps per photograph, but not before 1,500; None: never."""
    long_side_px: int = 1_152
    """Photographs are reduced until their long side is at most this."""
    max_num_splats: int = 1_000_000
    """Upper limit of Gaussians; more sparse points than that are thinned out evenly."""
    sh_degree: int = 1
    """Degree 0 to 3 of the view dependence of colour."""
    ssim_weight: float = 0.2
    """λ of (1 − λ) L1 + λ (1 − SSIM) (paper Eqn. 4)."""
    max_scale_per_distance: float | None = 1 / 3
    """A Gaussian's axes stay below this share of its distance to the nearest camera; None for no
    limit. A larger one is constrained only by the cameras in front of its centre, and appears as
    haze in views from elsewhere."""
    max_elongation: float | None = 10.0
    """A Gaussian's longest axis stays below this many times its second longest, so that there are
    no needles; None for no limit."""
    needle_width_per_distance: float | Literal["auto"] = "auto"
    """For that limit the second axis counts as at least this share of the distance to the nearest
    camera: what is thinner than a pixel has no width that photographs show; auto: a pixel."""
    initial_opacity: float = 0.1
    """Opacity of the first Gaussians, the sky's apart."""
    initial_thickness: float = 1.0
    """The first Gaussians lie in the plane of their neighbours, at least this share as thick as
    wide; 1: they are round."""
    thickness_weight: float = 0.0
    """Weight in the loss of the mean logarithm of the Gaussians' shortest axes."""
    depth_spread_weight: float = 0.0
    """Weight in the loss of how far apart in depth lies what a pixel blends, as a share of its
    depth (`thin_surfaces.py`)."""
    drop_gaussians: Literal["none", "auto", "always"] = "none"
    """Whether steps leave Gaussians out at random, so that no place depends on few of them
    (`drop.py`); auto: where photographs are few."""
    drop_share: float = 0.2
    """Share of them that the last steps of a run leave out; none at its start."""
    cross_validate: Literal["none", "auto", "always"] = "none"
    """Whether trainings without some of the photographs choose, where they are "auto", if Gaussians
    are left out and how many there may be: up to eight trainings more (`few.py`); auto: below 36
    photographs. For a model that stands alone."""
    max_extent_per_distance: float | None = 2.0
    """The extent, in whose units centres move and density control calls Gaussians large, is that of
    the cameras, at most so many times the distance at which they see; None for no limit, as in 3DGS
    (`extent.py`)."""
    means_lr: float = 1.6e-4
    """Learning rate of the centres, in units of the extent."""
    means_lr_end: float = 0.01
    """Share of `means_lr` to which it falls over the run, exponentially."""
    average_from: float = 1.0
    """Share of the run from which on the models of all steps are averaged to the result
    (`mean_model.py`); 1: the last one is the result."""
    settle_epochs: int | None = None
    """A run of more steps per photograph than this, and of more than 700, ends with smaller
    learning rates, except for centres; None: rates keep their size."""
    scales_lr: float = 5e-3
    """Learning rate of the logarithmic scales."""
    quats_lr: float = 1e-3
    """Learning rate of the quaternions."""
    opacities_lr: float = 5e-2
    """Learning rate of the opacity logits."""
    sh0_lr: float = 2.5e-3
    """Learning rate of the base colour; the higher harmonics get a twentieth."""
    adam: Literal["visible", "dense"] = "visible"
    """visible: a step moves the Gaussians that its image shows; dense: all by moments, as 3DGS."""
    sh_degree_every: int = 0
    """Steps after which the next degree of colour is added, as in 3DGS; 0: all degrees at once."""
    density: Densification = field(default_factory=NoDensification)
    """How the number of Gaussians changes during training, with the knobs of that policy."""
    schedule_steps: int = 30_000
    """Length of the run for which the steps of `density` and `sh_degree_every` are meant; a run of
    another length scales them."""
    budget_s: float | None = None
    """Seconds of training after which the run ends, if the steps have not ended it; every schedule
    follows whichever is spent faster."""
    start_scale: float = 1.0
    """Share of the image size that training begins with."""
    full_size_from: float = 0.4
    """Share of the run from which images have their full size."""
    light: LightMode = "none"
    """Whether photographs are trained on in one canonical light, and renders scored in the light
    that is predicted of those held out; auto: where light differs."""
    num_looks: int = 6
    """How many times the validation views are rendered once growth and thinning are over."""
    sky: bool = True
    """Whether Gaussians on a far half sphere are added where photographs look above the horizon."""
    antialiased: bool = False
    """Whether opacities fade where a Gaussian is smaller than a pixel (Mip-Splatting): for views
    from distances that differ."""
    background: Literal["black", "random"] = "black"
    """The colour behind the Gaussians during training; random: another one at each step, which no
    half-transparent Gaussian can imitate."""
    fill_in: bool | Literal["auto"] = True
    """Whether places that structure from motion left empty get starting points; auto: where
    photographs see through some of them, as around an object, two short trainings choose."""
    dense_points: Literal["none", "always"] = "none"
    """always: photographs are matched against each other, and points that three of them agree on
    begin the model, which then does not grow."""
    skip_images: Literal["none", "auto"] = "none"
    """auto: photographs that repeat another one, and blurred ones of which others show the same,
    are left out."""
    reduce_on_cpu: bool = True
    """Whether size, steps and Gaussians are reduced so that a CPU finishes in minutes."""
    seed: int = 0
    """Seed of the order of images and of every random choice."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, ("num_steps", "long_side_px", "max_num_splats", "schedule_steps", "num_looks"))
        require_at_least(self, 1, ("max_epochs", "settle_epochs"), or_none=True)
        require_at_least(self, 0, ("sh_degree_every", "means_lr", "scales_lr", "quats_lr", "opacities_lr", "sh0_lr"))
        require_positive_or_none(self, ("max_scale_per_distance", "max_elongation", "max_extent_per_distance", "budget_s"))
        if not (self.needle_width_per_distance == "auto" or 0 <= self.needle_width_per_distance < 1):
            raise BadInput(f"needle_width_per_distance is {self.needle_width_per_distance}, expected auto or 0 to below 1.")
        if not 0 <= self.average_from <= 1:
            raise BadInput(f"average_from is {self.average_from}, expected a share of 0 to 1; 1 averages nothing.")
        if not 0 < self.means_lr_end <= 1:
            raise BadInput(f"means_lr_end is {self.means_lr_end}, expected above 0 and at most 1.")
        require_at_least(self, 0, ("thickness_weight", "depth_spread_weight"))
        if not 0 < self.initial_thickness <= 1:
            raise BadInput(f"initial_thickness is {self.initial_thickness}, expected more than 0 and at most 1.")
        if not 0 < self.drop_share < 1:
            raise BadInput(f"drop_share is {self.drop_share}, expected more than 0 and less than 1; drop_gaussians=none drops none.")
        if not 0 < self.initial_opacity < 1:
            raise BadInput(f"initial_opacity is {self.initial_opacity}, expected more than 0 and less than 1.")
        if not 0 <= self.sh_degree <= 3:
            raise BadInput(f"sh_degree is {self.sh_degree}, expected 0 to 3.")
        if not 0 <= self.ssim_weight <= 1:
            raise BadInput(f"ssim_weight is {self.ssim_weight}, expected 0 to 1.")
        if not (0 < self.start_scale <= 1 and 0 <= self.full_size_from <= 1):
            raise BadInput(f"start_scale is {self.start_scale} and full_size_from {self.full_size_from}, expected shares of at most 1.")
        require_one_of(self, "adam", ("visible", "dense"))
        require_one_of(self, "light", ("auto", "none", "always"))
        require_one_of(self, "drop_gaussians", ("none", "auto", "always"))
        require_one_of(self, "cross_validate", ("none", "auto", "always"))
        if self.cross_validate == "always" and self.budget_s is not None:
            raise BadInput("cross_validate is always, which takes several trainings, beside a budget of time: leave one of them out.")
        require_one_of(self, "background", ("black", "random"))
        require_one_of(self, "skip_images", ("none", "auto"))
        require_one_of(self, "dense_points", ("none", "always"))


# Short runs have no time for small steps: rates, Adam and growth were found on validation
# photographs (docs/experiments/training.md).
_SHORT = TrainConfig(
    max_epochs=120,
    settle_epochs=12,
    means_lr=6.4e-4,
    means_lr_end=0.1,
    average_from=0.95,
    scales_lr=3e-2,
    quats_lr=5e-3,
    opacities_lr=5e-2,
    sh0_lr=1e-2,
    adam="dense",
    initial_opacity=0.5,
    initial_thickness=0.15,
    drop_gaussians="auto",
    density=Adc(kind="planned", reset_opacity_every=NEVER, min_opacity=0.1, thin_to="auto"),
    start_scale=0.5,
    skip_images="auto",
    light="auto",
    fill_in="auto",
)
_PLAIN = TrainConfig(
    sh_degree=3,
    sh_degree_every=1_000,
    max_scale_per_distance=None,
    max_elongation=None,
    max_extent_per_distance=None,
    adam="dense",
    density=Adc(),
    sky=False,
    fill_in=False,
)
_PRESETS: dict[str, TrainConfig] = {
    "draft": replace(_SHORT, num_steps=2_000, long_side_px=576),
    "default": _SHORT,
    "standard": replace(_PLAIN, num_steps=30_000),
    # The paper's numbers at its 20,000 steps; 3DGS would reach a hundredth of the rate at 30,000.
    # It names no limit of Gaussians: this one keeps a mistaken run from filling the memory, 236
    # bytes times four for Adam and gradients each.
    "paper": replace(
        _PLAIN, num_steps=20_000, schedule_steps=20_000, means_lr_end=0.01 ** (2 / 3), max_num_splats=5_000_000, reduce_on_cpu=False
    ),
}


def train_preset(name: str) -> TrainConfig:
    """Return the configuration of a preset.

    Use it with `dataclasses.replace` to change what a preset has, and give that to `train`.

    Args:
        name: draft, default, standard (3DGS) or paper.

    Returns:
        The configuration, as every training of that preset begins with.

    Raises:
        BadInput: an unknown name; the message lists the names there are.

    Example:
        >>> config = replace(radiant.train_preset("draft"), num_steps=10, long_side_px=64)
        >>> result = radiant.train(radiant.load_scene("SCENE"), config)
        >>> result.num_steps
        10
    """
    if name not in _PRESETS:
        raise BadInput(f"train preset {name!r} is unknown: use one of {', '.join(get_args(Preset))}.")
    return _PRESETS[name]


def without_mean(config: TrainConfig) -> Mapping[str, Any]:
    """The settings of a training from `config` whose last step is its result, at rates that are
    steady without a mean."""
    rates = {"means_lr_end": LAST_STEP_MEANS_END, "scales_lr": LAST_STEP_SCALES_LR}
    return {"average_from": 1.0, **{name: min(rate, getattr(config, name)) for name, rate in rates.items()}}


@cache
def setting_types() -> Mapping[str, Any]:
    """The type of every setting by its path, such as "density.min_gradient", of all policies."""
    types = {name: hint for name, hint in get_type_hints(TrainConfig).items() if name != "density"}
    for policy in POLICIES.values():
        types |= {f"density.{name}": hint for name, hint in get_type_hints(policy).items()}
    return {**types, "density.kind": DensityKind}


def parse_setting(path: str, value: Any) -> Any:
    """Return the value of a setting in its own type.

    Args:
        path: the path of the setting, as "density.every".
        value: a text, read by the setting's type ("none" as None where that is one of its values),
            or a value of that type.

    Returns:
        The value.

    Raises:
        BadInput: there is no such setting, or the value is of another kind.
    """
    if path not in setting_types():
        raise BadInput(f"{path} is no setting of training: expected one of {', '.join(setting_types())}.")
    hint = setting_types()[path]
    if isinstance(value, str) and value.lower() == "none" and NoneType in get_args(hint):
        return None
    adapter = TypeAdapter(hint)
    try:
        return adapter.validate_strings(value) if isinstance(value, str) else adapter.validate_python(value)
    except ValidationError as error:
        raise BadInput(f"{path} is {value!r}: {what_was_expected(error)}.") from error


def what_was_expected(error: ValidationError) -> str:
    """What a value should have been, one of each kind that its setting may be."""
    return ", or ".join(dict.fromkeys(wrong["msg"].lower() for wrong in error.errors()))


def with_settings(config: TrainConfig, settings: Mapping[str, Any]) -> TrainConfig:
    """Return the configuration with other values, as
    `with_settings(config, {"sh_degree": "2", "density.kind": "mcmc", "density.every": "50"})`.

    Args:
        config: the configuration to begin with.
        settings: path of a setting → its value, a text or typed. Another "density.kind" keeps the
            knobs that the two policies share, and takes the defaults of the others.

    Returns:
        A new configuration.

    Raises:
        BadInput: as `parse_setting`; a value out of range; a knob that the policy does not have.
    """
    values = {path: parse_setting(path, value) for path, value in settings.items()}
    density = densification_of(values.pop("density.kind", config.density.kind), config.density)
    knobs = {path.removeprefix("density."): values.pop(path) for path in list(values) if path.startswith("density.")}
    names = [item.name for item in fields(density)]
    for name in knobs:
        if name not in names:
            raise BadInput(f"density.{name} is no setting of {density.kind!r}: use one of {', '.join(names)}, or another density.kind.")
    density = replace(density, **knobs)
    if isinstance(density, Adc):
        density.require_resettable()
    return replace(config, **values, density=density)
