"""Joining models at an edge or the cloud: all of them together, taught by what each shows at its
own cameras. Once per node.

`paper` concatenates and retrains everything (paper Sec. III-D, Fig. 6). `default` begins near the
end instead: every model fades where another one speaks for the place (`ownership`), so that the
first picture is about that of a clean cut, then all of them are fitted together in a few epochs at
falling rates. Views before which nothing is contested are not shown, and what only they see keeps
its bits. Gaussians are neither added nor densified: the paper densifies on devices, from step 500
of their 20,000 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.balance import Balance, balance_teachers, exposure_balance
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.ownership import Claims, Ownership, ownership
from radiant_core.aggregate.synthetic_views import Teacher, synthetic_views
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.results import TrainResult
from radiant_core.train.shapes import without_dead
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews, concatenate_views

RATES_END = 0.3
"""Share of the rates left at the end of a retraining by `default`; centres' fall as in training."""
RATES = ("means_lr", "means_lr_end", "scales_lr", "quats_lr", "opacities_lr", "sh0_lr")
"""Of a configuration, the rates that `paper` takes from 3DGS."""
TOUCHED_SHARE = 0.02
"""A view is shown where at least this share of the Gaussians before it is contested."""
NUM_COMPARED = 8
"""Views that say how far the models disagree before anything is done about it."""
NUM_ASKED = 10_000
"""Gaussians that say which views are touched."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Joined:
    """A joined model and what was done and skipped on the way."""

    trained: TrainResult
    num_given: int
    """Gaussians of all models."""
    num_views: int = 0
    """Synthetic views there are."""
    num_shown: int = 0
    """Those that something contested lies before."""
    contested_share: float = 1.0
    """Of all Gaussians, those in places that a second model knows too."""
    agreement_db: float | None = None
    """PSNR of the models' pictures and the cut ones', in the worst view; None: not compared."""
    balance: Balance | None = None
    """How exposures of the models differ; None: not compared."""

    @property
    def splats(self) -> Splats:
        """The joined model."""
        return self.trained.splats


def retrain_on_synthetic_views(
    teachers: Sequence[Teacher], train: TrainConfig, aggregate: AggregateConfig, options: FitOptions, claims: Claims | None = None
) -> Joined:
    """Join the teachers' models by what each shows at its own cameras; `claims` say whose region a
    place lies in.

    A single model is its own teacher and comes back unchanged unless `aggregate.retrain_single` or
    pooled. Raises BadInput without any.
    """
    if not teachers:
        raise BadInput("no models to join: give at least one, with the cameras it is asked at.")
    if len(teachers) == 1 and not (aggregate.retrain_single or teachers[0].pooled):
        return Joined(trained=untrained(teachers[0].splats), num_given=len(teachers[0].splats))
    if aggregate.preset == "paper":
        return _retrain_as_in_the_paper(teachers, train, aggregate, options)
    return _join(teachers, train, aggregate, options, claims)


def _retrain_as_in_the_paper(teachers: Sequence[Teacher], train: TrainConfig, aggregate: AggregateConfig, options: FitOptions) -> Joined:
    views = teacher_views(teachers, train.long_side_px)
    if not aggregate.weight_by_alpha:
        views = replace(views, weights=None)
    merged = concatenate_splats([teacher.splats for teacher in teachers])
    trained = fit_splats(merged, views, retraining_config(train, aggregate, merged, len(views)), options)
    return Joined(trained=trained, num_given=len(merged), num_views=len(views), num_shown=len(views))


def cut_at_borders(teachers: Sequence[Teacher], claims: Claims | None = None) -> Joined:
    """The teachers' models, each without what another owns; nothing is rendered or retrained."""
    return _cut(teachers, _find_owners(teachers, claims))


def _find_owners(teachers: Sequence[Teacher], claims: Claims | None) -> list[Ownership]:
    cameras = [teacher.cameras for teacher in teachers]
    return [ownership(teacher.splats.means, cameras, claims) for teacher in teachers]


def _cut(teachers: Sequence[Teacher], owned: Sequence[Ownership]) -> Joined:
    kept = [teacher.splats.select(places.owner == index) for index, (teacher, places) in enumerate(zip(teachers, owned, strict=True))]
    num_contested = sum(int(places.contested.sum()) for places in owned)
    num_given = sum(len(teacher.splats) for teacher in teachers)
    return Joined(
        trained=untrained(concatenate_splats(kept)),
        num_given=num_given,
        num_views=sum(len(teacher.cameras) for teacher in teachers),
        contested_share=num_contested / num_given if num_given else 0.0,
    )


def _join(
    teachers: Sequence[Teacher], train: TrainConfig, aggregate: AggregateConfig, options: FitOptions, claims: Claims | None
) -> Joined:
    balance = exposure_balance(teachers, options.backend)
    teachers = balance_teachers(teachers, balance)
    owned = _find_owners(teachers, claims)
    plainly_cut = _cut(teachers, owned)
    models, owned = without_faint([teacher.splats for teacher in teachers], owned, aggregate)
    owns = np.concatenate([places.owner == index for index, places in enumerate(owned)])
    contested = np.concatenate([places.contested | teacher.pooled for teacher, places in zip(teachers, owned, strict=True)])
    merged = faded(models, owned, aggregate.foreign_opacity)
    shown = [touched_cameras(teacher.cameras, merged.means, contested) for teacher in teachers]
    num_shown = int(sum(rows.sum() for rows in shown))
    contested_share = float(contested.mean()) if len(contested) else 0.0
    plainly_cut = replace(plainly_cut, num_shown=num_shown, contested_share=contested_share, balance=balance)
    if not num_shown:
        return plainly_cut
    views = teacher_views(
        [_select_cameras(teacher, rows) for teacher, rows in zip(teachers, shown, strict=True) if rows.any()], train.long_side_px
    )
    if not aggregate.weight_by_alpha:
        views = replace(views, weights=None)
    plainly_cut = replace(plainly_cut, agreement_db=_agreement_db(plainly_cut.splats, views, options.backend))
    if aggregate.agreement_db is not None and (plainly_cut.agreement_db or 0.0) >= aggregate.agreement_db:
        return plainly_cut
    made = retrain(merged, views, train, aggregate, options)
    whole = concatenate_splats([made.splats, merged.select(~made.reached & owns)])
    return replace(plainly_cut, trained=replace(made.trained, splats=whole))


@dataclass(frozen=True, kw_only=True, eq=False)
class Retrained:
    """The Gaussians of a retraining that any view can show, and which those are."""

    trained: TrainResult
    """Without the held ones and those that became invisible."""
    reached: NDArray[np.bool_]
    """(N,) Of the Gaussians given, those that were fitted; the others keep their bits."""

    @property
    def splats(self) -> Splats:
        """The fitted Gaussians."""
        return self.trained.splats


def retrain(
    moving: Splats,
    views: TrainingViews,
    train: TrainConfig,
    aggregate: AggregateConfig,
    options: FitOptions,
    held: Splats | None = None,
) -> Retrained:
    """Fit the Gaussians `moving` (N) to `views`, in the presence of those `held`, which are
    rendered and keep their bits.

    What no view can show takes no memory and no part, of either.
    """
    reached = reached_by(moving, views.cameras)
    start = moving.select(reached)
    steady = None
    if held is not None:
        shown = held.select(reached_by(held, views.cameras))
        start = concatenate_splats([shown, start])
        steady = np.arange(len(start)) < len(shown)
    config = retraining_config(train, aggregate, start, len(views))
    result = fit_splats(start, views, config, replace(options, held=steady, steps=Steps(end=RATES_END)))
    fitted = result.splats if steady is None else result.splats.select(~steady)
    return Retrained(trained=replace(result, splats=without_dead(fitted)[0]), reached=reached)


def without_faint(models: Sequence[Splats], owned: Sequence[Ownership], aggregate: AggregateConfig) -> tuple[list[Splats], list[Ownership]]:
    """Models and owners without what `faded` would make fainter than `aggregate.faint_opacity`."""
    kept = [
        (places.owner == index) | (aggregate.foreign_opacity * model.opacities >= aggregate.faint_opacity)
        for index, (model, places) in enumerate(zip(models, owned, strict=True))
    ]
    chosen = [model.select(rows) for model, rows in zip(models, kept, strict=True)]
    return chosen, [places.at(rows) for places, rows in zip(owned, kept, strict=True)]


def faded(models: Sequence[Splats], owned: Sequence[Ownership], factor: float) -> Splats:
    """All models together, their opacities times `factor` where another model owns the place."""
    parts = []
    for index, (model, places) in enumerate(zip(models, owned, strict=True)):
        faint = np.clip(model.opacities * factor, 1e-4, 1 - 1e-4)
        logits = np.where(places.owner == index, model.logit_opacities, np.log(faint / (1 - faint)))
        parts.append(replace(model, logit_opacities=logits.astype(np.float32)))
    return concatenate_splats(parts)


def reached_by(splats: Splats, cameras: Cameras) -> NDArray[np.bool_]:
    """Which Gaussians (N,) may show in an image: 3 standard deviations reach a camera's pyramid."""
    radii = 3 * np.exp(splats.log_scales.astype(np.float64).max(axis=1))
    means = splats.means.T.astype(np.float64)
    reached = np.zeros(len(splats), bool)
    for K, pose, (width, height) in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, strict=True):
        left = np.flatnonzero(~reached)
        # The sides of the pyramid, pointing inwards: columns 0 and width, rows 0 and height.
        sides = np.array([K[0] * [1, 0, 1], [-K[0, 0], 0, width - K[0, 2]], K[1] * [0, 1, 1], [0, -K[1, 1], height - K[1, 2]], [0, 0, 1]])
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        heights = (sides @ pose[:3, :3]) @ means[:, left] + (sides @ pose[:3, 3])[:, None]
        reached[left] = heights.min(axis=0) + radii[left] > 0
    return reached


def teacher_views(teachers: Sequence[Teacher], long_side_px: int) -> TrainingViews:
    """Every teacher's views at its cameras, reduced to `long_side_px`; rendered ones are reused."""
    return concatenate_views([synthetic_views(t.splats, t.cameras.scaled(long_side_px), rendered=t.rendered) for t in teachers])


def _select_cameras(teacher: Teacher, chosen: NDArray[np.bool_]) -> Teacher:
    """The teacher at some of its cameras."""
    rows = np.flatnonzero(chosen).tolist()
    rendered = {place: teacher.rendered[row] for place, row in enumerate(rows) if row in teacher.rendered}
    return replace(teacher, cameras=teacher.cameras.select(rows), rendered=rendered)


def touched_cameras(cameras: Cameras, means: NDArray[np.floating], contested: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cameras (C,) see enough contested Gaussians, judged by an even sample of all."""
    touched = np.zeros(len(cameras), bool)
    some = np.unique(np.linspace(0, len(means) - 1, NUM_ASKED).astype(np.int64))
    means, contested = means[some], contested[some]
    for index in range(len(cameras)):
        before = cameras.select([index]).any_sees(means)
        touched[index] = contested[before].sum() > TOUCHED_SHARE * before.sum()
    return touched


def _agreement_db(joined: Splats, views: TrainingViews, backend: Backend) -> float:
    """PSNR of the models' pictures and the joined one's, in the worst view: one seam is enough."""
    some = np.unique(np.linspace(0, len(views) - 1, NUM_COMPARED).astype(np.int64))
    compared = zip(render_views(joined, views.cameras.select(some), backend), some, strict=True)
    return min(psnr_db(view.image, views.images[index] / 255) for view, index in compared)


def retraining_config(train: TrainConfig, aggregate: AggregateConfig, merged: Splats, num_views: int) -> TrainConfig:
    """A device's settings for `aggregate.num_epochs` over so many synthetic views: nothing is
    added, grown or exposed anew, and rates fall as joining has it, not as a device's. `paper`
    retrains at the rates of 3DGS, however its devices were trained."""
    num_steps = aggregate.num_epochs * num_views
    if aggregate.max_num_steps is not None:
        num_steps = min(num_steps, aggregate.max_num_steps)
    still = {
        "sh_degree_every": 0,
        "density": NoDensification(),
        "start_scale": 1.0,
        "exposure": "none",
        "background": "black",
        "settle_epochs": None,
    }
    rates = {name: getattr(train_preset("paper"), name) for name in RATES} if aggregate.preset == "paper" else {}
    return replace(train, num_steps=num_steps, sh_degree=merged.sh_degree, **still, **rates)


def untrained(splats: Splats) -> TrainResult:
    """A model as it is, as the result of no step."""
    return TrainResult(splats=splats, num_steps=0, first_loss=0.0, last_loss=0.0, seconds=0.0)
