"""How many devices of a system an owner's photographs are worth. Once per plan.

A device learns from its own photographs alone, and what it did not see no join puts right. Where
photographs are few, one device that has all of them makes a better model than several whose models
are joined, in no more steps than each of these takes; so the fastest devices work and the others
stay idle (docs/experiments/aggregation.md, "What one machine makes in the same time").
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.run.predictions import with_camera_limits, with_fixed_steps
from radiant_app.run.training_costs import scaled_to_training
from radiant_core.decisions import Decision
from radiant_core.io.transport.upload import BYTES_FACTORS
from radiant_core.plan.system import Device, System
from radiant_core.regimes import DEVICES, Regime, look_up
from radiant_core.train.config import TrainConfig

COST = (
    "one device that had all of 15 to 28 photographs made a model 0.2 to 1.9 dB better than four whose models were joined in six "
    "of seven cells (0.1 worse in one), with as many steps as each of them"
)


@dataclass(frozen=True, kw_only=True)
class Workforce:
    """The part of a system that works, and what a user is told."""

    system: System
    decision: Decision | None = None
    warning: str | None = None


def num_devices_worth(num_photographs: int, num_devices: int) -> int:
    """How many of so many equal devices so many training photographs are worth, at least one."""
    case = _case_of(num_photographs, num_devices)
    return num_devices if case is None else min(num_devices, max(1, num_photographs // case.values["photographs_each"]))


def _case_of(num_photographs: int, num_devices: int) -> Regime | None:
    """Why these are few; None where they are not."""
    return look_up(DEVICES, {"photographs": num_photographs, "photographs_each": num_photographs / num_devices})


def choose_workforce(config: RunConfig, system: System, num_photographs: int, train: TrainConfig) -> Workforce:
    """The devices that so many training photographs of one owner are worth, the fastest that hold
    them; all where the user asks for all, or for a plan by another method."""
    plan, num_devices = config.plan, len(system.devices)
    wanted = num_devices_worth(num_photographs, num_devices)
    if wanted == num_devices:
        return Workforce(system=system)
    few = f"{num_photographs} training photographs are few for {num_devices} devices: {COST}"
    if plan.devices != "auto":
        return Workforce(system=system, warning=f"{few}; without --devices {plan.devices} fewer would work.")
    if plan.asks_together:
        return Workforce(system=system, warning=f"{few}; they are to train together, else fewer would work.")
    if plan.file is not None or plan.method != "exact":
        option = f"--plan-method {plan.method}" if plan.file is None else "--plan"
        return Workforce(system=system, warning=f"{few}; without {option} fewer would work.")
    # Curves of several trainings, or of other steps than these, say nothing of who is faster.
    scaled = scaled_to_training(system, train, config.train.preset, num_photographs).system
    names = _fastest_that_hold(config, with_fixed_steps(scaled, train), num_photographs, train, wanted)
    if len(names) == num_devices:
        return Workforce(system=system, warning=f"{few}; fewer cannot hold them: raise max_cameras or memory_gb.")
    return _workforce_of(_restrict(system, names), num_photographs, num_devices)


def _fastest_that_hold(config: RunConfig, system: System, num_photographs: int, train: TrainConfig, wanted: int) -> Collection[str]:
    """Ids of as few devices as hold the photographs, `wanted` or more, and of those the fastest."""
    limited, _, too_small = with_camera_limits(system, train, num_photographs, BYTES_FACTORS[config.upload])
    everyone = [device.id for device in system.devices]
    if too_small:
        return everyone
    capacity = {device.id: num_photographs if device.max_cameras is None else device.max_cameras for device in limited.devices}
    together = np.cumsum(sorted(capacity.values(), reverse=True))
    count = max(wanted, int(np.searchsorted(together, num_photographs)) + 1)
    fastest = sorted(system.devices, key=lambda device: _seconds(device, num_photographs / count))
    for slowest in range(count, len(everyone)):
        # The slowest is as fast as may be; of those up to it, whoever holds most.
        chosen = sorted((device.id for device in fastest[:slowest]), key=lambda name: -capacity[name])[:count]
        if sum(capacity[name] for name in chosen) >= num_photographs:
            return chosen
    return sorted(everyone, key=lambda name: -capacity[name])[:count]


def _workforce_of(working: System, num_photographs: int, num_devices: int) -> Workforce:
    names, case = [device.id for device in working.devices], _case_of(num_photographs, num_devices)
    assert case is not None, "few photographs are a measured case"
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
        reason=f"{case.reason}: {COST}",
        row=case.row,
    )
    return Workforce(system=working, decision=decision, warning=f"{choice}: too few to divide; --devices all deals them to all.")


def _seconds(device: Device, num_photographs: float) -> float:
    upload_s = float(device.model_bytes(num_photographs)) / device.uplink_bytes_per_s
    return float(device.init_s(num_photographs)) + float(device.train_s(num_photographs)) + upload_s


def _restrict(system: System, names: Collection[str]) -> System:
    """The system with these devices, and the edges that have any of them."""
    kept_of = {edge.id: tuple(device for device in edge.devices if device.id in names) for edge in system.edges}
    return replace(system, edges=tuple(replace(edge, devices=devices) for edge in system.edges if (devices := kept_of[edge.id])))
