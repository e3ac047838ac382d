"""Masks cancel to the bit in the sum, and one message alone is noise."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_core.errors import BadInput
from radiant_core.plan.together.costs import TogetherLaw
from radiant_core.render.rendered_view import render_views
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.results import TrainResult
from radiant_core.train.together.codec import encode_gradients, encode_limits
from radiant_core.train.together.fold import GroupCost, GroupMembers, fit_in_process
from radiant_core.train.together.gradients import StepGradients, sum_gradients
from radiant_core.train.together.masking import (
    FixedPoint,
    MaskKeys,
    check_sum,
    encode_masked,
    first_magnitudes,
    next_magnitudes,
    sum_masked,
    unmask_sum,
)
from radiant_core.train.together.replica import Group, Replica, Share
from radiant_core.train.together.roles import Holder
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats
from tests.core.train.together.test_scrutiny import LAYOUT, NUM_SPLATS, step_of

CONFIG = TrainConfig(density=NoDensification(), long_side_px=128)
COLUMNS = LAYOUT.num_columns
HEAD_BYTES = 24 + 2 * COLUMNS
NUM_COLUMNS_OF_GROUND = 3 + 4 + 3 + 1 + 3 + 0 + 1
HEAD_BYTES_OF_GROUND = 24 + 2 * NUM_COLUMNS_OF_GROUND


def keys_of(names: list[str], run_id: str = "run") -> dict[str, MaskKeys]:
    privates = {name: X25519PrivateKey.from_private_bytes(name.encode().ljust(32, b"\1")) for name in names}
    publics = {name: private.public_key().public_bytes_raw() for name, private in privates.items()}
    return {name: MaskKeys.agree(name, private, publics, run_id) for name, private in privates.items()}


def units(sent: dict[str, StepGradients]) -> FixedPoint:
    total = sum_gradients(list(sent.values()), NUM_SPLATS, LAYOUT)
    return FixedPoint.of(next_magnitudes(first_magnitudes(LAYOUT), total, LAYOUT), len(sent))


def test_both_of_a_pair_have_one_key_and_others_another() -> None:
    keys = keys_of(["d0", "d1", "d2"])
    assert keys["d0"].pairs["d1"] == keys["d1"].pairs["d0"]
    assert len({key for each in keys.values() for key in each.pairs.values()}) == 3
    assert keys_of(["d0", "d1"], "another run")["d0"].pairs["d1"] != keys["d0"].pairs["d1"]


@pytest.mark.parametrize("num_senders", [2, 3, 6])
def test_the_masked_sum_is_that_of_the_numbers_in_any_order(num_senders: int) -> None:
    sent = step_of(num_senders, 4)
    keys, unit = keys_of(list(sent)), units(sent)
    plain = np.zeros(NUM_SPLATS * (COLUMNS + 1) + 2, np.int64)
    for each in sent.values():
        plain += unit.quantise(each, NUM_SPLATS, num_senders)
    messages = {name: encode_masked(each, 4, NUM_SPLATS, unit, keys[name]) for name, each in sent.items()}
    for order in list(permutations(messages))[:8]:
        masked, same = sum_masked([messages[name] for name in order], 4, NUM_SPLATS, COLUMNS)
        np.testing.assert_array_equal(same.exponents, unit.exponents)
        np.testing.assert_array_equal(masked.view(np.int32), plain)


def test_the_sum_is_that_of_the_gradients_but_for_rounding() -> None:
    sent = step_of(4, 2)
    keys, unit = keys_of(list(sent)), units(sent)
    messages = {name: encode_masked(each, 2, NUM_SPLATS, unit, keys[name]) for name, each in sent.items()}
    total = unmask_sum(messages, list(sent), 2, NUM_SPLATS, LAYOUT)
    exact = sum_gradients(list(sent.values()), NUM_SPLATS, LAYOUT)
    np.testing.assert_array_equal(total.rows, exact.rows)
    np.testing.assert_array_equal(total.view_counts, exact.view_counts)
    assert total.num_views == 4
    assert total.loss == pytest.approx(exact.loss, abs=4e-6)
    # Each of four is rounded by half a unit, and a float32 sum by some of its own.
    error = np.abs(total.values - exact.values).max(axis=0)
    assert (error <= 2 * np.ldexp(1.0, unit.exponents) + 1e-6 * np.abs(exact.values).max(axis=0)).all()
    assert check_sum(total, 4, CONFIG, LAYOUT) is None


@pytest.mark.parametrize("seed", range(3))
def test_one_message_alone_is_uniform(seed: int) -> None:
    sent = step_of(3, seed)
    keys, unit = keys_of(list(sent), str(seed)), units(sent)
    numbers = np.frombuffer(encode_masked(sent["d1"], seed, NUM_SPLATS, unit, keys["d1"])[HEAD_BYTES:], np.uint8)
    counts = np.bincount(numbers, minlength=256)
    expected = len(numbers) / 256
    chi_square = float(((counts - expected) ** 2 / expected).sum())
    assert 160 < chi_square < 370  # 255 degrees of freedom: outside of this in 1 of 100,000
    plain = unit.quantise(sent["d1"], NUM_SPLATS, 3).view(np.uint8)
    assert Counter(plain.tolist())[0] > 2 * expected
    # Of a column that is mostly 0 and of one message in two steps nothing is in common.
    again = np.frombuffer(encode_masked(sent["d1"], seed + 1, NUM_SPLATS, unit, keys["d1"])[HEAD_BYTES:], np.uint8)
    assert abs(np.corrcoef(numbers, again)[0, 1]) < 5 / np.sqrt(len(numbers))


def test_the_plans_law_knows_how_long_a_masked_message_is() -> None:
    sent = step_of(2, 4)
    message = encode_masked(sent["d0"], 4, NUM_SPLATS, units(sent), keys_of(list(sent))["d0"])
    law = TogetherLaw(views_per_photograph=1.0, steps_of=float, num_floats=COLUMNS - 1, splat_bytes=1.0, masked=True)
    assert len(message) - HEAD_BYTES - 8 == law.sent_bytes(NUM_SPLATS, 1, 50) > replace(law, masked=False).sent_bytes(NUM_SPLATS, 1, 50)


def test_a_missing_sender_takes_the_step_with_it() -> None:
    sent = step_of(3, 0)
    keys, unit = keys_of(list(sent)), units(sent)
    messages = {name: encode_masked(each, 0, NUM_SPLATS, unit, keys[name]) for name, each in sent.items() if name != "d1"}
    with pytest.raises(BadInput, match="nothing of d1 came"):
        unmask_sum(messages, list(sent), 0, NUM_SPLATS, LAYOUT)
    # With the sum of the two of the same step, a late message of d1 would be open.
    others = {name: keys[name].without("d1") for name in ("d0", "d2")}
    with pytest.raises(BadInput, match="d0 has masked step 1 already"):
        encode_masked(sent["d0"], 0, NUM_SPLATS, unit, others["d0"])
    after = {name: encode_masked(sent[name], 1, NUM_SPLATS, unit, others[name]) for name in others}
    assert unmask_sum(after, list(others), 1, NUM_SPLATS, LAYOUT).num_views == 2
    with pytest.raises(BadInput, match="would travel open"):
        others["d0"].without("d2").mask(2, 1)


def test_values_beyond_the_head_room_are_cut_and_do_not_overflow() -> None:
    sent = step_of(4, 1)
    unit, keys = units(sent), keys_of(list(sent))
    large = {name: replace(each, values=np.float32(1e9) * np.abs(each.values)) for name, each in sent.items()}
    messages = {name: encode_masked(each, 1, NUM_SPLATS, unit, keys[name]) for name, each in large.items()}
    total = unmask_sum(messages, list(sent), 1, NUM_SPLATS, LAYOUT)
    assert (total.values >= 0).all()
    assert (total.values[:, 0] <= np.ldexp(1.0, 31 + unit.exponents[0])).all()


@pytest.mark.parametrize(("change", "words"), [((1, 0), "are of step 5 and 2000 Gaussians, expected step 4"), ((0, 1), "bytes")])
def test_messages_of_another_step_or_model_are_refused(change: tuple[int, int], words: str) -> None:
    sent = step_of(2, 5)
    unit, keys = units(sent), keys_of(list(sent))
    messages = [encode_masked(each, 5, NUM_SPLATS, unit, keys[name]) for name, each in sent.items()]
    with pytest.raises(BadInput, match=words):
        sum_masked(messages, 5 - change[0], NUM_SPLATS - change[1], COLUMNS)


def test_keys_and_radii_that_do_not_fit_are_refused() -> None:
    with pytest.raises(BadInput, match="d1 sends no X25519 key"):
        MaskKeys.agree("d0", X25519PrivateKey.generate(), {"d1": b"short"}, "run")
    sent = step_of(2, 0)["d0"]
    with pytest.raises(BadInput, match="radii on screen"):
        encode_masked(
            replace(sent, radii_px=np.ones(len(sent.rows), np.float32)), 0, NUM_SPLATS, units(step_of(2, 0)), keys_of(["d0", "d1"])["d0"]
        )


def test_a_sum_that_no_views_cause_counts_for_nothing() -> None:
    total = sum_gradients(list(step_of(3, 0).values()), NUM_SPLATS, LAYOUT)
    assert "expected 1 to 2" in str(check_sum(total, 2, CONFIG, LAYOUT))
    assert "longer than photographs cause" in str(check_sum(replace(total, values=np.float32(1e6) * total.values), 3, CONFIG, LAYOUT))


def masked_group(*, masked: bool, relays: bool) -> tuple[TrainResult, GroupCost]:
    """Four devices of two edges train on bumpy ground for six steps, in fixed point or float32."""
    truth, cameras = ground_splats(200), cameras_above([(x, y) for x in (-1.5, 1.5) for y in (-1.0, 1.0)])
    images = tuple(np.uint8(255 * np.clip(view.image, 0, 1)) for view in render_views(truth, cameras))
    views = TrainingViews(cameras=cameras, images=images)
    config = TrainConfig(num_steps=24, density=NoDensification(), long_side_px=48)
    group = Group(config=config, num_photographs=4, views_per_step=4, extent=4.0, overlaps=True, form="float32", masked=masked)
    edges = {"e0": ["d0", "d1"], "e1": ["d2", "d3"]}
    sums = list(edges.values()) if relays else [["d0", "d1", "d2", "d3"]]
    keys = {name: each for names in sums for name, each in keys_of(names).items()} if masked else {}
    start = replace(truth, sh0=np.zeros_like(truth.sh0))
    holders = {}
    for number in range(4):
        share = Share(views=views.select([number]), num_views=1, first=number)
        name = f"d{number}"
        holders[name] = Holder(Replica(start, group, FitOptions(backend="native"), share), group, keys.get(name))
    members = GroupMembers(holders=holders, edges={edge: dict.fromkeys(names, 1) for edge, names in edges.items()}, has_relays=relays)
    return fit_in_process(start, group, members, cameras.centers, FitOptions(backend="native"))


@pytest.mark.parametrize("relays", [False, True])
def test_a_group_trains_under_masks_as_without(relays: bool) -> None:
    plain, _ = masked_group(masked=False, relays=relays)
    under, cost = masked_group(masked=True, relays=relays)
    again, _ = masked_group(masked=True, relays=relays)
    for name, array in under.splats.arrays().items():
        np.testing.assert_array_equal(array, again.splats.arrays()[name])
    # Adam's first steps are of one length by sign alone, so that rounding shows where a gradient is near 0.
    away = np.abs(under.splats.sh0 - plain.splats.sh0)
    assert np.median(away) < 1e-4
    assert np.median(np.abs(plain.splats.sh0)) > 0.02
    assert cost.bytes_up["d0"][0] == HEAD_BYTES_OF_GROUND + 4 * (200 * (NUM_COLUMNS_OF_GROUND + 1) + 2)


def test_a_masked_group_needs_keys() -> None:
    truth = ground_splats(20)
    group = Group(config=CONFIG, num_photographs=1, views_per_step=1, extent=1.0, masked=True)
    with pytest.raises(BadInput, match="needs keys"):
        Holder(Replica(truth, group, FitOptions(backend="native")), group)


def test_holders_of_sums_of_other_sizes_have_units_of_their_own_where_one_takes_the_step_for_all() -> None:
    truth = ground_splats(20)
    group = Group(config=CONFIG, num_photographs=5, views_per_step=5, extent=1.0, masked=True)
    keys = {**keys_of(["d0", "d1"]), **keys_of(["d2", "d3", "d4"])}
    holders = {name: Holder(Replica(truth, group, FitOptions(backend="native")), group, each) for name, each in keys.items()}
    layout = holders["d0"].replica.layout
    values = np.full((1, layout.num_columns), 0.5, np.float32)
    total = StepGradients(num_views=5, loss=0.1, rows=np.array([3]), values=values, view_counts=np.array([2], np.uint16))
    holders["d0"].take(encode_limits(None, 0, len(truth)) + encode_gradients(total, 0, len(truth), layout, "float32"))
    for name in ("d1", "d2"):
        holders[name].follow(holders["d0"])
    of_two, of_three = (holders[name].unit_of(keys[name]).exponents for name in ("d1", "d2"))
    assert (of_three - of_two == 1).all()
