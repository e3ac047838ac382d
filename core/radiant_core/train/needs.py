"""A training fitted to its machine and photographs: reductions as typed decisions. Once per run.

Without a GPU the presets are reduced to what finishes in minutes. CPU seconds of one step on one
core: `native` 0.02 for 13,000 Gaussians at 480×270; `reference` 0.26 for 5,000 at 240×180.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.plan.profiles.step_law import StepLaw
from radiant_core.regimes import FEW_PHOTOGRAPHS, LENGTH, PHOTOGRAPHS, THINNING, require
from radiant_core.train.config import TrainConfig, with_settings
from radiant_core.train.densify.policies import Adc, NoDensification
from radiant_core.train.views import TrainingViews

MIN_PLANNED = 4_000
"""Planned growth may always reach this number of Gaussians."""
PIXELS_PER_SPLAT, PIXELS_OF_FEW = (
    require(PHOTOGRAPHS, {"photographs": count}).values["pixels_per_splat"] for count in (2 * FEW_PHOTOGRAPHS, 0)
)
"""Training pixels for each Gaussian that growth may reach, and the same for few photographs, or
where Gaussians are left out at random: few show a place less often, so that each of their pixels
tells more. From `FEW_PHOTOGRAPHS` to twice as many the limit stays where it is, so that more
photographs never mean fewer Gaussians."""
MIN_STEPS = 1_500
"""Few photographs never shorten a run below this."""


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """Settings that the user gave; None leaves one to the preset and the backend."""

    long_side_px: int | None = None
    """Long side of the training images."""
    num_steps: int | None = None
    """Optimisation steps of a device."""
    max_num_splats: int | None = None
    """Upper limit of Gaussians of a device."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Any other setting of training by its path in `TrainConfig`, as `with_settings` takes it."""


_LIMITS = {
    "native": Overrides(long_side_px=576, num_steps=1_500, max_num_splats=200_000),
    "reference": Overrides(long_side_px=240, num_steps=120, max_num_splats=8_000),
}
_UNITS = {"long_side_px": "px", "num_steps": "steps", "max_num_splats": "Gaussians"}
_OPTIONS = {"long_side_px": "--long-side-px", "num_steps": "--steps", "max_num_splats": "--max-splats"}


def fit_to_backend(config: TrainConfig, backend: str, overrides: Overrides) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The configuration reduced to what this backend finishes in minutes, and a decision for each
    number that differs."""
    limits = _LIMITS.get(backend, Overrides()) if config.reduce_on_cpu else Overrides()
    decisions = [_setting_decision(config, name, value) for name, value in overrides.settings.items()]
    if overrides.num_steps is not None:
        # A number of steps that the user gave is not reduced.
        config = replace(config, max_epochs=None)
    config = with_settings(config, overrides.settings)
    if backend in _LIMITS and not config.reduce_on_cpu:
        decisions.append(_unreduced_decision(overrides.num_steps or config.num_steps, backend))
    for name, unit in _UNITS.items():
        requested, wanted, limit = getattr(overrides, name), getattr(config, name), getattr(limits, name)
        if requested is not None:
            chosen, reason = requested, "asked for on the command line"
        elif limit is not None and wanted > limit:
            chosen = limit
            reason = f"the preset's {wanted:,} {unit} would take hours on a CPU with the {backend} renderer"
        else:
            continue
        # In place of a number that was asked for, what this backend would have had.
        usual = wanted if limit is None else min(wanted, limit)
        config = replace(config, **{name: chosen})
        decisions.append(
            Decision(
                stage="train",
                topic=name,
                choice=f"{chosen:,} {unit} instead of {wanted if requested is None else usual:,}",
                figure=float(chosen),
                unit=unit,
                reason=reason,
                otherwise="" if requested is None else f"{_OPTIONS[name]} {usual}",
                forced=requested is not None,
            )
        )
    return config, tuple(decisions)


def _setting_decision(config: TrainConfig, name: str, value: Any) -> Decision:
    return Decision(
        stage="train",
        topic=name,
        choice=f"{value} instead of {reduce(lambda part, field: getattr(part, field, None), name.split('.'), config)}",
        figure=float(value) if isinstance(value, int | float) else 0.0,
        unit="as set",
        reason="asked for on the command line",
        forced=True,
    )


def _unreduced_decision(num_steps: int, backend: str) -> Decision:
    return Decision(
        stage="train",
        topic="size",
        choice="nothing is reduced for a CPU",
        figure=float(num_steps),
        unit="steps",
        reason=f"the preset is followed as it is; with the {backend} renderer its full size takes hours",
        forced=True,
    )


def fit_to_views(config: TrainConfig, views: TrainingViews) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """What is "auto", decided by the photographs that are trained on."""
    return fit_to_cameras(config, views.cameras)


def fit_to_cameras(config: TrainConfig, cameras: Cameras) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The same by the cameras of the photographs, at the size that is trained on."""
    config, dropping = fit_dropping(config, len(cameras))
    config, size = _fit_size(config, cameras)
    config, length = _fit_length(config, len(cameras))
    config, thinning = fit_thinning(config, len(cameras))
    return config, (*size, *length, *dropping, *thinning)


def _fit_size(config: TrainConfig, cameras: Cameras) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """Where growth has a limit to reach, at most one Gaussian per `pixels_per_splat` pixels."""
    per_splat, most = pixels_per_splat(config, len(cameras)), _most_splats(config, cameras)
    if most >= config.max_num_splats:
        return config, ()
    num_pixels = int(cameras.sizes_wh.prod(axis=1).sum())
    decision = Decision(
        stage="train",
        topic="number of Gaussians",
        choice=f"growth is planned to {most:,} instead of {config.max_num_splats:,}",
        figure=num_pixels / 1e6,
        unit="million pixels of training photographs",
        row=_row_of(len(cameras)) if getattr(config.density, "pixels_per_splat", None) == "auto" else "",
        reason=f"more than one Gaussian per {per_splat} pixels {_why_no_more(config, per_splat)}",
    )
    return replace(config, max_num_splats=most), (decision,)


def _why_no_more(config: TrainConfig, per_splat: int | None) -> str:
    if per_splat is None or getattr(config.density, "pixels_per_splat", None) != "auto":
        return "were not set, nor chosen by trials"
    if per_splat < PIXELS_PER_SPLAT:
        return "gain on some sets of few photographs and lose on others, for up to twice the time"
    return "cost time and gained nothing on photographs left out"


def _row_of(num_views: int) -> str:
    return require(PHOTOGRAPHS, {"photographs": num_views}).row


def pixels_per_splat(config: TrainConfig, num_views: int) -> int | None:
    """Training pixels for each Gaussian that growth may reach with so many photographs, once
    `drop_gaussians` is no longer "auto"; None: growth has no such limit."""
    density = config.density
    if isinstance(density, NoDensification) or density.kind == "adc":
        return None
    if density.pixels_per_splat == "auto":
        if config.drop_gaussians == "always":
            return PIXELS_OF_FEW
        between = round(PIXELS_OF_FEW * num_views / FEW_PHOTOGRAPHS)
        return require(PHOTOGRAPHS, {"photographs": num_views}).values.get("pixels_per_splat", between)
    return density.pixels_per_splat


def most_splats(config: TrainConfig, views: TrainingViews) -> int:
    """How many Gaussians growth may reach with these photographs."""
    return _most_splats(config, views.cameras)


def _most_splats(config: TrainConfig, cameras: Cameras) -> int:
    per_splat = pixels_per_splat(config, len(cameras))
    if per_splat is None:
        return config.max_num_splats
    num_pixels = int(cameras.sizes_wh.prod(axis=1).sum())
    return min(config.max_num_splats, max(MIN_PLANNED, num_pixels // per_splat))


def step_law_of(config: TrainConfig, num_photographs: int, num_devices: int) -> StepLaw:
    """The steps of devices of which one with the mean number of photographs trains as long as this
    configuration asks for."""
    mean = num_photographs / num_devices
    return StepLaw(num_steps=most_steps(config, mean), mean_photographs=mean)


def most_steps(config: TrainConfig, num_views: float) -> int:
    """The steps of a training of so many photographs."""
    return config.num_steps if config.max_epochs is None else min(config.num_steps, max(MIN_STEPS, round(config.max_epochs * num_views)))


def _fit_length(config: TrainConfig, num_views: int) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """At most `max_epochs` steps per photograph; schedules are scaled to them."""
    if config.num_steps == (most := most_steps(config, num_views)):
        return config, ()
    case = require(LENGTH)
    decision = Decision(
        stage="train",
        topic="length",
        choice=f"at most {most:,} steps",
        figure=float(num_views),
        unit="training photographs",
        reason=f"after {config.max_epochs} steps per photograph {case.reason}",
        row=case.row,
    )
    return replace(config, num_steps=most), (decision,)


def fit_thinning(config: TrainConfig, num_views: int) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """Whether Gaussians of which photographs show least go after growth, where that is "auto"."""
    density = config.density
    if not isinstance(density, Adc) or density.thin_to != "auto":
        return config, ()
    case = require(THINNING, {"photographs": num_views})
    percent = case.values["stays_percent"]
    decision = Decision(
        stage="train",
        topic="Gaussians after growth",
        choice="all stay" if percent == 100 else f"{percent} % stay, those that photographs show most",
        figure=float(num_views),
        unit="training photographs",
        reason=case.reason,
        row=case.row,
        otherwise=f"--set train.density.thin_to={'0.75' if percent == 100 else '1'}",
        changes_nothing=percent == 100,
    )
    return replace(config, density=replace(density, thin_to=percent / 100)), (decision,)


def fit_dropping(config: TrainConfig, num_views: int) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """Whether steps leave Gaussians out, where that is "auto"."""
    if config.drop_gaussians != "auto":
        return config, ()
    case = require(PHOTOGRAPHS, {"photographs": num_views})
    few = bool(case.values["leaves_out"])
    decision = Decision(
        stage="train",
        topic="Gaussians left out at random",
        choice=f"up to {config.drop_share:.0%} at each step" if few else "none",
        figure=float(num_views),
        unit="training photographs",
        reason=case.reason,
        row=case.row,
        otherwise=f"--set train.drop_gaussians={'none' if few else 'always'}",
        changes_nothing=not few,
    )
    return replace(config, drop_gaussians="always" if few else "none"), (decision,)
