"""Which photographs are kept apart. Computed once per scene, from names alone, so that it is the same in every run.

held out: what the set itself keeps in val/ (Mill 19 does), else position 0, 8, 16, … by sorted name; used for scoring only.
validation: position 0, 8, 16, … of what remains, used for choices inside training.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput


def held_out_mask(names: Sequence[str], every: int = 8) -> NDArray[np.bool_]:
    """Mask (C,) of the first, ninth, … of `names` (C) in sorted order; it moves with the names when they are reordered.

    Where some names begin with "train/" and all others with "val/" the set brings its own split, and "val/" is held out.
    Raises BadInput when `every` is below 2 (nothing would be left to train on) or a name comes twice.
    """
    everything = _every_nth(names, np.ones(len(names), bool), every)
    folders = [name.split("/")[0] for name in names]
    return np.array([folder == "val" for folder in folders]) if set(folders) == {"train", "val"} else everything


def validation_mask(names: Sequence[str], every: int = 8) -> NDArray[np.bool_]:
    """Mask (C,) of every eighth of the training photographs, those that `held_out_mask` leaves; raises as it."""
    return _every_nth(names, ~held_out_mask(names, every), every)


def _every_nth(names: Sequence[str], candidates: NDArray[np.bool_], every: int) -> NDArray[np.bool_]:
    if every < 2:
        raise BadInput(f"every {every}. photograph is to be held out, expected 2 or more: nothing would be left to train on.")
    if len(set(names)) != len(names):
        raise BadInput("a photograph's name comes twice, so that the split is not determined: give every one its own name.")
    ordered = sorted((index for index in range(len(names)) if candidates[index]), key=names.__getitem__)
    mask = np.zeros(len(names), bool)
    mask[ordered[::every]] = True
    return mask
