"""Counts after a change against all counts there are: the least makespan, then the fewest that
leave, then the nearest edge."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.revision import replan_counts
from radiant_core.plan.revision.replan_counts import EdgeLoad, MachineLoad, solve_counts
from radiant_core.plan.system import Device, Edge
from tests.seeds import for_seeds


def machine(name: str, seconds: float, now: int, fixed: int = 0, most: int = 99, **more: object) -> MachineLoad:
    """A device that takes so many seconds and a second of sending per position."""
    device = Device(
        id=name, init_s=CostCurve(), train_s=CostCurve(linear=seconds), model_bytes=CostCurve(linear=10.0), uplink_bytes_per_s=10.0
    )  # fmt: skip
    return MachineLoad(device=device, now=now, fixed=fixed, most=most, **more)  # type: ignore[arg-type]


def edge(name: str, *machines: MachineLoad, distance_m: float = 0.0, aggregate: float = 0.5, finished: bool = False) -> EdgeLoad:
    """An edge whose time is its slowest device's and 0.5 s per position, a quarter to send it."""
    made = Edge(
        id=name,
        position=(0.0, 0.0),
        aggregate_s=CostCurve(linear=aggregate),
        uplink_bytes_per_s=40.0,
        devices=tuple(load.device for load in machines) or (machine(f"{name}-none", 1.0, 0).device,),
    )
    return EdgeLoad(edge=made, machines=machines, distance_m=distance_m, finished=finished)


def time_s(load: EdgeLoad, quotas: tuple[int, ...]) -> float:
    """T^m from the paper's equations, nothing of the module."""
    if load.finished or not sum(quotas):
        return 0.0
    ready = 0.0
    for one, quota in zip(load.machines, quotas, strict=True):
        if quota:
            own = 0.0 if one.closed else quota * one.device.train_s.linear + quota
            ready = max(ready, one.busy_s + own)
    return ready + sum(quotas) * load.edge.aggregate_s.linear + sum(quotas) / 4


def leaving(load: EdgeLoad, quotas: tuple[int, ...]) -> int:
    return sum(max(0, one.now - quota) for one, quota in zip(load.machines, quotas, strict=True))


def all_choices(loads: list[EdgeLoad], total: int) -> list[tuple[float, int, tuple[tuple[int, ...], ...]]]:
    """Makespan, leaving positions and quotas of every allowed way to deal `total` positions."""
    ranges = [
        range(one.fixed, (one.fixed if one.closed or load.finished else min(one.most, total)) + 1)
        for load in loads
        for one in load.machines
    ]
    sizes = np.cumsum([0, *(len(load.machines) for load in loads)]).tolist()
    found = []
    for flat in product(*ranges):
        if sum(flat) == total:
            quotas = tuple(tuple(flat[sizes[index] : sizes[index + 1]]) for index in range(len(loads)))
            makespan = max(time_s(load, own) for load, own in zip(loads, quotas, strict=True))
            found.append((makespan, sum(leaving(load, own) for load, own in zip(loads, quotas, strict=True)), quotas))
    return found


def random_loads(rng: np.random.Generator) -> tuple[list[EdgeLoad], int]:
    loads = []
    for index in range(int(rng.integers(1, 4))):
        machines = []
        for name in range(int(rng.integers(1, 3)) if index < 2 else 1):
            now = int(rng.integers(0, 4))
            fixed = int(rng.integers(0, now + 1)) if rng.random() < 0.5 else 0
            closed = rng.random() < 0.15
            busy_s = float(rng.uniform(0, 6)) if rng.random() < 0.4 else 0.0
            most = int(rng.integers(now, 8)) if rng.random() < 0.3 else 99
            machines.append(
                machine(f"d{index}-{name}", rng.uniform(0.3, 3), now, now if closed else fixed, most, busy_s=busy_s, closed=closed)
            )
        loads.append(edge(f"e{index}", *machines, distance_m=float(rng.uniform(0, 100)), aggregate=rng.uniform(0, 1)))
    total = sum(load.now for load in loads) + int(rng.integers(0, 4))
    return loads, total


@pytest.mark.parametrize("tolerance", [0.0, 0.25])
@for_seeds(60)
def test_no_other_quotas_are_faster_or_make_fewer_leave(seed: int, tolerance: float) -> None:
    loads, total = random_loads(np.random.default_rng(seed))
    found, choices = solve_counts(loads, total, tolerance), all_choices(loads, total)
    if found is None:
        assert not choices
        return
    least_s = min(makespan for makespan, _, _ in choices)
    assert found.deadline_s == pytest.approx(least_s, rel=1e-12)
    allowed = [row for row in choices if row[0] <= least_s * (1 + tolerance) * (1 + 1e-11)]
    assert found.quotas in [quotas for _, _, quotas in allowed]
    fewest = min(moves for _, moves, _ in allowed)
    assert found.proved and sum(leaving(load, own) for load, own in zip(loads, found.quotas, strict=True)) == fewest


def test_of_equally_good_edges_the_nearer_one_takes_more() -> None:
    """Nothing decides between two edges that wait for a third: what is left over goes to the nearer
    as long as that forces no move."""
    slow = edge("slow", machine("s", 9.0, 2, fixed=2))
    for near, quotas in ((0, ((2,), (4,), (1,))), (1, ((2,), (1,), (4,)))):
        others = [edge(f"e{index}", machine(f"d{index}", 1.0, 1), distance_m=50.0 - 40 * (index == near)) for index in range(2)]
        found = solve_counts([slow, *others], 7)
        assert found is not None and found.quotas == quotas and found.deadline_s == 21.5


def forced(distances: tuple[float, float]) -> list[EdgeLoad]:
    """A busy machine must give two away; each other can take one only if it gives one up."""
    giving = edge("g", machine("g", 1.0, 4, most=2, busy_s=5.0))
    takers = [edge(f"t{i}", machine(f"a{i}", 1.0, 3, most=3), machine(f"b{i}", 1.0, 0, most=2), distance_m=distances[i]) for i in range(2)]
    return [giving, *takers]


def test_the_dynamic_programme_takes_the_nearer_edge_and_is_left_out_where_it_is_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    near = solve_counts(forced((10.0, 90.0)), 10)
    far = solve_counts(forced((90.0, 10.0)), 10)
    assert near is not None and far is not None and near.proved and far.proved
    assert [sum(own) for own in near.quotas[1:]] == [sum(own) for own in far.quotas[1:]][::-1]
    calls = []
    cheapest = replan_counts._distribute_cheapest
    monkeypatch.setattr(
        replan_counts, "_distribute_cheapest", lambda choices, left: calls.append((len(choices), left)) or cheapest(choices, left)
    )
    loads, total = next(
        (loads, total)
        for loads, total in map(random_loads, map(np.random.default_rng, range(400)))
        if (solve_counts(loads, total), calls)[1]
    )
    count, left = calls[0]
    exact = solve_counts(loads, total)
    monkeypatch.setattr(replan_counts, "MAX_STEPS", count * left * left)
    same = solve_counts(loads, total)
    assert exact is not None and same is not None and same.proved and same.quotas == exact.quotas
    monkeypatch.setattr(replan_counts, "MAX_STEPS", count * left * left - 1)
    fastest = solve_counts(loads, total)
    assert fastest is not None and not fastest.proved and fastest.deadline_s == exact.deadline_s
    makespan = max(time_s(load, own) for load, own in zip(loads, fastest.quotas, strict=True))
    assert makespan <= exact.deadline_s * (1 + 1e-9) and sum(map(sum, fastest.quotas)) == total


def test_a_finished_edge_costs_nothing_and_takes_nothing_and_too_little_room_is_none() -> None:
    done = edge("done", machine("a", 5.0, 3, fixed=3), finished=True)
    work = edge("work", machine("b", 1.0, 2))
    found = solve_counts([done, work], 6)
    assert found is not None and found.quotas == ((3,), (3,)) and found.deadline_s == 3 * 2.75
    assert done.time_s([3]) == 0.0 and work.time_s([0]) == 0.0 and work.time_s([2]) == 5.5
    tight = edge("work", machine("b", 1.0, 2, most=2))
    assert solve_counts([done, tight], 6) is None and solve_counts([done, tight], 5) is not None
    assert solve_counts([done, work], 2) is None, "three stay where they are"
    assert (done.now, done.fixed) == (3, 3)
    empty = edge("empty")
    found = solve_counts([empty, work], 2)
    assert found is not None and found.quotas == ((), (2,))


def test_a_machine_is_ready_after_what_it_already_does() -> None:
    free = machine("a", 2.0, 1)
    assert [free.time_s(quota) for quota in (0, 1, 4)] == [0.0, 3.0, 12.0]
    busy = machine("a", 2.0, 1, busy_s=7.0)
    assert [busy.time_s(quota) for quota in (0, 1, 4)] == [0.0, 10.0, 19.0]
    closed = machine("a", 2.0, 1, busy_s=7.0, closed=True)
    assert [closed.time_s(quota) for quota in (0, 1, 4)] == [0.0, 7.0, 7.0]


@for_seeds(25)
def test_where_devices_send_unequally_quotas_keep_the_fastest_deadline_and_what_is_fixed(seed: int) -> None:
    """No moves are proved there; the makespan is still that of the quickest quotas."""
    rng = np.random.default_rng(seed)
    loads = []
    for index in range(2):
        machines = []
        for name in range(2):
            now = int(rng.integers(0, 12))
            one = machine(f"d{index}-{name}", rng.uniform(0.3, 3), now, int(rng.integers(0, now + 1)))
            sent = replace(one.device, model_bytes=CostCurve(constant=rng.uniform(0, 200), linear=rng.uniform(1, 90)))
            machines.append(replace(one, device=sent))
        loads.append(edge(f"e{index}", *machines))
    total = sum(load.now for load in loads) + 2
    found = solve_counts(loads, total)
    assert found is not None and not found.proved and sum(map(sum, found.quotas)) == total
    for load, own in zip(loads, found.quotas, strict=True):
        assert load.time_s(own) <= found.deadline_s * (1 + 1e-9)
        assert all(quota >= one.fixed for one, quota in zip(load.machines, own, strict=True))
