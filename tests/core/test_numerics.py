"""Checks of arrays and laws of rotations."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.numerics import check_array, figure_text, rotmats_from_quats


def test_a_checked_array_is_a_read_only_copy() -> None:
    source = np.arange(6.0).reshape(2, 3)
    checked = check_array("a", source, (None, 3))
    source[0, 0] = 99
    assert checked[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        checked[0, 0] = 1


@pytest.mark.parametrize("shape", [(2,), (3, 2), (2, 3, 1), (None, 4), ()])
def test_another_shape_is_refused_with_both_shapes(shape: tuple[int | None, ...]) -> None:
    with pytest.raises(BadInput, match=r"a has shape \(2, 3\), expected"):
        check_array("a", np.zeros((2, 3)), shape)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_the_first_value_that_is_not_finite_is_named(value: float) -> None:
    array = np.zeros((3, 2))
    array[1, 1] = array[2, 0] = value
    with pytest.raises(BadInput, match=r"a has 2 values that are not finite, the first at index \(1, 1\)"):
        check_array("a", array, (3, 2))


def test_doubles_beyond_float32_are_refused_without_a_warning() -> None:
    with pytest.raises(BadInput, match="1 values that are not finite"):
        check_array("a", [1.0, 1e300], (2,), np.float32)


@pytest.mark.parametrize("value", [[0.5], [np.nan], [np.inf], [256], [-1], [1e30], [2**64]])
def test_whole_numbers_are_never_rounded_or_wrapped(value: list[float]) -> None:
    with pytest.raises(BadInput):
        check_array("a", value, (1,), np.uint8)


def test_whole_floats_and_empty_lists_become_integers() -> None:
    assert check_array("a", [3.0, 4.0], (2,), np.int64).dtype == np.int64
    assert check_array("a", [], (0,), np.int64).dtype == np.int64


@pytest.mark.parametrize("value", [["1.5"], [None], [[1], [1, 2]], [1j], object(), b"12"])
def test_what_is_no_array_of_numbers_is_refused(value: object) -> None:
    with pytest.raises(BadInput, match="number"):
        check_array("a", value, (None,))  # pyright: ignore[reportArgumentType]


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w, v = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(1, keepdims=True), np.cross(a[:, 1:], b[:, 1:])
    return np.hstack([w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + v])


def test_rotations_compose_as_their_quaternions() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 100, 4))
    both = rotmats_from_quats(quaternion_product(a, b))
    # float64, sums of three.
    np.testing.assert_allclose(both, rotmats_from_quats(a) @ rotmats_from_quats(b), atol=1e-14)


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    rotation = rotmats_from_quats([[1, 0, 0, 1]])[0]
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("length", [5e-324, 1e-200, 1.0, 1e200, 1e308])
def test_the_length_and_sign_of_a_quaternion_do_not_matter(length: float) -> None:
    quats = np.array([[1.0, 1.0, 0.0, 0.0], [-1.0, -1.0, 0.0, 0.0]]) * length
    np.testing.assert_allclose(rotmats_from_quats(quats), rotmats_from_quats([[1, 1, 0, 0]] * 2), atol=1e-15)


def test_zero_quaternions_and_empty_sets() -> None:
    assert np.array_equal(rotmats_from_quats(np.zeros((2, 4))), np.tile(np.eye(3), (2, 1, 1)))
    assert rotmats_from_quats(np.zeros((0, 4))).shape == (0, 3, 3)


def test_figures_have_no_powers_of_ten_where_people_read_them() -> None:
    values = (4667.4, 1671.0, 999.6, 999.4, 49.52, 1.0, 0.01234, 0.0)
    assert [figure_text(value) for value in values] == ["4,670", "1,670", "1,000", "999", "49.5", "1", "0.0123", "0"]
    assert [figure_text(value, 2) for value in (1234.0, 99.6, 1.25)] == ["1,200", "100", "1.2"]
