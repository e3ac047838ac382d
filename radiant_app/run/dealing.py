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
from radiant_app.run.sources import masks_of_scene
from radiant_app.workers.cloud_task import forget_cut, pool_settings, retrain_settings
from radiant_app.workers.delivering import DELIVERIES, give_task, introduce, introduce_teacher
from radiant_app.workers.evaluation import LPIPS_NAME
from radiant_app.workers.inbox import REFUSED_NAME, VIRTUAL_CAMERAS, VIRTUAL_VIEWS
from radiant_app.workers.nodes import MASKS
from radiant_app.workers.task_schema import SIGNED
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import Tree
from radiant_core.cameras import Cameras
from radiant_core.io.photos.masks import mask_name
from radiant_core.io.records import save_cameras, save_scene
from radiant_core.io.run_store import content_key, is_sealed, read_json, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig

MODEL_NAME, UPLOAD_NAME = "model.safetensors", "upload.safetensors"
"""What a device or edge keeps, and what it sends where that is not the same file. In an inbox both are called by the first name."""

ENDED = "its process ended before it was done; the warnings say how."

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
    upload: UploadFormat = "float32"
    checkpoint_every_s: float = 10.0
    ledger: list[dict[str, Any]] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    """Node id → the key it is sealed with when it is done, so that only what this run finished is used."""

    def prepare(self, node: Tree) -> NodeTask | None:
        """Fill the node's folder and say what to run there; None where nothing arrived that could be joined."""
        folder = self.run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        fills = {"device": self.fill_device, "teacher": self.fill_teacher, "edge": self.fill_edge, "cloud": self.fill_cloud}
        filled = fills[node.tier](node, folder)
        if filled is None:
            return None
        task, inputs = filled
        task |= self._crossing(node)
        key = content_key(__version__, task, *inputs)
        # A teacher is a part of its edge: what it is sent counts once, when the edge takes it.
        if node.tier == "teacher":
            _drop_other_views(folder, key)
        else:
            self.ledger.append({"node": node.id, "tier": node.tier, **received([*inputs, folder / DELIVERIES])})
        # What changes no bit of the result is not in the key: who rendered a view, how often a training is saved.
        unkeyed: dict[str, Any] = {"checkpoint_every_s": self.checkpoint_every_s}
        if node.tier == "edge":
            unkeyed["teachers"] = [child.name for child in node.children if child.tier == "teacher"]
        write_json(folder / "task.json", {**task, **unkeyed})
        kind = self.kinds[node.tier]
        if kind in SIGNED:
            # What lies in an inbox was signed by those who sent it.
            beside = [path.relative_to(folder).as_posix() for path in inputs if path.name != "inbox"]
            give_task(self.run, self._above(node), node.id, SIGNED[kind], folder, ["task.json", *beside])
        self.keys[node.id] = key
        return NodeTask(kind=kind, stage=node.id, folder=folder, key=key)

    def take_plan(self, cloud: CloudPlan, edges: tuple[EdgePlan, ...]) -> None:
        """Go on by another plan, in which devices that have begun keep what they have."""
        self.cloud_plan, self.edge_plans = cloud, edges

    @property
    def kinds(self) -> dict[str, str]:
        """Which worker runs the nodes of a tier."""
        return {"device": "device", "teacher": "teacher", "edge": "edge", "cloud": "cloud"}

    def _crossing(self, node: Tree) -> dict[str, Any]:
        """What a node's task says of signatures, after making its key and exchanging it with the one above."""
        if node.tier == "teacher":
            (device,) = node.children
            introduce_teacher(self.run, node.id, f"edges/{self._edge_of(device.name)}", device.name)
            return {"signed": True}
        introduce(self.run, "cloud", None, [f"edges/{plan.edge_id}" for plan in self.edge_plans])
        if node.tier == "cloud":
            return {"signed": True}
        edge = node.name if node.tier == "edge" else self._edge_of(node.name)
        devices = next(plan.device_ids for plan in self.edge_plans if plan.edge_id == edge)
        introduce(self.run, f"edges/{edge}", "cloud", [f"devices/{device}" for device in devices])
        sends: dict[str, Any] = {"sends": self.sends(node.tier)}
        if node.tier == "edge":
            return {**sends, "signed": True}
        introduce(self.run, node.id, f"edges/{edge}")
        return sends

    def _above(self, node: Tree) -> str:
        """Whom the tasks of a device or edge come from."""
        return "cloud" if node.tier == "edge" else f"edges/{self._edge_of(node.name)}"

    def _edge_of(self, device: str) -> str:
        return next(plan.edge_id for plan in self.edge_plans if device in plan.device_ids)

    def sends(self, tier: str) -> list[str]:
        """Files that a device or edge sends beside its model."""
        if tier == "device":
            return ["cameras.safetensors"]
        return [VIRTUAL_CAMERAS, VIRTUAL_VIEWS] if self.aggregate.cloud == "retrain" else []

    def deal_record(self, sender: str, receiver: Path) -> None:
        """The signed record of what a device or edge sends."""
        deal_files(self.run / sender, [RECORD_NAME, SIGNATURE_NAME], receiver / DELIVERIES / Path(sender).name)

    def fill_device(self, node: Tree, folder: Path) -> Filled:
        """Settings and files of a device."""
        raise NotImplementedError

    def memory_bytes_of(self, device: str) -> float | None:
        """What the training of a device may hold, as the system says."""
        return next(own.memory_bytes for own in self.system.devices if own.id == device)

    def deal_device(self, device: str, place: Path) -> None:
        """What an edge gets of a device: its model as it was uploaded, and its cameras."""
        raise NotImplementedError

    def num_dealt(self, device: str) -> int:
        """How many photographs a device was dealt to train on: it sends no more cameras."""
        raise NotImplementedError

    def delivered(self, node: Tree) -> bool:
        """Whether a device or edge is done in this run and has a model."""
        return self.is_done(node.id)

    def is_done(self, node_id: str) -> bool:
        """Whether the node with this id is done in this run."""
        return node_id in self.keys and is_sealed(self.run / node_id, self.keys[node_id])

    def refused_by(self, node_id: str) -> dict[str, str]:
        """Whose uploads an edge or the cloud refused, and why."""
        record = self.run / node_id / REFUSED_NAME
        return read_json(record) if record.is_file() else {}

    def fill_teacher(self, node: Tree, folder: Path) -> Filled | None:
        """What the teacher's device uploaded."""
        (device,) = node.children
        if not self.delivered(device):
            return None
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        self.deal_device(node.name, folder / "inbox")
        self.deal_record(device.id, folder)
        task = {"long_side_px": self.train.long_side_px, "backend": self.backend, "num_dealt": self.num_dealt(node.name)}
        return task, [folder / "inbox"]

    def fill_edge(self, node: Tree, folder: Path) -> Filled | None:
        """What its devices uploaded."""
        devices = self._delivered_of(node)
        for place in ("inbox", DELIVERIES):
            shutil.rmtree(folder / place, ignore_errors=True)
        if not devices:
            return None
        for device in devices:
            self.deal_device(device, folder / "inbox" / device)
            self.deal_record(f"devices/{device}", folder)
        task = {
            "devices": devices,
            "num_dealt": [self.num_dealt(device) for device in devices],
            "strips": [self._strip_of(device) for device in devices],
            "train": asdict(self.train),
            "aggregate": asdict(self.aggregate),
            "backend": self.backend,
            "upload": self.upload,
            "memory_bytes": next(edge.memory_bytes for edge in self.system.edges if edge.id == node.name),
            "cloud": pool_settings(node.name, self.cloud_plan, self.system, self.aggregate),
        }
        return task, [folder / "inbox"]

    def _delivered_of(self, edge: Tree) -> list[str]:
        """The devices below an edge that are done and have a model."""
        leaves = [next(iter(child)) for child in edge.children]
        return [device.name for device in leaves if self.delivered(device)]

    def _strip_of(self, device: str) -> list[list[float]]:
        plan = next(plan for plan in self.edge_plans if device in plan.device_ids)
        return plan.strips[plan.device_ids.index(device)].tolist()

    def fill_cloud(self, node: Tree, folder: Path) -> Filled | None:
        """What the edges uploaded, and the plan's borders."""
        num_dealt = {edge.name: sum(map(self.num_dealt, self._delivered_of(edge))) for edge in node.children if self.delivered(edge)}
        edges = list(num_dealt)
        for place in ("inbox", DELIVERIES):
            shutil.rmtree(folder / place, ignore_errors=True)
        if not edges:
            return None
        forget_cut(folder)
        for edge in edges:
            self.deal_edge(edge, folder / "inbox" / edge)
            self.deal_record(f"edges/{edge}", folder)
        rows = [self.cloud_plan.edge_ids.index(edge) for edge in edges]
        task = {
            "edges": edges,
            "num_dealt": list(num_dealt.values()),
            "sites": self.cloud_plan.sites[rows].tolist(),
            "weights": self.cloud_plan.weights[rows].tolist(),
            "train": asdict(self.train),
            "backend": self.backend,
            **retrain_settings(self.run, edges, self.cloud_plan, self.system, self.aggregate),
        }
        return task, [folder / "inbox"]

    def deal_edge(self, edge: str, place: Path) -> None:
        """What the cloud gets of an edge: its model as it was uploaded, and virtual cameras with their pictures where it retrains."""
        self.deal_upload(self.run / "edges" / edge, place)
        deal_files(self.run / "edges" / edge, self.sends("edge"), place)

    def deal_upload(self, sender: Path, place: Path) -> None:
        """The model that a device or edge sends."""
        place.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(sender / (MODEL_NAME if self.upload == "float32" else UPLOAD_NAME), place / MODEL_NAME)


@dataclass(kw_only=True)
class SharedDealer(Dealer):
    """Deals the photographs of one owner. `scene` holds the training cameras, the plan's indices point into them."""

    images: Path
    """Folder of the undistorted photographs."""
    scene: SfmScene

    def delivered(self, node: Tree) -> bool:
        """Whether a device or edge is done and has a model: an edge has none where all that arrived was refused."""
        if not self.is_done(node.id):
            return False
        return node.tier != "edge" or read_json(self.run / node.id / "frame.json", ("status",))["status"] == "placed"

    def missing(self) -> dict[str, str]:
        """Devices with photographs whose model is not in the scene, and why."""
        cloud = self.refused_by("cloud")
        found: dict[str, str] = {}
        for plan in self.edge_plans:
            edge, refused = plan.edge_id, self.refused_by(f"edges/{plan.edge_id}")
            for device in (device for device in plan.device_ids if len(plan.cameras_of(device))):
                if not self.is_done(f"devices/{device}"):
                    found[device] = f"{ENDED} Its {len(plan.cameras_of(device))} photographs are in no model."
                elif device in refused:
                    found[device] = f"edges/{edge} refused {device}: {refused[device]}"
                elif not self.is_done(f"edges/{edge}"):
                    found[device] = f"edges/{edge}: {ENDED}"
                elif edge in cloud:
                    found[device] = f"cloud refused {edge}: {cloud[edge]}"
        return found

    def fill_device(self, node: Tree, folder: Path) -> Filled:
        """The device's photographs and its part of the scene."""
        own = self.scene.restricted_to(self._camera_indices(node.name))
        deal_files(self.images, own.cameras.names, folder / "photos")
        save_scene(folder / "scene.safetensors", own)
        memory = {"memory_bytes": self.memory_bytes_of(node.name)}
        task = {"train": asdict(self.train), "backend": self.backend, "upload": self.upload, **memory}
        masks = deal_masks(self.run, own.cameras.names, folder)
        return task, [folder / "photos", folder / "scene.safetensors", *masks]

    def deal_device(self, device: str, place: Path) -> None:
        """Its upload, and its cameras in the owner's scene."""
        self.deal_upload(self.run / "devices" / device, place)
        deal_files(self.run / "devices" / device, self.sends("device"), place)

    def num_dealt(self, device: str) -> int:
        """By the plan."""
        return len(self._camera_indices(device))

    def _camera_indices(self, device: str) -> Any:
        plan = next(plan for plan in self.edge_plans if device in plan.device_ids)
        return plan.cameras_of(device)


def evaluation_task(run: Path, images: Path, cameras: Cameras, backend: str, lpips_network: str | None) -> NodeTask:
    """Prepare evaluation/: the finished scene, the held-out photographs and their cameras; the untrained scene, and weights for LPIPS where
    a network is named, are already there."""
    folder = run / "evaluation"
    deal_files(images, cameras.names, folder / "photos")
    masks = deal_masks(run, cameras.names, folder)
    deal_files(run / "cloud", ["scene.ply"], folder)
    deal_files(run, ["plan.json"], folder)
    save_cameras(folder / "cameras.safetensors", cameras)
    task = {"backend": backend, "seams": True, "lpips": lpips_network}
    write_json(folder / "task.json", task)
    names = ["photos", "scene.ply", "plan.json", "cameras.safetensors", "initial.safetensors", *([LPIPS_NAME] if lpips_network else [])]
    inputs = [*(folder / name for name in names), *masks]
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


def deal_masks(run: Path, names: Sequence[str], folder: Path) -> list[Path]:
    """Copy the masks of the named photographs from the run's scene to masks/ in `folder`; that place where there are any."""
    masks, place = masks_of_scene(run), folder / MASKS
    shutil.rmtree(place, ignore_errors=True)
    masked = [] if masks is None else [mask_name(name) for name in names if (masks / mask_name(name)).is_file()]
    if masks is None or not masked:
        return []
    deal_files(masks, masked, place)
    return [place]


def received(inputs: Sequence[Path]) -> dict[str, int]:
    """How many photographs, bytes of photographs and other bytes lie at these paths."""
    masks = [path for path in inputs if path.name == MASKS]
    files = [file for path in inputs for file in (path.rglob("*") if path.is_dir() else [path]) if file.is_file()]
    photographs = [
        file
        for file in files
        if file.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif", ".tiff") and not any(file.is_relative_to(path) for path in masks)
    ]
    return {
        "num_photographs": len(photographs),
        "photograph_bytes": sum(file.stat().st_size for file in photographs),
        "other_bytes": sum(file.stat().st_size for file in files if file not in photographs),
    }
