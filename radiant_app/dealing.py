"""Lays into each node's folder what it may read, and nothing else: photographs to devices, models to edges and to the cloud.

Called by the executor when a node's children are done. The ledger counts what each tier received.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from radiant_app.cloud_task import retrain_settings
from radiant_app.executors.protocol import NodeTask
from radiant_app.inbox import VIRTUAL_CAMERAS
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import Tree
from radiant_core.cameras import Cameras
from radiant_core.io.records import save_cameras, save_scene
from radiant_core.io.run_store import content_key, write_json
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig

Filled = tuple[dict[str, Any], Sequence[Path]]
"""The content of a node's task.json and the files it may read besides."""


@dataclass(kw_only=True)
class Dealer:
    """Prepares the nodes of one planned run."""

    run: Path
    system: System
    cloud_plan: CloudPlan
    edge_plans: tuple[EdgePlan, ...]
    train: TrainConfig
    aggregate: AggregateConfig
    backend: str
    ledger: list[dict[str, Any]] = field(default_factory=list)

    def prepare(self, node: Tree) -> NodeTask | None:
        """Fill the node's folder and say what to run there; None where nothing arrived that could be joined."""
        folder = self.run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        fill = {"device": self.fill_device, "edge": self.fill_edge, "cloud": self.fill_cloud}[node.tier]
        filled = fill(node, folder)
        if filled is None:
            return None
        task, inputs = filled
        write_json(folder / "task.json", task)
        self.ledger.append({"node": node.id, "tier": node.tier, **received(inputs)})
        return NodeTask(kind=self.kinds[node.tier], stage=node.id, folder=folder, key=content_key(__version__, task, *inputs))

    @property
    def kinds(self) -> dict[str, str]:
        """Which worker runs the nodes of a tier."""
        return {"device": "device", "edge": "edge", "cloud": "cloud"}

    def fill_device(self, node: Tree, folder: Path) -> Filled:
        """Settings and files of a device."""
        raise NotImplementedError

    def fill_edge(self, node: Tree, folder: Path) -> Filled | None:
        """Settings and files of an edge: what its devices delivered."""
        raise NotImplementedError

    def fill_cloud(self, node: Tree, folder: Path) -> Filled | None:
        """Settings and files of the cloud: what the edges delivered, and the plan's borders."""
        edges = [name_of(child) for child in node.children]
        return self.cloud_task(
            edges, folder, ["model.safetensors", VIRTUAL_CAMERAS] if self.aggregate.cloud == "retrain" else ["model.safetensors"]
        )

    def cloud_task(self, edges: Sequence[str], folder: Path, files: Sequence[str]) -> Filled:
        """The cloud's settings with `files` of these edges in its inbox."""
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        for edge in edges:
            deal_files(self.run / "edges" / edge, files, folder / "inbox" / edge)
        rows = [self.cloud_plan.edge_ids.index(edge) for edge in edges]
        task = {
            "edges": list(edges),
            "sites": self.cloud_plan.sites[rows].tolist(),
            "weights": self.cloud_plan.weights[rows].tolist(),
            "train": asdict(self.train),
            "backend": self.backend,
            **retrain_settings(self.run, edges, self.cloud_plan, self.system, self.aggregate),
        }
        return task, [folder / "inbox"]

    def edge_task(self, devices: Sequence[str]) -> dict[str, Any]:
        """An edge's settings for the devices whose models are in its inbox."""
        return {"devices": list(devices), "train": asdict(self.train), "aggregate": asdict(self.aggregate), "backend": self.backend}


@dataclass(kw_only=True)
class SharedDealer(Dealer):
    """Deals the photographs of one owner. `scene` holds the training cameras, the plan's indices point into them."""

    images: Path
    """Folder of the undistorted photographs."""
    scene: SfmScene

    def fill_device(self, node: Tree, folder: Path) -> Filled:
        """The device's photographs and its part of the scene."""
        own = self.scene.restricted_to(self._camera_indices(name_of(node)))
        deal_files(self.images, own.cameras.names, folder / "photos")
        save_scene(folder / "scene.safetensors", own)
        task = {"train": asdict(self.train), "backend": self.backend}
        return task, [folder / "photos", folder / "scene.safetensors"]

    def fill_edge(self, node: Tree, folder: Path) -> Filled:
        """The models of its devices and their cameras."""
        devices = [name_of(child) for child in node.children]
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        for device in devices:
            place = folder / "inbox" / device
            deal_files(self.run / "devices" / device, ["model.safetensors"], place)
            save_cameras(place / "cameras.safetensors", self.scene.cameras.select(self._camera_indices(device)))
        return self.edge_task(devices), [folder / "inbox"]

    def _camera_indices(self, device: str) -> Any:
        plan = next(plan for plan in self.edge_plans if device in plan.device_ids)
        return plan.cameras_of(device)


def evaluation_task(run: Path, images: Path, cameras: Cameras, backend: str) -> NodeTask:
    """Prepare evaluation/: the finished scene, the untrained one (already there), the held-out photographs and their cameras."""
    folder = run / "evaluation"
    deal_files(images, cameras.names, folder / "photos")
    deal_files(run / "cloud", ["scene.ply"], folder)
    deal_files(run, ["plan.json"], folder)
    save_cameras(folder / "cameras.safetensors", cameras)
    task = {"backend": backend, "seams": True}
    write_json(folder / "task.json", task)
    inputs = [folder / name for name in ("photos", "scene.ply", "plan.json", "cameras.safetensors", "initial.safetensors")]
    return NodeTask(kind="evaluate", stage="evaluation", folder=folder, key=content_key(__version__, task, *inputs))


def deal_files(source: Path, names: Sequence[str], target: Path) -> None:
    """Copy the named files to `target`, which afterwards holds them with the same bytes; other files in a photos folder go away."""
    if target.name == "photos" and target.exists():
        shutil.rmtree(target)
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def received(inputs: Sequence[Path]) -> dict[str, int]:
    """How many photographs, bytes of photographs and other bytes lie at these paths."""
    files = [file for path in inputs for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
    photographs = [file for file in files if file.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif", ".tiff")]
    return {
        "num_photographs": len(photographs),
        "photograph_bytes": sum(file.stat().st_size for file in photographs),
        "other_bytes": sum(file.stat().st_size for file in files if file not in photographs),
    }


def name_of(node: Tree) -> str:
    """The id of a device or edge in the plan."""
    return node.id.rsplit("/", 1)[-1]
