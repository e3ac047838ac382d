"""How well the light of every eighth photograph of the real sets is predicted without its pixels. A
minute each."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from radiant_core.evaluate.split import held_out_mask
from radiant_core.light.captures import read_captures, shots_of
from radiant_core.light.predict import predict_lights
from radiant_core.light.solve import NUM_PLACES, lights_from_tracks
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.photographs import load_training_views

DATA = Path(os.environ.get("RADIANT_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.mark.stress
@pytest.mark.parametrize(("name", "least_db", "gain_db"), [("brighton", 35.0, 10.0), ("caliterra", 38.0, 8.0), ("lewis", 27.0, 1.5)])
def test_predicted_light_leaves_less_error_than_the_mean(name: str, least_db: float, gain_db: float, tmp_path: Path) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    result = scene_from_colmap(DATA / name / "sparse" / "0", DATA / name / "images", tmp_path, lambda progress: None, None, Placement())
    scene = result.scene
    views = load_training_views(result.undistorted_folder, scene.cameras.scaled(576))
    captures = read_captures(DATA / name / "images", scene.cameras.names)
    truth = lights_from_tracks(scene, views).log_gains
    brightness = np.array([np.mean((image / 255) ** 2) for image in views.images])
    left, mean_left, choices = np.zeros(len(truth)), np.zeros(len(truth)), list[str]()
    for first in range(8):
        held = held_out_mask(scene.cameras.names, first=first)
        rows, asked = np.flatnonzero(~held), np.flatnonzero(held)
        part = scene.restricted_to(rows)
        lights = lights_from_tracks(part, views.select(rows))
        places = [part.points[part.observations[part.observations[:, 1] == view, 0]][:NUM_PLACES] for view in range(len(rows))]
        shots, targets = (shots_of(scene.cameras.select(chosen), captures) for chosen in (rows, asked))
        found = predict_lights(lights, shots, places, targets)
        # Both gauges are of the training photographs here.
        expected = truth[asked] - truth[rows].mean(axis=0)
        left[asked] = brightness[asked] * np.mean(np.expm1(found.lights.log_gains - expected) ** 2, axis=1)
        mean_left[asked] = brightness[asked] * np.mean(np.expm1(-expected) ** 2, axis=1)
        choices.append(f"{found.base}+{found.interpolation}")
    predicted_db, mean_db = -10 * np.log10(left.mean()), -10 * np.log10(mean_left.mean())
    print(f"{name}: {predicted_db:.1f} dB predicted, {mean_db:.1f} dB by the mean; {', '.join(choices)}")
    assert predicted_db >= least_db and predicted_db >= mean_db + gain_db
