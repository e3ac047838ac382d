"""Time by steps: what is left is foretold as it was measured, whatever the schedule of growth and sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.train.config import train_preset
from radiant_core.train.step_costs import StepCosts

TOWN_MS = (20.5, 23.5, 32.0, 38.6, 42.6, 48.0, 78.9, 78.4, 84.3, 73.7, 75.8, 65.1, 62.7, 57.4, 56.8)
"""CPU milliseconds of a step of `radiant train` of the town, 1,500 steps at 576 px, by fifteenths."""
TOWN = replace(train_preset("default"), num_steps=1500, max_num_splats=187_125)
TOWN = replace(TOWN, density=replace(TOWN.density, thin_to=0.75))


def test_what_is_left_of_the_town_is_told_as_it_was_measured() -> None:
    costs, spent = StepCosts(TOWN, 42_399), np.concatenate([[0.0], np.cumsum(TOWN_MS) / np.sum(TOWN_MS)])
    by_steps, by_costs = [], []
    for done in range(1, 14):
        # Seconds left as `pace.py` extrapolates them, over those that were left.
        truth = (1 - spent[done]) / spent[done]
        share = costs.spent_at(done / 15)
        by_costs.append((1 - share) / share / truth)
        by_steps.append((15 - done) / done / truth)
    assert min(by_costs) > 0.8 and max(by_costs) < 1.25
    assert min(by_steps) < 0.5


@pytest.mark.parametrize("preset", ["draft", "default", "standard", "paper"])
def test_time_rises_with_steps_from_nothing_to_all(preset: str) -> None:
    costs = StepCosts(train_preset(preset), 1_000)
    shares = [costs.spent_at(progress) for progress in np.linspace(0, 1, 101)]
    assert shares[0] == 0 and shares[-1] == pytest.approx(1) and np.all(np.diff(shares) > 0)


def test_progress_of_a_budget_of_time_is_time_already() -> None:
    costs = StepCosts(replace(TOWN, budget_s=60.0), 42_399)
    assert [costs.spent_at(progress) for progress in (0.1, 0.5, 0.9)] == pytest.approx([0.1, 0.5, 0.9])
