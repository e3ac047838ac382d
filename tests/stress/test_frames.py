"""Trained device models of the town, put elsewhere by known similarities, come back to 0.1 % of scale, 0.05° and 1 cm per 10 m. Minutes."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_app.commands.run.demo import demo_config
from radiant_app.commands.run.pipeline import run
from radiant_core.cameras import Cameras
from radiant_core.frames import Sim3
from radiant_core.geometry.frame_refinement import PlacedModel, refine_frames
from radiant_core.geometry.open3d_ops import surface_points
from radiant_core.io.records import load_scene, load_splats
from radiant_core.splats import Splats
from tests.core.geometry.patchy_ground import GPS_LIKE, gps_like_move, move_about, moved_model
from tests.core.geometry.test_frame_refinement import SURE, errors_without_gauge

NOTHING = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
Model = tuple[Splats, Cameras]


@pytest.fixture(scope="module")
def town_models(tmp_path_factory: pytest.TempPathFactory) -> list[Model]:
    out = tmp_path_factory.mktemp("town") / "run"
    run(demo_config(out))
    folders = sorted(path.parent for path in out.glob("devices/*/model.safetensors"))
    assert len(folders) >= 4
    return [(load_splats(folder / "model.safetensors"), load_scene(folder / "scene.safetensors").cameras) for folder in folders]


def ground_below(cameras: Cameras) -> np.ndarray:
    return cameras.centers.mean(axis=0) * (1, 1, 0)


def surface_of(model: PlacedModel) -> PlacedModel:
    """What the cameras of a model see of its surface: a far, unseen Gaussian is no measure of a frame."""
    means, chosen = surface_points(model.splats, 3.0)
    seen = np.flatnonzero(chosen)[model.cameras.any_sees(means)]
    return PlacedModel(splats=model.splats.select(seen), cameras=model.cameras, uncertainty=model.uncertainty)


@pytest.mark.stress
@pytest.mark.parametrize("seed", range(3))
def test_gps_like_errors_of_trained_models_are_taken_off(town_models: list[Model], seed: int) -> None:
    moves = [gps_like_move(ground_below(cameras), 10 * seed + k) for k, (_, cameras) in enumerate(town_models)]
    models = [moved_model(*model, move, GPS_LIKE) for model, move in zip(town_models, moves, strict=True)]
    frames = refine_frames(models)
    assert [frame.status for frame in frames] == ["ok"] * len(models)
    for scale, angle_deg, place_m in errors_without_gauge([surface_of(model) for model in models], moves, frames):
        # The town is 120 m long: 1 cm per 10 m are 0.12 m.
        assert scale < 1e-3 and angle_deg < 0.05 and place_m < 0.12


@pytest.mark.stress
@pytest.mark.parametrize(("shift_m", "turn_deg"), [((14.0, 14.0, 0.0), 0.0), ((0.0, 0.0, 0.0), 40.0)], ids=["20 m away", "turned by 40°"])
def test_a_trained_model_that_contradicts_its_gps_is_refused(town_models: list[Model], shift_m: tuple, turn_deg: float) -> None:
    smallest = int(np.argmin([len(cameras) for _, cameras in town_models]))
    models = []
    for index, (splats, cameras) in enumerate(town_models):
        wrong = move_about(ground_below(cameras), shift_m=shift_m, turn_deg=(0, 0, turn_deg))
        models.append(moved_model(splats, cameras, wrong if index == smallest else NOTHING, SURE))
    frames = refine_frames(models)
    assert [frame.status for frame in frames] == ["refused" if index == smallest else "ok" for index in range(len(models))]
    assert "GPS allows" in frames[smallest].reason
