"""Averages of refinements: the weighted mean Gaussian by Gaussian, associative, refused where they do not fit."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate import averaging
from radiant_core.aggregate.averaging import (
    Refinement,
    admit_refinement,
    average_refinements,
    join_refinements,
    limit_changes,
    refine_scene,
    refinement_problem,
    start_of_next_round,
)
from radiant_core.errors import BadInput
from radiant_core.evaluate.shown_pixels import count_shown_photographs
from radiant_core.hierarchy.codec import passed_refinement
from tests.core.scenes import cameras_above, ground_splats

SCENE = ground_splats(200)


def refined(rows: list[int], brighter: float, weight: float = 1.0) -> Refinement:
    """Some of the scene's Gaussians, brighter."""
    chosen = np.array(rows, np.int64)
    part = SCENE.select(chosen)
    return Refinement(rows=chosen, splats=replace(part, sh0=part.sh0 + brighter), weights=np.full(len(rows), weight, np.float32))


def test_the_mean_is_weighted_per_gaussian_and_the_rest_keeps_its_bits() -> None:
    mean = average_refinements([refined([1, 5, 9], 0.4, 1.0), refined([5, 7], 0.1, 3.0)], SCENE)
    assert mean.rows.tolist() == [1, 5, 7, 9] and mean.weights.tolist() == [1, 4, 3, 1]
    made = refine_scene(SCENE, [mean])
    change = (made.sh0 - SCENE.sh0)[:, 0, 0]
    np.testing.assert_allclose(change[[1, 5, 7, 9]], [0.4, (0.4 + 3 * 0.1) / 4, 0.1, 0.4], atol=1e-6)
    others = np.setdiff1d(np.arange(len(SCENE)), [1, 5, 7, 9])
    for name, array in SCENE.select(others).arrays().items():
        np.testing.assert_array_equal(made.select(others).arrays()[name], array)


def test_the_next_round_starts_beyond_the_mean() -> None:
    made = refine_scene(SCENE, [refined([1, 5], 0.4)])
    start = start_of_next_round(SCENE, made)
    np.testing.assert_allclose((start.sh0 - SCENE.sh0)[[1, 5], 0, 0], 0.4 * averaging.SERVER_RATE, atol=1e-6)
    others = np.setdiff1d(np.arange(len(SCENE)), [1, 5])
    for name, array in SCENE.select(others).arrays().items():
        np.testing.assert_array_equal(start.select(others).arrays()[name], array)


def test_what_nobody_refines_in_a_round_is_the_mean_of_the_one_before() -> None:
    first = refine_scene(SCENE, [refined([1, 5], 0.4)])
    start = start_of_next_round(SCENE, first)
    part = start.select(np.array([5]))
    second = Refinement(rows=np.array([5]), splats=replace(part, sh0=part.sh0 - 0.1), weights=np.ones(1, np.float32))
    change = (refine_scene(start, [second], first).sh0 - SCENE.sh0)[:, 0, 0]
    np.testing.assert_allclose(change[[1, 5, 7]], [0.4, 0.4 * averaging.SERVER_RATE - 0.1, 0.0], atol=1e-6)
    nothing = refine_scene(start, [], first)
    assert all((nothing.arrays()[name] == array).all() for name, array in first.arrays().items())


@pytest.mark.parametrize(("name", "limit"), [("means", 1e6), ("sh0", 50.0), ("log_scales", 12.0)])
def test_what_is_made_of_the_next_start_can_be_sent(name: str, limit: float) -> None:
    edge = replace(SCENE, **{name: np.full_like(SCENE.arrays()[name], np.float32(0.999 * limit))})
    made = replace(edge, **{name: np.full_like(SCENE.arrays()[name], np.float32(limit))})
    start = start_of_next_round(edge, made)
    whole = Refinement(rows=np.arange(len(start)), splats=start, weights=np.full(len(start), 1e-3, np.float32))
    assert refinement_problem(whole, start) is None


def test_the_next_round_of_huge_values_is_finite() -> None:
    huge = np.float32(3e38)
    far, moved = (replace(SCENE, means=np.full_like(SCENE.means, sign * huge)) for sign in (-1, 1))
    assert np.isfinite(start_of_next_round(far, moved).means).all() and (start_of_next_round(far, moved).means > 0).all()


def test_means_of_means_are_the_mean_of_all() -> None:
    rng = np.random.default_rng(0)
    parts = [
        refined(sorted(rng.choice(len(SCENE), 60, replace=False).tolist()), float(rng.normal()), float(rng.uniform(0.5, 20)))
        for _ in range(5)
    ]
    whole = average_refinements(parts, SCENE)
    by_edge = average_refinements([average_refinements(parts[:2], SCENE), average_refinements(parts[2:], SCENE)], SCENE)
    assert whole.rows.tolist() == by_edge.rows.tolist()
    for name, array in whole.splats.arrays().items():
        np.testing.assert_allclose(by_edge.splats.arrays()[name], array, atol=2e-6)


def test_nothing_refined_is_the_scene_itself() -> None:
    nothing = refined([], 0.0)
    for mean in (average_refinements([], SCENE), average_refinements([nothing], SCENE)):
        assert not len(mean.rows)
        made = refine_scene(SCENE, [mean])
        assert all((made.arrays()[name] == array).all() for name, array in SCENE.arrays().items())


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        (refined([], 0.0), None),
        (replace(refined([3], 0.0), rows=np.array([len(SCENE)])), "names Gaussian 200 of a scene of 200"),
        (replace(refined([3], 0.0), splats=replace(SCENE.select([3]), sh0=SCENE.select([3]).sh0 + 1e6)), "a value of its sh0"),
        (replace(refined([3], 0.0), splats=replace(SCENE.select([3]), shN=np.zeros((1, 15, 3), np.float32))), "harmonics of degree 3"),
    ],
)
def test_what_does_not_fit_to_the_scene_is_refused_in_a_sentence(wrong: Refinement, problem: str | None) -> None:
    found = refinement_problem(wrong, SCENE)
    assert (found is None) if problem is None else (found is not None and problem in found)
    if problem is not None:
        with pytest.raises(BadInput):
            average_refinements([wrong], SCENE)


def test_a_sender_changes_only_what_its_cameras_show_weighted_by_how_much_they_show_of_it() -> None:
    """Whatever weights it sends: the near camera outweighs the far one by the pixels of each, and neither is heard of what it misses."""
    near, far = (cameras_above([(0.0, 0.0)], height_m=height_m, size_wh=(64, 48)) for height_m in (3.0, 30.0))
    everything = list(range(len(SCENE)))
    shown = [count_shown_photographs(SCENE, cameras, "native") for cameras in (near, far)]
    sent = zip((refined(everything, 0.1, 1e6), refined(everything, -0.1, 1e6)), shown, strict=True)
    own, other = (admit_refinement(each, SCENE, seen) for each, seen in sent)
    assert 0 < len(own.rows) < len(other.rows) and 0 < own.weights.max() < 1
    assert own.rows.tolist() == np.flatnonzero(shown[0]).tolist()
    both = np.flatnonzero((shown[0] > 20 * shown[1]) & (shown[1] > 0))
    change = (refine_scene(SCENE, [own, other]).sh0 - SCENE.sh0)[:, 0, 0]
    assert len(both) > 5 and (change[both] > 0.085).all(), "the far camera shows a twentieth of it"
    unseen = np.setdiff1d(other.rows, own.rows)
    np.testing.assert_allclose(change[unseen], -0.1, atol=1e-6)


def test_changes_beyond_what_refining_does_count_in_no_direction() -> None:
    everything = np.arange(len(SCENE))
    for name, most in averaging.MAX_CHANGES.items():
        for sign in (-1, 1):
            changed = SCENE.arrays()[name].copy()
            changed[3:5] += np.float32(sign * 1.01 * most)
            changed[7:9] += np.float32(sign * 0.99 * most)
            hostile = Refinement(rows=everything, splats=replace(SCENE, **{name: changed}), weights=np.ones(len(SCENE), np.float32))
            lost = {3, 4} if changed.size else set()
            assert set(everything) - set(admit_refinement(hostile, SCENE).rows.tolist()) == lost, (name, sign)
    sizes = np.exp(SCENE.log_scales.max(axis=1))
    means, quats = SCENE.means.copy(), SCENE.quats.copy()
    means[3, 0] += 1.01 * averaging.MAX_MOVE * sizes[3]
    means[5, 1] += 0.99 * averaging.MAX_MOVE * sizes[5]
    quats[7:9] = averaging._turned_by(SCENE.quats[7:9], SCENE.quats[7:9, [1, 0, 3, 2]] * [-1, 1, -1, 1], averaging.MAX_TURN_DEG + 1)
    quats[9:11] = averaging._turned_by(SCENE.quats[9:11], SCENE.quats[9:11, [1, 0, 3, 2]] * [-1, 1, -1, 1], averaging.MAX_TURN_DEG - 1)
    quats[11] *= -3
    hostile = Refinement(rows=everything, splats=replace(SCENE, means=means, quats=quats), weights=np.ones(len(SCENE), np.float32))
    assert set(everything) - set(admit_refinement(hostile, SCENE).rows.tolist()) == {3, 7, 8}


@pytest.mark.parametrize("amount", [0.0, 1e-3, 0.1, 30.0])
def test_what_a_device_limits_is_admitted_whole_and_what_is_within_keeps_its_bits(amount: float) -> None:
    rng = np.random.default_rng(3)
    changed = {name: (array + amount * rng.normal(size=array.shape)).astype(np.float32) for name, array in SCENE.arrays().items()}
    fitted = replace(SCENE, **changed)
    limited = limit_changes(SCENE, fitted)
    everything = Refinement(rows=np.arange(len(SCENE)), splats=limited, weights=np.ones(len(SCENE), np.float32))
    arrived = passed_refinement(everything, "float16", SCENE)
    assert not isinstance(arrived, str) and len(admit_refinement(arrived, SCENE).rows) == len(SCENE)
    near = admit_refinement(replace(everything, splats=fitted), SCENE).rows
    assert len(near) == (len(SCENE) if amount <= 1e-3 else 0 if amount > 1 else len(near))
    inner = np.setdiff1d(near, np.flatnonzero([(limited.quats != fitted.quats).any(axis=1)][0]))
    for name, array in limited.select(inner).arrays().items():
        np.testing.assert_allclose(array, fitted.select(inner).arrays()[name], atol=0.04)
    if amount <= 1e-3:
        for name, array in limited.arrays().items():
            np.testing.assert_array_equal(array, fitted.arrays()[name])


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "logit_opacities", "sh0"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -3e38])
def test_no_poisoned_number_reaches_a_scene(name: str, value: float) -> None:
    """Refused where it is read, or not admitted: no value of the refined scene is another than without it."""
    array = SCENE.arrays()[name].copy()
    array.reshape(len(array), -1)[5, 0] = value
    if not np.isfinite(value):
        with pytest.raises(BadInput, match=name):
            replace(SCENE, **{name: array})
        return
    weights = np.full(len(SCENE), 9, np.float32)
    hostile = Refinement(rows=np.arange(len(SCENE)), splats=replace(SCENE, **{name: array}), weights=weights)
    with np.errstate(over="ignore", invalid="ignore"):
        if refinement_problem(hostile, SCENE) is None:
            for key, values in refine_scene(SCENE, [admit_refinement(hostile, SCENE)]).arrays().items():
                np.testing.assert_allclose(values, SCENE.arrays()[key], rtol=1e-6)


def test_many_refinements_are_held_one_at_a_time() -> None:
    """The mean of an iterator equals the float64 mean of all, and no refinement outlives the next one."""
    rng, alive, made = np.random.default_rng(1), [], []

    def arriving() -> Iterator[Refinement]:
        for _ in range(12):
            assert sum(one() is not None for one in alive) <= 1
            chosen = np.flatnonzero(rng.random(len(SCENE)) < 0.5)
            part = SCENE.select(chosen)
            noise = rng.normal(0, 0.1, part.sh0.shape).astype(np.float32)
            one = Refinement(
                rows=chosen, splats=replace(part, sh0=part.sh0 + noise), weights=rng.integers(1, 30, len(chosen)).astype(np.float32)
            )
            made.append((chosen, one.splats.sh0.astype(np.float64), one.weights.astype(np.float64)))
            alive.append(weakref.ref(one))
            yield one
            del one

    refined_scene = refine_scene(SCENE, arriving())
    sums, total = np.zeros(SCENE.sh0.shape), np.zeros(len(SCENE))
    for rows, values, weights in made:
        sums[rows] += values * weights[:, None, None]
        total[rows] += weights
    sent = total > 0
    np.testing.assert_allclose(refined_scene.sh0[sent], (sums[sent] / total[sent, None, None]), atol=1e-6)
    np.testing.assert_array_equal(refined_scene.sh0[~sent], SCENE.sh0[~sent])


def test_an_edge_tells_powers_of_four_and_opposite_quaternions_are_one_rotation() -> None:
    joined = join_refinements([refined([1, 5], 0.1, 3.0), refined([5], 0.1, 3.0)], SCENE)
    assert joined.weights.tolist() == [1, 4]
    small = join_refinements([refined([1, 5], 0.1, 3e-7), refined([5], 0.1, 4.0**-6)], SCENE)
    assert small.weights.tolist() == [4.0**-11, 4.0**-6]
    turned = replace(refined([5], 0.0), splats=replace(SCENE.select([5]), quats=-SCENE.select([5]).quats))
    np.testing.assert_allclose(average_refinements([refined([5], 0.0), turned], SCENE).splats.quats, SCENE.select([5]).quats, atol=1e-6)


def test_no_sender_outweighs_the_others_by_counting_more_photographs_than_it_has() -> None:
    assert refinement_problem(refined([3, 5], 0.1, 6.0), SCENE, num_dealt=12) is None
    for weight in (6.1, 1e30):
        found = refinement_problem(refined([3, 5], 0.1, weight), SCENE, num_dealt=12)
        assert found is not None and "where 12 were dealt to it" in found
    # Honest ones: a photograph is filled once at most.
    cameras = cameras_above([(0.0, 0.0), (1.0, 0.0)], height_m=3.0, size_wh=(64, 48))
    assert 1 < count_shown_photographs(SCENE, cameras, "native").sum() <= 2


def test_rows_that_wrap_around_are_refused() -> None:
    five = SCENE.select([0, 1, 2, 3, 4])
    with pytest.raises(BadInput):
        Refinement(rows=np.array([5, 2**63 - 1, -(2**63), -1, 3]), splats=five, weights=np.ones(5, np.float32))


@pytest.mark.parametrize(
    ("rows", "weights"),
    [([3, 3], [1, 1]), ([5, 3], [1, 1]), ([-1, 3], [1, 1]), ([3, 5], [1, 0]), ([3, 5], [1, np.nan]), ([3], [1, 1]), ([3, 5], [1])],
)
def test_rows_and_weights_are_checked(rows: list[int], weights: list[float]) -> None:
    with pytest.raises(BadInput):
        Refinement(rows=np.array(rows, np.int64), splats=SCENE.select([3, 5]), weights=np.array(weights, np.float32))
