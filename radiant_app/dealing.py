"""Lays into each node's folder what it may read, and nothing else: photographs to devices, models to edges and to the cloud.

Called by the executor when a node's children are done. The ledger counts what each tier received.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from radiant_app.executors.protocol import NodeTask
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import Tree
from radiant_core.cameras import Cameras
from radiant_core.io.records import save_cameras, save_scene
from radiant_core.io.run_store import content_key, is_sealed, write_json
from radiant_core.io.upload import UploadFormat
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig

MODEL_NAME, UPLOAD_NAME = "model.safetensors", "upload.safetensors"
"""What a device or edge keeps, and what it sends where that is not the same file. In an inbox both are called by the first name."""


@dataclass
class Dealer:
    """Prepares nodes of one planned run. `scene` holds the training cameras, the plan's indices point into them."""

    run: Path
    images: Path
    """Folder of the undistorted photographs."""
    scene: SfmScene
    cloud_plan: CloudPlan
    edge_plans: tuple[EdgePlan, ...]
    train: TrainConfig
    aggregate: AggregateConfig
    backend: str
    upload: UploadFormat = "float32"
    ledger: list[dict[str, Any]] = field(default_factory=list)

    def prepare(self, node: Tree) -> NodeTask:
        """Fill the node's folder and say what to run there."""
        folder = self.run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        fills = {"device": self._fill_device, "teacher": self._fill_teacher, "edge": self._fill_edge, "cloud": self._fill_cloud}
        task, inputs = fills[node.tier](node, folder)
        key = content_key(__version__, task, *inputs)
        # A teacher is a part of its edge: what it is sent counts once, when the edge takes it.
        if node.tier == "teacher":
            _drop_other_views(folder, key)
        else:
            self.ledger.append({"node": node.id, "tier": node.tier, **_received(inputs)})
        # Who rendered a view does not change it, so it is not in the edge's key.
        teachers = {"teachers": [child.name for child in node.children if child.tier == "teacher"]} if node.tier == "edge" else {}
        write_json(folder / "task.json", {**task, **teachers})
        return NodeTask(kind=node.tier, stage=node.id, folder=folder, key=key)

    def _fill_device(self, node: Tree, folder: Path) -> tuple[dict[str, Any], Sequence[Path]]:
        own = self.scene.restricted_to(self._camera_indices(node.name))
        deal_files(self.images, own.cameras.names, folder / "photos")
        save_scene(folder / "scene.safetensors", own)
        task = {"train": asdict(self.train), "backend": self.backend, "upload": self.upload}
        return task, [folder / "photos", folder / "scene.safetensors"]

    def _fill_teacher(self, node: Tree, folder: Path) -> tuple[dict[str, Any], Sequence[Path]]:
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        self._deal_device(node.name, folder / "inbox")
        return {"long_side_px": self.train.long_side_px, "backend": self.backend}, [folder / "inbox"]

    def _fill_edge(self, node: Tree, folder: Path) -> tuple[dict[str, Any], Sequence[Path]]:
        devices = [child.name for child in node.children]
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        for device in devices:
            self._deal_device(device, folder / "inbox" / device)
        task = {
            "devices": devices,
            "train": asdict(self.train),
            "aggregate": asdict(self.aggregate),
            "backend": self.backend,
            "upload": self.upload,
        }
        return task, [folder / "inbox"]

    def _fill_cloud(self, node: Tree, folder: Path) -> tuple[dict[str, Any], Sequence[Path]]:
        edges = [child.name for child in node.children]
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        for edge in edges:
            self._deal_upload(self.run / "edges" / edge, folder / "inbox" / edge)
        rows = [self.cloud_plan.edge_ids.index(edge) for edge in edges]
        task = {"edges": edges, "sites": self.cloud_plan.sites[rows].tolist(), "weights": self.cloud_plan.weights[rows].tolist()}
        return task, [folder / "inbox"]

    def _deal_device(self, device: str, place: Path) -> None:
        """What an edge gets of a device: its model as it was uploaded, and its cameras."""
        self._deal_upload(self.run / "devices" / device, place)
        save_cameras(place / "cameras.safetensors", self.scene.cameras.select(self._camera_indices(device)))

    def _deal_upload(self, sender: Path, place: Path) -> None:
        place.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(sender / (MODEL_NAME if self.upload == "float32" else UPLOAD_NAME), place / MODEL_NAME)

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


def _drop_other_views(teacher: Path, key: str) -> None:
    """What a teacher left of another model, or half-written: its edge takes whatever view lies there."""
    if not is_sealed(teacher, key):
        shutil.rmtree(teacher / "views", ignore_errors=True)


def deal_files(source: Path, names: Sequence[str], target: Path) -> None:
    """Copy the named files to `target`, which afterwards holds them with the same bytes; other files in a photos folder go away."""
    if target.name == "photos" and target.exists():
        shutil.rmtree(target)
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def _received(inputs: Sequence[Path]) -> dict[str, int]:
    files = [file for path in inputs for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
    photographs = [file for file in files if file.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif", ".tiff")]
    return {
        "num_photographs": len(photographs),
        "photograph_bytes": sum(file.stat().st_size for file in photographs),
        "other_bytes": sum(file.stat().st_size for file in files if file not in photographs),
    }
