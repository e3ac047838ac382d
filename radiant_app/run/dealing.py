"""Copies into each node's folder exactly what it may read: photographs to devices, models to edges
and to the cloud.

Called by the executor when a node's children are done. The access log counts what each tier
received.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from radiant_app.executors.protocol import NodeTask
from radiant_app.run.photographs import Photographs
from radiant_app.together.places import ENDED_NAME, GROUP_FOLDER
from radiant_app.workers.delivering import DELIVERIES, exchange_keys, sign_task
from radiant_app.workers.inbox import REFUSED_NAME, load_corrections
from radiant_app.workers.nodes import CUT_SCENE, unseal_cut
from radiant_app.workers.sources import masks_folder_of
from radiant_app.workers.tasks import SIGNED
from radiant_app.workers.training import MASKS
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree
from radiant_core.choices import Version
from radiant_core.frames import Sim3
from radiant_core.hierarchy.choosing import in_order
from radiant_core.hierarchy.codec import FRAME_NAME, SUMMARY_NAME, TASK_NAME, save_task, sent_files, task_key
from radiant_core.hierarchy.messages import ONLY_FADED
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.photos.masks import mask_name
from radiant_core.io.run_store import content_key, is_sealed, read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.plan.plans import CloudPlan, EdgePlan

ENDED = "its process ended before it was done; the warnings say how."


@dataclass(kw_only=True)
class Dealer:
    """Prepares the nodes of one planned run."""

    run: Path
    recipe: Recipe
    photographs: Photographs
    access_log: list[dict[str, Any]] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    """Node id → the key of its seal, so that only nodes that this run finished are used."""
    refined: Path | None = None
    """Where the refined scene.ply lies; None: the scene is as it was joined."""
    chosen: Version | None = None
    """The version of the scene that photographs held out chose; None: the first of `versions`."""
    conductor: str = "cloud"
    """The node that conducts: an edge over a network signs for itself alone, else all keys are
    here."""
    exchange: Callable[[], None] | None = None
    """Registers the keys of nodes that have keys of their own; None: keys are made here."""

    def __post_init__(self) -> None:
        self.photographs.use_recipe(self.recipe)

    def replace_plan(self, cloud: CloudPlan, edges: tuple[EdgePlan, ...]) -> None:
        """Continue with another plan, in which devices that have started keep their photographs."""
        self.recipe = self.recipe.with_plan(cloud, edges)
        self.photographs.use_recipe(self.recipe)

    def prepare(self, node: Tree) -> NodeTask | None:
        """Fill the node's folder and return its task; None if nothing arrived to be joined."""
        folder = self.run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        fills = {"device": self._fill_device, "edge": self._fill_edge, "cloud": self._fill_cloud}
        filled = fills[node.tier](node, folder)
        if filled is None:
            return None
        task, extra_inputs = filled
        self._exchange_keys(node)
        names = save_task(folder, task)
        inputs = [*(folder / name for name in names if name != TASK_NAME), *extra_inputs]
        # Of devices that train together their root receives nothing beforehand.
        below = [self.keys.get(child.id) for child in node.children] if node.tier != "device" and task.group is not None else []
        # How an earlier try ended holds for its processes alone.
        (folder / GROUP_FOLDER / ENDED_NAME).unlink(missing_ok=True)
        key = content_key(__version__, task_key(task), *inputs, *below)
        self._log_access(node, [*inputs, folder / DELIVERIES])
        kind = self.photographs.kind if node.tier == "device" else node.tier
        if kind in SIGNED and self.signs_for(self.parent_of(node.id)):
            # Files in an inbox were signed by their senders.
            signed = [path.relative_to(folder).as_posix() for path in inputs if path.name != "inbox"]
            sign_task(self.run, self.parent_of(node.id), node.id, SIGNED[kind], folder, [TASK_NAME, *signed])
        self.keys[node.id] = key
        return NodeTask(kind=kind, stage=node.id, folder=folder, key=key)

    def _log_access(self, node: Tree, inputs: Sequence[Path]) -> None:
        """Add what a node receives or fetches to the access log."""
        entry: dict[str, Any] = {"node": node.id, "tier": node.tier, **count_received(inputs)}
        if node.tier == "device" and (fetched := self.photographs.fetched_files(node.name)):
            entry |= {name: count_received(fetched)[name] for name in ("num_photographs", "photograph_bytes")}
        self.access_log.append(entry)

    def _exchange_keys(self, node: Tree) -> None:
        """Create a node's key and exchange keys with its parent."""
        if self.exchange is not None:
            return self.exchange()
        exchange_keys(self.run, "cloud", None, [f"edges/{plan.edge_id}" for plan in self.recipe.edge_plans])
        if node.tier == "cloud":
            return None
        edge = node.id if node.tier == "edge" else self.parent_of(node.id)
        devices = next(plan.device_ids for plan in self.recipe.edge_plans if f"edges/{plan.edge_id}" == edge)
        exchange_keys(self.run, edge, "cloud", [f"devices/{device}" for device in devices])
        if node.tier == "device":
            exchange_keys(self.run, node.id, edge)
        return None

    def signs_for(self, sender: str) -> bool:
        """Whether the key of this sender of tasks is here."""
        return self.conductor in ("cloud", sender)

    def parent_of(self, node_id: str) -> str:
        """The node that signs the tasks of a device or edge."""
        tier, name = node_id.split("/")
        return "cloud" if tier == "edges" else f"edges/{self.recipe.plan_of(name).edge_id}"

    def _fill_device(self, node: Tree, folder: Path) -> tuple[Any, list[Path]]:
        return self.photographs.fill(node.name, folder, self.recipe)

    def _fill_edge(self, node: Tree, folder: Path) -> tuple[Any, list[Path]] | None:
        """Copy the uploads of its devices."""
        self._empty_inbox(folder)
        if any(node.name in group.views for group in self.recipe.groups.values()):
            return self.recipe.edge_task(node.name, {child.name: self.photographs.num_dealt(child.name) for child in node.children}), []
        num_dealt = {device: self.photographs.num_dealt(device) for device in self._delivered_devices(node)}
        if not num_dealt:
            return None
        unseal_cut(folder)
        for device in num_dealt:
            self._deliver(f"devices/{device}", folder, folder / "inbox" / device)
        return self.recipe.edge_task(node.name, num_dealt), [folder / "inbox"]

    def _fill_cloud(self, node: Tree, folder: Path) -> tuple[Any, list[Path]] | None:
        """Copy the uploads of the edges."""
        self._empty_inbox(folder)
        if "cloud" in self.recipe.groups:
            dealt = {edge.name: sum(self.photographs.num_dealt(device.name) for device in edge.children) for edge in node.children}
            return self.recipe.cloud_task(dealt, {}), []
        edges = [edge for edge in node.children if self.has_model(edge.id)]
        if not edges:
            return None
        unseal_cut(folder)
        num_dealt = {edge.name: sum(map(self.photographs.num_dealt, self._delivered_devices(edge))) for edge in edges}
        for edge in edges:
            self._deliver(edge.id, folder, folder / "inbox" / edge.name)
        joined = {edge.name: read_json(self.run / edge.id / SUMMARY_NAME, ("train_s", "num_steps")) for edge in edges}
        return self.recipe.cloud_task(num_dealt, joined), [folder / "inbox"]

    def _empty_inbox(self, folder: Path) -> None:
        for place in ("inbox", DELIVERIES):
            shutil.rmtree(folder / place, ignore_errors=True)

    def _deliver(self, sender: str, receiver: Path, place: Path) -> None:
        """Copy a node's upload to `place`, and its signed record to the receiver's folder."""
        place.mkdir(parents=True, exist_ok=True)
        for name, path in sent_files(self.run / sender).items():
            shutil.copyfile(path, place / name)
        deal_files(self.run / sender, [RECORD_NAME, SIGNATURE_NAME], receiver / DELIVERIES / Path(sender).name)

    def _delivered_devices(self, edge: Tree) -> list[str]:
        """The devices of an edge that are done and have a model."""
        return [device.name for device in edge.children if self.has_model(device.id)]

    def has_model(self, node_id: str) -> bool:
        """Whether a node is done in this run and has a model: not if it refused all it received."""
        frame = self.run / node_id / FRAME_NAME
        return self.is_done(node_id) and (not frame.is_file() or read_json(frame, ("status",))["status"] == "placed")

    @property
    def versions(self) -> dict[Version, Path]:
        """Folder of each version of the scene, that which is kept without a comparison first."""
        joined, cut = self.run / "cloud", self.run / "cloud" / CUT_SCENE
        if not cut.is_file():
            return in_order(self.refined, joined, None, only_faded=False)
        return in_order(self.refined, joined, cut.parent, only_faded=bool(read_json(joined / SUMMARY_NAME).get(ONLY_FADED)))

    @property
    def version(self) -> Version:
        """The version of the scene that is kept."""
        return self.chosen or next(iter(self.versions))

    @property
    def scene_folder(self) -> Path:
        """Where the finished scene.ply lies."""
        return self.versions[self.version]

    def is_done(self, node_id: str) -> bool:
        """Whether the node with this id is done in this run."""
        return node_id in self.keys and is_sealed(self.run / node_id, self.keys[node_id])

    def load_moves(self) -> dict[str, list[Sim3]]:
        """Device with a model in the scene → similarities from its frame to that, in order."""
        moves = {}
        for edge, to_cloud in load_corrections(self.run / "cloud").items():
            if to_cloud is not None:
                moved = load_corrections(self.run / "edges" / edge)
                # An edge speaks of its devices alone.
                below = next(plan.device_ids for plan in self.recipe.edge_plans if plan.edge_id == edge)
                moves |= {device: [move, to_cloud] for device, move in moved.items() if move is not None and device in below}
        return moves

    def missing_devices(self) -> dict[str, str]:
        """Device with photographs whose model is not in the scene → the reason."""
        present = set(self.load_moves()) if self.has_model("cloud") else set()
        return {device: self._missing_reason(device) for device in self.photographs.devices() if device not in present}

    def _missing_reason(self, device: str) -> str:
        node = f"devices/{device}"
        if node not in self.keys:
            return "it has no photograph to train on whose place is known."
        if not self.is_done(node):
            return f"{ENDED} Its {self.photographs.num_dealt(device)} photographs are in no model."
        frame = self.run / node / FRAME_NAME
        if not self.has_model(node):
            return read_json(frame, ("reason",))["reason"]
        edge = self.recipe.plan_of(device).edge_id
        for tier, name in ((f"edges/{edge}", device), ("cloud", edge)):
            if not self.is_done(tier):
                return f"{tier}: {ENDED}"
            record = self.run / tier / REFUSED_NAME
            refused = read_json(record) if record.is_file() else {}
            if name in refused:
                return f"{tier} refused {name}: {refused[name]}"
        return f"edges/{edge} delivered nothing."


def deal_files(source: Path, names: Sequence[str], target: Path) -> None:
    """Copy the named files to `target`; other files in a photos folder are removed."""
    if target.name == "photos" and target.exists():
        shutil.rmtree(target)
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def deal_masks(run: Path, names: Sequence[str], folder: Path) -> list[Path]:
    """Copy the photographs' masks to masks/ in `folder`; returns [that folder], [] without any."""
    masks, place = masks_folder_of(run), folder / MASKS
    shutil.rmtree(place, ignore_errors=True)
    masked = [] if masks is None else [mask_name(name) for name in names if (masks / mask_name(name)).is_file()]
    if masks is None or not masked:
        return []
    deal_files(masks, masked, place)
    return [place]


def count_received(inputs: Sequence[Path]) -> dict[str, int]:
    """Count the photographs, their bytes and all other bytes at these paths."""
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
