"""The benchmark of structure from motion: angles are right, and a quick run on the hamlet gives sound figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.sfm import ARMS, _config_of, bench_sfm, rotation_errors_deg
from radiant_core.errors import BadInput

HAMLET = Path(__file__).parents[2] / "sample_scenes" / "hamlet"


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 0.5, 90.0, 180.0])
def test_the_angle_between_rotations_is_the_turn_between_them(angle_deg: float) -> None:
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(10, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    truth = Rotation.from_quat(rng.normal(size=(10, 4))).as_matrix()
    turned = Rotation.from_rotvec(np.radians(angle_deg) * axes).as_matrix() @ truth
    # 2e-6°: near 180° the sine is flat, so rounding of 1e-16 shows as 1e-8 rad.
    assert np.allclose(rotation_errors_deg(turned, truth), angle_deg, atol=2e-6, rtol=1e-6)


def test_a_quick_run_on_the_hamlet_gives_every_figure() -> None:
    # Of twelve photographs, whose neighbours by GPS are nearly all pairs, the spatial arm is the exhaustive one once more.
    assert [_config_of(arm, quick=True).matching for arm in ARMS] == ["auto", "spatial", "exhaustive"]
    arms = ("default", "exhaustive")
    figures = {metric.key: metric.value for metric in bench_sfm(HAMLET, quick=True, arms=arms)}
    assert {key.split(".")[2] for key in figures} == {*arms}
    for matching in arms:
        phases = [figures[f"sfm.hamlet.{matching}.{phase}_s"] for phase in ("features", "matching", "mapping", "refining", "undistorting")]
        assert min(phases) > 0 and sum(phases) < figures[f"sfm.hamlet.{matching}.cpu_s"]
        assert figures[f"sfm.hamlet.{matching}.registered"] >= 11
        assert figures[f"sfm.hamlet.{matching}.seconds"] > 0
        # 2 % and 2°: a dozen images of 320 px.
        assert figures[f"sfm.hamlet.{matching}.position_max_percent"] < 2
        assert figures[f"sfm.hamlet.{matching}.rotation_error_deg"] < 2


def test_a_scene_without_known_cameras_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no known/ cameras"):
        bench_sfm(tmp_path, quick=True)
