"""Re-plans: the least makespan and the fewest moves against exhaustive search, what must not move,
and what cannot be done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.devices.device_split import long_axis, split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.revision import replan as replan_module
from radiant_core.plan.revision.assigned import hull_of
from radiant_core.plan.revision.replan import FleetChange, Replan, ReplanInfeasible, extend_system, replan
from radiant_core.plan.system import Device, Edge, System
from tests.seeds import for_seeds


def device(name: str, speed: float = 1.0, most: int | None = None) -> Device:
    return Device(
        id=name,
        init_s=CostCurve(linear=0.1 / speed),
        train_s=CostCurve(constant=2.0 / speed, linear=1 / speed),
        model_bytes=CostCurve(linear=5e5),
        uplink_bytes_per_s=5e6,
        max_cameras=most,
    )


def edge(name: str, position: tuple[float, float], *devices: Device) -> Edge:
    return Edge(id=name, position=position, aggregate_s=CostCurve(constant=1, linear=0.3), uplink_bytes_per_s=1e7, devices=devices)


@dataclass(frozen=True, kw_only=True)
class Made:
    system: System
    positions: FloatArray
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]

    def replanned(self, change: FleetChange, **more: object) -> Replan | ReplanInfeasible:
        return replan(self.cloud, self.edges, self.positions, self.system, change, **more)  # type: ignore[arg-type]


def made(system: System, num_positions: int, seed: int = 0) -> Made:
    positions = np.random.default_rng(seed).random((num_positions, 2)) * 100
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    return Made(system=system, positions=positions, cloud=cloud, edges=split_edges(positions, cloud, system))


def town(num_positions: int = 120) -> Made:
    west = edge("west", (20.0, 50.0), device("w1"), device("w2", 0.7))
    return made(System(edges=(west, edge("east", (80.0, 50.0), device("e1", 1.5), device("e2")))), num_positions)


def solved(result: Replan | ReplanInfeasible) -> Replan:
    assert isinstance(result, Replan)
    require_plan_of(len(result.device_after), result.cloud, result.edges)
    return result


def counts(result: Replan, owners: Sequence[int] | None = None) -> dict[str, int]:
    owned = np.bincount(result.device_after if owners is None else owners, minlength=len(result.system.devices)).tolist()
    return dict(zip((d.id for d in result.system.devices), owned, strict=True))


def test_a_dead_device_gives_all_its_positions_away_and_few_others_move() -> None:
    plan = town()
    result = solved(plan.replanned(FleetChange(dead=frozenset({"e2"}))))
    had = len(plan.edges[1].cameras_of("e2"))
    assert counts(result)["e2"] == 0 and sum(counts(result).values()) == 120
    assert had <= result.moved.sum() <= 2 * had
    assert np.isinf(result.makespan_before_s) and np.isinf(result.time_before_s[3])
    assert result.cloud.makespan_s == result.cloud.lower_bound_s and result.fewest_proved
    # No plan without e2 is faster than one made from nothing.
    others = System(edges=(plan.system.edges[0], replace(plan.system.edges[1], devices=(device("e1", 1.5),))))
    fresh = plan_regions(plan.positions, others)
    assert isinstance(fresh, CloudPlan) and result.cloud.makespan_s == pytest.approx(fresh.makespan_s, rel=1e-12)


def test_captured_positions_never_move_and_those_of_a_dead_device_are_lost() -> None:
    plan = town()
    captured = np.random.default_rng(1).random(120) < 0.4
    result = solved(plan.replanned(FleetChange(dead=frozenset({"w1"}), slow={"e1": 3.0}), captured=captured))
    assert not (result.moved & captured).any() and result.moved.any()
    on_w1 = result.device_before == 0
    np.testing.assert_array_equal(result.lost, on_w1 & captured)
    assert (result.device_after[on_w1 & ~captured] != 0).all()


def test_what_is_done_stays_as_it_is_and_takes_nothing() -> None:
    plan = town()
    result = solved(plan.replanned(FleetChange(dead=frozenset({"e2"}), done=frozenset({"west"}))))
    for index in (0, 1):
        np.testing.assert_array_equal(result.edges[0].cameras_of(f"w{index + 1}"), plan.edges[0].cameras_of(f"w{index + 1}"))
    assert result.time_after_s[:2].tolist() == [0.0, 0.0] and result.cloud.edge_time_s[0] == 0.0
    assert counts(result)["e1"] == len(plan.edges[1].camera_indices)
    np.testing.assert_array_equal(result.cloud.borders[0], plan.cloud.borders[0])
    for old, new in zip(plan.edges[0].strips, result.edges[0].strips, strict=True):
        np.testing.assert_array_equal(old, new)
    nothing = solved(plan.replanned(FleetChange(done=frozenset({"west", "east"}))))
    assert not nothing.moved.any() and nothing.cloud.makespan_s == 0.0


def test_nothing_new_moves_nothing_and_a_tolerance_moves_less() -> None:
    plan = town()
    same = solved(plan.replanned(FleetChange()))
    assert not same.moved.any() and same.cloud.makespan_s == pytest.approx(plan.cloud.makespan_s, rel=1e-9)
    assert same.makespan_before_s == pytest.approx(plan.cloud.makespan_s, rel=1e-9)
    slow = FleetChange(slow={"w1": 1.3})
    exact, loose = solved(plan.replanned(slow)), solved(plan.replanned(slow, tolerance=0.05))
    assert exact.moved.sum() > loose.moved.sum()
    assert exact.cloud.makespan_s <= loose.cloud.makespan_s <= 1.05 * exact.cloud.makespan_s * (1 + 1e-9)
    assert exact.cloud.makespan_s < exact.makespan_before_s


def test_a_busy_device_is_waited_for() -> None:
    plan = town()
    free, busy = solved(plan.replanned(FleetChange())), solved(plan.replanned(FleetChange(busy_s={"e1": 20.0})))
    assert counts(busy)["e1"] < counts(free)["e1"]
    assert busy.time_after_s[2] == pytest.approx(20.0 + device_time_s(plan.system.devices[2], counts(busy)["e1"]))


def test_a_joined_edge_and_device_take_the_land_beside_them() -> None:
    plan = town(400)
    joining = System(edges=(edge("north", (50.0, 95.0), device("n1"), device("n2")), edge("west", (0.0, 0.0), device("w3"))))
    result = solved(plan.replanned(FleetChange(), joining=joining))
    assert [e.id for e in result.system.edges] == ["west", "east", "north"] and counts(result)["w3"] > 0
    assert result.system.edges[0].position == (20.0, 50.0), "an edge that was there keeps its place"
    assert result.cloud.makespan_s < result.makespan_before_s
    new, rest = result.cloud.edge_of_camera == 2, result.cloud.edge_of_camera != 2
    assert plan.positions[new, 1].mean() > plan.positions[rest, 1].mean() + 20
    own = assign(plan.positions, result.cloud.sites, result.cloud.weights)
    assert (own == result.cloud.edge_of_camera).mean() > 0.7, "what moved lies apart, yet most are in their own region"
    assert len(result.edges[2].cameras_of("n1")) > 0 and all(len(strip) >= 3 for strip in result.edges[2].strips)
    assert result.moved.sum() == counts(result)["w3"] + counts(result)["n1"] + counts(result)["n2"], "only what goes to the new ones"


def test_what_cannot_be_done_is_said_with_the_capacity() -> None:
    plan = town()
    everybody = plan.replanned(FleetChange(dead=frozenset({"west", "east"})))
    assert isinstance(everybody, ReplanInfeasible) and everybody.capacity == 0 and "0 of 120 positions" in everybody.reason
    gone = plan.replanned(FleetChange(dead=frozenset({"west", "east"})), captured=np.ones(120))
    assert isinstance(gone, ReplanInfeasible) and "plan them anew" in gone.reason
    tight = made(System(edges=(edge("a", (0.0, 0.0), device("a1", most=30), device("a2", most=30)),)), 60)
    full = tight.replanned(FleetChange(dead=frozenset({"a2"})))
    assert isinstance(full, ReplanInfeasible) and full.capacity == 30 and "30 of 60 positions" in full.reason
    one = made(System(edges=(edge("a", (0.0, 0.0), device("a1")),)), 5)
    assert not solved(one.replanned(FleetChange(slow={"a1": 4.0}))).moved.any()
    closed = plan.replanned(FleetChange(dead=frozenset({"w1"}), closed=frozenset({"w2", "e1", "e2"})))
    assert isinstance(closed, ReplanInfeasible) and closed.capacity == 120 - len(plan.edges[0].cameras_of("w1"))


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ({"slow": {"w1": np.nan}}, "'w1' is slow by nan, expected a finite factor above 0"),
        ({"slow": {"w1": 0.0}}, "slow by 0.0"),
        ({"slow": {"w1": -2.0}}, "slow by -2.0"),
        ({"busy_s": {"w1": np.inf}}, "busy for inf s"),
        ({"dead": frozenset({"w1"}), "done": frozenset({"w1"})}, "dead and as done"),
    ],
)
def test_impossible_situations_are_refused(about: Mapping[str, object], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        FleetChange(**about)  # type: ignore[arg-type]


def test_what_does_not_belong_together_is_refused() -> None:
    plan = town()
    for field in ("dead", "done", "closed"):
        with pytest.raises(BadInput, match=r"no device or edge 'w9': there are e1, e2, w1, w2, of west, east"):
            plan.replanned(FleetChange(**{field: frozenset({"w9"})}))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="no device or edge 'w9'"):
        plan.replanned(FleetChange(slow={"w9": 2.0}))
    with pytest.raises(BadInput, match="tolerance is nan"):
        plan.replanned(FleetChange(), tolerance=float("nan"))
    with pytest.raises(BadInput, match="device id 'w1' comes twice"):
        extend_system(plan.system, System(edges=(edge("new", (0.0, 0.0), device("w1")),)))
    with pytest.raises(BadInput, match="'new' has no position"):
        plan.replanned(FleetChange(), joining=System(edges=(replace(edge("new", (0.0, 0.0), device("n1")), position=None),)))
    with pytest.raises(BadInput, match="shape"):
        replan(plan.cloud, plan.edges, plan.positions[1:], plan.system, FleetChange())
    with pytest.raises(BadInput, match="captured"):
        plan.replanned(FleetChange(), captured=np.full(120, np.nan))


def best_by_search(plan: Made, system: System, change: FleetChange, captured: np.ndarray, before: np.ndarray) -> tuple[float, int]:
    """Least makespan and fewest moves over all owners of the positions that may move, times written
    out from the paper's equations."""
    devices, names = system.devices, [d.id for d in system.devices]
    edge_of = np.repeat(np.arange(len(system.edges)), [len(e.devices) for e in system.edges])
    stays = captured | np.array([names[o] in change.done for o in before])
    lost = captured & np.array([names[o] in change.dead for o in before])
    takers = [i for i, name in enumerate(names) if name not in change.dead | change.done]
    free = np.flatnonzero(~stays)
    found: list[tuple[float, int]] = []
    for choice in product(takers, repeat=len(free)):
        owners = before.copy()
        owners[free] = choice
        held = np.bincount(owners[~lost], minlength=len(names))
        limits = [(int(held[i]), devices[i].max_cameras) for i in takers]
        if any(limit is not None and count > limit for count, limit in limits):
            continue
        worst = 0.0
        for index, e in enumerate(system.edges):
            own = np.flatnonzero(edge_of == index)
            if not held[own].sum():
                continue
            ready = 0.0
            for i in own:
                if held[i] and names[i] not in change.done:
                    slow = change.slow.get(names[i], 1.0)
                    d, k = devices[i], int(held[i])
                    spent = slow * (d.init_s(k) + d.train_s(k)) + d.model_bytes(k) / d.uplink_bytes_per_s
                    ready = max(ready, change.busy_s.get(names[i], 0.0) + float(spent))
            sent = sum(float(devices[i].model_bytes(int(held[i]))) for i in own) / e.uplink_bytes_per_s
            worst = max(worst, ready + float(e.aggregate_s(int(held[own].sum()))) + sent)
        found.append((worst, int((owners != before).sum())))
    least = min(makespan for makespan, _ in found)
    return least, min(moves for makespan, moves in found if makespan <= least * (1 + 1e-12))


def test_exhaustive_search_finds_nothing_faster_and_no_fewer_moves() -> None:
    """100 fleets of 2 to 4 devices at 1 or 2 edges with up to 5 positions: dead, done, slow, busy,
    captured, joining and full devices."""
    checked = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        num = int(rng.integers(2, 6))
        speeds = rng.uniform(0.5, 2.0, 4)
        most = [None if rng.random() < 0.7 else num for _ in range(4)]
        first = edge("a", (20.0, 50.0), *(device(f"a{i}", speeds[i], most[i]) for i in range(rng.integers(1, 3))))
        second = edge("b", (80.0, 50.0), *(device(f"b{i}", speeds[2 + i], most[2 + i]) for i in range(rng.integers(1, 3))))
        plan = made(System(edges=(first, second)), num, seed)
        names = [d.id for d in plan.system.devices]
        picked = rng.permutation(names)
        change = FleetChange(
            dead=frozenset(picked[:1] if rng.random() < 0.6 else ()),
            done=frozenset(picked[1:2] if rng.random() < 0.3 and len(names) > 2 else ()),
            slow={picked[-1]: float(rng.uniform(0.5, 4.0))},
            busy_s={picked[-2]: float(rng.uniform(0, 10))} if rng.random() < 0.5 and picked[-2] not in picked[:2] else {},
        )
        joining = System(edges=(edge("c", (50.0, 90.0), device("c0", 1.2)),)) if rng.random() < 0.3 else None
        captured = rng.random(num) < 0.25
        result = plan.replanned(change, captured=captured, joining=joining)
        if isinstance(result, ReplanInfeasible):
            assert captured.all() or len(change.dead) + len(change.done) == len(names), seed
            continue
        system = plan.system if joining is None else extend_system(plan.system, joining)
        least_s, fewest = best_by_search(plan, system, change, captured, result.device_before)
        assert result.cloud.makespan_s == pytest.approx(least_s, rel=1e-9), seed
        assert result.moved.sum() == fewest, seed
        assert result.fewest_proved
        checked += 1
    assert checked > 80


def test_those_that_move_are_the_nearest_for_one_and_for_several_that_lose() -> None:
    """Against every assignment with the same quotas: Σ of squared distances to devices' centres."""
    for seed, change in enumerate(
        [FleetChange(slow={"w1": 3.0}), FleetChange(slow={"w1": 4.0, "e1": 4.0}), FleetChange(dead=frozenset({"w2"}))] * 4
    ):
        plan = made(town().system, 6, seed)
        result = solved(plan.replanned(change))
        centres = np.array([[0.0, 0.0]] * 4)
        for index in range(4):
            own = plan.positions[result.device_before == index]
            centres[index] = own.mean(axis=0) if len(own) else np.array(plan.system.edges[index // 2].position)
        squared = np.sum((plan.positions[:, None] - centres) ** 2, axis=-1)
        gains = squared - squared[np.arange(6), result.device_before][:, None]
        held = np.bincount(result.device_after, minlength=4)
        best = min(
            sum(gains[i, o] for i, o in enumerate(owners))
            for owners in product(range(4), repeat=6)
            if (np.bincount(owners, minlength=4) == held).all() and (np.array(owners) != result.device_before).sum() == result.moved.sum()
        )
        cost = float(gains[np.arange(6), result.device_after].sum())
        assert cost == pytest.approx(best, rel=1e-9, abs=1e-9), (seed, change)


def test_unequal_uploads_keep_the_deadline_and_say_that_moves_are_not_proved() -> None:
    """One device sends ten times the bytes: quotas keep the makespan of the fastest dealing."""
    heavy = replace(device("w2", 0.7), model_bytes=CostCurve(constant=1e6, linear=5e6))
    plan = made(System(edges=(edge("west", (20.0, 50.0), device("w1"), heavy), edge("east", (80.0, 50.0), device("e1")))), 100)
    result = solved(plan.replanned(FleetChange(slow={"e1": 2.0})))
    assert not result.fewest_proved and result.cloud.makespan_s <= result.cloud.lower_bound_s * (1 + 1e-9)


def test_twenty_thousand_positions_are_replanned_in_seconds() -> None:
    devices = [tuple(device(f"d{e}-{i}", 1 + 0.1 * i) for i in range(4)) for e in range(16)]
    where = [(float(x), float(y)) for x in (10, 35, 60, 85) for y in (10, 35, 60, 85)]
    plan = made(System(edges=tuple(edge(f"e{i}", where[i], *own) for i, own in enumerate(devices))), 20_000)
    result = solved(plan.replanned(FleetChange(dead=frozenset({"d3-0", "e7"}), slow={"d0-0": 2.0}), tolerance=0.01))
    gone = sum(len(plan.edges[e].cameras_of(n)) for e, n in [(3, "d3-0"), *((7, f"d7-{i}") for i in range(4))])
    assert gone <= result.moved.sum() <= 1.4 * gone
    assert len(result.cloud.borders[7]) == 0, "nobody owns the land of a dead edge"
    assert result.cloud.makespan_s <= 1.01 * result.cloud.lower_bound_s * (1 + 1e-9)


def test_an_edge_that_need_not_join_is_counted_so_and_stays_within_the_deadline() -> None:
    """Where one device has all positions of its edge nothing is retrained: against all quotas of
    one edge with two devices."""
    first, second = device("a", 1.0), device("b", 0.3)
    one = replace(edge("one", (0.0, 0.0), first, second), aggregate_alone_s=CostCurve(constant=0.5))
    for num_positions in (1, 2, 3, 5, 8, 13):
        plan = made(System(edges=(one,)), num_positions)
        result = solved(plan.replanned(FleetChange(slow={"a": 1.01})))
        slowed = result.system.edges[0]

        def time_s(quotas: tuple[int, int], edge: Edge = slowed) -> float:
            pairs = list(zip(edge.devices, quotas, strict=True))
            ready_s = max(float(device_time_s(d, n)) if n else 0.0 for d, n in pairs)
            sent = sum(float(d.model_bytes(n)) for d, n in pairs)
            return ready_s + edge.aggregation_s(sum(quotas), sum(n > 0 for n in quotas)) + sent / edge.uplink_bytes_per_s

        found = counts(result)
        assert result.cloud.makespan_s == pytest.approx(time_s((found["a"], found["b"])), rel=1e-12)
        # As in `radiant plan`: quotas of the fastest devices, with what they then need to join.
        assert result.cloud.makespan_s <= result.cloud.lower_bound_s * (1 + 1e-9)
        assert not result.fewest_proved or num_positions == 0


def test_an_edge_of_which_nothing_changed_keeps_its_strips_and_another_gets_hulls() -> None:
    plan = town()
    same = solved(plan.replanned(FleetChange()))
    for old, new in zip(plan.edges, same.edges, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(old.strips, new.strips, strict=True))
    # e2 gives to e1 alone: the west is as before.
    result = solved(plan.replanned(FleetChange(dead=frozenset({"e2"}), closed=frozenset({"w1", "w2"}))))
    west, east = result.edges
    assert all(np.array_equal(a, b) for a, b in zip(plan.edges[0].strips, west.strips, strict=True))
    np.testing.assert_array_equal(east.strips[0], hull_of(plan.positions[result.device_after == 2]))
    assert len(east.strips[1]) == 0


def test_limits_of_what_is_said_of_a_machine() -> None:
    for factor in (1e-9, 1e6):
        assert FleetChange(slow={"w1": factor}).slow["w1"] == factor
    with pytest.raises(BadInput, match="slow by 1000001"):
        FleetChange(slow={"w1": 1_000_001.0})
    assert FleetChange(busy_s={"w1": 0.0}).busy_s["w1"] == 0
    with pytest.raises(BadInput, match=r"busy for -0\.1 s"):
        FleetChange(busy_s={"w1": -0.1})
    with pytest.raises(BadInput, match="positions has shape"):
        replan(town().cloud, town().edges, np.zeros((3, 2)), town().system, FleetChange())


@pytest.mark.parametrize(
    ("curve", "proved"),
    [
        (CostCurve(linear=5e5), True),
        (CostCurve(power_coefficient=5e5, exponent=1.0), True),
        (CostCurve(linear=2e5, power_coefficient=3e5, exponent=1.0), True),
        (CostCurve(power_coefficient=5e5, exponent=2.0), False),
        (CostCurve(constant=1e6, linear=5e5), False),
    ],
)
def test_fewest_moves_are_proved_where_what_is_sent_depends_on_the_sum_alone(curve: CostCurve, proved: bool) -> None:
    west = edge("west", (20.0, 50.0), *(replace(device(name), model_bytes=curve) for name in ("w1", "w2")))
    east = edge("east", (80.0, 50.0), *(replace(device(name), model_bytes=curve) for name in ("e1", "e2")))
    result = solved(made(System(edges=(west, east)), 60).replanned(FleetChange(slow={"w1": 2.0})))
    assert result.fewest_proved is proved and result.cloud.makespan_s <= result.cloud.lower_bound_s * (1 + 1e-9)


def test_polygons_of_a_replan_are_the_cells_of_its_weights() -> None:
    plan = town()
    result = solved(plan.replanned(FleetChange(dead=frozenset({"w1"}), slow={"e1": 2.0})))
    assert (result.cloud.edge_of_camera != plan.cloud.edge_of_camera).any(), "regions are new"
    cells = assign(plan.positions, result.cloud.sites, result.cloud.weights)
    for index, border in enumerate(result.cloud.borders):
        # Millimetres: polygons have rounded corners where cells meet.
        inside = shapely.distance(shapely.points(plan.positions), shapely.Polygon(border)) < 1e-3
        np.testing.assert_array_equal(inside, cells == index)


def test_dead_devices_have_no_time_in_the_new_plan_and_nothing_is_left_to_replan_without_positions() -> None:
    plan = town()
    result = solved(plan.replanned(FleetChange(dead=frozenset({"e2"}))))
    assert result.edges[1].device_time_s[1] == 0.0 and result.edges[1].device_time_s[0] > 0
    gone = plan.replanned(FleetChange(dead=frozenset({"west", "east"})), captured=np.ones(120))
    assert isinstance(gone, ReplanInfeasible) and (gone.num_positions, gone.capacity, gone.status) == (120, 0, "infeasible")
    assert gone.reason == "all 120 positions were captured by devices that are dead: plan them anew."
    everybody = plan.replanned(FleetChange(dead=frozenset({"west", "east"})))
    assert isinstance(everybody, ReplanInfeasible)
    assert everybody.reason == "the machines that are left can hold 0 of 120 positions: let more join, or raise max_cameras."


def test_a_slow_edge_slows_its_devices_and_what_it_joins_and_both_factors_multiply() -> None:
    plan = town()
    result = solved(plan.replanned(FleetChange(slow={"west": 2.0, "w1": 3.0})))
    old, new = plan.system.edges[0], result.system.edges[0]
    assert [d.train_s.linear / o.train_s.linear for d, o in zip(new.devices, old.devices, strict=True)] == pytest.approx([6.0, 2.0])
    assert [d.init_s.linear / o.init_s.linear for d, o in zip(new.devices, old.devices, strict=True)] == pytest.approx([6.0, 2.0])
    assert new.aggregate_s.linear == pytest.approx(2 * old.aggregate_s.linear) and result.system.edges[1] == plan.system.edges[1]
    busy = solved(plan.replanned(FleetChange(busy_s={"west": 10.0})))
    held = counts(busy)
    for index, name in enumerate(("w1", "w2")):
        assert busy.time_after_s[index] == pytest.approx(10.0 + float(device_time_s(plan.system.devices[index], held[name])))


@pytest.mark.parametrize(
    ("gains", "total", "parts"),
    [([3, 0, 1], 4, [3, 0, 1]), ([3, 0, 1], 2, [2, 0, 0]), ([1, 1, 1], 2, [1, 1, 0]), ([0, 0, 0], 0, [0, 0, 0]), ([5, 3, 2], 5, [3, 1, 1])],
)
def test_a_part_of_what_is_gained_is_shared_in_proportion(gains: list[int], total: int, parts: list[int]) -> None:
    shared = replan_module._share_gains(np.array(gains), total)
    assert shared.sum() == total and (shared <= gains).all()
    exact = np.array(gains) * total / max(1, sum(gains))
    assert (np.abs(shared - exact) < 1).all() and np.abs(shared - exact).sum() <= np.abs(np.array(parts) - exact).sum() + 1e-9


@for_seeds(12)
def test_the_linear_program_is_the_best_of_all_choices_and_so_is_the_native_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, centres = rng.random((6, 2)) * 100, rng.random((4, 2)) * 100
    owners = np.array([0, 0, 0, 1, 1, 1])
    losses, gains = np.array([int(rng.integers(1, 4)), int(rng.integers(0, 3)), 0, 0]), np.zeros(4, np.int64)
    for _ in range(int(losses.sum())):
        gains[rng.integers(2, 4)] += 1
    squared = np.sum((points[:, None] - centres) ** 2, axis=2)
    change = squared - squared[np.arange(6), owners][:, None]

    def cost(after: np.ndarray) -> float:
        return float(change[np.arange(6), after].sum())

    choices = [
        np.array(after)
        for after in product(*[(owner, 2, 3) for owner in owners])
        if all((np.array(after) == index).sum() == gains[index] for index in (2, 3))
        and all((np.array(after)[owners == index] != index).sum() == losses[index] for index in (0, 1))
    ]
    best = min(map(cost, choices))
    assert cost(replan_module._solve_linear_program(points, owners, centres, gains, losses)) == pytest.approx(best, abs=1e-9)
    assert cost(replan_module._transport(points, owners, centres, gains, losses)) == pytest.approx(best, abs=1e-9)


def test_beyond_the_arcs_of_the_program_devices_are_emptied_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = town(60)
    change = FleetChange(slow={"w1": 3.0, "w2": 3.0})
    exact = solved(plan.replanned(change))
    monkeypatch.setattr(replan_module, "MAX_ARCS", 0)
    stepwise = solved(plan.replanned(change))
    assert counts(stepwise) == counts(exact) and stepwise.moved.sum() == exact.moved.sum() > 2


def test_what_new_devices_of_an_edge_get_together_is_cut_across_its_long_side() -> None:
    plan = town(200)
    joining = System(edges=(edge("north", (50.0, 95.0), device("n1"), device("n2"), device("n3")),))
    result = solved(plan.replanned(FleetChange(), joining=joining))
    own = [plan.positions[result.edges[2].cameras_of(f"n{index}")] for index in (1, 2, 3)]
    axis = long_axis(np.concatenate(own))
    spans = [(float((part @ axis).min()), float((part @ axis).max())) for part in own]
    assert spans[0][1] <= spans[1][0] and spans[1][1] <= spans[2][0]


def test_where_everything_stays_the_bound_and_the_cells_say_how_good_it_is() -> None:
    plan = town()
    same = solved(plan.replanned(FleetChange()))
    assert (same.cloud.status, same.cloud.certified, same.cloud.method) == ("optimal", True, "replan")
    assert same.cloud.history == (same.cloud.makespan_s,) and same.makespan_before_s == pytest.approx(same.cloud.makespan_s)
    moved = solved(plan.replanned(FleetChange(dead=frozenset({"e1"}))))
    assert moved.cloud.status == ("optimal" if moved.cloud.certified else "converged")
    np.testing.assert_array_equal(moved.cloud.edge_of_camera, np.array([0, 0, 1, 1])[moved.device_after])
