"""Flight lines: the rows of a lawn-mower flight are found whole, and one is held out."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hold_out import held_out_line
from radiant_core.errors import BadInput
from radiant_core.plan.flight.lines import MIN_LINE, flight_lines

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "sample_scenes"))


def survey(num_rows: int, in_row: int, *, noise: float = 0.0, turn_deg: float = 0.0, seed: int = 0) -> np.ndarray:
    """Centres (R·K,3) of rows flown to and fro, 2 apart along and 3 across, turned as a whole."""
    along, rows = np.arange(in_row) * 2.0, []
    for row in range(num_rows):
        x = along if row % 2 == 0 else along[::-1]
        rows.append(np.column_stack([x, np.full(in_row, 3.0 * row), np.full(in_row, 40.0)]))
    centers = np.concatenate(rows) + np.random.default_rng(seed).normal(0, noise, (num_rows * in_row, 3))
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return centers @ turn.T


@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 90.0])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_rows_of_a_survey_are_its_lines(turn_deg: float, noise: float) -> None:
    lines = flight_lines(survey(5, 8, noise=noise, turn_deg=turn_deg))
    assert [line.tolist() for line in lines] == [list(range(8 * row, 8 * row + 8)) for row in range(5)]


def test_the_generators_town_has_its_rows() -> None:
    from scenegen.config import SceneConfig
    from scenegen.flight import plan_flight, survey_lines

    config = SceneConfig()
    num_rows, num_nadir = survey_lines(config)
    shots = plan_flight(config)
    lines = flight_lines(np.array([shot.center_m for shot in shots]))
    rows = [line for line in lines if line[-1] < num_nadir]
    ends = np.cumsum([num_nadir // num_rows + (row < num_nadir % num_rows) for row in range(num_rows)])
    assert [int(line[-1]) + 1 for line in rows] == ends.tolist()


def test_the_middle_line_is_held_out_first_whatever_the_order_of_the_names() -> None:
    centers = survey(5, 6)
    names = [f"p{row:03d}.jpg" for row in range(len(centers))]
    mask = held_out_line(names, centers)
    assert np.flatnonzero(mask).tolist() == list(range(12, 18))
    shuffled = np.random.default_rng(1).permutation(len(names))
    again = held_out_line([names[row] for row in shuffled], centers[shuffled])
    assert sorted(shuffled[again].tolist()) == list(range(12, 18))
    each = [held_out_line(names, centers, number) for number in range(5)]
    assert (np.sum(each, axis=0) == 1).all()


def test_flights_without_two_lines_are_refused_in_one_sentence() -> None:
    circle = np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3), np.zeros(6)])
    single = survey(1, 9)
    turns = np.arange(60) * np.pi / 15
    twice = np.column_stack([np.cos(turns), np.sin(turns), turns]) + np.random.default_rng(2).normal(0, 0.003, (60, 3))
    for centers in (circle, twice, twice[::-1], single, np.zeros((5, 3)), np.zeros((0, 3)), survey(1, 1)):
        with pytest.raises(BadInput, match=r"2 are needed to hold a whole one out"):
            held_out_line([f"{row:03d}" for row in range(len(centers))], centers)
    with pytest.raises(BadInput, match="line 5 is to be held out"):
        held_out_line([f"{row:03d}" for row in range(30)], survey(5, 6), 5)


def test_a_set_that_brings_its_own_split_is_ordered_by_its_photographs() -> None:
    centers = survey(5, 6)
    names = [f"{'val' if row % 8 == 0 else 'train'}/{row:04d}.jpg" for row in range(len(centers))]
    assert np.flatnonzero(held_out_line(names, centers)).tolist() == list(range(12, 18))


def test_legs_around_a_block_are_lines() -> None:
    leg = np.arange(8.0)
    zero, far = np.zeros(8), np.full(8, 8.0)
    around = np.concatenate([np.column_stack(side) for side in ((leg, zero), (far, leg), (8 - leg, far), (zero, 8 - leg))])
    lines = flight_lines(np.column_stack([around, np.full(32, 40.0)]))
    assert sum(len(line) for line in lines) == 32 and len(lines) == 4


def test_short_runs_gaps_and_huge_coordinates() -> None:
    assert flight_lines(survey(2, MIN_LINE - 1)) == []
    gap = survey(1, 10)
    gap[5:, 0] += 40
    assert [line.tolist() for line in flight_lines(gap)] == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert len(flight_lines(survey(4, 6) + np.array([5e5, 5e6, 0]))) == 4
    for poison in (np.nan, np.inf):
        broken = survey(2, 6)
        broken[3, 0] = poison
        with pytest.raises(BadInput):
            flight_lines(broken)
