"""What machines of a plan cost for the training that their system file names, and how many
photographs they do by a deadline. Once per plan.

The least makespan does not fall with the number of photographs (`plan/counts/deadline.py`), so that
halving finds the most of them whose least makespan is within the deadline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

from radiant_app.run.predictions import depends_on_training, planned_training, with_camera_limits, with_short_joins, with_step_law
from radiant_app.run.training_costs import scaled_to_training
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.errors import BadInput
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts, system_capacity
from radiant_core.plan.system import System
from radiant_core.train.config import Preset
from radiant_core.train.needs import Overrides


@dataclass(frozen=True, kw_only=True)
class InTime:
    """How many of the best views machines do by a deadline, and at which costs; choice, and
    left_out, why others are: None where none is."""

    system: System
    num_views: int
    choice: str = ""
    left_out: str | None = None
    warnings: tuple[str, ...] = ()


def views_in_time(system: System, count: int, deadline_s: float, *, asked: bool) -> InTime:
    """The most of `count` views with which every edge is done by the deadline, dealt in the fastest
    way; BadInput where that is none. asked: whether so many were asked for, and not as many as
    possible; of those that memory does not hold the plan speaks."""
    costed, warnings = costed_by_training(system, count)
    capacity = system_capacity(costed, count)
    if capacity < count and asked:
        return InTime(system=costed, num_views=count, warnings=warnings)
    fits, beyond = 0, min(count, capacity) + 1
    while beyond - fits > 1:
        middle = (fits + beyond) // 2
        fits, beyond = (middle, beyond) if _slowest(system, middle)[0] <= deadline_s else (fits, middle)
    if not fits:
        least_s, edge = _slowest(system, 1)
        raise BadInput(
            f"--deadline is {deadline_s:g} s, and one photograph takes edge {edge!r}, the fastest, {_up(least_s)} s: give a longer one, "
            "or faster machines."
        )
    costed = costed_by_training(system, fits)[0]
    if beyond > min(count, capacity):
        return InTime(system=costed, num_views=fits, warnings=warnings)
    (fits_s, _), (next_s, edge), (all_s, _) = (_slowest(system, num) for num in (fits, fits + 1, count))
    left_out = f"{fits} take {_up(fits_s)} s of {deadline_s:g} s to train, join and send, one more takes edge {edge!r} {_up(next_s)} s"
    if not asked:
        return InTime(system=costed, num_views=fits, choice=f"{fits} views", left_out=left_out, warnings=warnings)
    choice = f"{count - fits} of {count} views, those of least gain, are left out"
    return InTime(system=costed, num_views=fits, choice=choice, left_out=f"{left_out}, all take {_up(all_s)} s", warnings=warnings)


def _slowest(system: System, num_views: int) -> tuple[float, str]:
    """The least makespan in s of so many views, infinite where memory holds fewer, and the edge
    that takes it."""
    costed, _ = costed_by_training(system, num_views)
    if system_capacity(costed, num_views) < num_views:
        return math.inf, system.edges[0].id
    edge_time_s = fastest_edge_counts(costed, num_views).edge_time_s
    return float(edge_time_s.max()), system.edges[int(edge_time_s.argmax())].id


def _up(seconds: float) -> str:
    """Seconds to a tenth, rounded up: a deadline of as many is enough."""
    return f"{math.ceil(10 * seconds) / 10:.1f}"


def costed_by_training(system: System, num_positions: int) -> tuple[System, tuple[str, ...]]:
    """The system with limits by memory, where it has none, and profiles taken at the steps of so
    many photographs, for the training that it names, else the default one; warnings."""
    if not depends_on_training(system):
        return system, ()
    preset, overrides = _training_of(system)
    train = planned_training(preset, overrides)
    scaled = scaled_to_training(system, train, preset, num_positions)
    shorter = with_short_joins(with_step_law(scaled.system, train, num_positions), train, num_positions, AggregateConfig())
    limited, _, warnings = with_camera_limits(shorter, train, num_positions)
    return limited, warnings if scaled.note is None else (scaled.note, *warnings)


def _training_of(system: System) -> tuple[Preset, Overrides]:
    """The training that the costs of the machines hold for; the default one where their file does
    not say."""
    training = system.training
    preset = next((name for name in get_args(Preset) if training is not None and name == training.preset), None)
    if training is None or preset is None:
        return "default", Overrides()
    return preset, Overrides(long_side_px=training.long_side_px, num_steps=training.num_steps, max_num_splats=training.max_num_splats)
