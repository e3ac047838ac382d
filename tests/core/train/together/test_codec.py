"""What a message of a step says comes back, however many views the step has."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.train.together.codec import decode_gradients, encode_gradients
from radiant_core.train.together.gradients import StepGradients
from tests.core.train.together.test_scrutiny import LAYOUT


@pytest.mark.parametrize("num_views", [1, 255, 256, 300, 1_000])
def test_a_gaussian_is_seen_as_often_as_was_said(num_views: int) -> None:
    rows, seen = np.array([1, 4, 6]), np.array([0, num_views // 2, num_views], np.uint16)
    values = np.ones((3, LAYOUT.num_columns), np.float32)
    sent = StepGradients(num_views=num_views, loss=0.5, rows=rows, values=values, view_counts=seen)
    message = encode_gradients(sent, 2, 7, LAYOUT, "float32")
    got = decode_gradients(message, 2, 7, LAYOUT, num_views)
    np.testing.assert_array_equal(got.view_counts, seen)
    np.testing.assert_array_equal(got.rows, rows)
    np.testing.assert_array_equal(got.values, values)
