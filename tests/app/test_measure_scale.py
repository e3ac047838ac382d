"""σ of a measure holds that of the scale, by whatever fixed it, or says that it does not."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.report.known_scale import known_scale
from radiant_core.frames import Frame
from radiant_core.io.measures_file import figures_text, load_measures
from radiant_core.io.run_store import write_json
from radiant_core.scene import SfmScene
from radiant_core.survey.map_grid import map_frame_of
from tests.viewer.made_up_run import made_up_town, save_run

CONTROL: dict[str, Any] = {"control": {"rms_axis_m": 0.02}, "check": None}


def scene(kind: Any, residual_m: float | None = None) -> SfmScene:
    town = made_up_town().scene
    origin = town.frame.origin_lat_lon_alt if kind == "metric" else np.zeros(3)
    return replace(town, frame=Frame(kind=kind, origin_lat_lon_alt=origin, residual_m=residual_m))


def spread_m(of: SfmScene) -> float:
    return float(np.sqrt(np.square(of.cameras.centers - of.cameras.centers.mean(axis=0)).sum()))


@pytest.mark.parametrize(
    ("kind", "residual_m", "survey", "sigma", "said"),
    [
        ("metric", 2.0, None, "by GPS", r"scale by GPS, σ [\d.]+ %"),
        ("metric", None, {**CONTROL, "scale_sigma": 0.0004}, 0.0004, r"scale by ground control, σ 0.04 %"),
        ("metric", 0.03, {**CONTROL, "scale_sigma": 0.0004}, 0.0004, r"scale by ground control, σ 0.04 %"),
        ("metric", 0.03, {"control": None, "check": None, "scale_sigma": 1e-4}, 1e-4, r"scale by camera positions, σ 0.01 %"),
        ("scaled", None, {**CONTROL, "scale_sigma": 0.0004}, 0.0004, r"scale by ground control, σ 0.04 %"),
        ("scaled", None, None, 0.0, r"σ is without that of the scale, which is as good as --distance or --height"),
        (
            "metric",
            None,
            CONTROL,
            0.0,
            r"σ is without that of the scale, which is as good as what placed this run, which did not record it",
        ),
        ("metric", None, None, 0.0, r"σ is without that of the scale, .* did not record it"),
        ("unscaled", None, None, 0.0, r"lengths in units of their own, for nothing gives the scale"),
    ],
)
def test_the_scale_is_as_good_as_what_gives_it(kind: str, residual_m: float | None, survey: Any, sigma: Any, said: str) -> None:
    of = scene(kind, residual_m)
    found = known_scale(of, survey)
    assert found.sigma == pytest.approx(2.0 / spread_m(of) if sigma == "by GPS" else sigma)
    assert re.fullmatch(said, found.text)


def measured(folder: Path, town: Any, record: dict[str, Any], distance: float = 60.0) -> dict[str, Any]:
    save_run(folder, town)
    write_json(folder / "sfm" / "result.json", {"images": "images", "unregistered": [], **record})
    half = distance / 2
    ends = map_frame_of(town.scene.frame).from_world([[-half, 0, 1], [half, 0, 1]])
    at = " ".join(f"{east:.3f},{north:.3f}" for east, north, _ in ends)
    result = CliRunner().invoke(app, ["measure", str(folder), "--kind", "distance", "--at", at, "--resolution", "2"])
    assert result.exception is None, result.exception
    (row,) = load_measures(folder).values()
    assert figures_text(row) in result.stdout
    return row


def test_a_distance_on_a_scene_by_ground_control_has_the_sigma_of_its_scale(tmp_path: Path) -> None:
    town = made_up_town()
    town = replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9))
    town = replace(town, scene=replace(town.scene, frame=replace(town.scene.frame, residual_m=None)))
    sure, unsure = (
        measured(tmp_path / str(share), town, {"ground_control": {**CONTROL, "scale_sigma": share}})["figures"]["distance on the map"]
        for share in (0.0, 0.05)
    )
    of_scale = np.sqrt(unsure["sigma"] ** 2 - sure["sigma"] ** 2)
    assert of_scale == pytest.approx(0.05 * unsure["value"], rel=1e-3)  # figures of four decimals


def test_what_gives_the_scale_stands_in_every_file(tmp_path: Path) -> None:
    town = made_up_town()
    town = replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9))
    row = measured(tmp_path / "run", town, {"ground_control": {**CONTROL, "scale_sigma": 0.001}})
    assert row["scale"] == "scale by ground control, σ 0.1 %" and figures_text(row).endswith("; scale by ground control, σ 0.1 %")
    assert CliRunner().invoke(app, ["measure", str(tmp_path / "run"), "--export", str(tmp_path / "a.csv")]).exit_code == 0
    assert CliRunner().invoke(app, ["measure", str(tmp_path / "run"), "--export", str(tmp_path / "a.geojson")]).exit_code == 0
    assert "scale by ground control" in (tmp_path / "a.csv").read_text()
    (feature,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert feature["properties"]["scale"].startswith("scale by ground control")


def test_measures_of_before_and_of_strangers_have_no_scale() -> None:
    row = {"kind": "distance", "places": [[0, 0, 0]], "figures": {"d": {"value": 1.0, "sigma": 0.1, "unit": "m"}}}
    assert figures_text(row) == "d 1.000 ± 0.100 m"
