"""What machines of a group do in a step with messages that do not fit."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.together.codec import encode_gradients
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.replica import Group, Replica
from radiant_core.train.together.roles import Root
from radiant_core.train.trainer import FitOptions
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
    return StepGradients(num_views=1, loss=0.1, rows=np.arange(COUNT), values=values, seen=np.ones(COUNT, np.uint16))


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
    assert root.inbox.refused == {"all": ["step 1: the sum is not finite"]}
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
    assert late.inbox.refused == whole.inbox.refused and "step 8: left out" in whole.inbox.refused["liar"][0]
    for name, array in whole.result().splats.arrays().items():
        np.testing.assert_array_equal(late.result().splats.arrays()[name], array)
