"""Uploads through dealing and nodes, on a made-up ground, every node in this process."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event, Warned
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.system_file import even_system
from radiant_app.run.dealing import Dealer
from radiant_app.run.pooled import PooledPhotographs
from radiant_app.workers.nodes import run_node
from radiant_core.aggregate.config import AggregateConfig, Join
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.frames import Frame
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_splats
from radiant_core.io.run_store import is_sealed, read_json, seal
from radiant_core.io.transport.upload import BYTES_FACTORS, UploadFormat, load_upload
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset
from tests.core.scenes import cameras_above, ground_splats

Note = Callable[[Event], None]


@pytest.fixture(scope="module")
def dealt(tmp_path_factory: pytest.TempPathFactory) -> Dealer:
    """A planned run of one edge with two devices, in float32; every test deals into a folder of its own."""
    folder = tmp_path_factory.mktemp("ground")
    truth, cameras = ground_splats(), cameras_above([(0, 1), (-2, -1), (-2, 1), (0, 0), (2, -1), (2, 1)], size_wh=(64, 48))
    # The first is held out.
    cameras = replace(cameras, names=tuple(f"{index}.png" for index in range(len(cameras))))
    (folder / "photos").mkdir()
    for view in render_views(truth, cameras):
        cv2.imwrite(str(folder / "photos" / view.name), view.image_bytes[..., ::-1])
    points, everyone = truth.means.astype(float), np.indices((len(truth), len(cameras))).reshape(2, -1).T
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3), residual_m=0.0)
    colors = np.full((len(points), 3), 128, np.uint8)
    scene = SfmScene(cameras=cameras, points=points, colors=colors, observations=everyone, frame=frame)
    photographs = PooledPhotographs(config=RunConfig(source=folder / "photos", out=folder / "run"), scene=scene, images=folder / "photos")
    positions = photographs.training.cameras.centers[:, :2]
    system = place_edges(even_system(1, 2), positions, None, 0)
    cloud_plan = plan_regions(positions, system)
    assert isinstance(cloud_plan, CloudPlan)
    recipe = Recipe(
        system=system,
        cloud_plan=cloud_plan,
        edge_plans=split_edges(positions, cloud_plan, system),
        train=replace(train_preset("draft"), num_steps=20, long_side_px=64, max_num_splats=300),
        aggregate=AggregateConfig(cloud=Join(epochs=1)),
        backend="native",
    )
    return Dealer(run=folder / "run", recipe=recipe, photographs=photographs)


def folded(dealer: Dealer, *, listen: Note = lambda event: None, without: str = "") -> Tree:
    """Run every node but those of the tier `without` and what needs them, as an executor would, here."""
    tree = tree_of_plan(dealer.recipe.cloud_plan, dealer.recipe.edge_plans)
    for node in tree:
        if without and (node.tier == without or any(child.tier == without for child in node)):
            continue
        task = dealer.prepare(node)
        assert task is not None
        if not is_sealed(task.folder, task.key):
            seal(task.folder, task.key, run_node(task.kind, task.folder, task.stage, listen))
    return tree


@pytest.fixture(scope="module")
def late(dealt: Dealer) -> Dealer:
    folded(dealt)
    return dealt


def with_devices_of(late: Dealer, folder: Path) -> Dealer:
    """A copy of a run whose devices are done."""
    shutil.copytree(late.run / "devices", folder / "devices")
    shutil.copyfile(late.run / "run.json", folder / "run.json")
    return replace(late, run=folder, access_log=[])


@pytest.mark.parametrize("upload", ["float16", "spz"])
def test_a_run_with_compressed_uploads_keeps_its_models_and_sends_less(late: Dealer, tmp_path: Path, upload: UploadFormat) -> None:
    small = replace(late, run=tmp_path, recipe=replace(late.recipe, upload=upload), access_log=[])
    tree = folded(small)
    for node in tree:
        if node.tier == "device":
            kept, sent = load_splats(tmp_path / node.id / "model.safetensors"), load_upload(tmp_path / node.id / "upload.safetensors")
            assert len(kept) == len(sent) and (kept.sh0 != sent.sh0).any()
            inbox = tmp_path / "edges" / "edge-1" / "inbox" / node.name / "model.safetensors"
            assert inbox.read_bytes() == (tmp_path / node.id / "upload.safetensors").read_bytes()
    received = {row["tier"]: row["other_bytes"] for row in small.access_log}
    exact = {row["tier"]: row["other_bytes"] for row in late.access_log}
    assert received["edge"] < 0.75 * exact["edge"] and received["cloud"] < 0.6 * exact["cloud"]
    scene, same = load_ply(tmp_path / "cloud" / "scene.ply"), load_ply(late.run / "cloud" / "scene.ply")
    assert len(scene) == pytest.approx(len(same), rel=0.05)
    folded(replace(small, access_log=[]), listen=lambda event: pytest.fail(f"a sealed node ran again: {event}"))


def test_a_model_that_the_format_cannot_hold_is_sent_as_float32_with_a_warning(late: Dealer, tmp_path: Path) -> None:
    assert isinstance(late.photographs, PooledPhotographs)
    scene = late.photographs.scene
    scattered = scene.points.copy()
    scattered[0] = 1e8
    photographs = replace(late.photographs, scene=replace(scene, points=scattered))
    far = replace(late, run=tmp_path, recipe=replace(late.recipe, upload="spz"), photographs=photographs, access_log=[])
    events: list[Event] = []
    folded(far, listen=events.append, without="edge")
    warned = [event for event in events if isinstance(event, Warned)]
    assert warned and all("uploaded as float32 instead of spz" in event.message for event in warned)
    device = warned[0].stage
    kept, sent = (load_upload(tmp_path / device / name) for name in ("model.safetensors", "upload.safetensors"))
    np.testing.assert_array_equal(kept.means, sent.means)


def test_the_plan_counts_the_bytes_of_the_upload() -> None:
    system = even_system(1, 2)
    device, small = system.devices[0], system.with_uploads_of(BYTES_FACTORS["spz"]).devices[0]
    sending_s = device.model_bytes(40) / device.uplink_bytes_per_s
    saved_s = device_time_s(device, 40) - device_time_s(small, 40)
    np.testing.assert_allclose(saved_s, sending_s * (1 - BYTES_FACTORS["spz"]), rtol=1e-12)


def prepared_edge(dealer: Dealer) -> tuple[NodeTask, list[str]]:
    """The edge of a run whose devices are done, before it runs, and its devices."""
    tree = tree_of_plan(dealer.recipe.cloud_plan, dealer.recipe.edge_plans)
    tasks = {node.id: dealer.prepare(node) for node in tree if node.tier != "cloud"}
    (edge,) = (task for name, task in tasks.items() if name.startswith("edges/") and task is not None)
    return edge, sorted(Path(name).name for name in tasks if name.startswith("devices/"))


def test_an_edge_leaves_out_what_was_changed_on_its_way(late: Dealer, tmp_path: Path) -> None:
    edge, (first, second) = prepared_edge(with_devices_of(late, tmp_path))
    inbox = edge.folder / "inbox"
    # Whole files of the right kind, but not those that were signed.
    shutil.copyfile(inbox / second / "cameras.safetensors", inbox / first / "cameras.safetensors")
    warnings: list[Event] = []
    run_node("edge", edge.folder, edge.stage, warnings.append)
    refused = read_json(edge.folder / "refused.json")
    assert list(refused) == [first] and "its sender signed" in refused[first]
    # What goes on to the cloud says nothing of who was refused.
    assert read_json(edge.folder / "frame.json") == {"status": "placed", "reason": "", "uncertainty": None}
    assert any(isinstance(event, Warned) and f"the model of {first} is left out" in event.message for event in warnings)


def test_uploads_of_another_run_or_key_are_refused(late: Dealer, tmp_path: Path) -> None:
    dealer = with_devices_of(late, tmp_path)
    (tmp_path / "run.json").unlink()
    edge, devices = prepared_edge(dealer)
    run_node("edge", edge.folder, edge.stage, lambda event: None)
    refused = read_json(edge.folder / "refused.json")
    assert sorted(refused) == devices and all("it belongs to run" in reason for reason in refused.values())
    # Somebody else's key beside the files is not the one that was registered.
    shutil.copyfile(late.run / "run.json", tmp_path / "run.json")
    edge, (first, second) = prepared_edge(dealer)
    shutil.copyfile(edge.folder / "senders" / f"{second}.pub", edge.folder / "senders" / f"{first}.pub")
    run_node("edge", edge.folder, edge.stage, lambda event: None)
    refused = read_json(edge.folder / "refused.json")
    assert list(refused) == [first] and "not signed by the key that is registered" in refused[first]


def test_a_renewed_key_makes_its_device_sign_anew(late: Dealer, tmp_path: Path) -> None:
    dealer = with_devices_of(late, tmp_path)
    _, (first, second) = prepared_edge(dealer)
    shutil.rmtree(tmp_path / "devices" / first / "identity")
    tree = tree_of_plan(dealer.recipe.cloud_plan, dealer.recipe.edge_plans)
    tasks = {Path(node.id).name: dealer.prepare(node) for node in tree if node.tier == "device"}
    sealed = {name: is_sealed(task.folder, task.key) for name, task in tasks.items() if task is not None}
    assert sealed == {first: False, second: True}
    folded(dealer)
    assert read_json(tmp_path / "edges" / "edge-1" / "refused.json") == {}
    assert read_json(tmp_path / "devices" / first / "delivery.json")["attempt"] == 2
