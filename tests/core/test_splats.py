"""Splats: finite float32 of agreeing shapes, and joins that lose nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.splats import SH_BASES, SH_C0, Splats, concatenate_splats


def some_splats(count: int = 5, degree: int = 1, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.standard_normal((count, 3), dtype=np.float32),
        quats=rng.standard_normal((count, 4), dtype=np.float32),
        log_scales=rng.standard_normal((count, 3), dtype=np.float32),
        logit_opacities=rng.standard_normal(count, dtype=np.float32),
        sh0=rng.standard_normal((count, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((count, SH_BASES[degree] - 1, 3), dtype=np.float32),
    )


def same(a: Splats, b: Splats) -> bool:
    return all(np.array_equal(a.arrays()[name], b.arrays()[name]) for name in a.arrays())


@pytest.mark.parametrize("name", list(some_splats().arrays()))
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_value_that_float32_cannot_hold_is_refused_by_tensor(name: str, value: float) -> None:
    arrays: dict[str, Any] = {key: array.astype(np.float64) for key, array in some_splats().arrays().items()}
    arrays[name].flat[3] = value
    with pytest.raises(BadInput, match=f"{name} has 1 values that are not finite"):
        Splats(**arrays)


@pytest.mark.parametrize("name", list(some_splats().arrays()))
def test_a_tensor_of_another_length_is_refused(name: str) -> None:
    arrays = some_splats().arrays()
    with pytest.raises(BadInput, match="has shape"):
        Splats(**{**arrays, name: arrays[name][:-1]})


def test_a_single_number_is_no_model() -> None:
    with pytest.raises(BadInput, match="means has shape"):
        Splats(**{**some_splats().arrays(), "means": np.float32(3)})


@pytest.mark.parametrize("bases", [1, 2, 4, 16, 24])
def test_an_odd_number_of_harmonics_is_refused(bases: int) -> None:
    with pytest.raises(BadInput, match=f"shN has {bases} bases"):
        Splats(**{**some_splats().arrays(), "shN": np.zeros((5, bases, 3))})


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_degree_and_bytes_follow_from_the_arrays(degree: int) -> None:
    splats = some_splats(7, degree)
    assert splats.sh_degree == degree
    assert splats.num_bytes == 7 * 4 * (3 + 4 + 3 + 1 + 3 * (degree + 1) ** 2)


def test_denormals_and_empty_models_are_fine() -> None:
    assert len(some_splats(0)) == 0
    arrays = {**some_splats().arrays(), "means": np.full((5, 3), 1e-45, np.float32)}
    assert Splats(**arrays).means[0, 0] == np.float32(1e-45)


def test_parts_joined_again_are_the_whole() -> None:
    splats = some_splats()
    mask = np.array([True, True, False, False, False])
    assert same(concatenate_splats([splats.select(mask), splats.select(~mask)]), splats)
    assert same(concatenate_splats([splats, some_splats(0)]), splats)
    assert same(splats.select(np.flatnonzero(mask)), splats.select(mask))


def test_joining_pads_lower_degrees_with_zeros() -> None:
    joined = concatenate_splats([some_splats(2, 0), some_splats(3, 2, seed=1)])
    assert joined.sh_degree == 2
    assert (joined.shN[:2] == 0).all()
    assert np.array_equal(joined.shN[2:], some_splats(3, 2, seed=1).shN)


def test_joining_nothing_is_refused() -> None:
    with pytest.raises(BadInput, match="no models"):
        concatenate_splats([])


def test_the_constant_harmonic_is_normalised_over_the_sphere() -> None:
    assert SH_C0**2 * 4 * np.pi == pytest.approx(1.0, abs=1e-15)
