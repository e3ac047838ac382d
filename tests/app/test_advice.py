"""What a poor scene is told to try: what trials left open, then the likeliest cause, then what was not tried."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from radiant_app.report.advice import MOST_LINES, NOTHING_SEEN, what_to_try
from radiant_app.report.tables import print_model
from radiant_core.io.run_store import write_json
from radiant_core.train.config import train_preset
from radiant_core.train.needs import Overrides, fit_to_backend

POOR: dict[str, Any] = {"psnr_db": 15.0, "psnr_cc_db": 15.5, "ssim": 0.4, "images": [{}] * 8, "num_photographs": 60}


def decided(topic: str, otherwise: str = "", otherwise_db: float | None = None, figure: float = 1.0) -> dict[str, Any]:
    return {"topic": topic, "choice": "on", "otherwise": otherwise, "otherwise_db": otherwise_db, "figure": figure, "forced": False}


def test_few_steps_and_small_pictures_that_were_asked_for_come_first() -> None:
    def lines(**sizes: int) -> tuple[str, ...]:
        _, decisions = fit_to_backend(train_preset("default"), "native", Overrides(**sizes))
        return what_to_try({**POOR, "num_photographs": 20}, [decided("points", "--set train.fill_in=false"), *map(asdict, decisions)])

    first, *others = lines(num_steps=300, long_side_px=256)
    asked = "only 300 steps and pictures of 256 px were asked for"
    assert first == f"`--steps 1500 --long-side-px 576`: {asked}; the default here would be up to 1,500 steps and pictures of 576 px"
    assert "20 photographs are few" in others[0] and "fill_in=false` was not tried here" in others[1]
    assert lines(num_steps=300)[0].startswith("`--steps 1500`: only 300 steps were asked for")
    # As many as by default, or more, are no cause.
    assert not any("asked for" in line for line in (*lines(num_steps=1500, long_side_px=800), *lines()))


def test_a_good_scene_is_told_nothing() -> None:
    assert what_to_try({**POOR, "psnr_db": 25.0, "ssim": 0.8}, [decided("points", "--set train.fill_in=false", 1.0)]) == ()


def test_the_other_choice_of_trials_that_lost_little_comes_first_and_best_first() -> None:
    tried = [
        decided("points", "--set train.fill_in=false", -0.2),
        decided("light", "--set train.light=none", -0.1),
        decided("sky", "--set train.sky=false", -2.0),
    ]
    lines = what_to_try({**POOR, "num_photographs": 20}, tried)
    assert [line.split("`")[1] for line in lines[:2]] == ["--set train.light=none", "--set train.fill_in=false"]
    assert "-0.10 dB" in lines[0] and "20 photographs are few" in lines[2] and len(lines) == MOST_LINES


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ({"num_photographs": 40, "num_unplaced": 20}, "20 of 60 photographs could not be placed"),
        ({"views_per_point": 2.2}, "seen by 2.2 photographs"),
        ({"num_photographs": 12}, "12 photographs are few"),
        ({"psnr_cc_db": 19.0}, "gains 4.0 dB, so the light differs"),
        ({"training": {"num_steps": 100, "num_photographs": 50}}, "used each photograph 2 times"),
    ],
    ids=["unplaced", "overlap", "few", "light", "steps"],
)
def test_the_cause_that_the_figures_show_is_named(figures: dict[str, Any], said: str) -> None:
    (line,) = what_to_try({**POOR, **figures}, [])
    assert said in line


def test_blur_is_told_by_its_decision() -> None:
    (line,) = what_to_try(POOR, [decided("blurred photographs", figure=64.0)])
    assert "64 % of the others' sharpness" in line


def test_where_nothing_is_seen_what_was_not_tried_is_named_and_a_manifest_of_before_is_read() -> None:
    before = {"topic": "matching", "choice": "all pairs", "figure": 1.0, "forced": False}
    assert what_to_try(POOR, [before]) == (NOTHING_SEEN,)
    lines = what_to_try(POOR, [before, decided("points", "--set train.fill_in=false")])
    assert lines == ("`--set train.fill_in=false` was not tried here; this run's choice for points: on", NOTHING_SEEN)


def test_beside_causes_stands_what_was_not_tried_first_what_lost_somewhere() -> None:
    untried = [decided("light", "--set train.light=always"), decided("points", "--set train.fill_in=false"), decided("repeats")]
    lines = what_to_try({**POOR, "num_photographs": 20}, untried)
    assert "20 photographs are few" in lines[0] and len(lines) == MOST_LINES
    assert [line.split("`")[1] for line in lines[1:]] == ["--set train.fill_in=false", "--set train.light=always"]


def test_it_follows_the_word_on_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "manifest.json", {"decisions": [decided("points", "--set train.fill_in=false", -0.1)]})
    (tmp_path / "scene.ply").write_bytes(b"ply")
    print_model(tmp_path / "scene.ply", {**POOR, "num_gaussians": 10})
    model, quality, tried = capsys.readouterr().out.splitlines()
    assert model.startswith("model: ") and quality.startswith("quality: poor: 15.00 dB")
    assert tried == "try: `--set train.fill_in=false`: short trials decided on points (on), where this had -0.10 dB"
