"""The table of measured cases: every row is named by some decision and stands with its evidence on its page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.files.system_file import even_system
from radiant_app.run.few_photographs import choose_workforce
from radiant_app.run.predictions import planned_training
from radiant_app.run.this_machine import Division
from radiant_core.decisions import Decision
from radiant_core.hierarchy.decisions import fill_decision, joining_decision, shapes_decision, sky_decision
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import plan_refining
from radiant_core.light.canonical import light_decision
from radiant_core.light.lights import Lights
from radiant_core.regimes import REGIMES, look_up
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import Adc
from radiant_core.train.extent import extent_decision
from radiant_core.train.fill_in import fill_in_points
from radiant_core.train.gates import choose_helpers, open_gates
from radiant_core.train.needs import Overrides, fit_to_cameras
from radiant_core.train.shapes import ShapeCounts
from radiant_core.train.worth import images_worth
from tests.app.test_faults import planned
from tests.core.light.plain_lights import no_lights
from tests.core.scenes import cameras_above, ground_splats
from tests.core.train.test_fill_in import ball_before_a_wall
from tests.core.train.test_needs import scene_of

PAGES = Path(__file__).parents[2] / "docs" / "experiments"
CASES = [(topic, case) for topic, cases in REGIMES.items() for case in cases]
PRESENT = {"edge-1": ["edge-1-device-1", "edge-1-device-2"]}


@pytest.mark.parametrize(("topic", "row"), [(topic, case.row) for topic, case in CASES])
def test_a_row_stands_on_the_page_with_its_limits_its_evidence_and_where_it_was_measured(topic: str, row: str) -> None:
    case = next(case for _, case in CASES if case.row == row)
    (line,) = [line for line in (PAGES / "regimes.md").read_text().splitlines() if f"| `{row}` |" in line]
    assert [cell.strip() for cell in line.split("|")[1:-1]] == [
        topic,
        f"`{row}`",
        case.where,
        case.evidence,
        f"[{case.page}]({case.page}.md)",
    ]
    assert (PAGES / f"{case.page}.md").is_file() and any(sign.isdigit() for sign in case.evidence)


def test_rows_have_names_of_their_own_and_no_case_hides_another() -> None:
    rows = [case.row for _, case in CASES]
    assert len(set(rows)) == len(rows)
    for cases in REGIMES.values():
        assert all(case.limits for case in cases[:-1]), "only the last of a topic always holds"


def test_a_limit_belongs_to_the_case_above_it_and_what_is_endless_to_the_last() -> None:
    for figure, row in ((35, "few-photographs"), (36, "some-photographs"), (71, "some-photographs"), (72, "many-photographs")):
        assert look_up("photographs of a model", {"photographs": figure}).row == row  # type: ignore[union-attr]
    assert look_up("refining", {"shows": inf, "steps": inf, "devices": 2}).row == "shown-enough"  # type: ignore[union-attr]
    assert look_up("devices of few photographs", {"photographs": 36, "photographs_each": 10}) is None


def test_every_row_is_named_by_some_decision(tmp_path: Path) -> None:
    decided = [*decisions_of_a_run(planned(tmp_path)[0].recipe), *decisions_of_a_plan(), *decisions_of_a_training()]
    assert {decision.row for decision in decided if decision.row} == {case.row for _, case in CASES}


def decisions_of_a_run(recipe: Recipe) -> Iterator[Decision]:
    recipe = replace(recipe, groups={}, num_devices=4)
    for shows, steps, devices in ((20, 500, 4), (40, 500, 4), (60, 600, 4), (120, 600, 4), (60, 1500, 8), (60, 600, 8), (120, 1500, 4)):
        train = replace(recipe.train, num_steps=steps, max_epochs=None)
        own = replace(recipe, train=train, num_devices=devices, num_photographs=round(steps * devices / shows))
        joining = joining_decision(own)
        assert joining is not None
        yield joining
        yield from plan_refining(own, PRESENT, 1_000).decisions


def decisions_of_a_plan() -> Iterator[Decision]:
    config, train = RunConfig(source=Path("photos"), out=Path("run")), planned_training("draft", Overrides())
    for photographs, devices in ((20, 2), (60, 8)):
        decision = choose_workforce(config, even_system(1, devices), photographs, train).decision
        assert decision is not None
        yield decision
    yield Division(num_devices=1, num_photographs=60, needed_bytes=1, ample_bytes=1, free_bytes=10).decision


def decisions_of_a_training() -> Iterator[Decision]:
    config = replace(train_preset("default"), density=Adc(kind="planned", thin_to="auto"))
    for count in (20, 50, 100):
        yield from fit_to_cameras(config, cameras_above([(0.1 * v, 0.0) for v in range(count)]))[1]
    for share in (0.0, 0.5):
        yield sky_decision("train", share, wanted=True)
    yield fill_decision("train", 1, 10, "at the height of the points beside them", wanted=True)
    scene, views = ball_before_a_wall()
    grey = replace(views, images=tuple(np.full((60, 80, 3), 30 * view, np.uint8) for view in range(len(views))))
    for own in (views, grey):
        yield from choose_helpers(
            *open_gates(config, fill_in_points(scene, own), own), own, lambda trial: np.zeros(trial.held_out.sum())
        ).decisions
    yield from images_worth(*scene_of(4)).decisions
    yield extent_decision(cameras_above([(0.0, 0.0), (100.0, 0.0)]), ground_splats(), 2.0)
    yield shapes_decision("train", TrainConfig(), ShapeCounts(num_needles=1))
    for spread, evenness in ((0.0, inf), (0.1, 0.5), (0.1, 5.0)):
        yield light_decision(lights_of(spread, evenness), "auto")


def lights_of(spread: float, evenness: float) -> Lights:
    cameras = cameras_above([(0.0, 0.0), (1.0, 0.0)])
    gains = spread * np.array([[-1.0] * 3, [1.0] * 3])
    return replace(no_lights(cameras), log_gains=gains, is_known=np.ones(2, bool), evenness=evenness)
