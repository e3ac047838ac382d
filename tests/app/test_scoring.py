"""Scoring: figures do not depend on how many machines hold the photographs, nor on their frames."""

from __future__ import annotations

import weakref
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided
from radiant_app.report.html import describe_unscored
from radiant_app.reporting import EventReporter
from radiant_app.run.scoring import Scoring, ScoringMachine, combine_figures
from radiant_app.workers.evaluation import ScoredImage, png_bytes, run_score
from radiant_app.workers.score_files import SCORES_NAME
from radiant_app.workers.scores import read_scores
from radiant_app.workers.tasks import HELD_OUT_NAME, INITIAL_NAME, OWN_NAME, TRAINED_NAME, Move, ScoreTask
from radiant_core.cameras import Cameras
from radiant_core.choices import LightMode
from radiant_core.errors import StageFailed
from radiant_core.frames import Frame, Sim3
from radiant_core.geometry.similarity import move_cameras, move_splats
from radiant_core.geometry.support import SUPPORT_NAME, load_support
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_cameras, save_plan, save_scene, save_splats
from radiant_core.io.run_store import read_json, seal, write_json
from radiant_core.light.captures import save_captures
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from tests.core.plan.made_plans import plan_of
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-1.5, -0.5, 0.5, 1.5) for y in (-1.0, 0.0, 1.0)], size_wh=(192, 144))
TRUTH = ground_splats(400)
SCENE = replace(TRUTH, sh0=TRUTH.sh0 + np.random.default_rng(1).normal(0, 0.2, TRUTH.sh0.shape).astype(np.float32))
INITIAL = replace(TRUTH, sh0=np.zeros_like(TRUTH.sh0))
PLAN = plan_of(np.array([[-4.0, 0.0], [4.0, 0.0]]), np.zeros(2))
STAY = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
AWAY = Sim3(scale=2.0, rotation=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), translation=np.array([4.0, -8.0, 0.5]))


def scored(run: Path, stage: str, cameras: Cameras, move: Sim3 | None = None) -> Path:
    """The scores of the owner's machine or, with the move of its frame, of a device, with the
    photographs of these cameras."""
    folder = run / stage
    own = folder if move is None else folder.parent
    (folder / "inbox").mkdir(parents=True)
    (own / "photos").mkdir()
    for view in render_views(TRUTH, cameras):
        (own / "photos" / view.name).write_bytes(png_bytes(view.image_bytes))
    back = STAY if move is None else move.inverse()
    save_cameras(own / HELD_OUT_NAME, move_cameras(cameras, back))
    save_splats(own / INITIAL_NAME, move_splats(INITIAL, back))
    write_json(own / OWN_NAME, {"images": str(own / "photos")})
    if move is None:
        save_cameras(own / TRAINED_NAME, cameras)
    else:
        save_model(own, move_cameras(cameras, back), move_splats(SCENE, back))
    save_ply(folder / "inbox" / "scene.ply", SCENE)
    save_plan(folder / "inbox" / "plan.json", PLAN, ())
    moves = () if move is None else (Move.of(move),)
    task = ScoreTask(corrections=moves, long_side_px=192, backend="native", lpips=None, light="none", owned=move is not None)
    run_score(folder, task, EventReporter(stage=stage, emit=lambda event: None))
    return folder / SCORES_NAME


def save_model(own: Path, cameras: Cameras, splats: Splats) -> None:
    """What else a device keeps: its training photographs are those that it is scored on."""
    save_scene(
        own / "scene.safetensors",
        SfmScene(
            cameras=cameras,
            points=np.zeros((0, 3)),
            colors=np.zeros((0, 3), np.uint8),
            observations=np.zeros((0, 2), np.int64),
            frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
        ),
    )
    save_splats(own / "model.safetensors", splats)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "cloud").mkdir()
    write_json(tmp_path / "cloud" / "summary.json", {"num_splats": len(SCENE)})
    save_plan(tmp_path / "plan.json", PLAN, ())
    return tmp_path


def without_names(figures: dict[str, Any]) -> dict[str, Any]:
    rows = [{key: value for key, value in row.items() if key != "name"} for row in figures["images"]]
    return {key: value for key, value in figures.items() if key not in ("images", "leakage", "median", "borders")} | {"rows": rows}


def test_one_machine_with_all_photographs_and_two_devices_in_frames_of_their_own_give_the_same_figures(run: Path) -> None:
    whole = combine_figures(run, {"evaluation": read_scores(scored(run, "evaluation", CAMERAS))}, None)
    shares = {"a": (range(5), AWAY), "b": (range(5, 12), STAY)}
    files = {name: scored(run, f"devices/{name}/score", CAMERAS.select(list(rows)), move) for name, (rows, move) in shares.items()}
    divided = combine_figures(run, {name: read_scores(file) for name, file in files.items()}, None)
    assert whole["seam_excess_db"] is not None and whole["seam_photographs"] == 12 and not whole["seam_found"]
    assert [row["between"] for row in whole["borders"]] == [("edge-0", "edge-1")] and whole["borders"][0]["seam_excess_db"] == whole[
        "seam_excess_db"
    ]
    assert whole["num_gaussians"] == 400 and "leakage" not in whole
    assert [row["name"] for row in whole["images"]] == list(CAMERAS.names)
    assert [row["name"] for row in divided["images"]][4:6] == ["a/held-out-0004", "b/held-out-0000"]
    assert divided["leakage"].keys() == {"a", "b"}
    one, other = without_names(whole), without_names(divided)
    # 1e-3 dB: the moved Gaussians are rounded to float32 in another frame.
    for key in one.keys() - {"rows"}:
        assert one[key] == (pytest.approx(other[key], abs=1e-3) if isinstance(one[key], float) else other[key]), key
    for row, twin in zip(one["rows"], other["rows"], strict=True):
        assert row == pytest.approx(twin, abs=1e-3)


def test_pictures_of_one_photograph_are_in_memory_at_a_time(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[weakref.ref[ScoredImage]] = []
    saved: list[int] = []
    save = ScoredImage.save

    def watched(image: ScoredImage, folder: Path) -> list[str]:
        made.append(weakref.ref(image))
        saved.append(sum(each() is not None for each in made))
        return save(image, folder)

    monkeypatch.setattr(ScoredImage, "save", watched)
    scored(run, "evaluation", CAMERAS)
    assert saved == [1] * len(CAMERAS)
    assert len([*(run / "evaluation" / "renders").iterdir()]) == len(CAMERAS)


def test_a_machine_without_photographs_adds_nothing_and_alone_has_no_figures(run: Path) -> None:
    file = scored(run, "evaluation", CAMERAS.select([]))
    assert read_json(file)["images"] == [] and not (file.parent / "renders").exists()
    with pytest.raises(StageFailed, match="no held-out photograph could be scored: the machines that scored have none whose pose is known"):
        combine_figures(run, {"evaluation": read_scores(file)}, None)


def test_figures_of_another_scene_are_not_used_where_scoring_anew_fails(run: Path, tmp_path: Path) -> None:
    file = scored(run, "evaluation", CAMERAS)
    seal(file.parent, "of an earlier scene", [SCORES_NAME])
    save_ply(run / "cloud" / "scene.ply", SCENE)
    machine = ScoringMachine(stage="evaluation", inputs=(file.parent / HELD_OUT_NAME,))
    config = RunConfig(source=tmp_path, out=run)
    recipe = SimpleNamespace(train=SimpleNamespace(long_side_px=192, light="none"), backend="native")
    scoring = Scoring(config=config, recipe=cast(Any, recipe), machines=[machine])
    dealer = SimpleNamespace(versions={"joined": run / "cloud"}, version="joined")
    given_up = SimpleNamespace(fold=lambda tree, prepare, listen: [prepare(node) for node in tree])
    with pytest.raises(StageFailed, match="ended without figures on every machine that has any; --resume"):
        scoring.run(cast(Any, dealer), cast(Any, given_up), cast(Any, SimpleNamespace(listen=None)))
    assert file.is_file() and scoring.keys and scoring.failed == ("evaluation",)


@pytest.mark.parametrize(
    ("metrics", "words"),
    [
        ({"missing": {}}, "the others have no known pose"),
        ({"missing": {"a": "It was lost.", "b": "It was late."}}, "the others lie on missing devices (a, b) or have no known pose"),
        (
            {"missing": {"a": "It was lost."}, "failed_scoring": ["c"]},
            "the others lie on missing devices (a) or lie on devices that ended without figures when they scored the scene (c) or have no "
            "known pose",
        ),
    ],
)
def test_where_unscored_photographs_are_is_said(metrics: dict[str, Any], words: str) -> None:
    assert describe_unscored(metrics) == words


def scored_in_light(run: Path, light: LightMode, *, noise: bool = False) -> tuple[float, dict[str, bytes], list[Any]]:
    """PSNR, renders and decisions of the scene on every fourth of photographs whose light drifts;
    optionally with noise in the place of these four."""
    folder = run / "evaluation"
    (folder / "inbox").mkdir(parents=True)
    (folder / "photos").mkdir()
    held = np.arange(len(CAMERAS)) % 4 == 1
    for index, view in enumerate(render_views(TRUTH, CAMERAS)):
        image = np.clip(view.image * np.exp(0.04 * (index - 5.5)) * 255, 0, 255).round().astype(np.uint8)
        if noise and held[index]:
            image = np.random.default_rng(index).integers(0, 256, image.shape).astype(np.uint8)
        (folder / "photos" / view.name).write_bytes(png_bytes(image))
    save_captures(folder, {name: (rank, None) for rank, name in enumerate(CAMERAS.names)})
    save_cameras(folder / HELD_OUT_NAME, CAMERAS.select(held))
    save_cameras(folder / TRAINED_NAME, CAMERAS.select(~held))
    save_splats(folder / INITIAL_NAME, INITIAL)
    write_json(folder / OWN_NAME, {"images": str(folder / "photos")})
    save_ply(folder / "inbox" / "scene.ply", TRUTH)
    save_plan(folder / "inbox" / "plan.json", PLAN, ())
    events: list[Any] = []
    task = ScoreTask(corrections=(), long_side_px=192, backend="native", lpips=None, light=light, owned=False)
    run_score(folder, task, EventReporter(stage="evaluation", emit=events.append))
    rows = read_json(folder / SCORES_NAME)["images"]
    renders = {path.name: path.read_bytes() for path in (folder / "renders").iterdir()}
    return float(np.mean([row["psnr_db"] for row in rows])), renders, [event.decision for event in events if isinstance(event, Decided)]


def test_noise_in_the_place_of_photographs_held_out_changes_no_bit_of_their_predicted_light(tmp_path: Path) -> None:
    plain, as_rendered, none = scored_in_light(tmp_path / "none", "none")
    better, lit, (decision,) = scored_in_light(tmp_path / "auto", "auto")
    _, noisy, (same,) = scored_in_light(tmp_path / "noise", "auto", noise=True)
    assert not none and decision.topic == "light of photographs held out" and "before and after" in decision.choice
    # 14 % of brightness between the mean and a photograph, against 1 % between neighbours in time.
    assert better > plain + 10 and lit != as_rendered
    support = load_support(tmp_path / "auto" / "evaluation" / SUPPORT_NAME)
    assert len(support) == len(TRUTH) and support.num_views.max() <= 9 and support.constrained().mean() > 0.5
    # The model's own light is kept beside it, and is that of a score without light.
    canonical = {path.name: path.read_bytes() for path in (tmp_path / "auto" / "evaluation" / "canonical").iterdir()}
    assert canonical == as_rendered and not (tmp_path / "none" / "evaluation" / "canonical").exists()
    assert noisy == lit and same == decision


def test_photographs_of_one_light_are_scored_as_they_are(run: Path, tmp_path: Path) -> None:
    scored(run, "evaluation", CAMERAS)
    save_captures(run / "evaluation", {name: (rank, None) for rank, name in enumerate(CAMERAS.names)})
    before = read_json(run / "evaluation" / SCORES_NAME)
    task = ScoreTask(corrections=(), long_side_px=192, backend="native", lpips=None, light="auto", owned=False)
    run_score(run / "evaluation", task, EventReporter(stage="evaluation", emit=lambda event: None))
    assert read_json(run / "evaluation" / SCORES_NAME) == before
