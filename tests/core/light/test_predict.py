"""Predicted light: each predictor wins where it is right, with its error; what says nothing is not
asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_json
from radiant_core.light.captures import CAPTURES_NAME, Shots, complete_captures, load_captures, read_captures, save_captures, shots_of
from radiant_core.light.lights import Lights
from radiant_core.light.predict import predict_lights
from tests.core.light.plain_lights import no_lights
from tests.core.scenes import cameras_above

RNG = np.random.default_rng(0)
PLACES = [(float(x), float(y)) for x, y in RNG.uniform(-20, 20, (64, 2))]
CAMERAS = cameras_above(PLACES, size_wh=(64, 48))
EXPOSURES = RNG.normal(0, 1, 64)
POINTS = [np.column_stack([RNG.uniform(-2, 2, (64, 2)) + place, np.zeros(64)]) for place in PLACES]
HELD = np.arange(64) % 8 == 0
SHOTS = Shots(cameras=CAMERAS, ranks=np.arange(64.0), log2_exposures=EXPOSURES)


def part(rows: np.ndarray, shots: Shots = SHOTS) -> Shots:
    return Shots(cameras=shots.cameras.select(rows), ranks=shots.ranks[rows], log2_exposures=shots.log2_exposures[rows])


def lights_of(gains: np.ndarray) -> Lights:
    known = np.ones(len(gains), bool)
    return replace(no_lights(CAMERAS.select(np.flatnonzero(~HELD))), log_gains=gains[~HELD], is_known=known[~HELD])


def predicted(gains: np.ndarray, shots: Shots = SHOTS):
    rows, asked = np.flatnonzero(~HELD), np.flatnonzero(HELD)
    found = predict_lights(lights_of(gains), part(rows, shots), [POINTS[row] for row in rows], part(asked, shots))
    return found, float(np.sqrt(np.mean((found.lights.log_gains - gains[asked]) ** 2)))


TIME = 0.2 * np.sin(np.arange(64) / 9)[:, None] * [1.0, 0.9, 1.1]
EXPOSED = 0.4 * EXPOSURES[:, None] + [0.1, 0.0, -0.1]
PLACED = 0.02 * np.array(PLACES)[:, :1] * np.ones(3)


@pytest.mark.parametrize(
    ("gains", "choice"),
    [
        (TIME, ("mean", "time")),
        (EXPOSED, ("exposure", "none")),
        (EXPOSED + TIME, ("exposure", "time")),
        (PLACED, ("mean", "place")),
        (EXPOSED + PLACED, ("exposure", "place")),
    ],
)
def test_the_predictor_that_is_right_is_chosen_and_states_its_error(gains: np.ndarray, choice: tuple[str, str]) -> None:
    noisy = gains + np.random.default_rng(1).normal(0, 0.005, gains.shape)
    found, error = predicted(noisy)
    assert (found.base, found.interpolation) == choice
    assert error < 0.5 * found.mean_error and error < 2 * found.error and found.error < 0.6 * found.mean_error
    decision = found.decision("evaluation", 56)
    assert decision.figure == pytest.approx(100 * found.error) and "predicted by" in decision.choice


def test_noise_is_predicted_by_its_mean_and_nothing_by_nothing() -> None:
    found, _ = predicted(np.random.default_rng(3).normal(0, 0.1, (64, 3)))
    assert (found.base, found.interpolation) == ("mean", "none") and "mean of the training photographs" in found.decision("s", 56).choice
    few = predict_lights(lights_of(TIME).select([0, 1]), part(np.array([1, 2])), POINTS[1:3], part(np.array([0])))
    assert (few.base, few.interpolation) == ("mean", "none")
    unknown = replace(lights_of(TIME), is_known=np.zeros(56, bool))
    rows = np.flatnonzero(~HELD)
    none = predict_lights(unknown, part(rows), [POINTS[row] for row in rows], part(np.array([0])))
    assert not none.lights.log_gains.any() and none.error == 0


def test_what_is_not_known_is_predicted_by_no_one() -> None:
    gains = TIME.copy()
    gains[5] = 50.0
    known = (np.arange(64) != 5)[~HELD]
    rows, asked = np.flatnonzero(~HELD), np.flatnonzero(HELD)
    lights = replace(lights_of(gains), is_known=known)
    found = predict_lights(lights, part(rows), [POINTS[row] for row in rows], part(asked))
    assert np.abs(found.lights.log_gains - TIME[asked]).max() < 0.05


def test_without_exif_or_with_one_exposure_there_is_no_slope() -> None:
    for exposures in (np.full(64, np.nan), np.full(64, 3.0)):
        found, _ = predicted(EXPOSED + TIME, replace(SHOTS, log2_exposures=exposures))
        assert (np.isfinite(found.lights.log_gains).all() and found.interpolation == "time") or found.error <= found.mean_error
    some = np.where(np.arange(64) % 5 == 0, np.nan, EXPOSURES)
    assert np.isfinite(predicted(EXPOSED, replace(SHOTS, log2_exposures=some))[0].lights.log_gains).all()


def test_another_camera_has_no_vignetting() -> None:
    rows = np.flatnonzero(~HELD)
    lights = replace(lights_of(TIME), vignettings=np.full((1, 3, 3), -0.1))
    wide = replace(CAMERAS, Ks=CAMERAS.Ks * np.array([[0.5], [0.5], [1.0]]) + np.array([[0, 0, 16.0], [0, 0, 12.0], [0, 0, 0]]))
    for cameras, corner in ((CAMERAS, np.exp(-0.3)), (wide, 1.0)):
        targets = part(np.array([0]), replace(SHOTS, cameras=cameras))
        found = predict_lights(lights, part(rows), [POINTS[row] for row in rows], targets).lights
        factors = found.factors(0, targets.cameras)
        assert factors[0, 0, 0] / factors[24, 32, 0] == pytest.approx(corner, abs=0.02)


def test_captures_come_back_and_missing_ones_are_ranked_by_name(tmp_path: Path) -> None:
    captures = {"b.jpg": (0, -3.5), "a.jpg": (1, None)}
    assert save_captures(tmp_path, captures) == CAPTURES_NAME and load_captures(tmp_path) == captures
    assert load_captures(tmp_path / "nowhere") == {}
    assert complete_captures(captures, ["a.jpg"]) == captures
    assert complete_captures(captures, ["c.jpg", "b.jpg", "a.jpg"]) == {"a.jpg": (0, None), "b.jpg": (1, -3.5), "c.jpg": (2, None)}
    cameras = replace(CAMERAS.select([0, 1]), names=("a.jpg", "b.jpg"))
    shots = shots_of(cameras, captures)
    assert shots.ranks.tolist() == [1, 0] and np.isnan(shots.log2_exposures[0]) and shots.log2_exposures[1] == -3.5
    (tmp_path / "plain.png").write_bytes(b"no photograph")
    assert read_captures(tmp_path, ["plain.png", "missing.png"]) == {"plain.png": (0, None)}


@pytest.mark.parametrize("content", [{"a": [1]}, {"a": ["x", 0]}, [1], {"a": None}])
def test_captures_that_are_none_are_refused(tmp_path: Path, content: object) -> None:
    write_json(tmp_path / CAPTURES_NAME, {"photographs": content})
    with pytest.raises(BadInput, match=r"captures\.json"):
        load_captures(tmp_path)
