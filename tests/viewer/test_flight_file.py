"""The keyframes of a flight come back as they were kept; a broken file is named and not replaced."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.flight_file import MAX_KEYFRAMES, FlightFile


def pose(x: float) -> ViewPose:
    return ViewPose(position=np.array([x, 0.1, 40]), focal_point=np.array([0, 1 / 3, 0]), up=np.array([0.0, 0.6, 0.8]), angle_deg=33.3)


def test_keyframes_come_back_to_the_last_digit_in_their_order(tmp_path: Path) -> None:
    file = FlightFile(tmp_path)
    assert file.load() == []
    file.keep([pose(3.0), pose(-1 / 7)])
    again = FlightFile(tmp_path).load()
    for own, other in zip([pose(3.0), pose(-1 / 7)], again, strict=True):
        assert own.angle_deg == other.angle_deg
        for name in ("position", "focal_point", "up"):
            assert np.array_equal(getattr(own, name), getattr(other, name))
    file.keep([])
    assert FlightFile(tmp_path).load() == []


def test_the_flight_of_a_file_lies_beside_it(tmp_path: Path) -> None:
    assert FlightFile(tmp_path / "town.ply").path == tmp_path / "town.flight.json"


def flight(position: str) -> str:
    view = f'{{"position": {position}, "focal_point": [0, 0, 0], "up": [0, 0, 1], "angle_deg": 30}}'
    return f'{{"schema": "radiant.flight", "version": 1, "keyframes": [{view}]}}'


NEWER = '{"schema": "radiant.flight", "version": 2, "keyframes": []}'


@pytest.mark.parametrize("text", ["", "{}", "[]", NEWER, flight("[0, 0, NaN]"), flight("[0, 0]")])
def test_a_broken_file_is_one_sentence_and_stays(tmp_path: Path, text: str) -> None:
    (tmp_path / "flight.json").write_text(text)
    with pytest.raises(StoreDamaged, match=r"holds no keyframes.*move it away") as caught:
        FlightFile(tmp_path).load()
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(StoreDamaged):
        FlightFile(tmp_path).keep([pose(1.0)])
    assert (tmp_path / "flight.json").read_text() == text


def test_too_long_a_flight_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="at most 1,000"):
        FlightFile(tmp_path).keep([pose(1.0)] * (MAX_KEYFRAMES + 1))
