"""`radiant plan` with several options at once: slack, constraints, curves of edges, memory, forecasts, buffers, methods and the chart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.plan.replan import ReplanRequest, replan_files
from radiant_app.files.constraints_file import load_constraints
from radiant_app.files.profile_file import save_profile
from radiant_app.files.system_file import dump_system, load_system
from radiant_app.report.prediction_error import curves_note
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import read_json
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_viewer.charts.slack_chart import slack_picture
from tests.app.test_plan_command import grid_csv
from tests.app.test_replan_command import display
from tests.core.plan.test_profiles import MEASURED

MIXED = """
[[edge]]
id = "far"
lat_lon_deg = [47.37, 8.5375]
time_s = { constant = 30.0, linear = 1.1 }
max_cameras = 40
[[edge]]
id = "near"
lat_lon_deg = [47.37, 8.5425]
profile = "mine.toml"
[[edge.device]]
id = "measured"
profile = "mine.toml"
[[edge.device]]
id = "guessed"
profile = "rtx-3090"
[[edge.device]]
id = "default"
memory_gb = 8.0
"""


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    save_profile(tmp_path / "mine.toml", MEASURED)
    (tmp_path / "system.toml").write_text(MIXED)
    grid_csv(tmp_path, 16, 8)
    return tmp_path


def radiant(*arguments: str | Path) -> tuple[str, BaseException | None]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.output, result.exception


def test_everything_at_once_on_an_edge_by_its_curve_and_one_of_measured_guessed_and_default_devices(mixed: Path) -> None:
    options = ("--slack", "1.1", "--slack-curve", "--compare", "--buffer", "20%", "--steps", "300")
    output, failed = radiant(
        "plan", mixed / "flight.csv", "--system", mixed / "system.toml", "--out", mixed / "plan.json", *options, "--json"
    )
    assert failed is None, output
    result = json.loads(output[output.index("{") :])
    cloud, edges = load_plan(mixed / "plan.json")
    record = read_json(mixed / "plan.json")
    assert cloud.slack == 1.1 and cloud.makespan_s <= 1.1 * cloud.lower_bound_s * (1 + 1e-12)
    assert not edges[0].dealt and len(edges[0].camera_indices) == cloud.counts[0] <= 40
    assert {"forecast", "buffers", "slack_curve", "warnings", "waypoints"} <= set(record)
    far, near = record["buffers"]
    assert far["camera_indices"] == [] and far["edge_time_s"] == far["planned_edge_time_s"]
    assert near["camera_indices"] and near["edge_time_s"] >= near["planned_edge_time_s"]
    assert "far none, it deals its own" in result["buffers"] and "Dealt by the edge itself, later: far." in result["warnings"]
    assert record["warnings"] and all(warning in result["warnings"] for warning in record["warnings"])
    assert {row["method"] for row in result["methods"]} >= {"exact", "paper", "even"}
    for name in ("picture", "gantt", "comparison", "slack_picture"):
        picture = cv2.imread(result[name])
        assert picture is not None and (picture != 255).any(axis=2).mean() > 0.01
    assert (mixed / "plan_waypoints" / "edges" / "far.csv").is_file()


def test_a_plan_in_which_an_edge_is_known_by_its_curve_cannot_be_replanned_and_says_so(mixed: Path) -> None:
    assert radiant("plan", mixed / "flight.csv", "--system", mixed / "system.toml", "--out", mixed / "plan.json")[1] is None
    request = ReplanRequest(source=mixed / "plan.json", out=mixed / "new.json", system=mixed / "system.toml")
    with pytest.raises(BadInput, match="'far' has time_s and no devices: `radiant plan` plans it, everything else needs its devices"):
        replan_files(request, display())
    assert not (mixed / "new.json").exists()


def test_a_written_system_says_where_its_curves_come_from(mixed: Path) -> None:
    system = load_system(mixed / "system.toml", curves=True)
    (mixed / "written.toml").write_text(dump_system(system))
    written = load_system(mixed / "written.toml", curves=True)
    assert [device.origin for device in written.devices] == ["measured mine.toml", "estimate rtx-3090", None]
    assert written.edges[1].origin == "measured mine.toml" and written.devices[0].train_s == system.devices[0].train_s
    for note in (curves_note(system), curves_note(written)):
        assert "The curves of default are a system file's defaults: guesses" in note
        assert "of measured, near were measured, profile mine.toml." in note
        assert "of guessed are estimates, never measured, profile rtx-3090." in note
        assert "of far are those of the system file" in note
    (mixed / "written.toml").write_text(dump_system(system).replace("measured mine.toml", "dreamt mine.toml"))
    with pytest.raises(BadInput, match="costs_from is 'dreamt mine"):
        load_system(mixed / "written.toml", curves=True)


def test_constraints_hold_and_are_told(mixed: Path) -> None:
    source = mixed / "flight.csv"
    assert radiant("plan", source, "--out", mixed / "before.json")[1] is None
    (mixed / "given.toml").write_text('plan = "before.json"\nlocked = ["edge-1"]\n[pinned]\nedge-2 = ["wp0", "wp5"]\n')
    before = load_plan(mixed / "before.json")[0]
    names = [f"wp{index}" for index in range(128)]
    if before.edge_of_camera[0] == 0 or before.edge_of_camera[5] == 0:
        (mixed / "given.toml").write_text('plan = "before.json"\nlocked = ["edge-2"]\n[pinned]\nedge-1 = ["wp0", "wp5"]\n')
    given = load_constraints(mixed / "given.toml", names)
    assert given.start is not None and list(given.constraints.pinned) == [0, 5]
    output, failed = radiant("plan", source, "--out", mixed / "after.json", "--constraints", mixed / "given.toml")
    assert failed is None and "Planned around constraints: region of edge" in output
    after = load_plan(mixed / "after.json")[0]
    np.testing.assert_array_equal(after.edge_of_camera, before.edge_of_camera)
    assert after.status in ("optimal", "constrained") and len(after.constrained) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[pinned]\nedge-1 = ["nowhere"]', "'nowhere' is pinned to edge 'edge-1', but is none of the 128 positions"),
        ('[pinned]\nedge-1 = ["wp1"]\nedge-2 = ["wp1"]', "'wp1' is pinned twice, to 'edge-1' and 'edge-2'"),
        ("", "it fixes, locks and pins nothing"),
        ("[fixed_weights_m2]\nedge-1 = nan", "fixed_weights_m2.edge-1 is nan"),
        ('[fixed_weights_m2]\nedge-1 = "x"', "fixed_weights_m2.edge-1 is 'x'"),
        ("slack = 2", "slack is not a key"),
        ('locked = ["edge-1"]\nplan = "none.json"', "there is no plan none.json beside it"),
        ('locked = ["edge-1"]', "regions are locked, which needs a plan of these 128 cameras"),
        ('[pinned]\nedge-9 = ["wp1"]', "edge 'edge-9' is constrained, but the system's edges are edge-1, edge-2"),
    ],
)
def test_bad_constraints_get_one_sentence_and_leave_nothing(tmp_path: Path, text: str, message: str) -> None:
    source = grid_csv(tmp_path, 16, 8)
    (tmp_path / "given.toml").write_text(text)
    before = sorted(tmp_path.iterdir())
    _, failed = radiant("plan", source, "--out", tmp_path / "plan.json", "--constraints", tmp_path / "given.toml")
    assert isinstance(failed, BadInput) and message in str(failed) and "\n" not in str(failed)
    assert sorted(tmp_path.iterdir()) == before


def test_slack_below_one_and_slack_beside_constraints_are_refused(tmp_path: Path) -> None:
    source = grid_csv(tmp_path, 16, 8)
    output, failed = radiant("plan", source, "--out", tmp_path / "plan.json", "--slack", "0.5")
    assert isinstance(failed, SystemExit) and failed.code == 2 and "'--slack': Input should be greater than or equal to 1" in output
    (tmp_path / "given.toml").write_text("[fixed_weights_m2]\nedge-1 = 1.0\n")
    _, failed = radiant("plan", source, "--out", tmp_path / "plan.json", "--slack", "1.1", "--constraints", tmp_path / "given.toml")
    assert isinstance(failed, BadInput) and "slack and constraints are given together" in str(failed)


def test_the_picture_of_slacks_changes_with_what_they_buy_and_takes_one_point() -> None:
    first = SlackPoint(slack=1.0, makespan_s=100.0, mean_distance_m=30.0, rms_distance_m=40.0, border_m=500.0, certified=True)
    points = [first, replace(first, slack=1.5, makespan_s=150.0, rms_distance_m=20.0, border_m=300.0)]
    picture, other = slack_picture(points), slack_picture([points[0], replace(points[1], rms_distance_m=39.0)])
    assert picture.shape == (460, 1100, 3) == slack_picture([first]).shape
    assert (picture != other)[:, :550].any() and not (picture != other)[80:, 560:].any()
    with pytest.raises(BadInput, match="no slack curve to draw"):
        slack_picture([])
