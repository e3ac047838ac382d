"""Joining models at an edge or the cloud: all of them together, taught by what each shows at its
own cameras. Once per node.

`paper` concatenates and retrains everything (paper Sec. III-D, Fig. 6). `default` begins near the
end instead: every model fades where another one speaks for the place (`ownership`), so that the
first picture is about that of a clean cut, then all of them are fitted together in a few epochs at
falling rates; in no epoch, where devices fit them at once (`hierarchy/refine.py`). Views before
which nothing is contested are not shown, and what only they see keeps its bits. Gaussians are
neither added nor densified: the paper densifies on devices, from step 500 of their 20,000 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.balance import Balance, balance_teachers, exposure_balance
from radiant_core.aggregate.config import Join
from radiant_core.aggregate.ownership import Ownership, find_owners
from radiant_core.aggregate.retrain import retraining_config
from radiant_core.aggregate.synthetic_views import Teacher, synthetic_views
from radiant_core.aggregate.tiles import retrain_by_tiles
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db, psnr_db_of_mse
from radiant_core.numerics import FloatArray
from radiant_core.plan.regions.claims import Claims
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.results import TrainResult
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews, concatenate_views

TOUCHED_SHARE = 0.02
"""A view is shown where at least this share of the Gaussians before it is contested."""
NUM_COMPARED = 8
"""Views that say how far the models disagree before anything is done about it, and after it."""
NUM_ASKED = 10_000
"""Gaussians that say which views are touched."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """PSNR, over all pixels, of the joined and of the cut model in some of the models' pictures. A
    mean of each view's would favour the cut: well inside a region it is its teacher's own picture,
    to the bit. Both see these pictures: to hold them back from joining cost 0.1 to 0.3 dB."""

    num_views: int
    joined_db: float
    cut_db: float

    @property
    def keeps_joined(self) -> bool:
        """Whether the joined model is the better one."""
        return self.joined_db >= self.cut_db


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
    check: Check | None = None
    """Joined against cut; None: not compared."""
    cut: Splats | None = None
    """The cut that the joined model was better than, or that stands for models that nobody fits;
    None: nothing is contested, or the cut is kept."""

    @property
    def is_unfitted(self) -> bool:
        """Whether models only faded, for devices to fit."""
        return self.cut is not None and self.check is None

    @property
    def splats(self) -> Splats:
        """The joined model."""
        return self.trained.splats


def join_models(
    teachers: Sequence[Teacher],
    train: TrainConfig,
    join: Join,
    options: FitOptions,
    claims: Claims | None = None,
    num_tiles: int = 1,
) -> Joined:
    """Join the teachers' models by what each shows at its own cameras; `claims` say whose region a
    place lies in.

    A single model is its own teacher and comes back unchanged unless `join.retrain_single`.
    `num_tiles` are fitted one after another, except by `paper`. Raises BadInput without any model.
    """
    if not teachers:
        raise BadInput("no models to join: give at least one, with the cameras it is asked at.")
    if len(teachers) == 1 and not join.retrain_single:
        return Joined(trained=as_result(teachers[0].splats), num_given=len(teachers[0].splats))
    if join.method == "paper":
        return _retrain_as_in_the_paper(teachers, train, join, options)
    return _join(teachers, train, join, options, claims, num_tiles)


def _retrain_as_in_the_paper(teachers: Sequence[Teacher], train: TrainConfig, join: Join, options: FitOptions) -> Joined:
    views = teacher_views(teachers, train.long_side_px, options.backend, options.scratch)
    if not join.weight_by_alpha:
        views = replace(views, weights=None)
    merged = concatenate_splats([teacher.splats for teacher in teachers])
    trained = fit_splats(merged, views, retraining_config(train, join, merged, len(views)), options)
    return Joined(trained=trained, num_given=len(merged), num_views=len(views), num_shown=len(views))


def cut_at_borders(teachers: Sequence[Teacher], claims: Claims | None = None) -> Joined:
    """The teachers' models, each without what another owns; nothing is rendered or retrained."""
    return _cut(teachers, _find_owners(teachers, claims))


def _find_owners(teachers: Sequence[Teacher], claims: Claims | None) -> list[Ownership]:
    return find_owners([teacher.splats for teacher in teachers], [teacher.cameras for teacher in teachers], claims)


def _cut(teachers: Sequence[Teacher], owned: Sequence[Ownership]) -> Joined:
    parts = [teacher.splats.select(places.owner == index) for index, (teacher, places) in enumerate(zip(teachers, owned, strict=True))]
    num_contested = sum(int(places.contested.sum()) for places in owned)
    num_given = sum(len(teacher.splats) for teacher in teachers)
    return Joined(
        trained=as_result(concatenate_splats(parts)),
        num_given=num_given,
        num_views=sum(len(teacher.cameras) for teacher in teachers),
        contested_share=num_contested / num_given if num_given else 0.0,
    )


def _join(
    teachers: Sequence[Teacher],
    train: TrainConfig,
    join: Join,
    options: FitOptions,
    claims: Claims | None,
    num_tiles: int,
) -> Joined:
    balance = exposure_balance(teachers, options.backend)
    teachers = balance_teachers(teachers, balance)
    owned = _find_owners(teachers, claims)
    cut = replace(_cut(teachers, owned), balance=balance)
    merged, owns, contested = _start(teachers, owned, join)
    shares = [contested_shares(teacher.cameras, merged.means, contested) for teacher in teachers]
    touched = [views_shares > TOUCHED_SHARE for views_shares in shares]
    cut = replace(
        cut, num_shown=int(sum(rows.sum() for rows in touched)), contested_share=float(contested.mean()) if len(contested) else 0.0
    )
    if not cut.num_shown:
        return cut
    if join.epochs == 0:
        # The cut is for the case that nobody refines it.
        return replace(cut, trained=as_result(merged), cut=cut.splats)
    touched_teachers = [
        replace(one, cameras=one.cameras.select(np.flatnonzero(rows))) for one, rows in zip(teachers, touched, strict=True) if rows.any()
    ]
    views = teacher_views(touched_teachers, train.long_side_px, options.backend, options.scratch)
    if not join.weight_by_alpha:
        views = replace(views, weights=None)
    compared = views.select(
        most_contested(np.concatenate([views_shares[rows] for views_shares, rows in zip(shares, touched, strict=True)]))
    )
    cut = replace(cut, agreement_db=min(_psnr_db(cut.splats, compared, options.backend)))
    if join.agreement_db is not None and (cut.agreement_db or 0.0) >= join.agreement_db:
        return cut
    # What the cut is made of is there: a copy would wait for the end of the training.
    figures = replace(cut, trained=as_result(merged.select(np.arange(0))))
    del cut
    retrained = retrain_by_tiles(merged, views, train, join, options, num_tiles)
    whole = concatenate_splats([retrained.splats, merged.select(~retrained.reached & owns)])
    joined = replace(figures, trained=replace(retrained.trained, splats=whole))
    cut_again = _cut(teachers, owned).splats
    joined_db, cut_db = (_pooled_db(_psnr_db(model, compared, options.backend)) for model in (whole, cut_again))
    check = Check(num_views=len(compared), joined_db=joined_db, cut_db=cut_db)
    if check.keeps_joined:
        return replace(joined, check=check, cut=cut_again)
    return replace(joined, trained=replace(retrained.trained, splats=cut_again), check=check)


def _start(teachers: Sequence[Teacher], owned: Sequence[Ownership], join: Join) -> tuple[Splats, NDArray[np.bool_], NDArray[np.bool_]]:
    """All models together (N), faded; which (N,) are in their own place, which are contested."""
    models, owned = without_faint([teacher.splats for teacher in teachers], owned, join)
    owns = np.concatenate([places.owner == index for index, places in enumerate(owned)])
    return fade(models, owned, join.foreign_opacity), owns, np.concatenate([places.contested for places in owned])


def without_faint(models: Sequence[Splats], owned: Sequence[Ownership], join: Join) -> tuple[list[Splats], list[Ownership]]:
    """Models and owners without what `fade` would make fainter than `join.faint_opacity`."""
    opaque_rows = [
        (places.owner == index) | (join.foreign_opacity * model.opacities >= join.faint_opacity)
        for index, (model, places) in enumerate(zip(models, owned, strict=True))
    ]
    chosen = [model.select(rows) for model, rows in zip(models, opaque_rows, strict=True)]
    return chosen, [places.at(rows) for places, rows in zip(owned, opaque_rows, strict=True)]


def fade(models: Sequence[Splats], owned: Sequence[Ownership], factor: float) -> Splats:
    """All models together, their opacities times `factor` where another model owns the place."""
    parts = []
    for index, (model, places) in enumerate(zip(models, owned, strict=True)):
        faint = np.clip(model.opacities * factor, 1e-4, 1 - 1e-4)
        logits = np.where(places.owner == index, model.logit_opacities, np.log(faint / (1 - faint)))
        parts.append(replace(model, logit_opacities=logits.astype(np.float32)))
    return concatenate_splats(parts)


def teacher_views(teachers: Sequence[Teacher], long_side_px: int, backend: Backend = "auto", folder: Path | None = None) -> TrainingViews:
    """Every teacher's views at its cameras, reduced to `long_side_px`."""
    parts = [synthetic_views(teacher.splats, teacher.cameras.scaled(long_side_px), backend, folder) for teacher in teachers]
    return concatenate_views(parts)


def contested_shares(cameras: Cameras, means: NDArray[np.floating], contested: NDArray[np.bool_]) -> FloatArray:
    """Of the Gaussians that each camera (C,) sees, the share that is contested, by an even sample
    of all; it sees enough of them above `TOUCHED_SHARE`."""
    shares = np.zeros(len(cameras))
    some = np.unique(np.linspace(0, len(means) - 1, NUM_ASKED).astype(np.int64))
    means, contested = means[some], contested[some]
    for index in range(len(cameras)):
        before = cameras.select([index]).any_sees(means)
        shares[index] = contested[before].sum() / max(1, before.sum())
    return shares


def most_contested(shares: FloatArray) -> NDArray[np.int64]:
    """Rows of views in which a joined and a cut model are compared: `NUM_COMPARED` of the half with
    more that is contested, evenly chosen. In the others both are their teacher's own picture."""
    ranked = np.argsort(-shares, kind="stable")[: max(NUM_COMPARED, len(shares) // 2)]
    return np.sort(ranked[np.unique(np.linspace(0, len(ranked) - 1, NUM_COMPARED).astype(np.int64))])


def _pooled_db(psnrs_db: Sequence[float]) -> float:
    """PSNR of the mean squared error of views with these."""
    return psnr_db_of_mse(float(np.mean(10.0 ** (-np.array(psnrs_db) / 10))))


def _psnr_db(model: Splats, views: TrainingViews, backend: Backend) -> list[float]:
    """PSNR of the model in each view, where its teacher is opaque."""
    weights = views.weights if views.weights is not None else [None] * len(views)
    triples = zip(render_views(model, views.cameras, backend), views.images, weights, strict=True)
    return [psnr_db(view.image, image / 255, _opaque(weight)) for view, image, weight in triples]


def _opaque(weight: NDArray[np.uint8] | None) -> NDArray[np.bool_] | None:
    return None if weight is None or not (opaque := weight > 127).any() else opaque


def as_result(splats: Splats) -> TrainResult:
    """A model as it is, as the result of no step."""
    return TrainResult(splats=splats, num_steps=0, first_loss=0.0, last_loss=0.0, seconds=0.0)
