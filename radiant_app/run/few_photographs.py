"""How many devices of a system an owner's photographs are worth. Once per plan.

A device learns from its own photographs alone, and what it did not see no join puts right. With
fewer than `FEW_PER_DEVICE` photographs each, one device that has all of them makes a better model
than four whose models are joined, in no more steps than each of these takes; so the fastest devices
work and the others stay idle (docs/experiments/aggregation.md, "What one machine makes in the same
time").
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from radiant_app.config.run_config import RunConfig
from radiant_app.run.predictions import with_camera_limits
from radiant_core.decisions import Decision
from radiant_core.hierarchy.recipe import devices_with_photographs
from radiant_core.io.transport.upload import BYTES_FACTORS
from radiant_core.plan.counts.wide_deadline import system_capacity
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import Device, System
from radiant_core.train.config import TrainConfig

FEW_PER_DEVICE = 8
"""Photographs per device below which fewer devices work: with 4 to 7 each on four devices a joined
model was 0.3 to 2.1 dB behind that of one device in six of seven cells and level in one; with 12 to
16 each it was 0.2 to 0.7 dB ahead, in twice the time."""
ENOUGH_PER_DEVICE = 26
"""Photographs of each device that works then, at least: one model of 26 to 28 was level with two of
half of them or better, in half of the time."""
COST = (
    "one device that had all of 15 to 28 photographs made a model 0.3 to 2.1 dB better than four whose models were joined in six "
    "of seven cells (level in one), with as many steps as each of them"
)


@dataclass(frozen=True, kw_only=True)
class Workforce:
    """The part of a system that works, and what a user is told."""

    system: System
    decision: Decision | None = None
    warning: str | None = None


def num_devices_worth(num_photographs: int, num_devices: int) -> int:
    """How many of so many equal devices so many training photographs are worth, at least one."""
    if num_photographs >= FEW_PER_DEVICE * num_devices:
        return num_devices
    return min(num_devices, max(1, num_photographs // ENOUGH_PER_DEVICE))


def choose_workforce(config: RunConfig, system: System, num_photographs: int, train: TrainConfig) -> Workforce:
    """The devices that so many training photographs of one owner are worth, the fastest ones and as
    many more as hold them; all where the user asks for all, or for a plan by another method."""
    plan, num_devices = config.plan, len(system.devices)
    wanted = num_devices_worth(num_photographs, num_devices)
    if wanted == num_devices or plan.devices == "all" or plan.file is not None or plan.method != "exact":
        return Workforce(system=system)
    fastest = sorted(system.devices, key=lambda device: _seconds(device, num_photographs / wanted))
    model_factor = BYTES_FACTORS[config.upload]
    for count in range(wanted, num_devices):
        working = _restrict(system, {device.id for device in fastest[:count]})
        limited, _, too_small = with_camera_limits(working, train, num_photographs, model_factor)
        if not too_small and system_capacity(limited, num_photographs) >= num_photographs:
            return _told(working, num_photographs, num_devices)
    return Workforce(system=system)


def few_photographs_warning(edge_plans: Sequence[EdgePlan]) -> str | None:
    """What joining costs where one owner's photographs are few for so many devices; else None."""
    num_photographs = sum(len(plan.camera_indices) for plan in edge_plans)
    num_devices = devices_with_photographs(edge_plans)
    if num_devices < 2 or num_photographs >= FEW_PER_DEVICE * num_devices:
        return None
    return (
        f"{num_photographs} training photographs are dealt to {num_devices} devices: {COST}; "
        "`--devices auto` uses no more devices than the photographs are worth."
    )


def _told(working: System, num_photographs: int, num_devices: int) -> Workforce:
    names = [device.id for device in working.devices]
    who = f"{names[0]} trains" if len(names) == 1 else f"{', '.join(names)} train"
    num_idle = num_devices - len(names)
    idle = "the other one stays" if num_idle == 1 else f"{num_idle} others stay"
    choice = f"{who} on all {num_photographs} photographs, and {idle} idle"
    decision = Decision(
        stage="plan",
        topic="devices",
        choice=choice,
        figure=num_photographs / num_devices,
        unit="photographs for each device of the system",
        reason=f"below {FEW_PER_DEVICE} {COST}",
    )
    return Workforce(system=working, decision=decision, warning=f"{choice}: {COST}; --devices all deals them to all.")


def _seconds(device: Device, num_photographs: float) -> float:
    upload_s = float(device.model_bytes(num_photographs)) / device.uplink_bytes_per_s
    return float(device.init_s(num_photographs)) + float(device.train_s(num_photographs)) + upload_s


def _restrict(system: System, names: Collection[str]) -> System:
    """The system with these devices, and the edges that have any of them."""

    kept_of = {edge.id: tuple(device for device in edge.devices if device.id in names) for edge in system.edges}
    return replace(system, edges=tuple(replace(edge, devices=kept) for edge in system.edges if (kept := kept_of[edge.id])))
