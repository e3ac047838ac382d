"""Copies into each node's folder exactly what it may read: photographs to devices, models to edges
and to the cloud; in every round of refining the scene to all, and what changed in it to edges and
the cloud.

Called by the executor when a node's children are done. A round's nodes lie in folders inside those
of their owners (`refined_at`). The access log counts what each tier received.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from radiant_app.executors.protocol import NodeTask
from radiant_app.run.photographs import Photographs
from radiant_app.together.places import ENDED_NAME, GROUP_FOLDER
from radiant_app.workers.delivering import DELIVERIES, exchange_keys, identify_part, sign_task
from radiant_app.workers.inbox import REFUSED_NAME, load_corrections
from radiant_app.workers.nodes import CUT_SCENE, unseal_cut
from radiant_app.workers.refining import KEPT_SCENE, NEXT_SCENE, REFINED_SCENE, counted_file, is_counted
from radiant_app.workers.sources import masks_folder_of
from radiant_app.workers.tasks import SIGNED, AverageTask, FinishTask, Move, RefineNodeTask
from radiant_app.workers.training import MASKS
from radiant_core import __version__
from radiant_core.aggregate.tree import Tier, Tree, refined_at, refines_for, round_of
from radiant_core.choices import Version
from radiant_core.frames import Sim3
from radiant_core.hierarchy.choosing import in_order
from radiant_core.hierarchy.codec import (
    CAMERAS_NAME,
    FRAME_NAME,
    MODEL_NAME,
    REFINED_NAME,
    ROWS_NAME,
    SUMMARY_NAME,
    TASK_NAME,
    save_task,
    sent_files,
    task_key,
)
from radiant_core.hierarchy.messages import ONLY_FADED, RefineTask
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import choose_rounds
from radiant_core.io.photos.masks import mask_name
from radiant_core.io.run_store import content_key, file_sha256, is_sealed, read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.plan.plans import CloudPlan, EdgePlan

SCENE_NAME = "scene.ply"
ENDED = "its process ended before it was done; the warnings say how."


@dataclass(kw_only=True)
class Refining:
    """What all rounds in which devices refine a run's scene have in common."""

    run: Path
    devices: Mapping[str, Sequence[str]]
    """Edge → its devices that refine."""
    moves: Mapping[str, Sequence[Sim3]]
    """Device with a model in the scene → similarities from its frame to that."""
    joined: str | None = None
    """SHA-256 of the scene before any round, where somebody else has that."""

    @cached_property
    def joined_sha256(self) -> str:
        """Of the scene before any round."""
        return self.joined or file_sha256(self.run / "cloud" / SCENE_NAME)


@dataclass(frozen=True, kw_only=True)
class _Work:
    """What a node is to do."""

    kind: str
    """Which worker runs it."""
    task: Any
    inputs: Sequence[Path] = ()
    """What it receives in its folder, beside the files of its task."""
    decisive: Sequence[Any] = ()
    """What decides its result too and is not received: paths, and keys of other nodes."""


@dataclass(kw_only=True)
class Dealer:
    """Prepares the nodes of one planned run, and those of the rounds in which its scene is
    refined."""

    run: Path
    recipe: Recipe
    photographs: Photographs
    access_log: list[dict[str, Any]] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    """Node id → the key of its seal, so that only nodes that this run finished are used."""
    refining: Refining | None = None
    """None: it is not known yet which devices refine the scene."""
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
        """Fill the node's folder and return its task; None if nothing arrived for it to work on."""
        folder, owner = self.run / node.id, refines_for(node.id)
        folder.mkdir(parents=True, exist_ok=True)
        refines = owner != node.id
        if (work := (self._refine if refines else self._join)[node.tier](node, folder)) is None:
            return None
        above = None if node.tier == "cloud" else self.parent_of(owner)
        if refines:
            self.deal_start(round_of(node.id), folder)
            identify_part(self.run, node.id, owner, above)
        else:
            self._exchange_keys(node)
            # How an earlier try ended holds for its processes alone.
            (folder / GROUP_FOLDER / ENDED_NAME).unlink(missing_ok=True)
        names = save_task(folder, work.task)
        inputs = [*(folder / name for name in names if name != TASK_NAME), *work.inputs]
        key = content_key(__version__, task_key(work.task), *inputs, *work.decisive)
        self._log_access(node, [*inputs, folder / DELIVERIES])
        if above is not None and work.kind in SIGNED and self.signs_for(above):
            # Files in an inbox were signed by their senders.
            signed = [path.relative_to(folder).as_posix() for path in inputs if path.name != "inbox"]
            sign_task(self.run, above, owner, SIGNED[work.kind], folder, [TASK_NAME, *signed])
        self.keys[node.id] = key
        return NodeTask(kind=work.kind, stage=node.id, folder=folder, key=key)

    @property
    def _join(self) -> Mapping[Tier, Callable[[Tree, Path], _Work | None]]:
        """How nodes that train and join are filled."""
        return {"device": self._fill_device, "edge": self._fill_edge, "cloud": self._fill_cloud}

    @property
    def _refine(self) -> Mapping[Tier, Callable[[Tree, Path], _Work | None]]:
        """How nodes of a round are filled."""
        return {"device": self._fill_refine, "edge": self._fill_average, "cloud": self._fill_finish}

    def _log_access(self, node: Tree, inputs: Sequence[Path]) -> None:
        """Add what a node receives or fetches to the access log."""
        entry: dict[str, Any] = {"node": node.id, "tier": node.tier, **count_received(inputs)}
        if node.tier == "device" and not round_of(node.id) and (fetched := self.photographs.fetched_files(node.name)):
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

    def _fill_device(self, node: Tree, folder: Path) -> _Work:
        task, inputs = self.photographs.fill(node.name, folder, self.recipe)
        return _Work(kind=self.photographs.kind, task=task, inputs=inputs)

    def _keys_below(self, node: Tree, task: Any) -> list[str | None]:
        """Of devices that train together their root receives nothing beforehand."""
        return [self.keys.get(child.id) for child in node.children] if task.group is not None else []

    def _fill_edge(self, node: Tree, folder: Path) -> _Work | None:
        """Copy the uploads of its devices."""
        self._empty_inbox(folder)
        if any(node.name in group.views for group in self.recipe.groups.values()):
            task = self.recipe.edge_task(node.name, {child.name: self.photographs.num_dealt(child.name) for child in node.children})
            return _Work(kind="edge", task=task, decisive=self._keys_below(node, task))
        num_dealt = {device: self.photographs.num_dealt(device) for device in self._delivered_devices(node)}
        if not num_dealt:
            return None
        unseal_cut(folder)
        for device in num_dealt:
            self._deliver(f"devices/{device}", folder, folder / "inbox" / device)
        task = self.recipe.edge_task(node.name, num_dealt)
        return _Work(kind="edge", task=task, inputs=[folder / "inbox"], decisive=self._keys_below(node, task))

    def _fill_cloud(self, node: Tree, folder: Path) -> _Work | None:
        """Copy the uploads of the edges."""
        self._empty_inbox(folder)
        if "cloud" in self.recipe.groups:
            dealt = {edge.name: sum(self.photographs.num_dealt(device.name) for device in edge.children) for edge in node.children}
            task = self.recipe.cloud_task(dealt, {})
            return _Work(kind="cloud", task=task, decisive=self._keys_below(node, task))
        edges = [edge for edge in node.children if self.has_model(edge.id)]
        if not edges:
            return None
        unseal_cut(folder)
        num_dealt = {edge.name: sum(map(self.photographs.num_dealt, self._delivered_devices(edge))) for edge in edges}
        for edge in edges:
            self._deliver(edge.id, folder, folder / "inbox" / edge.name)
        joined = {edge.name: read_json(self.run / edge.id / SUMMARY_NAME, ("train_s", "num_steps")) for edge in edges}
        task = self.recipe.cloud_task(num_dealt, joined)
        return _Work(kind="cloud", task=task, inputs=[folder / "inbox"], decisive=self._keys_below(node, task))

    def _fill_refine(self, node: Tree, folder: Path) -> _Work:
        device, refining = Path(refines_for(node.id)), self._planned_refining
        settings = self.recipe.refine_task(device.name)
        common = {field.name: getattr(settings, field.name) for field in fields(RefineTask)}
        task = RefineNodeTask(corrections=tuple(map(Move.of, refining.moves[device.name])), **common)
        # Its own model stands for the photographs, which it was made from.
        return _Work(kind="refine", task=task, inputs=[folder / SCENE_NAME], decisive=[self.run / device / MODEL_NAME])

    def _fill_average(self, node: Tree, folder: Path) -> _Work | None:
        if not (senders := self._receive_refinements(node, folder)):
            return None
        refining, recipe = self._planned_refining, self.recipe
        task = AverageTask(
            senders=senders,
            num_dealt=tuple(map(self.photographs.num_dealt, senders)),
            corrections=tuple(tuple(map(Move.of, refining.moves[sender])) for sender in senders),
            upload=recipe.upload,
            backend=recipe.backend,
            long_side_px=recipe.train.long_side_px,
            joined=refining.joined_sha256,
            counted_in=tuple(self._counted_in(node, sender) for sender in senders),
        )
        cameras = [folder.parent / "inbox" / sender / CAMERAS_NAME for sender in senders]
        return _Work(kind="average", task=task, inputs=[folder / SCENE_NAME, folder / "inbox"], decisive=cameras)

    def _counted_in(self, node: Tree, device: str) -> int:
        """The earlier round in which an edge counted what a device's photographs show; 0: none."""
        owner, joined = refines_for(node.id), self._planned_refining.joined_sha256
        places = ((number, self.run / refined_at(owner, number) / counted_file(device)) for number in range(1, round_of(node.id)))
        return next((number for number, path in places if is_counted(path, joined)), 0)

    def _fill_finish(self, node: Tree, folder: Path) -> _Work | None:
        kept_scene, number = folder / KEPT_SCENE, round_of(node.id)
        shutil.rmtree(kept_scene.parent, ignore_errors=True)
        if not (senders := self._receive_refinements(node, folder)):
            return None
        below = {Path(edge.id).parent.name: [Path(device.id).parent.name for device in edge.children] for edge in node.children}
        num_dealt = tuple(sum(map(self.photographs.num_dealt, below[edge])) for edge in senders)
        decisive = []
        if (scene_folder := self.refined_by(number - 1)) is not None:
            deal_files(scene_folder, [SCENE_NAME], kept_scene.parent)
            decisive.append(kept_scene)
        task = FinishTask(senders=senders, num_dealt=num_dealt, another_round=number < choose_rounds(self.recipe))
        return _Work(kind="finish", task=task, inputs=[folder / SCENE_NAME, folder / "inbox"], decisive=decisive)

    @property
    def _planned_refining(self) -> Refining:
        assert self.refining is not None, "which devices refine is planned before their round"
        return self.refining

    def _receive_refinements(self, node: Tree, folder: Path) -> tuple[str, ...]:
        """Copy the refinements of a node's children that have one; the names of these."""
        self._empty_inbox(folder)
        senders = []
        for child in node.children:
            if self.is_done(child.id):
                senders.append(Path(child.id).parent.name)
                deal_files(self.run / child.id, [REFINED_NAME, ROWS_NAME], folder / "inbox" / senders[-1])
                deal_files(self.run / child.id, [RECORD_NAME, SIGNATURE_NAME], folder / DELIVERIES / senders[-1])
        return tuple(senders)

    def deal_start(self, number: int, folder: Path) -> None:
        """Copy the scene that a round refines."""
        refined = self.refined_by(number - 1)
        deal_files(self.run / "cloud" if refined is None else refined.parent / Path(NEXT_SCENE).parent, [SCENE_NAME], folder)

    def refined_by(self, number: int) -> Path | None:
        """Where the scene lies after this round, or after the last one before it that made one;
        None where none did."""
        finished = (node for before in range(number, 0, -1) if self.is_done(node := refined_at("cloud", before)))
        return next(((self.run / node / REFINED_SCENE).parent for node in finished), None)

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
