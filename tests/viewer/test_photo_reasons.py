"""What a camera saw beside the others, and the regions of a plan for a GIS."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_viewer.editing.store.plan_files import plan_subject, save_plan_geojson
from radiant_viewer.runs.photo_reasons import reason_text, tilts_deg
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.made_up_run import made_up_town, save_run


def test_a_camera_that_sees_nothing_and_looks_level_says_so(tmp_path: Path) -> None:
    save_run(tmp_path / "run", made_up_town())
    scene = load_run_view(tmp_path / "run").scene
    poses = np.array(scene.cameras.cam_from_world)
    poses[3, :3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    level = replace(
        scene, cameras=replace(scene.cameras, cam_from_world=poses), observations=scene.observations[scene.observations[:, 1] != 3]
    )
    assert tilts_deg(level)[3] == pytest.approx(90.0, abs=1e-9)
    assert reason_text(level, 3).startswith("0 sparse points seen (median ") and "tilted 90°" in reason_text(level, 3)


def test_regions_go_to_a_gis_where_the_cameras_are_on_the_globe(tmp_path: Path) -> None:
    save_run(tmp_path / "run", made_up_town())
    run = load_run_view(tmp_path / "run")
    subject = plan_subject(run)
    plan = (run.cloud_plan, run.edge_plans)
    out = tmp_path / "regions.geojson"
    with pytest.raises(BadInput, match=r"ends in \.geojson"):
        save_plan_geojson(tmp_path / "regions.shp", subject, plan)
    with pytest.raises(BadInput, match="not on the globe"):
        save_plan_geojson(out, replace(subject, origin=None), plan)
    assert not out.exists()
    save_plan_geojson(out, replace(subject, origin=np.array([47.0, 8.0, 400.0])), plan)
    features = json.loads(out.read_text())["features"]
    regions = {feature["properties"]["name"]: feature for feature in features if feature["properties"]["kind"] == "region"}
    assert set(regions) == set(run.cloud_plan.edge_ids)
    lon, lat = np.array(regions[run.cloud_plan.edge_ids[0]]["geometry"]["coordinates"][0]).T
    border = run.cloud_plan.borders[0]
    # A degree of latitude at 47° is 111,176 m.
    assert np.ptp(lat) * 111_176 == pytest.approx(np.ptp(border[:, 1]), rel=1e-3)
    assert abs(lon - 8.0).max() * 76_000 <= 1.01 * np.abs(border[:, 0]).max()
