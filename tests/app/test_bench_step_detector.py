"""The bench of the step detector: thresholds keep their rate on noise, virtual borders lie in the model, steps where they were planted."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_app.bench.step_detector import cross_validated_false_alarms, plants, thresholds_of, virtual_borders
from radiant_core.errors import BadInput
from radiant_core.evaluate.step_detector import QUANTITIES, THRESHOLDS
from tests.core.scenes import ground_splats


def test_thresholds_alarm_at_one_line_in_twenty() -> None:
    scores = np.abs(np.random.default_rng(0).standard_t(5, (4000, 4)))
    alarms = (scores > thresholds_of(scores)).any(axis=1).mean()
    assert 0.045 < alarms <= 0.05
    # 4,000 lines: 0.05 ± 3 · 0.0034, and as much from the thresholds' own sampling.
    assert cross_validated_false_alarms(scores) == pytest.approx(0.05, abs=0.015)
    scores[::7] = np.nan
    assert (np.nan_to_num(scores) > thresholds_of(scores)).any(axis=1).mean() <= 0.05


def test_virtual_borders_cross_the_middle_of_the_model_and_are_the_same_again() -> None:
    splats = ground_splats(2000, half_side_m=40.0)
    lines = virtual_borders(splats, 30, seed=3)
    assert np.abs(np.array(lines)).max() <= 40.0
    assert min(np.hypot(*(line[1] - line[0])) for line in lines) >= 0.5 * 0.75 * 80
    np.testing.assert_array_equal(lines, virtual_borders(splats, 30, seed=3))
    with pytest.raises(BadInput, match="train it first"):
        virtual_borders(ground_splats(50), 3)


def test_planted_steps_change_the_left_side_alone() -> None:
    splats, line = ground_splats(500), np.array([[0.0, -4.0], [0.0, 4.0]])
    left = splats.means[:, 0] < 0
    for (quantity, name), plant in plants().items():
        planted = plant(splats, line)
        if quantity == "gap":
            assert (np.abs(planted.means[:, 0]) > 0.1).all(), name
        elif quantity == "density":
            assert (planted.means[:, 0] >= 0).sum() == (~left).sum()
            assert 0.4 * left.sum() < (planted.means[:, 0] < 0).sum() < 0.8 * left.sum()
        else:
            changed = (planted.means[:, 2] != splats.means[:, 2]) | (planted.sh0 != splats.sh0).any(axis=(1, 2))
            np.testing.assert_array_equal(changed, left)


def test_every_quantity_has_its_threshold() -> None:
    assert set(THRESHOLDS) == set(QUANTITIES)
    assert min(THRESHOLDS.values()) > 1
