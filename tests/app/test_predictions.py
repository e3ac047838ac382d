"""Memory alone limits what a device is planned to hold, by the trainer's own model; a count given beside it wins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiant_app.config.run_config import PlanOptions, RunConfig, SfmOptions
from radiant_app.executors.emulated import RESUMED
from radiant_app.files.run_folder import Manifest
from radiant_app.files.system_file import dump_system
from radiant_app.report.prediction_error import gantt_rows, prediction_of
from radiant_app.run.captured import Captured
from radiant_app.run.on_devices import DevicePhotographs
from radiant_app.run.predictions import (
    BESIDE_EPOCHS,
    BESIDE_EPOCHS_AT_CLOUD,
    KNOWN_POSES_SHARE,
    depends_on_training,
    planned_training,
    predicts_frames,
    refining_law_of,
    with_camera_limits,
    with_own_frames,
    with_short_joins,
    with_step_law,
)
from radiant_app.run.progress import Progress
from radiant_app.run.stages import FRAMES_UNPREDICTED, warn_about_predictions
from radiant_app.together.places import GROUP_FOLDER
from radiant_core.aggregate.config import AggregateConfig, Refine, aggregate_preset
from radiant_core.io.run_store import write_json
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Cloud, System
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.memory import BASE_BYTES, IMAGE_BYTES_PER_PX, PROCESS_BYTES, STEP_BYTES_PER_PX, bytes_per_splat, most_cameras
from tests.core.plan.test_prediction import SYSTEM, planned
from tests.core.plan.test_profiles import MEASURED
from tests.core.plan.test_profiles import system as system_of

TRAIN = TrainConfig(long_side_px=400, max_num_splats=10**9)
PIXELS = 400 * 300
SPLATS_PER_PHOTOGRAPH = 5_000
POSITIONS = np.random.default_rng(0).random((300, 2)) * 100


def system_with(*memory_gb: float | None, max_cameras: int | None = None) -> System:
    """Equal devices whose models have 5,000 Gaussians of 92 bytes per photograph."""
    (edge,) = system_of(*[None] * len(memory_gb)).edges
    devices = tuple(
        replace(
            device,
            memory_bytes=None if memory is None else memory * 1e9,
            max_cameras=max_cameras,
            model_bytes=CostCurve(linear=92.0 * SPLATS_PER_PHOTOGRAPH),
        )
        for device, memory in zip(edge.devices, memory_gb, strict=True)
    )
    return System(edges=(replace(edge, devices=devices),))


def needed_bytes(count: int) -> float:
    """The trainer's model, written out."""
    fixed = PROCESS_BYTES + BASE_BYTES + IMAGE_BYTES_PER_PX * count * PIXELS + STEP_BYTES_PER_PX * PIXELS
    return fixed + count * SPLATS_PER_PHOTOGRAPH * bytes_per_splat(TRAIN.sh_degree)


def profiled(**changes: Any) -> System:
    """Two devices of one profile, the second half as fast as the machine that was measured."""
    init, train = FittedCurve(curve=CostCurve(constant=6.0), smallest_count=5, largest_count=50), FITTED_TRAINING
    profile = replace(MEASURED, key=replace(MEASURED.key, num_steps=500), init_s=init, train_s=train, **changes)
    (edge,) = system_of(profile, profile).edges
    first, second = (replace(own, init_s=init.curve, train_s=train.curve) for own in edge.devices)
    second = replace(second, init_s=init.curve.scaled(2.0), train_s=train.curve.scaled(2.0))
    return System(edges=(replace(edge, devices=(first, second)),))


FITTED_TRAINING = FittedCurve(curve=CostCurve(constant=8.0, linear=0.1), smallest_count=5, largest_count=50)


def test_measured_devices_cost_the_steps_that_their_photographs_ask_for() -> None:
    train = replace(TRAIN, num_steps=1_000)
    system = with_step_law(profiled(), train, 60)
    for device, slower in zip(system.devices, (1.0, 2.0), strict=True):
        for count in (10, 30, 60):
            # 1,000 steps for the mean of 30 photographs, 500 were measured.
            assert float(device.train_s(count)) == pytest.approx(slower * (8.0 + 0.1 * count) * (1_000 * count / 30) / 500, rel=0.03)
    spelt_out = system_of(None, None)
    assert with_step_law(spelt_out, train, 60) == spelt_out


def test_measured_edges_and_the_cloud_cost_the_epochs_that_follow_on_short_trainings() -> None:
    curve, alone = CostCurve(linear=0.5), CostCurve(constant=2.0, linear=0.1)
    (edge,) = profiled().edges
    edge = replace(edge, profile=MEASURED, aggregate_s=curve, aggregate_alone_s=None)
    system = System(edges=(edge,), cloud=Cloud(merge_s=curve))
    train = replace(TRAIN, num_steps=1_000, max_epochs=None)
    # 1,000 steps for 10 photographs a device, 100 times each, then for 50, 20 times each.
    assert with_short_joins(system, train, 20, AggregateConfig()) == system
    short = with_short_joins(system, train, 100, AggregateConfig())
    at_edges = BESIDE_EPOCHS + (1 - BESIDE_EPOCHS) * 0.1
    assert float(short.edges[0].aggregate_s(40)) == pytest.approx(20 * at_edges)
    assert short.cloud.merge_s is not None and float(short.cloud.merge_s(40)) == pytest.approx(20 * BESIDE_EPOCHS_AT_CLOUD)
    alone_known = System(edges=(replace(edge, aggregate_alone_s=alone),))
    (with_alone,) = with_short_joins(alone_known, train, 100, AggregateConfig()).edges
    for count, expected in ((40, 6 + at_edges * (20 - 6)), (4, 2.4)):
        assert float(with_alone.aggregate_s(count)) == pytest.approx(expected, rel=0.05), "no less than what one device takes"
    assert with_short_joins(system, train, 100, aggregate_preset("paper")) == system
    assert with_short_joins(system, train, 100, AggregateConfig(refine=Refine(epochs=0))) == system
    spelt_out = System(edges=(replace(edge, profile=None),), cloud=Cloud(merge_s=curve))
    assert with_short_joins(spelt_out, train, 100, AggregateConfig()) == spelt_out


def test_devices_that_place_their_own_photographs_cost_their_structure_from_motion() -> None:
    sfm = FittedCurve(curve=CostCurve(linear=1.5, power_coefficient=0.1, exponent=2.0), smallest_count=5, largest_count=24)
    for device, slower in zip(with_own_frames(profiled(sfm_s=sfm), 60).devices, (1.0, 2.0), strict=True):
        for count in (5, 24, 60):
            assert float(device.init_s(count)) == pytest.approx(slower * (6.0 + 1.5 * count + 0.1 * count**2), rel=0.03)
    assert with_own_frames(profiled(), 60) == profiled()
    first = with_own_frames(profiled(sfm_s=sfm), 60, known_poses=True).devices[0]
    assert float(first.init_s(24)) == pytest.approx(6.0 + KNOWN_POSES_SHARE * (1.5 * 24 + 0.1 * 24**2), rel=0.03)


def test_models_that_gps_has_placed_cost_the_joins_what_one_frame_takes() -> None:
    curve, alone = CostCurve(constant=1.0, linear=0.5), CostCurve(constant=1.0)
    profile = replace(MEASURED, frames_s=8.0)
    (edge,) = system_of(None, None, None).edges
    edge = replace(edge, profile=profile, aggregate_s=curve, aggregate_alone_s=alone)
    system = System(
        edges=(edge, replace(edge, id="other", devices=(replace(edge.devices[0], id="lone"),))),
        cloud=Cloud(merge_s=curve, profile=replace(MEASURED, frames_alone_s=9.0)),
    )
    three, one = with_own_frames(system, 60).edges
    cloud = with_own_frames(system, 60).cloud
    # Three devices are two pairs, one device none, two edges one.
    assert float(three.aggregate_s(40)) == 21.0 + 2 * 8.0 and three.aggregate_alone_s == alone
    assert one.aggregate_s == curve and cloud.merge_s is not None and float(cloud.merge_s(40)) == 21.0 + 9.0
    assert with_own_frames(system, 60, known_poses=True) == system
    unknown = System(edges=tuple(replace(own, profile=MEASURED) for own in system.edges), cloud=replace(system.cloud, profile=MEASURED))
    assert with_own_frames(unknown, 60) == unknown
    assert predicts_frames(system) and not predicts_frames(unknown)
    assert not predicts_frames(replace(system, cloud=unknown.cloud)) and not predicts_frames(replace(unknown, cloud=system.cloud))
    assert predicts_frames(System(edges=(three,), cloud=unknown.cloud)), "one edge's model is alone at the cloud"
    assert predicts_frames(System(edges=(replace(one, profile=MEASURED),))), "as one device's is at its edge"
    spelt_out = System(edges=tuple(replace(own, profile=None) for own in system.edges), cloud=Cloud(merge_s=curve))
    assert predicts_frames(spelt_out) and with_own_frames(spelt_out, 60) == spelt_out, "what a file spells out is believed"


def test_devices_with_folders_of_their_own_are_predicted_and_warned_of_as_dealt_ones_are(tmp_path: Path) -> None:
    known = replace(MEASURED, frames_s=8.0, sfm_s=FittedCurve(curve=CostCurve(linear=2.0), smallest_count=5, largest_count=24))
    xy = np.random.default_rng(0).uniform(-50, 50, (30, 2))
    for profile, expected in ((known, 0), (MEASURED, 1)):
        (edge,) = system_of(profile, profile).edges
        system = System(edges=(replace(edge, profile=profile, aggregate_s=CostCurve(linear=0.5), position=(0.0, 0.0)),))
        out = tmp_path / profile.name.replace(".", "") / str(expected)
        out.mkdir(parents=True)
        owners = tuple(device.id for device in system.devices for _ in range(15))
        names = tuple(f"{row:02d}.jpg" for row in range(30))
        captured = Captured(
            names=names, owners=owners, positions=np.column_stack([xy, np.full(30, 50.0)]), origin=np.array([47.0, 8.0, 400.0])
        )
        config = RunConfig(source=tmp_path, out=out, frames="gps", plan=PlanOptions(raster_cell_m=0.0))
        manifest = Manifest(folder=out, config={})
        progress = Progress(manifest=manifest, listener=lambda event: None, clock=lambda: 0.0, started_s=0.0)
        photographs = DevicePhotographs(config=config, captured=captured, folders=dict.fromkeys(owners, tmp_path), poses=None)
        plan = photographs.make_plan(system, progress)
        assert str(manifest.warnings).count(FRAMES_UNPREDICTED) == expected
        (planned_edge,) = plan.system.edges
        by_frames = planned_edge.aggregate_s.constant - with_short_joins(system, *_run_of(config, 27)).edges[0].aggregate_s.constant
        assert by_frames == pytest.approx(0.0 if expected else 8.0)
        assert (float(planned_edge.devices[0].init_s(15)) > float(edge.devices[0].init_s(15)) + 2) == (not expected)


def _run_of(config: RunConfig, num_cameras: int) -> tuple[TrainConfig, int, AggregateConfig]:
    return planned_training(config.train.preset, config.train.overrides), num_cameras, config.joining


@pytest.mark.parametrize(("frames", "of_profile", "expected"), [("gps", True, 1), ("known", True, 0), ("gps", False, 0)])
def test_frames_by_gps_are_said_to_be_in_no_profile(tmp_path: Path, frames: Any, of_profile: bool, expected: int) -> None:
    config = RunConfig(source=tmp_path, out=tmp_path, frames=frames, sfm=SfmOptions(poses=tmp_path if frames == "known" else None))
    system = System(edges=tuple(replace(edge, profile=MEASURED if of_profile else None) for edge in SYSTEM.edges))
    manifest = Manifest(folder=tmp_path, config={})
    progress = Progress(manifest=manifest, listener=lambda event: None, clock=lambda: 0.0, started_s=0.0)
    warnings = warn_about_predictions(config, system, planned()[1], progress)
    said = [message for message in warnings if message == FRAMES_UNPREDICTED]
    assert len(said) == expected and len(warnings) == len(manifest.warnings)


def test_the_plan_keeps_to_what_memory_holds() -> None:
    system, decision, warnings = with_camera_limits(system_with(1.0, None), TRAIN, len(POSITIONS))
    small, large = system.devices
    assert small.max_cameras is not None and large.max_cameras is None and warnings == ()
    assert needed_bytes(small.max_cameras) <= 1e9 < needed_bytes(small.max_cameras + 1)
    assert decision is not None and f"{small.max_cameras:,} photographs" in decision.choice
    # Ten times as fast, it would get nearly all of them.
    quick = replace(small, train_s=CostCurve(linear=0.01), init_s=CostCurve(), model_bytes=CostCurve())
    edge = replace(system.edges[0], devices=(quick,))
    other = replace(system.edges[0], id="f", position=(90.0, 90.0), devices=(large,))
    plan = plan_regions(POSITIONS, System(edges=(edge, other)))
    assert isinstance(plan, CloudPlan) and plan.counts.tolist() == [small.max_cameras, len(POSITIONS) - small.max_cameras]


def test_a_count_of_cameras_stays_what_the_file_says() -> None:
    given_both = system_with(1.0, max_cameras=7)
    assert with_camera_limits(given_both, TRAIN, 300) == (given_both, None, ())
    assert not depends_on_training(given_both) and depends_on_training(system_with(1.0)) and not depends_on_training(system_with(None))


def test_where_memory_holds_too_few_devices_train_with_fewer_gaussians() -> None:
    system, _, (warning,) = with_camera_limits(system_with(0.8, 0.8), TRAIN, len(POSITIONS))
    assert "of 300 photographs with all the Gaussians" in warning
    assert all(device.max_cameras is not None and device.max_cameras >= 150 for device in system.devices)
    nothing, _, _ = with_camera_limits(system_with(0.3), TRAIN, 300)
    assert nothing.devices[0].max_cameras == 0


def test_uploads_in_fewer_bytes_hold_as_many_gaussians() -> None:
    exact, _, _ = with_camera_limits(system_with(1.0, None), TRAIN, 300)
    halved, _, _ = with_camera_limits(system_with(1.0, None).with_uploads_of(0.52), TRAIN, 300, 0.52)
    assert exact.devices[0].max_cameras == halved.devices[0].max_cameras


@given(st.floats(1e6, 1e13), st.floats(0, 1e7), st.integers(1, 10**7))
def test_the_largest_count_that_fits_is_found(memory_bytes: float, per_photograph: float, num_cameras: int) -> None:
    def needs(count: int) -> float:
        splats = max(1_000, min(per_photograph * count, TRAIN.max_num_splats))
        fixed = PROCESS_BYTES + BASE_BYTES + IMAGE_BYTES_PER_PX * count * PIXELS + STEP_BYTES_PER_PX * PIXELS
        return fixed + splats * bytes_per_splat(TRAIN.sh_degree)

    found = most_cameras(TRAIN, memory_bytes, lambda count: per_photograph * count, num_cameras)
    assert 0 <= found <= num_cameras
    assert found == 0 or needs(found) <= memory_bytes * (1 + 1e-12)
    assert found == num_cameras or needs(found + 1) > memory_bytes * (1 - 1e-12)


@pytest.mark.parametrize("limit", [1_000, 50_000])
def test_a_limit_of_gaussians_leaves_room_for_photographs(limit: int) -> None:
    few = most_cameras(replace(TRAIN, max_num_splats=limit), 1e9, lambda count: 5_000.0 * count, 10_000)
    assert few > most_cameras(TRAIN, 1e9, lambda count: 5_000.0 * count, 10_000)


@pytest.mark.usefixtures("usual_rounds")
def test_the_law_has_the_rounds_and_steps_of_a_run() -> None:
    train, aggregate = train_preset("default"), AggregateConfig()
    train = replace(train, num_steps=1500)
    long, short = (refining_law_of(train, aggregate, count, 4) for count in (52, 400))
    assert (long.num_rounds, short.num_rounds) == (1, 5)
    # Eight epochs of 13 photographs, and 200 steps at most of 100; trainings of 1,500 steps each.
    assert long.share_of_training(13) == pytest.approx(104 / 1500) and short.share_of_training(100) == pytest.approx(200 / 1500)
    fixed = refining_law_of(train, aggregate, 52, 4, fixed=True)
    assert fixed.share_of_training(5) == pytest.approx(40 / 1500) and fixed.num_rounds == long.num_rounds
    # 500 steps of four devices with five photographs each: five epochs.
    assert refining_law_of(replace(train, num_steps=500), aggregate, 20, 4).share_of_training(5) == pytest.approx(25 / 500)
    for nothing in (refining_law_of(train, AggregateConfig(refine=Refine(epochs=0)), 52, 4), refining_law_of(train, aggregate, 0, 4)):
        assert nothing.num_rounds == 0 and nothing.share_of_training(5) == 0


def edges_of_a_run() -> tuple[System, tuple[EdgePlan, ...], RefiningLaw]:
    _, edges, _ = planned()
    return SYSTEM, edges, RefiningLaw(num_rounds=2, share_of_training=lambda count: count / 1000)


def manifest_of(seconds: dict[str, float], **changes: Any) -> Manifest:
    stages = {node: {"started_s": 5.0, "ended_s": 5.0 + spent_s} for node, spent_s in seconds.items()}
    return Manifest(folder=Path("unused"), config={}, stages=stages, **changes)


def test_refining_is_compared_over_the_rounds_that_were_taken(tmp_path: Path) -> None:
    system, edges, law = edges_of_a_run()
    (tmp_path / "system.toml").write_bytes(dump_system(system).encode())
    # Of edge a the second device is the slowest, then its edge; edge b is faster; then the cloud.
    first = {"devices/a1/refine": 3.0, "devices/a2/refine": 7.0, "edges/a/refine": 2.0, "devices/b1/refine": 4.0, "edges/b/refine": 1.0}
    first["cloud/refine"] = 0.5
    second = {f"{node}2": 2 * spent_s for node, spent_s in first.items()}
    for seconds, number in ((first, 1), (first | second, 2)):
        row = prediction_of(tmp_path, manifest_of(seconds), edges, law)["refining"]
        assert row["measured_s"] == pytest.approx(9.5 if number == 1 else 28.5)
        predicted_s = predict_refining(system, edges, replace(law, num_rounds=number), with_sending=False)
        assert row["predicted_s"] == pytest.approx(predicted_s) and row["stage"] == "refine"


def test_refining_is_not_compared_where_a_time_is_not_known(tmp_path: Path) -> None:
    system, edges, law = edges_of_a_run()
    (tmp_path / "system.toml").write_bytes(dump_system(system).encode())
    seconds = {"devices/a1/refine": 3.0, "edges/a/refine": 1.0, "cloud/refine": 0.5}
    resumed = manifest_of({**seconds, "devices/a1/refine": 0.0})
    emulated = manifest_of(seconds, emulated={"devices/a1": {"started_s": 0.0, "ended_s": 9.0}})
    for manifest, rounds in ((manifest_of({}), law), (resumed, law), (emulated, law), (manifest_of(seconds), None)):
        assert prediction_of(tmp_path, manifest, edges, rounds)["refining"] is None


GROUP = GroupPlan(level="edge", edges=("a",), views={"a1": 1, "a2": 1}, num_photographs=30, num_steps=100, step_s=0.2, end_s=2.0)


def test_machines_that_train_together_have_one_time_and_the_others_their_stages(tmp_path: Path) -> None:
    system, edges, _ = edges_of_a_run()
    (tmp_path / "system.toml").write_bytes(dump_system(system).encode())
    seconds = {"devices/a1": 30.0, "devices/a2": 31.0, "edges/a": 33.0, "edges/b": 4.0, "cloud": 5.0}
    prediction = prediction_of(tmp_path, manifest_of(seconds), edges, groups=(GROUP,))
    (row,) = prediction["together"]
    assert (row["node"], row["stage"], row["num_cameras"]) == ("edges/a", "together", 30)
    assert (row["predicted_s"], row["measured_s"]) == pytest.approx((22.0, 33.0))
    # The law of joined models says nothing about them, nor about the whole.
    assert {row["node"] for row in prediction["stages"]} <= {"edges/b", "cloud"} and prediction["makespan"] is None
    assert "edges/b" in {row["node"] for row in prediction["stages"]}
    of_all = replace(GROUP, level="cloud", edges=("a", "b"), views={"a1": 1, "a2": 1, "b1": 1})
    prediction = prediction_of(tmp_path, manifest_of({**seconds, "devices/b1": 40.0}), edges, groups=(of_all,))
    assert [(row["node"], row["measured_s"]) for row in prediction["together"]] == [("cloud", pytest.approx(40.0))]
    assert prediction["stages"] == [] and prediction["median_error_percent"] == pytest.approx(45.0)


def test_the_time_of_a_group_is_not_known_where_a_machine_was_skipped(tmp_path: Path) -> None:
    system, edges, _ = edges_of_a_run()
    (tmp_path / "system.toml").write_bytes(dump_system(system).encode())
    for seconds in ({"devices/a1": 30.0, "devices/a2": 0.0, "edges/a": 33.0}, {}):
        assert prediction_of(tmp_path, manifest_of(seconds), edges, groups=(GROUP,))["together"] == []
    seconds = {"devices/a1": 30.0, "devices/a2": 31.0, "edges/a": 33.0}
    assert prediction_of(tmp_path, manifest_of(seconds), edges, groups=(GROUP,))["together"] != []
    resumed = manifest_of(seconds, warnings=[f"edges/a: {RESUMED}"])
    assert prediction_of(tmp_path, resumed, edges, groups=(GROUP,))["together"] == []


def test_a_chart_has_no_planned_stages_of_machines_that_train_together(tmp_path: Path) -> None:
    system, edges, _ = edges_of_a_run()
    for node in ("devices/a1", "devices/a2", "edges/a"):
        (tmp_path / node / GROUP_FOLDER).mkdir(parents=True)
    for node in ("devices/a1", "devices/a2"):
        write_json(tmp_path / node / "summary.json", {"train_s": 10.0})
    manifest = manifest_of({"devices/a1": 30.0, "devices/a2": 31.0, "edges/a": 33.0, "edges/b": 4.0})
    rows = {row.name: row for row in gantt_rows(system, edges, tmp_path, manifest)}
    assert not rows["edges/a"].predicted and not rows["devices/a1"].predicted
    assert rows["edges/b"].predicted
    bars = {name: [(span.stage, span.stop_s - span.start_s) for span in row.measured] for name, row in rows.items()}
    assert bars["devices/a1"] == [("train", pytest.approx(30.0))] and bars["edges/a"] == [("train", pytest.approx(33.0))]
    assert bars["edges/b"] == [("aggregate", pytest.approx(4.0))]
    assert all(row.predicted for row in gantt_rows(system, edges))
