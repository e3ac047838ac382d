"""Which photographs are kept apart, from names alone, the same in every run. Once per scene.

held out:   what the set itself keeps in val/ (as Mill 19), else position 0, 8, 16, … by sorted
            name; used for scoring only.
validation: position 0, 8, 16, … of what remains, from 8 photographs on; used for choices inside
            training, never to score.
training:   the rest; a choice that was made by the validation part may then be trained on both.

All faces of a panorama (`panoramas.frame_of`) are one photograph here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.panoramas import frame_of


def held_out_mask(names: Sequence[str], every: int = 8, first: int = 0) -> NDArray[np.bool_]:
    """Mask (C,) of the first, ninth, … of `names` (C) in sorted order, whatever their own order.

    `first` from 1 to `every` − 1 begins that many later: `every` splits of one set hold each
    photograph out once (cross-validation). Where some names begin with "train/" and all others with
    "val/" the set brings its own split, and "val/" is held out. Raises BadInput when `every` is
    below 2, a name comes twice, or `first` is none of these or asked of a set with its own split.
    """
    everything = _every_nth(names, np.ones(len(names), bool), every, first)
    if not 0 <= first < every:
        raise BadInput(f"split {first} is asked for, expected 0 to {every - 1}: each begins with another of the first {every} photographs.")
    folders = [name.split("/")[0] for name in names]
    if set(folders) != {"train", "val"}:
        return everything
    if first:
        raise BadInput(f"split {first} is asked for, but this set has its own, train/ and val/: ask for one split.")
    return np.array([folder == "val" for folder in folders])


def validation_mask(names: Sequence[str], every: int = 8) -> NDArray[np.bool_]:
    """Mask (C,) of a whole set: the validation part of what `held_out_mask` leaves."""
    held_out = held_out_mask(names, every)
    training = np.flatnonzero(~held_out)
    mask = np.zeros(len(names), bool)
    mask[training] = training_validation_mask([names[int(index)] for index in training], every)
    return mask


def training_validation_mask(training_names: Sequence[str], every: int = 8) -> NDArray[np.bool_]:
    """Mask (C,) of the validation part of training photographs (C), none of them held out.

    The first, ninth, … in sorted order: ⌈C / every⌉ of them, or none where C < `every`. Raises as
    `held_out_mask`.
    """
    mask = _every_nth(training_names, np.ones(len(training_names), bool), every)
    num_frames = len({frame_of(name) for name in training_names})
    return mask if num_frames >= every else np.zeros(len(training_names), bool)


def _every_nth(names: Sequence[str], candidates: NDArray[np.bool_], every: int, first: int = 0) -> NDArray[np.bool_]:
    if every < 2:
        raise BadInput(f"every {every}. photograph is to be held out, expected 2 or more: nothing would be left to train on.")
    if len(set(names)) != len(names):
        raise BadInput("a photograph's name comes twice, so that the split is not determined: give every one its own name.")
    frames = [frame_of(name) for name in names]
    chosen = set(sorted({frame for frame, is_candidate in zip(frames, candidates, strict=True) if is_candidate})[first::every])
    return np.array([frame in chosen for frame in frames], bool) & candidates
