"""A scene without GPS and without a known length has no metres, in whatever a run shows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.report.survey import survey_of
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_viewer.charts import slack_chart
from radiant_viewer.layers.layer import Layer
from radiant_viewer.runs.camera_figures import camera_figures
from radiant_viewer.runs.places import camera_heights, place_text
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.window.subject import run_subject
from tests.viewer.made_up_run import Town, made_up_town, save_run

METRES = re.compile(r"(?<![A-Za-z×])\d[\d.,]* ?(?:mm|cm|m|km|m²|m³|ha)\b|\((?:m|m²|m³)\)|\bmet(?:re|er)s?\b")


def unscaled_town() -> Town:
    town = made_up_town()
    return replace(town, scene=replace(town.scene, frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))))


def texts(layer: Layer) -> Iterator[str]:
    yield layer.name
    yield from (label.text for label in layer.labels)
    yield from (entry.text for entry in layer.legend)
    if layer.heat is not None:
        yield layer.heat.label


def test_the_pattern_sees_metres_and_no_others() -> None:
    assert all(METRES.search(text) for text in ("cells of 3.2 m", "East (m)", "12 m²", "5 cm", "in metres"))
    assert not any(METRES.search(text) for text in ("cells of 3.2 units", "East (units)", "20 min", "3 models", "5 ms", "1.2 × bound"))


@pytest.mark.parametrize("kind", ["unscaled", "metric"])
def test_no_layer_of_the_inspector_shows_metres_of_a_scene_without_scale(tmp_path: Path, kind: str) -> None:
    save_run(tmp_path / "run", unscaled_town() if kind == "unscaled" else made_up_town())
    subject = run_subject(load_run_view(tmp_path / "run", with_files=True))
    said = [text for layer in subject.layers for text in texts(layer)]
    assert any(METRES.search(text) for text in said) == (kind == "metric"), said
    assert any("units" in text for text in said) == (kind == "unscaled")
    assert any(text.startswith("Images that see the spot, cells of") for text in said)


def test_no_figure_of_a_camera_is_in_metres(tmp_path: Path) -> None:
    save_run(tmp_path / "run", unscaled_town())
    run = load_run_view(tmp_path / "run", with_files=True)
    figures = camera_figures(run.scene, run.roles, run.cloud_plan)
    said = [camera_heights(run.scene)[0], place_text(np.zeros(2), run.scene.frame), survey_of(run.scene, 0, None).line]
    said += [*figures.headings.values()]
    assert any("(units)" in text for text in said) and not any(METRES.search(text) for text in said), said


def test_the_picture_of_slacks_has_the_unit_of_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    labels: list[str] = []
    monkeypatch.setattr(slack_chart, "style_axes", lambda axes, across, up: labels.append(up))
    point = SlackPoint(slack=1.0, makespan_s=100.0, mean_distance_m=30.0, rms_distance_m=40.0, border_m=500.0, certified=True)
    for unit in ("units", "m"):
        slack_chart.slack_picture([point], unit)
    assert [label[-len(end) :] for label, end in zip(labels, ["(units)"] * 2 + ["(m)"] * 2, strict=True)] == ["(units)"] * 2 + ["(m)"] * 2


def test_a_plan_of_a_scene_without_scale_prints_no_metres(tmp_path: Path) -> None:
    save_run(tmp_path / "run", unscaled_town())
    arguments: list[Any] = ["plan", tmp_path / "run", "--out", tmp_path / "p" / "plan.json", "--compare", "--slack-curve"]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None, result.exception
    assert not METRES.search(result.output) and "units²" in result.output


def test_a_buffer_in_metres_is_refused_for_a_scene_that_has_none(tmp_path: Path) -> None:
    save_run(tmp_path / "run", unscaled_town())
    arguments = ["plan", str(tmp_path / "run"), "--out", str(tmp_path / "p" / "plan.json"), "--buffer"]
    result = CliRunner().invoke(app, [*arguments, "15m"])
    assert isinstance(result.exception, BadInput)
    assert str(result.exception) == "--buffer 15m is in metres, and the scene has no scale: give a share of the footprint such as 20%."
    assert CliRunner().invoke(app, [*arguments, "20%"]).exception is None
