"""What an edge does that leaves joining to the cloud: it pools models and pictures. Once per edge.

Two tiers that both retrain lose: the cloud learns from an edge's model that itself only learnt from
pictures. With the devices' pictures and all steps at the cloud the same work gives 0.2 to 0.5 dB
more (docs/experiments/aggregation.md). It costs the pictures' way up, and no Gaussian more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.ownership import Claims, ownership
from radiant_core.aggregate.retrain import Joined, faded, untrained, without_faint
from radiant_core.aggregate.synthetic_views import Teacher, ViewBytes, views_in_bytes
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.render.contract import Backend


def pool_teachers(teachers: Sequence[Teacher], aggregate: AggregateConfig, claims: Claims | None = None) -> Joined:
    """All teachers' models as one, faded where another owns the place; nothing is retrained."""
    if not teachers:
        raise BadInput("no models to pool: give at least one, with the cameras it is asked at.")
    models, cameras = [teacher.splats for teacher in teachers], [teacher.cameras for teacher in teachers]
    owned = [ownership(model.means, cameras, claims) for model in models]
    contested = np.concatenate([places.contested for places in owned])
    whole = faded(*without_faint(models, owned, aggregate), aggregate.foreign_opacity)
    num_views = len(concatenate_cameras(cameras))
    return Joined(
        trained=untrained(whole),
        num_given=sum(len(model) for model in models),
        num_views=num_views,
        contested_share=float(contested.mean()) if len(contested) else 0.0,
    )


def render_pictures(
    teachers: Sequence[Teacher], virtual: Cameras, near: NDArray[np.int64], long_side_px: int, backend: Backend = "auto"
) -> dict[int, ViewBytes]:
    """Each virtual camera's picture and weight, reduced to `long_side_px`, of the teacher near
    whose camera it stands: `near` (C,), rows into all teachers' cameras; else BadInput."""
    ends = np.cumsum([len(teacher.cameras) for teacher in teachers])
    if len(near) != len(virtual) or (len(near) and not (near.min() >= 0 and near.max() < ends[-1])):
        raise BadInput(f"{len(virtual)} virtual cameras stand near rows {near.tolist()} of {ends[-1] if len(ends) else 0} cameras.")
    teacher_of = np.searchsorted(ends, near, side="right")
    pictures: dict[int, ViewBytes] = {}
    for index, teacher in enumerate(teachers):
        rows = np.flatnonzero(teacher_of == index)
        shown = views_in_bytes(teacher.splats, virtual.select(rows).scaled(long_side_px), backend)
        pictures |= dict(zip(rows.tolist(), shown, strict=True))
    return pictures
