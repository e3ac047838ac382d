"""Edits of a plan on a map: records that turn wishes into new wishes for `plan_regions` to solve.

    FixWeight   a border was dragged by d along its normal: w_i becomes w_i + 2 ‖P_i − P_j‖ d
    LockRegion  the edge keeps its cameras; FreeRegion removes lock and fixed weight
    PinCameras  the cameras belong to one edge, whatever is optimal; without one they are unpinned
    MoveEdge, AddEdge, RemoveEdge, AddDevice, RemoveDevice, SetSlack, ReleaseAll, AdoptPlan

`text` is the entry of the menu, `wishes` returns the new wishes. Locks and fixed weights refer to
the plan at the time of the edit (`PlanWishes.reference`). Every edit gives a new plan or raises
BadInput with one sentence; nothing is changed in place. Regions once per edit and frame of a drag,
strips once per edit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.system import Edge, System
from radiant_viewer.editing.model.edited_plan import (
    EditedPlan,
    PlanSubject,
    PlanWishes,
    add_empty_edge,
    add_strips,
    initial_plan,
    remove_edge,
    solve_regions,
)


@dataclass(frozen=True, kw_only=True)
class FixWeight:
    """A dragged border: the edge owns its cell with this weight (m²) in the reference plan."""

    edge: str
    weight_m2: float

    @property
    def text(self) -> str:
        return f"drag the border of {self.edge}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        _require_edge(before.wishes.system, self.edge)
        old = before.wishes.constraints
        if self.edge in old.locked:
            raise BadInput(f"the region of {self.edge!r} is locked: free it before its border is dragged.")
        fixed = {**old.fixed_weights_m2, self.edge: self.weight_m2}
        return replace(before.wishes, constraints=replace(old, fixed_weights_m2=fixed), reference=before.cloud)


@dataclass(frozen=True, kw_only=True)
class LockRegion:
    """The edge keeps its present cameras and gets no others."""

    edge: str

    @property
    def text(self) -> str:
        return f"lock the region of {self.edge}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        _require_edge(before.wishes.system, self.edge)
        old = before.wishes.constraints
        if self.edge in old.locked:
            raise BadInput(f"the region of {self.edge!r} is locked already.")
        fixed = {name: weight for name, weight in old.fixed_weights_m2.items() if name != self.edge}
        constraints = replace(old, locked=(*old.locked, self.edge), fixed_weights_m2=fixed)
        return replace(before.wishes, constraints=constraints, reference=before.cloud)


@dataclass(frozen=True, kw_only=True)
class FreeRegion:
    """Remove lock and dragged borders of the edge."""

    edge: str

    @property
    def text(self) -> str:
        return f"free the region of {self.edge}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        _require_edge(before.wishes.system, self.edge)
        old = before.wishes.constraints
        if self.edge not in old.locked and self.edge not in old.fixed_weights_m2:
            raise BadInput(f"the region of {self.edge!r} is free already: nothing of it is locked or was dragged.")
        return replace(before.wishes, constraints=_release_edge(old, self.edge, pins=False))


@dataclass(frozen=True, kw_only=True)
class PinCameras:
    """These cameras belong to the edge; without an edge their pins are removed."""

    cameras: tuple[str, ...]
    edge: str | None

    @property
    def text(self) -> str:
        cameras = self.cameras[0] if len(self.cameras) == 1 else f"{len(self.cameras)} cameras"
        return f"unpin {cameras}" if self.edge is None else f"pin {cameras} to {self.edge}"

    def wishes(self, before: EditedPlan, subject: PlanSubject) -> PlanWishes:
        if not self.cameras:
            raise BadInput("no camera is selected: select those to pin in the table or on the map.")
        index_of = {name: index for index, name in enumerate(subject.names)}
        unknown = [name for name in self.cameras if name not in index_of]
        if unknown:
            raise BadInput(f"{unknown[0]!r} is none of the {len(index_of)} planned cameras: held-out photographs belong to no region.")
        old = before.wishes.constraints
        chosen = {index_of[name] for name in self.cameras}
        pinned = {camera: edge for camera, edge in old.pinned.items() if camera not in chosen}
        if self.edge is None and len(pinned) == len(old.pinned):
            raise BadInput("none of the selected cameras is pinned.")
        if self.edge is not None:
            _require_edge(before.wishes.system, self.edge)
            pinned |= dict.fromkeys(sorted(chosen), self.edge)
        return replace(before.wishes, constraints=replace(old, pinned=pinned))


@dataclass(frozen=True, kw_only=True)
class MoveEdge:
    """Move the edge to x east, y north."""

    edge: str
    position: tuple[float, float]

    @property
    def text(self) -> str:
        return f"move edge {self.edge}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        _require_edge(before.wishes.system, self.edge)
        position = (float(self.position[0]), float(self.position[1]))
        return _replace_edges(
            before.wishes, lambda edge: replace(edge, position=position, lat_lon_deg=None) if edge.id == self.edge else edge
        )


@dataclass(frozen=True, kw_only=True)
class AddEdge:
    """Add an edge with machines like those of edge `like`, named after it: <edge>-1, <edge>-2, …"""

    edge: str
    position: tuple[float, float]
    like: str

    @property
    def text(self) -> str:
        return f"add edge {self.edge}"

    def wishes(self, before: EditedPlan, subject: PlanSubject) -> PlanWishes:
        system = before.wishes.system
        like = _require_edge(system, self.like)
        if any(edge.id == self.edge for edge in system.edges):
            raise BadInput(f"there is an edge {self.edge!r} already: ids name folders, choose another.")
        devices = tuple(replace(device, id=f"{self.edge}-{number}") for number, device in enumerate(like.devices, 1))
        position = (float(self.position[0]), float(self.position[1]))
        new = replace(like, id=self.edge, position=position, lat_lon_deg=None, devices=devices)
        reference = add_empty_edge(before.wishes.reference, subject, self.edge, np.array(position))
        return replace(before.wishes, system=replace(system, edges=(*system.edges, new)), reference=reference)


@dataclass(frozen=True, kw_only=True)
class RemoveEdge:
    """Remove the edge with its devices and constraints."""

    edge: str

    @property
    def text(self) -> str:
        return f"remove edge {self.edge}"

    def wishes(self, before: EditedPlan, subject: PlanSubject) -> PlanWishes:
        system = before.wishes.system
        _require_edge(system, self.edge)
        if len(system.edges) == 1:
            raise BadInput(f"{self.edge!r} is the only edge: add another before it is removed.")
        constraints = _release_edge(before.wishes.constraints, self.edge, pins=True)
        return replace(
            before.wishes,
            system=replace(system, edges=tuple(edge for edge in system.edges if edge.id != self.edge)),
            constraints=constraints,
            reference=remove_edge(before.wishes.reference, subject, self.edge, constraints.locked),
        )


@dataclass(frozen=True, kw_only=True)
class AddDevice:
    """Add a device to the edge, with the cost and memory of an existing one."""

    edge: str
    device: str
    like: str

    @property
    def text(self) -> str:
        return f"add device {self.device} at {self.edge}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        system = before.wishes.system
        if not _require_edge(system, self.edge).devices:
            raise BadInput(f"edge {self.edge!r} is known by its curve alone: its devices are its own matter.")
        like = [device for device in system.devices if device.id == self.like]
        if not like:
            raise BadInput(
                f"there is no device {self.like!r} to take the new one after: there are {_list_names(d.id for d in system.devices)}."
            )
        new = replace(like[0], id=self.device)
        return _replace_edges(before.wishes, lambda edge: replace(edge, devices=(*edge.devices, new)) if edge.id == self.edge else edge)


@dataclass(frozen=True, kw_only=True)
class RemoveDevice:
    """Remove the device; its cameras are dealt to the others."""

    device: str

    @property
    def text(self) -> str:
        return f"remove device {self.device}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        owner = [edge for edge in before.wishes.system.edges if any(device.id == self.device for device in edge.devices)]
        if not owner:
            raise BadInput(f"there is no device {self.device!r}: there are {_list_names(d.id for d in before.wishes.system.devices)}.")
        if len(owner[0].devices) == 1:
            raise BadInput(f"{self.device!r} is the only device of edge {owner[0].id!r}: remove the edge instead.")

        def without_device(edge: Edge) -> Edge:
            return replace(edge, devices=tuple(device for device in edge.devices if device.id != self.device))

        return _replace_edges(before.wishes, without_device)


@dataclass(frozen=True, kw_only=True)
class SetSlack:
    """Allow a makespan of `slack` times the shortest, for shorter distances; None: the shortest."""

    slack: float | None

    @property
    def text(self) -> str:
        return "take the slack back" if self.slack is None else f"allow a slack of {self.slack:g}"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        return replace(before.wishes, slack=self.slack)


@dataclass(frozen=True, kw_only=True)
class ReleaseAll:
    """Remove all constraints and the slack: the best plan of the system."""

    @property
    def text(self) -> str:
        return "free everything"

    def wishes(self, before: EditedPlan, _: PlanSubject) -> PlanWishes:
        return replace(before.wishes, constraints=PlanConstraints(), slack=None)


@dataclass(frozen=True, kw_only=True, eq=False)
class AdoptPlan:
    """Replace the plan by another one of the same cameras and machines, without constraints."""

    name: str
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]

    @property
    def text(self) -> str:
        return f"load {self.name}"


Solved = (
    FixWeight | LockRegion | FreeRegion | PinCameras | MoveEdge | AddEdge | RemoveEdge | AddDevice | RemoveDevice | SetSlack | ReleaseAll
)
"""Edits that change wishes, so that the regions are solved again."""
Edit = Solved | AdoptPlan
EDITS: tuple[type[Any], ...] = get_args(Edit)


def apply_edit(subject: PlanSubject, before: EditedPlan, edit: Edit, *, strips: bool = True) -> EditedPlan:
    """Return the plan after an edit, without strips in a drag; BadInput where it is impossible."""
    if isinstance(edit, AdoptPlan):
        return initial_plan(subject, before.wishes.system, edit.cloud, edit.edges)
    after = solve_regions(subject, edit.wishes(before, subject), before.cloud)
    return add_strips(subject, after) if strips else after


def _require_edge(system: System, name: str) -> Edge:
    edges = [edge for edge in system.edges if edge.id == name]
    if not edges:
        raise BadInput(f"there is no edge {name!r}: there are {_list_names(edge.id for edge in system.edges)}.")
    return edges[0]


def _replace_edges(wishes: PlanWishes, changed: Callable[[Edge], Edge]) -> PlanWishes:
    return replace(wishes, system=replace(wishes.system, edges=tuple(changed(edge) for edge in wishes.system.edges)))


def _release_edge(constraints: PlanConstraints, name: str, *, pins: bool) -> PlanConstraints:
    """Return the constraints without lock, fixed weight and, if `pins`, pins of an edge."""
    return PlanConstraints(
        fixed_weights_m2={edge: weight for edge, weight in constraints.fixed_weights_m2.items() if edge != name},
        locked=tuple(edge for edge in constraints.locked if edge != name),
        pinned={camera: edge for camera, edge in constraints.pinned.items() if not (pins and edge == name)},
    )


def _list_names(names: Iterable[str]) -> str:
    listed = list(names)
    return ", ".join(listed[:6]) + (f" and {len(listed) - 6} more" if len(listed) > 6 else "")
