"""Crop-merge: of each model what lies in its own region (paper Sec. III-D). Once per merge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats, concatenate_splats


def crop_merge(models: Sequence[Splats], sites: FloatArray, weights: FloatArray) -> Splats:
    """Merge M models: x belongs to argmin ‖x − s‖² − w, `sites` s (M,2) m, `weights` w (M,) m².

    Every place has exactly one owner. BadInput when the counts differ or there is no model.
    """
    if not models:
        raise BadInput("no models to merge: pass at least one.")
    sites = check_array("sites", sites, (len(models), 2))
    weights = check_array("weights", weights, (len(models),))
    parts = []
    for index, model in enumerate(models):
        positions = model.means[:, None, :2].astype(np.float64)
        parts.append(model.select(np.argmin(((positions - sites) ** 2).sum(-1) - weights, axis=1) == index))
    return concatenate_splats(parts)
