"""Prepares the nodes of a run whose photographs stay on their devices, and the scoring that follows.

A device is told which photographs are its own and fetches them itself. An edge gets what its devices delivered, the cloud what its edges
did; who delivered nothing is left out. Then every device gets the finished scene and where its own frame went.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.executors.protocol import NodeTask
from radiant_app.run.dealing import ENDED, Dealer, Filled, deal_files, received
from radiant_app.workers.delivering import give_task, introduce_scoring
from radiant_app.workers.evaluation import LPIPS_NAME
from radiant_app.workers.inbox import VIRTUAL_CAMERAS, VIRTUAL_VIEWS
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree
from radiant_core.io.messages import message_record
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import content_key, is_sealed, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.sfm.given_poses import GivenPoses


@dataclass(frozen=True, kw_only=True)
class DeviceShare:
    """Which photographs are a device's own: file names in `source`, those to train on and those held out."""

    source: Path
    names: tuple[str, ...]
    held_out: tuple[str, ...]
    copy: bool
    """Whether the device fetches them into its folder; False where they lie in a folder of its own."""


@dataclass(kw_only=True)
class FieldDealer(Dealer):
    """Prepares devices that place their own photographs."""

    frames: str
    shares: dict[str, DeviceShare]
    origin: FloatArray | None
    poses: GivenPoses | None
    sfm: dict[str, Any]
    deal: Callable[[Sequence[EdgePlan]], dict[str, DeviceShare]] | None = None
    """Whose photographs are whose in another plan; None where they lie with their devices."""

    def take_plan(self, cloud: CloudPlan, edges: tuple[EdgePlan, ...]) -> None:
        """As in a shared run; devices' own photographs follow."""
        super().take_plan(cloud, edges)
        if self.deal is not None:
            self.shares = self.deal(edges)

    @property
    def kinds(self) -> dict[str, str]:
        """Devices reconstruct before they train."""
        return {**super().kinds, "device": "field"}

    def prepare(self, node: Tree) -> NodeTask | None:
        """As in a shared run; what a device fetches itself is counted too."""
        task = super().prepare(node)
        if task is not None and node.tier == "device" and self.shares[node.name].copy:
            fetched = received(self._photographs_of(node.name))
            self.ledger[-1] |= {key: fetched[key] for key in ("num_photographs", "photograph_bytes")}
        return task

    def _photographs_of(self, device: str) -> list[Path]:
        share = self.shares[device]
        return [share.source / name for name in (*share.names, *share.held_out)]

    def fill_device(self, node: Tree, folder: Path) -> Filled:
        """The names of its photographs; the given poses where there are some."""
        share = self.shares[node.name]
        names = [*share.names, *share.held_out]
        files = [path.stat() for path in self._photographs_of(node.name)]
        task = {
            "frames": self.frames,
            "source": str(share.source.resolve()),
            "names": list(share.names),
            "held_out": list(share.held_out),
            "copy": share.copy,
            "changed": [[file.st_size, file.st_mtime_ns] for file in files],
            "origin": None if self.origin is None else self.origin.tolist(),
            "sfm": {**self.sfm, "memory_bytes": self.memory_bytes_of(node.name)},
            "train": message_record(self.train),
            "backend": self.backend,
            "upload": self.upload,
            "memory_bytes": self.memory_bytes_of(node.name),
            "model": None,
        }
        if self.poses is None:
            return task, []
        task["model"] = self.poses.deal(names, folder)
        return task, [folder / ("poses" if task["model"] else "poses.safetensors")]

    def sends(self, tier: str) -> list[str]:
        """Beside their models: cameras (virtual ones of an edge, with their pictures), and how sure the frame is."""
        return [*(["cameras.safetensors"] if tier == "device" else [VIRTUAL_CAMERAS, VIRTUAL_VIEWS]), "frame.json"]

    def deal_device(self, device: str, place: Path) -> None:
        """Its upload, its poses under numbers, and how sure its frame is."""
        self.deal_upload(self.run / "devices" / device, place)
        deal_files(self.run / "devices" / device, self.sends("device"), place)

    def deal_edge(self, edge: str, place: Path) -> None:
        """Its upload, virtual cameras, and how sure its frame is."""
        self.deal_upload(self.run / "edges" / edge, place)
        deal_files(self.run / "edges" / edge, self.sends("edge"), place)

    def num_dealt(self, device: str) -> int:
        """Its photographs without those that it holds out."""
        return len(self.shares[device].names) if device in self.shares else 0

    def delivered(self, node: Tree) -> bool:
        """Whether a device or edge is done in this run and has a model."""
        return self.has_model(node.id)

    def has_model(self, node_id: str) -> bool:
        """Whether the node with this id is done in this run and has a model."""
        return self.is_done(node_id) and read_json(self.run / node_id / "frame.json", ("status",))["status"] == "placed"

    def moves(self) -> dict[str, list[Any]]:
        """Devices whose model is in the scene → the similarities from their own frame to the scene's, first to last."""
        to_cloud = read_json(self.run / "cloud" / "corrections.json")
        found = {}
        for edge in (edge for edge, move in to_cloud.items() if move is not None):
            to_edge = read_json(self.run / "edges" / edge / "corrections.json")
            found |= {device: [move, to_cloud[edge]] for device, move in to_edge.items() if move is not None}
        return found

    def missing(self) -> dict[str, str]:
        """Devices with photographs whose model is not in the scene, and why."""
        present = set(self.moves()) if self.has_model("cloud") else set()
        return {device: self._reason(device) for device in sorted(self.shares) if device not in present}

    def _reason(self, device: str) -> str:
        folder = self.run / "devices" / device
        key = self.keys.get(f"devices/{device}")
        if key is None:
            return "it has no photograph to train on whose place is known."
        if not is_sealed(folder, key):
            return ENDED
        frame = read_json(folder / "frame.json", ("status", "reason"))
        if frame["status"] == "missing":
            return frame["reason"]
        edge = next(plan.edge_id for plan in self.edge_plans if device in plan.device_ids)
        for tier, name in ((f"edges/{edge}", device), ("cloud", edge)):
            if tier not in self.keys or not is_sealed(self.run / tier, self.keys[tier]):
                return f"{tier} ended before it was done; the warnings say how."
            refused = self.refused_by(tier)
            if name in refused:
                return f"{tier} refused {name}: {refused[name]}"
        return f"edges/{edge} delivered nothing."


@dataclass(kw_only=True)
class Scorer:
    """Prepares the scoring of the finished scene on each device's own held-out photographs."""

    dealer: FieldDealer
    moves: dict[str, list[Any]]
    long_side_px: int
    lpips_network: str | None
    """With it, evaluation/ holds the weights."""
    ledger: list[dict[str, Any]] = field(default_factory=list)

    def prepare(self, node: Tree) -> NodeTask | None:
        """Give the device the scene, the plan's borders and where its frame went."""
        if not node.id.startswith("devices/"):
            return None
        run, folder = self.dealer.run, self.dealer.run / node.id
        device = node.id.split("/")[1]
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        deal_files(run / "cloud", ["scene.ply"], folder / "inbox")
        self._deal_borders(folder / "inbox" / "plan.json")
        if self.lpips_network:
            deal_files(run / "evaluation", [LPIPS_NAME], folder / "inbox")
        task = {
            "corrections": self.moves[device],
            "long_side_px": self.long_side_px,
            "backend": self.dealer.backend,
            "lpips": self.lpips_network,
        }
        write_json(folder / "task.json", task)
        edge = next(f"edges/{plan.edge_id}" for plan in self.dealer.edge_plans if device in plan.device_ids)
        introduce_scoring(run, node.id, f"devices/{device}", edge)
        given = [f"inbox/{path.name}" for path in sorted((folder / "inbox").iterdir())]
        give_task(run, edge, f"devices/{device}", "score_task", folder, ["task.json", *given])
        inputs = [folder / "inbox", *(folder.parent / name for name in ("held_out.safetensors", "model.safetensors"))]
        self.ledger.append({"node": node.id, "tier": "device", **received([folder / "inbox"])})
        return NodeTask(kind="score", stage=node.id, folder=folder, key=content_key(__version__, task, *inputs))

    def _deal_borders(self, path: Path) -> None:
        """The regions alone: cameras, strips and devices are no other device's business."""
        cloud, _ = load_plan(self.dealer.run / "plan.json")
        save_plan(path, replace(cloud, edge_of_camera=np.zeros(0, np.int64)), ())


def device_cameras(dealer: FieldDealer) -> dict[str, Path]:
    """For devices whose model is in the scene: the poses they sent to their edge."""
    edge_of = {device: plan.edge_id for plan in dealer.edge_plans for device in plan.device_ids}
    return {device: dealer.run / "edges" / edge_of[device] / "inbox" / device / "cameras.safetensors" for device in sorted(dealer.moves())}
