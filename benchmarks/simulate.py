"""The timeline of a fleet: devices train and send, edges join and send, the cloud waits for all.

    device n: starts, works (again from the start after a failure and its repair), sends H bytes
    edge m:   waits for its devices that do not drop out, aggregates, sends what it joined
    send(t, s): ends when ∫ share(τ) dτ from t reaches s, s the seconds at full bandwidth and
                share a trace of the network

All arrays at once, O(D + E): a million devices in some 50 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.system import System


@dataclass(frozen=True, kw_only=True, eq=False)
class Fleet:
    """D devices of E edges, devices in order of their edges, every edge with at least one.
    edge_of_device (D,); start_s, work_s, model_bytes, uplink_bytes_per_s (D,); aggregate_s,
    edge_uplink_bytes_per_s (E,); fails_s (D,): when a device fails and loses its work, inf for
    never; it starts anew after repair_s (D,); dropped (D,): lost for good, not waited for."""

    edge_of_device: NDArray[np.int64]
    start_s: FloatArray
    work_s: FloatArray
    model_bytes: FloatArray
    uplink_bytes_per_s: FloatArray
    aggregate_s: FloatArray
    edge_uplink_bytes_per_s: FloatArray
    fails_s: FloatArray
    repair_s: FloatArray
    dropped: NDArray[np.bool_]

    def __post_init__(self) -> None:
        num_devices, num_edges = len(self.edge_of_device), len(self.aggregate_s)
        if not num_edges or num_devices < num_edges:
            raise BadInput(f"a fleet of {num_edges} edges and {num_devices} devices cannot be simulated: give every edge a device.")
        steps = np.diff(self.edge_of_device)
        if self.edge_of_device[0] != 0 or self.edge_of_device[-1] != num_edges - 1 or (steps < 0).any() or (steps > 1).any():
            raise BadInput("edge_of_device must rise from 0 to E − 1 without a gap: sort the devices by edge.")
        for name in ("start_s", "work_s", "model_bytes", "repair_s"):
            if (check_array(name, getattr(self, name), (num_devices,)) < 0).any():
                raise BadInput(f"{name} has negative values, expected at least 0.")
        for name, count in (("uplink_bytes_per_s", num_devices), ("edge_uplink_bytes_per_s", num_edges)):
            if (check_array(name, getattr(self, name), (count,)) <= 0).any():
                raise BadInput(f"{name} has values that are not positive: a machine without bandwidth never delivers, drop it instead.")
        if np.isnan(self.fails_s).any() or self.fails_s.shape != (num_devices,) or self.dropped.shape != (num_devices,):
            raise BadInput("fails_s and dropped need one value per device, fails_s inf for never.")


@dataclass(frozen=True, kw_only=True, eq=False)
class BandwidthTrace:
    """The network's share of full bandwidth: shares (T,) > 0 from times_s (T,) on, the first time
    0; the last holds for ever."""

    times_s: FloatArray
    shares: FloatArray

    def __post_init__(self) -> None:
        times_s = check_array("times_s", self.times_s, (None,))
        shares = check_array("shares", self.shares, (len(times_s),))
        if not len(times_s) or times_s[0] != 0 or (np.diff(times_s) <= 0).any() or (shares <= 0).any():
            raise BadInput("a bandwidth trace needs rising times from 0 s and positive shares: a network that stops never delivers.")

    def sent_s(self, start_s: FloatArray, seconds: FloatArray) -> FloatArray:
        """When what takes `seconds` at full bandwidth has been sent from `start_s` on."""
        sent = np.concatenate([[0.0], np.cumsum(np.diff(self.times_s) * self.shares[:-1])])
        at = np.searchsorted(self.times_s, start_s, side="right") - 1
        target = sent[at] + (start_s - self.times_s[at]) * self.shares[at] + seconds
        end = np.searchsorted(sent, target, side="right") - 1
        return self.times_s[end] + (target - sent[end]) / self.shares[end]


@dataclass(frozen=True, kw_only=True, eq=False)
class Timeline:
    """device_done_s (D,), inf where it dropped out; edge_ready_s, edge_done_s (E,): all arrived;
    joined and sent. 0 without devices."""

    device_done_s: FloatArray
    edge_ready_s: FloatArray
    edge_done_s: FloatArray

    @property
    def makespan_s(self) -> float:
        """When the last edge has delivered."""
        return float(self.edge_done_s.max())


def simulate(fleet: Fleet, trace: BandwidthTrace | None = None) -> Timeline:
    """Play the fleet once."""
    finished = fleet.start_s + fleet.work_s
    failed = (fleet.fails_s >= fleet.start_s) & (fleet.fails_s < finished)
    finished = np.where(failed, fleet.fails_s + fleet.repair_s + fleet.work_s, finished)
    sending = fleet.model_bytes / fleet.uplink_bytes_per_s
    sent_s = finished + sending if trace is None else trace.sent_s(finished, sending)
    arrived = np.where(fleet.dropped, 0.0, sent_s)
    first = np.searchsorted(fleet.edge_of_device, np.arange(len(fleet.aggregate_s)))
    ready = np.maximum.reduceat(arrived, first)
    joined_bytes = np.add.reduceat(np.where(fleet.dropped, 0.0, fleet.model_bytes), first)
    nobody = np.logical_and.reduceat(fleet.dropped, first)
    joined = ready + fleet.aggregate_s
    sending = joined_bytes / fleet.edge_uplink_bytes_per_s
    edge_done = joined + sending if trace is None else trace.sent_s(joined, sending)
    return Timeline(device_done_s=np.where(fleet.dropped, np.inf, sent_s), edge_ready_s=ready, edge_done_s=np.where(nobody, 0.0, edge_done))


def fleet_of(system: System, quotas: ArrayLike) -> Fleet:
    """The fleet of a system whose devices have `quotas` (D,) cameras; those without are idle."""
    quotas = check_array("quotas", quotas, (len(system.devices),), np.int64)
    sizes = [len(edge.devices) for edge in system.edges]
    edge_of_device = np.repeat(np.arange(len(sizes)), sizes)
    counts = np.bincount(edge_of_device, weights=quotas).astype(np.int64)
    working = np.bincount(edge_of_device, weights=quotas > 0).astype(np.int64)
    loads = list(zip(system.edges, counts.tolist(), working.tolist(), strict=True))
    pairs = list(zip(system.devices, quotas.tolist(), strict=True))
    return Fleet(
        edge_of_device=edge_of_device,
        start_s=np.zeros(len(quotas)),
        work_s=np.array([float(d.init_s(count) + d.train_s(count)) for d, count in pairs]),
        model_bytes=np.array([float(d.model_bytes(count)) for d, count in pairs]),
        uplink_bytes_per_s=np.array([d.uplink_bytes_per_s for d in system.devices]),
        aggregate_s=np.array([edge.aggregation_s(count, devices) for edge, count, devices in loads]),
        edge_uplink_bytes_per_s=np.array([edge.uplink_bytes_per_s for edge in system.edges]),
        fails_s=np.full(len(quotas), np.inf),
        repair_s=np.zeros(len(quotas)),
        dropped=np.zeros(len(quotas), bool),
    )
