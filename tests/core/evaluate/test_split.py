"""Splits: fixed by names alone, never overlapping."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask, training_validation_mask, validation_mask

NAMES = [f"{index:03d}.jpg" for index in range(60)]


def chosen(names: list[str], mask: np.ndarray) -> set[str]:
    return {name for name, held in zip(names, mask, strict=True) if held}


def test_the_first_and_every_eighth_after_it_are_held_out() -> None:
    assert chosen(NAMES, held_out_mask(NAMES)) == set(NAMES[::8])


def test_the_splits_of_a_set_hold_each_photograph_out_once() -> None:
    splits = [held_out_mask(NAMES, first=first) for first in range(8)]
    assert (np.sum(splits, axis=0) == 1).all()
    assert chosen(NAMES, splits[3]) == set(NAMES[3::8]) and (splits[0] == held_out_mask(NAMES)).all()


def test_a_split_that_there_is_not_is_refused() -> None:
    for first in (-1, 8):
        with pytest.raises(BadInput, match="expected 0 to 7"):
            held_out_mask(NAMES, first=first)
    with pytest.raises(BadInput, match="this set has its own"):
        held_out_mask(["train/a.jpg", "train/b.jpg", "val/c.jpg"], first=1)


def test_held_out_and_validation_are_disjoint_and_leave_the_rest() -> None:
    held, validation = held_out_mask(NAMES), validation_mask(NAMES)
    assert not (held & validation).any()
    assert validation.sum() == 7  # 52 training photographs: ⌈52/8⌉
    assert (~held & ~validation).sum() == 45


@pytest.mark.parametrize("mask_of", [held_out_mask, validation_mask, training_validation_mask])
@pytest.mark.parametrize("every", [2, 3, 8])
def test_the_order_of_the_list_does_not_matter(mask_of, every: int) -> None:
    shuffled = list(np.random.default_rng(0).permutation(NAMES))
    assert chosen(shuffled, mask_of(shuffled, every)) == chosen(NAMES, mask_of(NAMES, every))


def test_a_set_with_a_split_of_its_own_keeps_it() -> None:
    names = [f"val/rgbs/{name}" if index in (3, 17) else f"train/rgbs/{name}" for index, name in enumerate(NAMES)]
    held, validation = held_out_mask(names), validation_mask(names)
    assert np.flatnonzero(held).tolist() == [3, 17]
    # 58 training photographs: ⌈58/8⌉.
    assert not (held & validation).any() and validation.sum() == 8
    only_train = [name for name in names if name.startswith("train/")]
    assert held_out_mask(only_train).sum() == 8


@pytest.mark.parametrize("count", [0, 1, 2])
def test_small_sets_work(count: int) -> None:
    assert held_out_mask(NAMES[:count]).tolist() == [True, False][:count]
    assert not validation_mask(NAMES[:count]).any()


@pytest.mark.parametrize(("count", "expected"), [(0, 0), (1, 0), (7, 0), (8, 1), (9, 2), (16, 2), (17, 3), (60, 8)])
def test_a_trainer_that_sees_no_held_out_names_gets_a_validation_part(count: int, expected: int) -> None:
    mask = training_validation_mask(NAMES[:count])
    assert mask.sum() == expected and mask.shape == (count,)
    assert chosen(NAMES[:count], mask) <= set(NAMES[:count:8])


def test_both_ways_to_the_validation_part_agree() -> None:
    shuffled = list(np.random.default_rng(1).permutation(NAMES))
    training = [name for name, held in zip(shuffled, held_out_mask(shuffled), strict=True) if not held]
    assert chosen(training, training_validation_mask(training)) == chosen(shuffled, validation_mask(shuffled))
    assert not chosen(shuffled, validation_mask(shuffled)) & chosen(shuffled, held_out_mask(shuffled))


def test_nothing_to_train_on_and_names_that_come_twice_are_refused() -> None:
    with pytest.raises(BadInput, match="nothing would be left"):
        held_out_mask(NAMES, every=1)
    with pytest.raises(BadInput, match="comes twice"):
        held_out_mask(["a", "a"])
    with pytest.raises(BadInput, match="comes twice"):
        training_validation_mask(["a", "a"])
