"""`radiant plan --after` on plan files: what it writes, that captured waypoints stay, and one sentence for what cannot be done."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.commands.plan.replan import ReplanRequest, parse_values, replan_files, replan_table
from radiant_app.files.system_file import load_system
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.frames import geodetic_from_enu
from radiant_core.io.records import load_plan, load_plan_waypoints
from radiant_core.plan.revision.captured import require_same_system
from radiant_core.plan.revision.replan import FleetChange
from radiant_core.waypoints.reader import read_waypoints

SYSTEM = """
[[edge]]
id = "north"
lat_lon_deg = [47.3716, 8.5405]
[[edge.device]]
id = "n1"
[[edge.device]]
id = "n2"
[[edge]]
id = "south"
lat_lon_deg = [47.3702, 8.5405]
[[edge.device]]
id = "s1"
relative_speed = 2.0
"""


def display() -> ProgressDisplay:
    return ProgressDisplay(Console(file=io.StringIO()))


def csv_of(folder: Path, name: str, chosen: range) -> Path:
    positions = np.array([(10.0 * (index % 15), 12.0 * (index // 15), 60.0) for index in range(180)])
    lines = [f"w{i},{a},{o},{h}" for i, (a, o, h) in enumerate(geodetic_from_enu(positions, (47.37, 8.54, 430.0))) if i in chosen]
    (folder / name).write_text("\n".join(["name,latitude,longitude,altitude", *lines]))
    return folder / name


@pytest.fixture
def planned(tmp_path: Path) -> Path:
    (tmp_path / "system.toml").write_text(SYSTEM)
    source = csv_of(tmp_path, "flight.csv", range(180))
    request = PlanRequest(source=source, out=tmp_path / "plan.json", system=tmp_path / "system.toml", method="exact", seed=0)
    assert (tmp_path / "plan_gantt.png") == Path(plan(request, display())["gantt"])
    return tmp_path


def test_a_dead_device_and_a_joined_edge_make_a_plan_with_all_its_files(planned: Path) -> None:
    west = '[[edge]]\nid = "west"\nlat_lon_deg = [47.371, 8.539]\n[[edge.device]]\nid = "w1"\n'
    joins = west + '[[edge]]\nid = "south"\n[[edge.device]]\nid = "s2"\n'
    (planned / "joins.toml").write_text(joins)
    captured = csv_of(planned, "captured.csv", range(0, 180, 5))
    before = load_plan(planned / "plan.json")[1]
    request = ReplanRequest(
        source=planned / "plan.json",
        out=planned / "new.json",
        system=planned / "system.toml",
        change=FleetChange(dead=frozenset({"n2"}), slow={"n1": 1.5}),
        join=planned / "joins.toml",
        captured=captured,
    )
    result = replan_files(request, display())
    cloud, edges = load_plan(planned / "new.json")
    assert cloud.edge_ids == ("north", "south", "west") and edges[1].device_ids == ("s1", "s2")
    require_same_system(edges, load_system(planned / "new_system.toml"))
    lost = set(before[0].cameras_of("n2").tolist()) & set(range(0, 180, 5))
    assert result["lost"] == len(lost) > 0 and "lost" in result["warnings"]
    assert set(edges[0].cameras_of("n2").tolist()) == lost
    for device, old in (("n1", before[0]), ("s1", before[1])):
        stays = set(old.cameras_of(device).tolist()) & set(range(0, 180, 5))
        assert stays <= set(next(e for e in edges if device in e.device_ids).cameras_of(device).tolist())
    rows = (planned / "new_moved.csv").read_text().splitlines()
    assert rows[0] == "name,x_m,y_m,from,to" and len(rows) == 1 + result["moved"]
    waypoints = load_plan_waypoints(planned / "new.json")
    listed = read_waypoints(planned / "new_waypoints" / "w1.csv").waypoints.names
    assert waypoints is not None and sorted(listed) == sorted(waypoints.names[i] for i in edges[2].cameras_of("w1"))
    for name in ("new.png", "new_gantt.png"):
        picture = cv2.imread(str(planned / name))
        assert picture is not None and (picture != 255).any()
    table = replan_table(result).splitlines()
    assert table[-1].startswith("makespan") and "never →" in table[-1] and len(table) == 2 + 5
    assert result["makespan_s"] == pytest.approx(result["lower_bound_s"])


def test_each_warning_is_a_line_and_a_joining_edge_far_away_is_one(planned: Path) -> None:
    (planned / "far.toml").write_text('[[edge]]\nid = "far"\nlat_lon_deg = [50.0, 8.54]\n[[edge.device]]\nid = "f1"\n')
    console = Console(file=io.StringIO())
    request = ReplanRequest(
        source=planned / "plan.json",
        out=planned / "far.json",
        system=planned / "system.toml",
        change=FleetChange(dead=frozenset({"n2"})),
        join=planned / "far.toml",
        captured=csv_of(planned, "captured.csv", range(0, 180, 5)),
    )
    warnings = replan_files(request, ProgressDisplay(console))["warnings"]
    assert isinstance(console.file, io.StringIO)
    lines = [line.removeprefix("warning replan: ") for line in console.file.getvalue().splitlines() if line.startswith("warning")]
    # 2.63 degrees of latitude.
    assert len(lines) >= 2 and " ".join(lines) == warnings and any(line.startswith("Edge 'far' stands 292 km") for line in lines)


def test_bad_requests_are_one_sentence_and_leave_nothing(planned: Path) -> None:
    (planned / "twice.toml").write_text('[[edge]]\nid = "new"\n[[edge.device]]\nid = "n1"\n')
    (planned / "old_gantt.png").write_text("mine")
    files = sorted(planned.rglob("*"))
    base = {"source": planned / "plan.json", "out": planned / "new.json", "system": planned / "system.toml"}
    cases = [
        ({"change": FleetChange(dead=frozenset({"nobody"}))}, "no device or edge 'nobody'"),
        ({"change": FleetChange(dead=frozenset({"north", "south"}))}, "can hold 0 of 180 positions"),
        ({"join": planned / "twice.toml"}, "device id 'n1' comes twice"),
        ({"join": planned / "none.toml"}, "cannot be read"),
        ({"system": None}, "use the system it was planned for"),
        ({"out": planned / "new.txt"}, r"ends in \.json"),
        ({"out": planned / "old.json"}, r"old_gantt\.png exists"),
        ({"source": planned}, "a run knows its system"),
        ({"source": planned, "system": None}, "no manifest.json"),
        ({"tolerance": -1.0}, "tolerance is -1.0"),
    ]
    for changed, told in cases:
        with pytest.raises(BadInput, match=told):
            replan_files(ReplanRequest(**{**base, **changed}), display())  # type: ignore[arg-type]
        assert sorted(planned.rglob("*")) == files, told
    for text in ("n1", "n1=fast", ""):
        with pytest.raises(BadInput, match="is no ID=NUMBER"):
            parse_values([text], "--slow")
    assert parse_values(["n1=2.5", "s1=1e1"], "--slow") == {"n1": 2.5, "s1": 10.0}
