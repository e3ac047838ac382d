"""The policies of densification with their knobs (`TrainConfig.density`), and the counts of edits.

Steps are those of `TrainConfig.schedule_steps`; a run of another length scales them, except for
`every`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from pydantic import Discriminator

from radiant_core.errors import BadInput

RESET_OPACITY = 0.01
"""What a reset lowers opacities to."""
DensityKind = Literal["none", "adc", "planned", "mcmc"]


@dataclass(frozen=True, kw_only=True)
class NoDensification:
    """The Gaussians of the start and no others."""

    kind: Literal["none"] = "none"
    """Names the policy."""


@dataclass(frozen=True, kw_only=True)
class Adc:
    """The adaptive density control of 3DGS clones, splits and prunes (Kerbl 2023, Sec. 5)."""

    kind: Literal["adc", "planned"] = "adc"
    """adc: up to `TrainConfig.max_num_splats` at once; planned: under a limit that grows to that
    number evenly, those first whose gradients have the largest sum over the views."""
    from_step: int = 500
    """Density control begins after this step."""
    until_step: int = 15_000
    """Density control, with its resets of opacity, ends before this step."""
    every: int = 100
    """Steps between two rounds of density control; not scaled: a mean over fewer steps is noise."""
    min_gradient: float = 2e-4
    """A Gaussian is cloned or split when its projected centre's mean gradient, in half image sides,
    is at least this."""
    gradient: Literal["mean", "absolute"] = "mean"
    """mean: gradients of a centre are summed over pixels with their signs, as in 3DGS; absolute:
    without, so that pixels which pull a large Gaussian to opposite sides do not cancel (AbsGS, Ye
    2024), with `min_absolute` as threshold."""
    min_absolute: float = 8e-4
    """The threshold in place of `min_gradient` where `gradient` is absolute; gsplat's for it."""
    min_opacity: float = 0.005
    """Less opaque Gaussians are pruned. More than 3DGS' 0.005 leaves fewer and more opaque ones,
    which hang less like haze before other views (docs/experiments/off_path.md)."""
    reset_opacity_every: int = 3_000
    """Steps between two resets of all opacities to at most 0.01."""
    prune_radius_px: float | None = None
    """A Gaussian wider than this on screen is pruned after the first reset of opacities. The code
    of 3DGS passes 20 but clears the radii before it looks at them, so that nothing is pruned by
    this rule; None is what it does."""
    thin_to: float = 1.0
    """Share of the Gaussians that stays after growth: those go of which photographs show least, in
    two rounds (`thinning.py`); 1: all."""
    pixels_per_splat: int | Literal["auto"] | None = "auto"
    """Training pixels for each Gaussian that planned growth may reach; auto: 40 for up to 36
    photographs or where Gaussians are left out at random, 80 from 72 on, between them as many
    Gaussians as for 36 (docs/experiments/training.md); None: any number."""

    def __post_init__(self) -> None:
        require_one_of(self, "kind", ("adc", "planned"))
        require_one_of(self, "gradient", ("mean", "absolute"))
        require_at_least(self, 0, ("from_step", "until_step", "min_gradient", "min_absolute"))
        require_at_least(self, 1, ("every", "reset_opacity_every"))
        _require_pixels(self.pixels_per_splat)
        require_positive_or_none(self, ("prune_radius_px",))
        if not 0 < self.thin_to <= 1:
            raise BadInput(f"thin_to is {self.thin_to}, expected more than 0 and at most 1.")
        if not 0 <= self.min_opacity < 1:
            raise BadInput(f"min_opacity is {self.min_opacity}, expected at least 0 and less than 1.")

    def require_resettable(self) -> None:
        """Raise BadInput where a reset of opacities would prune all Gaussians."""
        if self.min_opacity > RESET_OPACITY and self.reset_opacity_every < self.until_step:
            raise BadInput(
                f"min_opacity is {self.min_opacity}, but opacities are reset to {RESET_OPACITY} every {self.reset_opacity_every:,} steps, "
                "after which all would be pruned: set density.reset_opacity_every to density.until_step, or a smaller min_opacity."
            )


@dataclass(frozen=True, kw_only=True)
class Mcmc:
    """Densification as sampling relocates and adds Gaussians, up to `TrainConfig.max_num_splats`
    (Kheradmand 2024; `mcmc.py`)."""

    kind: Literal["mcmc"] = "mcmc"
    """Names the policy."""
    from_step: int = 500
    """Relocation and growth begin after this step."""
    until_step: int = 15_000
    """Relocation and growth end before this step."""
    every: int = 100
    """Steps between two rounds; not scaled."""
    pixels_per_splat: int | Literal["auto"] | None = "auto"
    """Training pixels for each Gaussian that growth may reach; auto: as of planned growth; None:
    any number."""

    def __post_init__(self) -> None:
        require_at_least(self, 0, ("from_step", "until_step"))
        require_at_least(self, 1, ("every",))
        _require_pixels(self.pixels_per_splat)


def _require_pixels(pixels_per_splat: object) -> None:
    is_number = isinstance(pixels_per_splat, int) and pixels_per_splat >= 1
    if not is_number and pixels_per_splat not in ("auto", None):
        raise BadInput(f"pixels_per_splat is {pixels_per_splat!r}, expected 'auto', at least 1, or None for no limit.")


Densification = Annotated[NoDensification | Adc | Mcmc, Discriminator("kind")]
POLICIES: dict[str, type[NoDensification | Adc | Mcmc]] = {"none": NoDensification, "adc": Adc, "planned": Adc, "mcmc": Mcmc}


def densification_of(kind: DensityKind, like: NoDensification | Adc | Mcmc) -> NoDensification | Adc | Mcmc:
    """The policy of a kind, with the fields it shares with `like` and its defaults for others."""
    shared = {field.name: getattr(like, field.name) for field in fields(POLICIES[kind]) if hasattr(like, field.name)}
    return POLICIES[kind](**{**shared, "kind": kind})


@dataclass(frozen=True, kw_only=True)
class DensityCounts:
    """What density control did, over one edit or a whole run."""

    num_cloned: int = 0
    num_split: int = 0
    """Each replaced by two."""
    num_pruned_transparent: int = 0
    num_pruned_large: int = 0
    """In the world or on screen."""
    num_refused: int = 0
    """Times a Gaussian would have been cloned or split but for the limit of Gaussians."""
    num_resets: int = 0
    """Resets of all opacities."""
    num_thinned: int = 0
    """Left out after growth, since photographs show little of them (`thinning.py`)."""
    num_relocated: int = 0
    """Dead Gaussians moved onto live ones (`mcmc.py`)."""

    def __add__(self, other: DensityCounts) -> DensityCounts:
        return DensityCounts(**{field.name: getattr(self, field.name) + getattr(other, field.name) for field in fields(self)})


def require_at_least(config: Any, least: int, names: tuple[str, ...], *, or_none: bool = False) -> None:
    """Raise BadInput where a field of a configuration is below `least`, or not finite."""
    for name in names:
        value = getattr(config, name)
        if not (or_none and value is None) and not least <= value < math.inf:
            raise BadInput(f"{name} is {value}, expected at least {least}{', or None for no limit' if or_none else ''}.")


def require_positive_or_none(config: Any, names: tuple[str, ...]) -> None:
    """Raise BadInput where a field of a configuration is neither a positive number nor None."""
    for name in names:
        value = getattr(config, name)
        if value is not None and not 0 < value < math.inf:
            raise BadInput(f"{name} is {value}, expected a positive number, or None for no limit.")


def require_one_of(config: Any, name: str, choices: tuple[str, ...]) -> None:
    """Raise BadInput where a field of a configuration is none of the choices."""
    if getattr(config, name) not in choices:
        raise BadInput(f"{name} is {getattr(config, name)!r}, expected one of {', '.join(choices)}.")
