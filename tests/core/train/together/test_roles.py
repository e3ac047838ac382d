"""What machines of a group do in a step with messages that do not fit."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_core.errors import BadInput
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import Adc, Densification, NoDensification
from radiant_core.train.together.codec import decode_gradients, encode_gradients, encode_limits, peek_gradients
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.masking import MaskKeys
from radiant_core.train.together.replica import Group, Replica, Share
from radiant_core.train.together.roles import Holder, Refusals, Relay, Root
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

CONFIG = TrainConfig(num_steps=48, density=NoDensification(), long_side_px=48)
GROUP = Group(config=CONFIG, num_photographs=4, views_per_step=4, extent=4.0, overlaps=False, form="float32")
INITIAL = ground_splats(20)
COUNT = len(INITIAL)


def root_of(*names: str) -> Root:
    replica = Replica(INITIAL, GROUP, FitOptions(backend="native"))
    return Root(replica, dict.fromkeys(names, 1), cameras_above([(0.0, 0.0)]).centers, GROUP)


def gradients(layout: Layout, size: float = 1e-3) -> StepGradients:
    values = np.full((COUNT, layout.num_columns), size, np.float32)
    return StepGradients(num_views=1, loss=0.1, rows=np.arange(COUNT), values=values, view_counts=np.ones(COUNT, np.uint16))


def message(root: Root, own: StepGradients) -> bytes:
    return encode_gradients(own, root.replica.step, COUNT, root.replica.layout, "float32")


def test_parts_that_add_up_to_no_number_count_for_nothing_and_the_training_goes_on() -> None:
    root = root_of("a", "b")
    layout = root.replica.layout
    long = gradients(layout)
    values = long.values.copy()
    values[:, layout.columns["means"]] = 3e38
    both = message(root, replace(long, values=values))
    root.take(root.total({"a": both, "b": both})[1])
    assert root.inbox.refused == {"all": Refusals(count=1, first="step 1: the sum is not finite")}
    honest = message(root, gradients(layout))
    root.take(root.total({"a": honest, "b": honest})[1])
    result = root.replica.outcome()
    assert (result.num_steps, result.num_rolled_back) == (2, 1)
    assert np.isfinite(result.splats.means).all()


def test_a_root_that_was_restored_knows_who_was_left_out_and_takes_the_same_steps() -> None:
    names = ("a", "b", "c", "liar")

    def step(root: Root) -> None:
        own = {name: message(root, gradients(root.replica.layout, 5e-3 if name == "liar" else 1e-3)) for name in names}
        root.take(root.total(own)[1])

    whole, early = root_of(*names), root_of(*names)
    while not whole.replica.is_done:
        step(whole)
    for _ in range(10):
        step(early)
    kept = early.state()
    late = root_of(*names)
    late.restore(replace(kept, numbers=json.loads(json.dumps(kept.numbers))))
    while not late.replica.is_done:
        step(late)
    assert late.inbox.refused == whole.inbox.refused and "step 8: left out" in whole.inbox.refused["liar"].first
    for name, array in whole.result().splats.arrays().items():
        np.testing.assert_array_equal(late.result().splats.arrays()[name], array)


def test_an_edge_that_begins_anew_from_what_the_root_has_of_it_refuses_whom_it_refused() -> None:
    names = ("a", "b", "c", "liar")
    group = replace(GROUP, config=replace(CONFIG, num_steps=200), views_per_step=8)

    def new_root() -> Root:
        return Root(Replica(INITIAL, group, FitOptions(backend="native")), {"e0": 4, "e1": 4}, np.zeros((1, 3)), group, sums_edges=True)

    root = new_root()
    layout, forgets = root.replica.layout, Relay(dict.fromkeys(names, 1), root.replica.layout, group)
    edges = {edge: Relay(dict.fromkeys(names, 1), layout, group) for edge in root.senders}
    for edge in edges.values():
        edge.begin(0, COUNT)

    def sums_of(relays: Mapping[str, Relay]) -> dict[str, bytes]:
        own = {name: message(root, gradients(layout, 5e-3 if name == "liar" else 1e-3)) for name in names}
        return {edge: relay.message(own) for edge, relay in relays.items()}

    while not root.replica.is_done:
        step = root.replica.step
        if step == 12:
            # e1 and the root are started again, from the root's checkpoint.
            saved, root = root.state(), new_root()
            root.restore(replace(saved, numbers=json.loads(json.dumps(saved.numbers))))
            edges["e1"] = Relay(dict.fromkeys(names, 1), layout, group)
            edges["e1"].begin(step, COUNT, root.relay_states["e1"])
            forgets.begin(step, COUNT)
        sums = sums_of(edges)
        assert sums["e0"] == sums["e1"]
        if step == 12:
            assert sums_of({"e0": forgets})["e0"] != sums["e0"]
        root.relay_states = {edge: relay.state() for edge, relay in edges.items()}
        total_message, total = root.total(sums)
        root.take(total)
        for edge in edges.values():
            edge.follow(total_message)
    assert edges["e0"].inbox == edges["e1"].inbox
    assert edges["e1"].inbox.refused["liar"].count == group.stepping.num_steps - 7
    with pytest.raises(BadInput, match="damaged"):
        forgets.begin(0, COUNT, b"noise")


def test_of_two_devices_that_contradict_each_other_on_the_size_of_the_model_none_is_believed() -> None:
    density = Adc(from_step=0, until_step=40, every=4, min_gradient=0.0, reset_opacity_every=10**9)
    group = replace(GROUP, config=replace(CONFIG, density=density, max_num_splats=200), views_per_step=2)
    layout = Replica(INITIAL, group, FitOptions(backend="native")).layout
    relay = Relay({"liar": 1, "honest": 1}, layout, group)

    def said(step: int, count: int) -> bytes:
        values = np.full((COUNT, layout.num_columns), 1e-3, np.float32)
        own = StepGradients(num_views=1, loss=0.1, rows=np.arange(COUNT), values=values, view_counts=np.ones(COUNT, np.uint16))
        return encode_gradients(own, step, count, layout, "float32")

    def total(step: int, count: int) -> bytes:
        return encode_limits(None, step, count) + encode_gradients(StepGradients.nothing(layout), step, count, layout, "float32")

    # Steps 2 and 4 add Gaussians, so that before steps 3 and 5 only devices know how many there are.
    assert [group.edits(step) for step in range(4)] == [False, True, False, True]
    relay.begin(1, COUNT)
    assert peek_gradients(relay.message({"liar": said(1, COUNT + 9), "honest": said(1, COUNT)})) == (1, COUNT)
    assert set(relay.inbox.refused) == {"liar"}
    relay.follow(total(1, COUNT))
    nothing = relay.message({"liar": said(2, COUNT + 9), "honest": said(2, COUNT + 2)})
    assert decode_gradients(nothing, 2, COUNT + 2, layout, 2).num_views == 0
    assert {name: each.count for name, each in relay.inbox.refused.items()} == {"liar": 2, "honest": 1}
    reason = f"step 3: senders contradict each other on how many Gaussians the model has (liar: {COUNT + 9}; honest: {COUNT + 2})"
    assert relay.inbox.refused["honest"].first.startswith(reason)
    relay.follow(total(2, COUNT + 2))
    known = relay.message({"liar": said(3, COUNT + 9), "honest": said(3, COUNT + 2)})
    assert decode_gradients(known, 3, COUNT + 2, layout, 2).num_views == 1
    assert {name: each.count for name, each in relay.inbox.refused.items()} == {"liar": 3, "honest": 1}


class Member:
    """A holder with what is on its way to it, as a device's process has it."""

    def __init__(self, number: int, root: Root, views: TrainingViews, group: Group, initial: Splats, masks: MaskKeys | None) -> None:
        state, last_total = root.standing()
        share = Share(views=views.select([number]), num_views=1, first=number)
        replica = Replica(initial, group, FitOptions(backend="native"), share)
        replica.restore(state)
        self.holder, self.arrived = Holder(replica, group, masks), list[bytes]()
        if last_total:
            self.holder.skip_message()
            self.arrived.append(last_total)

    def next_message(self) -> bytes:
        """As the loop of `radiant_app.together.holding`: a total is taken where it is waited for."""
        while self.holder.waits_for_total:
            self.holder.take(self.arrived.pop(0))
        return self.holder.message()


def new_keys() -> list[MaskKeys]:
    """Of four members: a member that comes back has another one."""
    privates = {str(number): X25519PrivateKey.generate() for number in range(4)}
    publics = {name: private.public_key().public_bytes_raw() for name, private in privates.items()}
    return [MaskKeys.agree(name, private, publics, "run") for name, private in privates.items()]


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("overlaps", [False, True])
@pytest.mark.parametrize(
    "density",
    [NoDensification(), Adc(from_step=0, until_step=40, every=12, min_gradient=0.0, reset_opacity_every=10**9)],
    ids=["fixed", "growing"],
)
def test_members_and_a_root_that_begin_anew_in_the_middle_end_in_the_same_bits(
    overlaps: bool, density: Densification, masked: bool
) -> None:
    truth, cameras = ground_splats(60), cameras_above([(x, y) for x in (-1.5, 1.5) for y in (-1.0, 1.0)])
    images = tuple(np.uint8(255 * np.clip(view.image, 0, 1)) for view in render_views(truth, cameras))
    views = TrainingViews(cameras=cameras, images=images)
    config = TrainConfig(num_steps=48, density=density, long_side_px=48, schedule_steps=48, max_num_splats=200, average_from=0.7)
    group = Group(config=config, num_photographs=4, views_per_step=4, extent=4.0, overlaps=overlaps, form="blocks", masked=masked)
    initial = replace(truth, sh0=np.zeros_like(truth.sh0))

    def new_root() -> Root:
        replica, before = (Replica(initial, group, FitOptions(backend="native")) for _ in range(2))
        return Root(replica, {str(number): 1 for number in range(4)}, cameras.centers, group, before=before)

    models: list[dict[str, np.ndarray]] = []

    def trained(restarts: Mapping[int, Sequence[int]]) -> Root:
        """All steps, which are in `models`; before those of `restarts` the root and these members begin anew."""
        root = new_root()
        models.clear()
        keys = new_keys() if masked else [None] * 4
        members = [Member(number, root, views, group, initial, keys[number]) for number in range(4)]
        while not root.replica.is_done:
            step = root.replica.step
            if step in restarts:
                saved = root.state()
                root = new_root()
                root.restore(replace(saved, numbers=json.loads(json.dumps(saved.numbers))))
                # Masks of old and new keys do not cancel: all begin anew.
                keys = new_keys() if masked else keys
                for number in range(4) if masked else restarts[step]:
                    members[number] = Member(number, root, views, group, initial, keys[number])
            message, total = root.total({str(number): member.next_message() for number, member in enumerate(members)})
            root.take(total)
            models.append(root.replica.state().arrays)
            for member in members:
                member.arrived.append(message)
        return root

    whole = trained({})
    assert density.kind == "none" or whole.replica.num_splats != len(initial)
    num_averaged = whole.replica.state().numbers["mean"]["num_steps"]
    colors = [arrays["splats.sh0"].astype(np.float64) for arrays in models[-num_averaged:]]
    assert num_averaged in (1, 4) and len(models) == 12
    np.testing.assert_allclose(whole.result().splats.sh0, np.mean(colors, axis=0), rtol=1e-5, atol=1e-6)
    # Each of them alone, all at once, before and after what adds Gaussians, and after the first step.
    assert not whole.inbox.refused
    again = trained({1: (0, 1, 2, 3), 2: (0,), 3: (1, 2), 4: (3,), 7: (0, 1, 2, 3), 11: (2,)})
    for name, array in whole.result().splats.arrays().items():
        np.testing.assert_array_equal(again.result().splats.arrays()[name], array)
