"""The system file: what is read, what a default is, and one precise sentence for everything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_app.files import system_file
from radiant_app.files.system_file import dump_system, even_system, load_system
from radiant_app.files.toml_file import MAX_FILE_BYTES
from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import Cloud, System

ROOT = Path(__file__).parents[2]
WHOLE = """
[[edge]]
id = "north"
position_m = [0.0, 40]
uplink_mbit_per_s = 100.0
speed = 1
aggregate_s = { constant = 5.0, linear = 0.5 }
[[edge.device]]
id = "north-1"
init_s = { linear = 0.1 }
train_s = { constant = 20.0, linear = 1.0, power_coefficient = 0.01, exponent = 1.5 }
model_mb = { linear = 0.5 }
uplink_mbit_per_s = 50.0
max_cameras = 400
memory_gb = 8
speed = 0.3
[[edge]]
id = "south"
lat_lon_deg = [47.37, 8.54]
[[edge.device]]
id = "south-1"
relative_speed = 2.0
"""


def loaded(tmp_path: Path, text: str | bytes) -> System:
    path = tmp_path / "system.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return load_system(path)


def test_every_key_arrives_in_base_units(tmp_path: Path) -> None:
    north, south = loaded(tmp_path, WHOLE).edges
    device = north.devices[0]
    assert (north.id, north.position, north.lat_lon_deg) == ("north", (0.0, 40.0), None)
    assert (north.uplink_bytes_per_s, device.uplink_bytes_per_s) == (12.5e6, 6.25e6)
    assert float(north.aggregate_s(10)) == 10.0
    assert float(device.init_s(10)) == pytest.approx(1.0, rel=1e-15)
    assert float(device.train_s(100)) == pytest.approx(130.0, rel=1e-15)
    assert float(device.model_bytes(3)) == 1.5e6
    assert (device.max_cameras, device.memory_bytes) == (400, 8e9)
    assert (north.speed, device.speed, south.speed, south.devices[0].speed) == (1.0, 0.3, None, None)
    assert (south.position, south.lat_lon_deg, south.devices[0].max_cameras) == (None, (47.37, 8.54), None)


def test_limits_of_the_cloud_arrive_in_base_units_and_are_none_when_left_out(tmp_path: Path) -> None:
    assert loaded(tmp_path, WHOLE).cloud == Cloud()
    system = loaded(tmp_path, WHOLE + "[cloud]\nmemory_gb = 16\ntime_s = 90.5\nmax_cameras = 2000\n")
    assert system.cloud == Cloud(memory_bytes=16e9, time_s=90.5, max_cameras=2000)
    merging = loaded(tmp_path, WHOLE + "[cloud]\nmerge_s = { constant = 9.0, linear = 0.3 }\n")
    assert merging.cloud == Cloud(merge_s=CostCurve(constant=9.0, linear=0.3)) == loaded(tmp_path, dump_system(merging)).cloud
    assert loaded(tmp_path, dump_system(system)) == system
    for limit in ("memory_gb = -1", "time_s = inf", "max_cameras = 2.5", "cameras = 3"):
        with pytest.raises(BadInput, match=f"cloud.{limit.split()[0]} is"):
            loaded(tmp_path, WHOLE + "[cloud]\n" + limit)


def test_a_limit_of_cameras_from_the_file_holds_in_the_plan(tmp_path: Path) -> None:
    """|C_max| as a count (paper Eqn. 13): a device in memory for 2 of 9 cameras gets no third one, and 8 for all are too few."""
    text = WHOLE.replace("max_cameras = 400", "max_cameras = 2").replace("lat_lon_deg = [47.37, 8.54]", "position_m = [0.0, 0.0]")
    positions = np.stack(np.meshgrid([0.0, 10, 20], [0.0, 20, 40]), axis=-1).reshape(-1, 2)
    plan = plan_regions(positions, loaded(tmp_path, text))
    assert isinstance(plan, CloudPlan) and plan.counts[0] <= 2 and plan.counts.sum() == 9
    too_few = plan_regions(positions, loaded(tmp_path, text + "max_cameras = 6\n"))
    assert isinstance(too_few, PlanInfeasible) and "can hold 8 of 9 cameras" in too_few.reason


def test_what_is_left_out_has_the_documented_default(tmp_path: Path) -> None:
    north, south = loaded(tmp_path, WHOLE).edges
    assert south.uplink_bytes_per_s == north.uplink_bytes_per_s
    assert south.aggregate_s == north.aggregate_s
    assert south.devices[0].uplink_bytes_per_s == north.devices[0].uplink_bytes_per_s
    assert south.devices[0].model_bytes == north.devices[0].model_bytes
    assert float(south.devices[0].train_s(10)) == 15.0  # 20 + 10 seconds at double speed
    assert float(south.devices[0].init_s(10)) == pytest.approx(0.5, rel=1e-15)


def test_a_device_may_stand_for_several_equal_ones(tmp_path: Path) -> None:
    path = tmp_path / "system.toml"
    path.write_text('[[edge]]\nid = "a"\n[[edge.device]]\nid = "gpu"\ncount = 3\nrelative_speed = 2.0\n[[edge.device]]\nid = "cpu"\n')
    devices = load_system(path).devices
    assert [device.id for device in devices] == ["gpu-1", "gpu-2", "gpu-3", "cpu"]
    assert devices[0].train_s == devices[2].train_s != devices[3].train_s
    path.write_text(path.read_text().replace('"cpu"', '"gpu-2"'))
    with pytest.raises(BadInput, match="gpu-2"):
        load_system(path)
    path.write_text(path.read_text().replace("count = 3", "count = 0"))
    with pytest.raises(BadInput, match="count"):
        load_system(path)


def test_the_text_written_is_the_system_read(tmp_path: Path) -> None:
    system = loaded(tmp_path, WHOLE)
    assert loaded(tmp_path, dump_system(system)) == system


def test_the_example_in_the_module_is_a_system_file(tmp_path: Path) -> None:
    assert system_file.__doc__ is not None
    example = [line for line in system_file.__doc__.splitlines() if line.startswith("    ")]
    assert [device.id for device in loaded(tmp_path, "\n".join(example)).devices] == ["north-1"]


def test_the_sample_system_of_the_town_has_two_edges_with_two_devices() -> None:
    system = load_system(ROOT / "sample_scenes" / "town" / "system.toml")
    assert [len(edge.devices) for edge in system.edges] == [2, 2]
    assert all(edge.position is None and edge.lat_lon_deg is None for edge in system.edges)


def test_an_even_system_has_equal_edges_and_equal_devices() -> None:
    system = even_system(3, 2)
    assert [edge.id for edge in system.edges] == ["edge-1", "edge-2", "edge-3"]
    assert len({(device.train_s, device.init_s, device.uplink_bytes_per_s) for device in system.devices}) == 1
    assert len(system.devices) == 6


@pytest.mark.parametrize("counts", [(0, 2), (2, 0), (-1, 1)])
def test_an_even_system_without_edges_or_devices_is_refused(counts: tuple[int, int]) -> None:
    with pytest.raises(BadInput, match="at least one"):
        even_system(*counts)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("uplink_mbit_per_s = 50.0", "uplink_mbit_per_s = 0", "edge[0].device[0].uplink_mbit_per_s is 0; expected greater than"),
        ("uplink_mbit_per_s = 100.0", "uplink_mbit_per_s = -1.5", "edge[0].uplink_mbit_per_s is -1.5; expected greater than 0"),
        ("uplink_mbit_per_s = 50.0", "uplink_mbit_per_s = nan", "edge[0].device[0].uplink_mbit_per_s is nan; expected"),
        ("uplink_mbit_per_s = 50.0", "uplink_mbit_per_s = inf", "device[0].uplink_mbit_per_s is inf; expected a finite"),
        ("uplink_mbit_per_s = 50.0", 'uplink_mbit_per_s = "50"', "device[0].uplink_mbit_per_s is '50'; expected a valid number"),
        ("uplink_mbit_per_s = 50.0", "uplink_mbit_per_s = true", "device[0].uplink_mbit_per_s is True; expected a valid number"),
        ("max_cameras = 400", "max_cameras = 400.5", "edge[0].device[0].max_cameras is 400.5; expected"),
        ("memory_gb = 8", "memory_gb = 0", "edge[0].device[0].memory_gb is 0; expected greater than 0"),
        ("max_cameras = 400", "max_cameras = -1", "edge[0].device[0].max_cameras is -1; expected greater than or equal to 0"),
        ("max_cameras = 400", "max_camera = 400", "edge[0].device[0].max_camera is not a key of a system file: did you mean max_cameras?"),
        ("init_s = { linear = 0.1 }", "init_s = { linear = -0.1 }", "edge[0].device[0].init_s.linear is -0.1; expected"),
        (
            "init_s = { linear = 0.1 }",
            "init_s = { linaer = 0.1 }",
            "edge[0].device[0].init_s.linaer is not a key of a system file: did you mean linear?",
        ),
        ("init_s = { linear = 0.1 }", "init_s = 0.1", "edge[0].device[0].init_s is 0.1; expected"),
        ("exponent = 1.5", "exponent = 5", "edge[0].device[0].train_s.exponent is 5; expected less than or equal to 4"),
        ("relative_speed = 2.0", "relative_speed = 0", "edge[1].device[0].relative_speed is 0; expected greater than or equal to 0.001"),
        ("relative_speed = 2.0", "relative_speed = 1e-320", "relative_speed is 1e-320; expected greater than or equal to 0.001"),
        ("position_m = [0.0, 40]", "lat_lon_deg = [91.0, 0.0]", "'north' has lat_lon_deg [91.0, 0.0], expected a latitude"),
        ("init_s = { linear = 0.1 }", "init_s = { linear = 1e308 }", "init_s.linear is 1e+308; expected less than"),
        ("position_m = [0.0, 40]", "position_m = [0.0]", "edge[0].position_m is [0.0]; list should have at least 2 items"),
        ("position_m = [0.0, 40]", "position_m = [0.0, 40]\nlat_lon_deg = [1, 2]", "'north' has both position_m and"),
        ('id = "north"\n', "", "edge[0].id is missing"),
        ('id = "north"\n', 'id = "../north"\n', "edge id '../north' cannot name a folder"),
        ('id = "south"', 'id = "north"', "edge id 'north' comes twice"),
        ('id = "south-1"', 'id = "north-1"', "device id 'north-1' comes twice"),
        ('[[edge.device]]\nid = "south-1"\nrelative_speed = 2.0\n', "", "edge 'south' has no devices: give it at least one, or its time_s"),
        ('[[edge.device]]\nid = "south-1"\nrelative_speed = 2.0\n', "device = []", "edge 'south' has no devices"),
        ('[[edge]]\nid = "south"', '[edge]\nid = "south"', "not a TOML file"),
        ("max_cameras = 400", "max_cameras = " + "9" * 5000, "not a TOML file"),
    ],
)
def test_a_bad_value_gets_one_sentence_with_file_key_and_expectation(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in WHOLE
    with pytest.raises(BadInput) as caught:
        loaded(tmp_path, WHOLE.replace(old, new, 1))
    sentence = str(caught.value)
    assert sentence.startswith(f"{tmp_path / 'system.toml'}: ")
    assert message in sentence
    assert "\n" not in sentence
    assert len(sentence) < len(str(tmp_path)) + 250


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "edge is missing"),
        (b"edge = []", "edge is []; list should have at least 1 item"),
        (b"edge = 3", "edge is 3; expected a valid list"),
        (b"edges = 2", "is missing"),
        (b"\xff\xfe", "byte 0 is not UTF-8"),
        (b"{", "not a TOML file"),
        (b"a = " + b"[" * 2000, "not a TOML file"),
        (b"#" * (MAX_FILE_BYTES + 1), "larger than 1048576 bytes"),
    ],
    ids=["empty", "no edge", "number", "misspelt", "binary", "broken", "deeply nested", "huge"],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(BadInput) as caught:
        loaded(tmp_path, content)
    assert message in str(caught.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(BadInput, match="cannot be read"):
            load_system(path)


CURVES = """
[[edge]]
id = "north"
time_s = { constant = 40.0, linear = 0.9 }
max_cameras = 300
[[edge]]
id = "south"
position_m = [0.0, 5.0]
[[edge.device]]
id = "south-1"
"""


def test_an_edge_may_be_known_by_its_curve_alone_where_curves_are_allowed(tmp_path: Path) -> None:
    path = tmp_path / "system.toml"
    path.write_text(CURVES)
    north, south = load_system(path, curves=True).edges
    assert north.devices == () and north.time_s == CostCurve(constant=40.0, linear=0.9) and north.max_cameras == 300
    assert len(south.devices) == 1 and south.time_s is None
    with pytest.raises(BadInput, match="'north' has time_s and no devices"):
        load_system(path)
    path.write_text(dump_system(load_system(path, curves=True)))
    assert load_system(path, curves=True).edges == (north, south)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max_cameras = 300", "max_cameras = -1", "max_cameras is -1; expected greater"),
        ("max_cameras = 300", "uplink_mbit_per_s = 5.0", "its whole time, and uplink_mbit_per_s too"),
        ("position_m = [0.0, 5.0]", "time_s = { linear = 1.0 }", "'south' has time_s, its whole time, and devices"),
        ("position_m = [0.0, 5.0]", "max_cameras = 3", "'south' has max_cameras and no time_s"),
        ("linear = 0.9", "linear = -0.9", "time_s.linear is -0.9; expected greater"),
    ],
)
def test_a_bad_curve_edge_gets_one_sentence(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "system.toml"
    path.write_text(CURVES.replace(old, new, 1))
    with pytest.raises(BadInput) as caught:
        load_system(path, curves=True)
    assert message in str(caught.value)


def test_latency_and_adding_arrive_in_base_units_and_are_written_again(tmp_path: Path) -> None:
    text = WHOLE.replace('id = "north"', 'id = "north"\nlatency_ms = 2.5\nadd_ms_per_mb = 4.0', 1)
    system = loaded(tmp_path, text + "[cloud]\nlatency_ms = 10\n")
    assert [(edge.latency_s, edge.add_s_per_byte) for edge in system.edges] == [(2.5e-3, 4e-9), (None, None)]
    assert (system.cloud.latency_s, system.cloud.add_s_per_byte) == (0.01, None)
    assert loaded(tmp_path, dump_system(system)) == system


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('id = "north"', 'id = "north"\nlatency_ms = -1', "edge[0].latency_ms is -1; expected greater than or equal to 0"),
        ('id = "north"', 'id = "north"\nadd_ms_per_mb = inf', "edge[0].add_ms_per_mb is inf; expected a finite"),
        ('id = "north-1"', 'id = "north-1"\nlatency_ms = 1', "edge[0].device[0].latency_ms is not a key of a system file: remove it"),
    ],
)
def test_a_wrong_latency_gets_one_sentence(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(BadInput) as caught:
        loaded(tmp_path, WHOLE.replace(old, new, 1))
    assert message in str(caught.value)
