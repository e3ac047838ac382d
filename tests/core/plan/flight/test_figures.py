"""Flight time, batteries, resolution and overlap of flights whose figures are known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.flight.figures import CLIMB_M_PER_S, TURN_S, Drone, flight_figures
from tests.core.plan.flight.test_whole_lines import lawn_mower


def test_a_lawn_mowers_figures_are_those_of_a_pencil() -> None:
    positions, heights = lawn_mower(4, 11), np.full(44, 80.0)
    drone = Drone(speed_m_per_s=8, battery_s=100, image_width_px=4000, optics=Optics(field_of_view_deg=2 * math.degrees(math.atan(0.75))))
    found = flight_figures(positions, heights, drone)
    length_m = 4 * 200 + 3 * 25
    assert found.length_m == pytest.approx(length_m)
    # Each of the three turns bends twice; from the end of line 4 home are 75 m.
    flight_s = (length_m + 75) / 8 + 6 * TURN_S + 2 * 80 / CLIMB_M_PER_S
    assert found.flight_s == pytest.approx(flight_s) and found.batteries == math.ceil(flight_s / 100)
    assert found.gsd_m == pytest.approx(120 / 4000)  # 2 · 80 m · 0.75 across
    assert found.forward_overlap == pytest.approx(1 - 20 / 90) and found.side_overlap == pytest.approx(1 - 25 / 120)


def test_what_is_not_known_is_none() -> None:
    found = flight_figures(lawn_mower(1, 5), None, Drone())
    assert (found.gsd_m, found.forward_overlap, found.side_overlap) == (None, None, None)
    empty = flight_figures(np.zeros((0, 2)), None, Drone())
    assert (empty.flight_s, empty.batteries, empty.length_m) == (0.0, 0, 0.0)
    on_ground = flight_figures(lawn_mower(2, 5), np.zeros(10), Drone())
    assert on_ground.gsd_m is None


@pytest.mark.parametrize("wrong", [{"speed_m_per_s": 0.0}, {"battery_s": math.nan}, {"image_width_px": 1}, {"speed_m_per_s": math.inf}])
def test_drones_that_do_not_fly_are_refused(wrong: dict) -> None:
    with pytest.raises(BadInput):
        Drone(**wrong)
