"""Quick matching: exact products on every instruction set, mutual matches, partners of a preview."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from radiant_core._native import compare_descriptors
from radiant_core.errors import BadInput
from radiant_core.sfm.quick.descriptors import MAX_ANGLE_RAD, MAX_RATIO, NORM, match_descriptors, root_descriptors
from radiant_core.sfm.quick.partners import LEAST_SCORE, choose_partners


def available() -> list[str]:
    one = np.zeros((1, 128), np.uint8)
    sets = []
    for name in ("portable", "avx2", "avx512", "avx512vnni"):
        try:
            compare_descriptors(one, one, name)
        except ValueError:
            continue
        sets.append(name)
    return sets


def drawn(count: int, seed: int) -> NDArray[np.uint8]:
    """Descriptors as RootSIFT makes them, with equal and extreme rows among them."""
    rng = np.random.default_rng(seed)
    rows = root_descriptors(rng.gamma(0.4, 1.0, (count, 128)).astype(np.float32))
    rows[rng.random(count) < 0.05] = 255
    rows[rng.random(count) < 0.05] = 0
    rows[rng.integers(0, count, count // 8)] = rows[rng.integers(0, count, count // 8)]
    return rows


@pytest.mark.parametrize("name", ["", *available()])
@pytest.mark.parametrize("counts", [(1, 1), (1, 17), (13, 16), (97, 250), (260, 33)])
def test_products_are_those_of_whole_numbers(name: str, counts: tuple[int, int]) -> None:
    first, second = drawn(counts[0], 1), drawn(counts[1], 2)
    products = first.astype(np.int64) @ second.astype(np.int64).T
    index, best, following, column_best = compare_descriptors(first, second, name)
    np.testing.assert_array_equal(index, products.argmax(axis=1))
    np.testing.assert_array_equal(best, products.max(axis=1))
    np.testing.assert_array_equal(column_best, products.max(axis=0))
    ordered = np.sort(products, axis=1)
    np.testing.assert_array_equal(following, ordered[:, -2] if counts[1] > 1 else np.zeros(counts[0]))


def test_matches_are_mutual_nearest_ones_of_clear_ratio() -> None:
    rng = np.random.default_rng(4)
    second = root_descriptors(rng.gamma(0.4, 1.0, (300, 128)).astype(np.float32))
    # Two that are equal match nothing: neither is clearly nearest.
    second[7] = second[8]
    order = rng.permutation(300)
    first = np.clip(second[order].astype(np.int64) + rng.integers(-3, 4, second.shape), 0, 255).astype(np.uint8)
    matches = match_descriptors(first, second)
    angles = np.arccos(np.minimum(first.astype(np.int64) @ second.astype(np.int64).T / NORM**2, 1.0))
    expected = []
    for row, own in enumerate(angles):
        best = int(own.argmin())
        clear = own[best] < MAX_RATIO * np.partition(own, 1)[1] and own[best] < MAX_ANGLE_RAD
        if clear and own[best] == angles[:, best].min():
            expected.append((row, best))
    assert matches.tolist() == [list(pair) for pair in expected] and len(matches) > 150
    assert sum(order[row] == other for row, other in matches.tolist()) == len(matches)


def test_nothing_matches_nothing_and_wrong_arrays_are_refused_by_shape() -> None:
    some = drawn(5, 0)
    assert match_descriptors(some[:0], some).shape == match_descriptors(some, some[:0]).shape == (0, 2)
    assert len(match_descriptors(np.zeros((4, 128), np.uint8), some)) == 0
    for wrong in (some[:, :64], some.astype(np.float32), some[0]):
        with pytest.raises(BadInput, match="expected"):
            match_descriptors(wrong, some)
    with pytest.raises(ValueError, match="instruction_set"):
        compare_descriptors(some, some, "sse9")
    with pytest.raises((ValueError, TypeError)):
        compare_descriptors(some[:0], some)


def test_poisoned_histograms_become_zeros_and_others_have_the_length_of_a_descriptor() -> None:
    histograms = np.random.default_rng(0).gamma(0.4, 1.0, (6, 128)).astype(np.float32)
    histograms[1, 3], histograms[2, 0], histograms[3] = np.nan, np.inf, 0
    rows = root_descriptors(histograms)
    assert not rows[1:4].any()
    # Rounding to whole numbers and the limit of 255 change the length by little.
    np.testing.assert_allclose(np.linalg.norm(rows[[0, 4, 5]].astype(float), axis=1), NORM, rtol=0.02)


@given(st.integers(2, 25), st.integers(0, 2**31), st.integers(1, 12))
def test_partners_leave_whole_what_was_whole_and_keep_the_best(count: int, seed: int, num_partners: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = np.triu_indices(count, 1)
    candidates = np.column_stack([rows, columns])
    scores = rng.integers(0, 60, len(candidates))
    chosen = choose_partners(candidates, scores, count, num_partners)
    assert not chosen[scores == 0].any()

    def pieces(edges: NDArray[np.int64]) -> int:
        root = list(range(count))

        def find(node: int) -> int:
            while root[node] != node:
                node = root[node]
            return node

        for a, b in edges.tolist():
            root[find(a)] = find(b)
        return len({find(node) for node in range(count)})

    assert pieces(candidates[chosen]) == pieces(candidates[scores > 0])
    for photograph in range(count):
        own = np.flatnonzero((candidates == photograph).any(axis=1) & (scores >= LEAST_SCORE))
        if len(own):
            assert chosen[own[scores[own].argmax()]] or (scores[own] == scores[own].max()).sum() > 1
