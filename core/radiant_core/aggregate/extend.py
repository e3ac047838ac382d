"""A region's new model joins a finished scene: the scene beyond a margin keeps its bits. Once per
new region.

d(x) is how far a place lies inside the new region, negative outside, m the margin:

    d < −m    the scene as it was; of the new model nothing
    |d| ≤ m   both, each faint where the other one owns the ground, fitted together
    d > m     the new model, untouched; of the scene only what lies where the new model has nothing

What they are fitted to are pictures in which both blend over the margin, the scene counting (1 − b)
and the new model b(d) = 3t² − 2t³ with t = (d/m + 1)/2, at the new model's cameras: those of the
finished scene need not be known any more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from shapely import Polygon, boundary, contains, distance, points, prepare

from radiant_core.aggregate.config import Join
from radiant_core.aggregate.join import TOUCHED_SHARE, contested_shares, fade
from radiant_core.aggregate.ownership import Ownership
from radiant_core.aggregate.retrain import retrain
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.errors import BadInput
from radiant_core.evaluate.ground_places import ground_places
from radiant_core.numerics import FloatArray, check_array
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews

OPAQUE = 0.5
"""A pixel shows a place of the new model where that covers so much of it, else of the scene."""
BLIND_FACTOR = 1.5
"""A replaced Gaussian stays where no new one is within this many times its own size."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NewRegion:
    """Land that a new model takes over: a simple polygon (V,2) m, and its margin in m."""

    polygon: FloatArray
    margin_m: float
    """Half the width of the strip along its border that is fitted."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", check_array("polygon", self.polygon, (None, 2)))
        if len(self.polygon) < 3 or not (area := Polygon(self.polygon)).is_valid or area.area <= 0:
            raise BadInput(
                f"the region has {len(self.polygon)} corners and no area of its own: give three or more, none crossing another side."
            )
        if not (np.isfinite(self.margin_m) and self.margin_m > 0):
            raise BadInput(f"the margin is {self.margin_m} m, expected a positive half width of the strip that is fitted anew.")

    def inside_m(self, places: NDArray[np.floating]) -> FloatArray:
        """How far inside the border places (..., 2 or 3) m lie (...,): negative outside, or NaN."""
        flat = np.asarray(places, np.float64)[..., :2]
        is_finite = np.isfinite(flat).all(axis=-1)
        area, xy = Polygon(self.polygon), points(flat[is_finite])
        prepare(area)
        away = distance(boundary(area), xy)
        inside = np.full(is_finite.shape, np.nan)
        inside[is_finite] = np.where(contains(area, xy), away, -away)
        return inside


@dataclass(frozen=True, kw_only=True, eq=False)
class Extended:
    """The extended scene, and how many Gaussians came from where.

    The first `num_kept` are those of the scene beyond the margin, in their order and bit for bit.
    """

    splats: Splats
    num_kept: int
    num_replaced: int
    """Of the scene, gone: the new model shows their place."""
    num_filled: int
    """Of the scene, inside the region, kept where the new model is blind."""
    num_added: int
    """Of the new model, further inside than the margin, as they came."""
    num_fitted: int
    """Of either, within the margin."""
    num_shown: int
    """Views that the margin was fitted to; 0 where it was only cut."""


def extend_scene(scene: Splats, addition: Teacher, region: NewRegion, train: TrainConfig, join: Join, options: FitOptions) -> Extended:
    """`scene` with the new model `addition` in `region`, both in one frame; only what lies within
    the margin is fitted.

    Raises BadInput where the new model has nothing inside the region.
    """
    old_m, new_m = region.inside_m(scene.means), region.inside_m(addition.splats.means)
    if not (new_m > 0).any():
        raise BadInput(f"none of the {len(new_m)} new Gaussians lies in the region: check that both models are in one frame.")
    old_core = np.flatnonzero(old_m > region.margin_m)
    filled = old_core[_far_from(scene.select(old_core), addition.splats.means[new_m > 0])]
    outside = scene.select(old_m < -region.margin_m)
    added = addition.splats.select(new_m > region.margin_m)
    still = concatenate_splats([outside, scene.select(filled), added])
    # Order: the scene's own, what fills gaps, what is new, the margin.
    near = [(scene, np.abs(old_m) <= region.margin_m), (addition.splats, np.abs(new_m) <= region.margin_m)]
    margin = [model.select(within) for model, within in near]
    owns = [old_m[near[0][1]] <= 0, new_m[near[1][1]] > 0]
    views = _blend_views(scene, addition, region, train, options.backend) if any(map(len, margin)) else None
    if views is None:
        joined = concatenate_splats(margin).select(np.concatenate(owns))
    else:
        moving = fade(margin, _owners(owns), join.foreign_opacity)
        retrained = retrain(moving, views, train, join, options, frozen=still)
        joined = concatenate_splats([retrained.splats, moving.select(~retrained.reached & np.concatenate(owns))])
    return Extended(
        splats=concatenate_splats([still, joined]),
        num_kept=len(outside),
        num_replaced=len(old_core) - len(filled),
        num_filled=len(filled),
        num_added=len(added),
        num_fitted=len(joined),
        num_shown=0 if views is None else len(views),
    )


def _far_from(splats: Splats, means: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which Gaussians (N,) have none of `means` (M,3) m within `BLIND_FACTOR` times their size."""
    if not len(means):
        return np.ones(len(splats), bool)
    distances, _ = KDTree(means).query(splats.means)
    return distances > BLIND_FACTOR * np.exp(splats.log_scales.astype(np.float64).max(axis=1))


def _owners(owns: Sequence[NDArray[np.bool_]]) -> list[Ownership]:
    """Who owns the places of two models, all of them contested, given where each owns its own."""
    numbered = enumerate(owns)
    return [Ownership(owner=np.where(is_owned, index, 1 - index), contested=np.ones(len(is_owned), bool)) for index, is_owned in numbered]


def _blend_views(scene: Splats, addition: Teacher, region: NewRegion, train: TrainConfig, backend: Backend) -> TrainingViews | None:
    """What the new model's cameras should show of the margin: both models, blended over it; None
    where none of them sees it."""
    means = np.concatenate([scene.means, addition.splats.means])
    contested = np.abs(region.inside_m(means)) <= region.margin_m
    rows = np.flatnonzero(contested_shares(addition.cameras, means, contested) > TOUCHED_SHARE)
    if not len(rows):
        return None
    cameras = addition.cameras.select(rows).scaled(train.long_side_px)
    images, weights = [], []
    rendered = zip(render_views(scene, cameras, backend), render_views(addition.splats, cameras, backend), strict=True)
    for index, (old, new) in enumerate(rendered):
        places = ground_places(cameras, index, np.where(new.alpha >= OPAQUE, new.depth, old.depth))
        share = np.clip(region.inside_m(places) / region.margin_m / 2 + 0.5, 0, 1)
        share = np.where(np.isfinite(share), share**2 * (3 - 2 * share), 0)[..., None]
        images.append(((1 - share) * old.image + share * new.image).clip(0, 1))
        weights.append((1 - share[..., 0]) * old.alpha + share[..., 0] * new.alpha)
    return TrainingViews(cameras=cameras, images=tuple(map(_bytes, images)), weights=tuple(map(_bytes, weights)))


def _bytes(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    return (values * 255).round().astype(np.uint8)
