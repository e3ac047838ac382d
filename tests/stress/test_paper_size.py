"""A scene of the paper's size, 1,600 photographs over 500 × 250 m, and a quarter of it: generated,
read, planned and dealt to 4 edges with 4 devices each. Every stage runs in a process of its own,
which tells its time and its peak memory. Some ten minutes on one core; `python -m pytest -m stress
tests/stress/test_paper_size.py -s` prints the table of docs/experiments/paper_size.md.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.run.dealing import Dealer
from radiant_app.run.pooled import PooledPhotographs
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import tree_of_plan
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_plan, load_scene, save_plan, save_scene
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset

ROOT = Path(__file__).parents[2]
SIZES = {400: (250.0, 125.0), 1600: (500.0, 250.0)}
"""Cameras → metres: the same density, so that only the scene grows."""
KNOWN_POINTS_PER_CAMERA = 12
STAGES = ("generate", "read", "plan", "deal")
MIB = 2**20


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Seconds of one stage, and the most memory its process held, libraries included."""

    seconds: float
    peak_bytes: int


def fleet() -> System:
    """4 edges with 4 devices each, from half to double speed, 10 to 100 Mbit/s, the slowest with little memory."""
    rng = np.random.default_rng(0)

    def device(name: str, speed: float) -> Device:
        return Device(
            id=name,
            init_s=CostCurve(linear=0.1 / speed),
            train_s=CostCurve(constant=20 / speed, linear=1 / speed, power_coefficient=0.01 / speed, exponent=1.5),
            model_bytes=CostCurve(linear=0.5e6),
            uplink_bytes_per_s=float(rng.uniform(10e6, 100e6) / 8),
            max_cameras=60 if speed == 0.5 else None,
        )

    def edge(name: str) -> Edge:
        devices = tuple(device(f"{name}-{number}", speed) for number, speed in enumerate((0.5, 0.8, 1.25, 2.0)))
        aggregate_s = CostCurve(constant=5, linear=float(rng.uniform(0.1, 0.5)))
        return Edge(id=name, position=None, aggregate_s=aggregate_s, uplink_bytes_per_s=float(rng.uniform(5e6, 2e7)), devices=devices)

    return System(edges=tuple(edge(f"edge-{number}") for number in range(4)))


def training_scene(folder: Path) -> SfmScene:
    """The scene without its held-out cameras."""
    scene = load_scene(folder / "scene.safetensors")
    return scene.restricted_to(np.flatnonzero(~held_out_mask(scene.cameras.names)))


def placed_fleet(scene: SfmScene) -> System:
    """The fleet's edges among the cameras of the scene."""
    return place_edges(fleet(), scene.cameras.centers[:, :2], None, seed=0)


def generate_scene(folder: Path, num_cameras: int) -> None:
    """images/ and known/ by the project's own generator, 160 × 120 px with one ray per pixel."""
    sys.path.insert(0, str(ROOT / "sample_scenes"))
    from generate import generate
    from scenegen.config import SceneConfig

    config = SceneConfig(
        num_cameras=num_cameras,
        extent_m=SIZES[num_cameras],
        width_px=160,
        height_px=120,
        samples_per_axis=1,
        gps_error_m=3.0,
        num_known_points=KNOWN_POINTS_PER_CAMERA * num_cameras,
    )
    generate(config, folder)


def read_scene(folder: Path, num_cameras: int) -> None:
    """The owner's scene from the known model, as `radiant run` on a COLMAP project reads it."""
    from radiant_core.sfm.reconstruct import scene_from_colmap

    result = scene_from_colmap(folder / "known", folder / "images", folder / "sfm", lambda progress: None)
    assert len(result.scene.cameras) == num_cameras
    save_scene(folder / "scene.safetensors", result.scene)


def plan_scene(folder: Path, num_cameras: int) -> None:
    """Regions and strips from the positions alone."""
    scene = training_scene(folder)
    system = placed_fleet(scene)
    positions = scene.cameras.centers[:, :2]
    begun_s = time.perf_counter()
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan)
    edge_plans = split_edges(positions, plan, system)
    print(f"planned {len(positions)} positions in {(time.perf_counter() - begun_s) * 1e3:.0f} ms", file=sys.stderr)
    save_plan(folder / "plan.json", plan, edge_plans)


def deal_scene(folder: Path, num_cameras: int) -> None:
    """Every device's folder with its photographs and its part of the scene."""
    plan, edge_plans = load_plan(folder / "plan.json")
    scene = load_scene(folder / "scene.safetensors")
    config = RunConfig(source=folder / "images", out=folder / "run")
    photographs = PooledPhotographs(config=config, scene=scene, images=folder / "images")
    recipe = Recipe(
        system=placed_fleet(photographs.training),
        cloud_plan=plan,
        edge_plans=tuple(edge_plans),
        train=train_preset("draft"),
        aggregate=AggregateConfig(),
        backend="native",
    )
    dealer = Dealer(run=folder / "run", recipe=recipe, photographs=photographs)
    for node in tree_of_plan(plan, edge_plans):
        if node.tier == "device":
            dealer.prepare(node)


def peak_bytes() -> int:
    """The most memory that this process held; unlike getrusage's maximum it starts anew with the program."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1]) * 1024


def run_stage(stage: str, folder: Path, num_cameras: int) -> Cost:
    """One stage in a fresh process, on one thread."""
    command = [sys.executable, __file__, stage, str(folder), str(num_cameras)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    finished = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)
    return Cost(**json.loads(finished.stdout.splitlines()[-1]))


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, dict[str, Cost]]]:
    """Both sizes, every stage run: folder and costs by number of cameras."""
    made = {}
    for num_cameras in SIZES:
        folder = tmp_path_factory.mktemp(f"cameras_{num_cameras}")
        made[num_cameras] = folder, {stage: run_stage(stage, folder, num_cameras) for stage in STAGES}
    print("\n| stage | " + " | ".join(f"{count} cameras: s, peak MiB" for count in SIZES) + " |")
    for stage in STAGES:
        costs = [made[count][1][stage] for count in SIZES]
        print(f"| {stage} | " + " | ".join(f"{c.seconds:.1f}, {c.peak_bytes / MIB:.0f}" for c in costs) + " |")
    return made


@pytest.fixture(scope="module")
def planned(scenes: dict[int, tuple[Path, dict[str, Cost]]]) -> tuple[SfmScene, System, CloudPlan, tuple[EdgePlan, ...]]:
    """The large scene's training cameras, its system and its plan."""
    folder, _ = scenes[1600]
    scene = training_scene(folder)
    plan, edge_plans = load_plan(folder / "plan.json")
    return scene, placed_fleet(scene), plan, tuple(edge_plans)


@pytest.mark.stress
def test_the_generated_scene_is_what_was_asked_for(scenes) -> None:
    for num_cameras, (folder, _) in scenes.items():
        assert len(list((folder / "images").iterdir())) == num_cameras
        scene = load_scene(folder / "scene.safetensors")
        assert len(scene.cameras) == num_cameras and scene.frame.kind == "metric"
        assert len(scene.points) > 0.7 * KNOWN_POINTS_PER_CAMERA * num_cameras, "points that two cameras see"
        # Rows end half a spacing (under 10 m) inside the border; with 3 m of GPS noise the frame is
        # good to far less than a metre.
        assert (np.ptp(scene.cameras.centers[:, :2], axis=0) > np.array(SIZES[num_cameras]) - 20).all()


@pytest.mark.stress
def test_every_training_camera_has_exactly_one_device_that_can_hold_it(planned) -> None:
    scene, system, plan, edge_plans = planned
    dealt = np.concatenate([plan.cameras_of(device) for plan in edge_plans for device in plan.device_ids])
    assert len(scene.cameras) == 1400
    np.testing.assert_array_equal(np.sort(dealt), np.arange(1400))
    assert len(plan.edge_ids) == 4 and (plan.counts > 0).all()
    for device in system.devices:
        count = sum(len(plan.cameras_of(device.id)) for plan in edge_plans if device.id in plan.device_ids)
        assert count <= (1400 if device.max_cameras is None else device.max_cameras)


@pytest.mark.stress
def test_no_quotas_and_no_counts_would_be_faster(planned) -> None:
    """Against the planner's own sort: with a deadline any shorter, the devices (and the edges) could not take all cameras."""
    _, system, plan, edge_plans = planned
    for edge, edge_plan in zip(system.edges, edge_plans, strict=True):
        deadline_s = edge_plan.device_time_s.max()
        fitting = [_most_cameras(lambda k, d=device: device_time_s(d, k), deadline_s, device.max_cameras) for device in edge.devices]
        assert sum(fitting) < len(edge_plan.camera_indices), edge.id
    curves = [_edge_time_s(edge) for edge in system.edges]
    assert [curve(count) for curve, count in zip(curves, plan.counts, strict=True)] == pytest.approx(list(plan.edge_time_s), rel=1e-9)
    assert sum(_most_cameras(curve, plan.makespan_s * (1 - 1e-9), None) for curve in curves) < 1400
    assert plan.status == "optimal" and plan.certified and plan.makespan_s == pytest.approx(plan.lower_bound_s, rel=1e-12)


def _most_cameras(time_s, deadline_s: float, limit: int | None) -> int:
    """How many cameras end before the deadline, by bisection on a time that never falls."""
    low, high = 0, 1400 if limit is None else limit
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if time_s(middle) < deadline_s else (low, middle - 1)
    return low


def _edge_time_s(edge: Edge):
    """T^m(c) without the planner's sort: bisection on the devices' deadline, then the paper's sum."""

    def quotas(num_cameras: int) -> list[int]:
        low_s, high_s = 0.0, 1e6
        for _ in range(100):
            middle_s = (low_s + high_s) / 2
            fits = sum(_most_cameras(lambda k, d=device: device_time_s(d, k), middle_s, device.max_cameras) for device in edge.devices)
            low_s, high_s = (low_s, middle_s) if fits >= num_cameras else (middle_s, high_s)
        return [_most_cameras(lambda k, d=device: device_time_s(d, k), high_s, device.max_cameras) for device in edge.devices]

    def edge_time_s(num_cameras: int) -> float:
        counts = quotas(num_cameras)
        slowest_s = max(float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True))
        sent = sum(float(device.model_bytes(count)) for device, count in zip(edge.devices, counts, strict=True))
        return slowest_s + float(edge.aggregate_s(num_cameras)) + sent / edge.uplink_bytes_per_s

    return edge_time_s


@pytest.mark.stress
def test_every_camera_lies_in_its_power_cell_and_its_strip(planned) -> None:
    from shapely import Point, Polygon

    scene, _, plan, edge_plans = planned
    positions = scene.cameras.centers[:, :2]
    power_m2 = np.sum((positions[:, None] - plan.sites) ** 2, axis=2) - plan.weights
    own_m2 = power_m2[np.arange(1400), plan.edge_of_camera]
    # Rounding of squared distances up to 500 m: 2.5e5 m² · 1e-12.
    assert (own_m2 - power_m2.min(axis=1)).max() < 1e-6
    for edge_plan in edge_plans:
        strips = [Polygon(strip).buffer(1e-6) if len(strip) else Polygon() for strip in edge_plan.strips]
        for camera, device in zip(edge_plan.camera_indices, edge_plan.device_of_camera, strict=True):
            assert strips[device].contains(Point(positions[camera]))


@pytest.mark.stress
def test_devices_get_their_own_photographs_and_no_others(scenes, planned) -> None:
    scene, _, _, edge_plans = planned
    folder, _ = scenes[1600]
    for plan in edge_plans:
        for device in plan.device_ids:
            names = sorted(np.array(scene.cameras.names)[plan.cameras_of(device)].tolist())
            place = folder / "run" / "devices" / device
            assert sorted(path.name for path in place.glob("photos/*")) == names
            assert sorted(load_scene(place / "scene.safetensors").cameras.names) == names if names else not place.exists()


@pytest.mark.stress
def test_neither_planning_nor_dealing_holds_photographs(scenes) -> None:
    (_, small), (folder, large) = scenes[400], scenes[1600]
    sparse_bytes = (folder / "scene.safetensors").stat().st_size
    # What grows is the owner's sparse scene (points and who sees them) while its training part is
    # taken out: some six copies of it.
    assert large["plan"].peak_bytes - small["plan"].peak_bytes < 8 * sparse_bytes
    # Dealing then adds one device's part at a time and no photograph: all of them decoded would be
    # 88 MiB.
    assert large["deal"].peak_bytes - large["plan"].peak_bytes < 16 * MIB
    assert large["plan"].peak_bytes < 512 * MIB
    assert large["plan"].seconds < 20 and large["generate"].peak_bytes < 2048 * MIB


if __name__ == "__main__":
    run = {"generate": generate_scene, "read": read_scene, "plan": plan_scene, "deal": deal_scene}[sys.argv[1]]
    began_s = time.perf_counter()
    run(Path(sys.argv[2]), int(sys.argv[3]))
    print(json.dumps({"seconds": time.perf_counter() - began_s, "peak_bytes": peak_bytes()}))


@pytest.mark.stress
def test_training_at_draft_size_takes_no_more_memory_anywhere_for_the_whole_scene(scenes, tmp_path: Path) -> None:
    """The quarter on one edge with four devices and the whole on four edges: every device and edge has as many photographs in both."""
    peaks = {}
    for num_cameras, num_edges in ((400, 1), (1600, 4)):
        folder = scenes[num_cameras][0]
        system = tmp_path / f"{num_edges}.toml"
        devices = [[f'[[edge.device]]\nid = "{edge}-{device}"\n' for device in range(4)] for edge in range(num_edges)]
        system.write_text("".join(f'[[edge]]\nid = "edge-{edge}"\n{"".join(own)}' for edge, own in enumerate(devices)))
        size = ["--long-side-px", "160", "--steps", "300", "--max-splats", "8000"]
        source = [str(folder / "images"), "--poses", str(folder / "known"), "--frames", "known", "--system", str(system)]
        command = [sys.executable, "-m", "radiant_app", "run", *source, "--train-preset", "draft", *size, "--json"]
        # A process of its own: the peak of one that has run before is that of both.
        out = tmp_path / f"run_{num_cameras}"
        done = subprocess.run([*command, "--out", str(out)], check=True, capture_output=True, text=True)
        metrics = json.loads(done.stdout)
        assert metrics["missing"] == {} and len(metrics["images"]) == num_cameras // 8
        assert all(row["psnr_db"] > row["initial_psnr_db"] for row in metrics["images"])
        found = metrics["peak_bytes"]
        peaks[num_cameras] = {
            tier: max(found[node] for node in found if node.startswith(tier)) for tier in ("devices", "edges", "cloud", "run")
        }
        seconds = sum(metrics["seconds"].values())
        print(
            f"\n{num_cameras} cameras: {metrics['psnr_db']:.2f} dB, {metrics['num_gaussians']:,} Gaussians, {seconds:.0f} s of processes",
            end="",
        )
        print({tier: f"{peak / MIB:.0f} MiB" for tier, peak in peaks[num_cameras].items()})
    for tier in ("devices", "edges"):
        assert peaks[1600][tier] < 1.1 * peaks[400][tier], tier
    # The cloud and the process that plans hold the scene they deliver, nothing else of it.
    assert peaks[1600]["cloud"] - peaks[400]["cloud"] < 64 * MIB and peaks[1600]["run"] - peaks[400]["run"] < 256 * MIB
