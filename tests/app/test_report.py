"""The report of a run: what was surveyed, how good it is, what is missing, and how it is read on a phone and on paper."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.events import Event, RunLeft, StageDone, StageProgress, StageStarted
from radiant_app.executors.fork_server import ForkedProcess
from radiant_app.files.run_folder import read_manifest
from radiant_app.report import drawing
from radiant_app.report.drawing import draw_report
from radiant_app.report.gaps import gaps_of, notes_of
from radiant_app.report.html import NUM_SIDES, PARTS, REPORT, title_of, with_code
from radiant_app.report.survey import area_text, length_text, observed_area, sampling_distance, survey_of
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import Frame
from radiant_core.io.run_store import read_json
from radiant_core.scene import SfmScene
from radiant_viewer.pictures.images import load_image
from radiant_viewer.pictures.turntable import MARGIN, crop_to, turntable
from tests.app.blank_reports import drawn_pictures
from tests.app.pipeline_kit import FOUR
from tests.browsers import chromium
from tests.core.scenes import cameras_above, ground_splats
from tests.forked import has_ended, open_server_of_tests

PHONE_PX = 390


@pytest.fixture(scope="module")
def heard() -> list[Event]:
    """What the finished run told."""
    return []


@pytest.fixture(scope="module")
def finished(hamlet_project: Path, tmp_path_factory: pytest.TempPathFactory, heard: list[Event]) -> RunResult:
    out = tmp_path_factory.mktemp("reports") / "run"
    train = TrainOptions(long_side_px=64, num_steps=20, max_num_splats=600)
    with drawn_pictures(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "started_server", open_server_of_tests)
        return run(RunConfig(source=hamlet_project, out=out, train=train, plan=FOUR), heard.append)


@pytest.fixture
def page(finished: RunResult) -> Iterator[Any]:
    """The report in a browser as wide as a phone."""
    with chromium() as browser:
        opened = browser.new_page(viewport={"width": PHONE_PX, "height": 844})
        opened.goto(finished.report.as_uri())
        yield opened


def scene_of(frame: Frame, *, depth_m: float = 6.0) -> SfmScene:
    """Points of a square of 8 × 8 m, which four cameras above it all see."""
    cameras = cameras_above([(-1, -1), (1, -1), (-1, 1), (1, 1)], height_m=depth_m)
    points = np.random.default_rng(0).uniform(-4, 4, (4000, 3)) * [1, 1, 0]
    observations = np.array([(point, view) for point in range(4000) for view in range(4)])
    return SfmScene(cameras=cameras, points=points, colors=np.zeros((4000, 3), np.uint8), observations=observations, frame=frame)


METRIC = Frame(kind="metric", origin_lat_lon_alt=np.array([47.37, -8.54, 400.0]), residual_m=0.456)
UNSCALED = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))


def test_the_page_begins_with_the_model_and_ends_with_what_is_folded_away(finished: RunResult) -> None:
    text = finished.report.read_text()
    marks = ['id="model"', "How good it is", "What is missing", "<h2>Plan", "<h2>Timeline", "worst first", "<summary>Decisions"]
    places = [text.index(mark) for mark in marks]
    assert places == sorted(places)
    assert "<h1>hamlet</h1>" in text and re.search(r"12 photographs of [\d,]+ m².*EPSG:326", text)
    assert "{&#39;" not in text and "None" not in re.sub(r'"data:[^"]*"', "", text), "settings are no dictionaries of Python"


def test_the_pictures_of_a_run_are_drawn(finished: RunResult) -> None:
    for name in ("model", "regions", "regions_phone", "cameras", "timeline", "gantt"):
        picture = load_image(finished.folder / "pictures" / f"{name}.png")
        assert min(picture.shape[:2]) > 100 and picture.std() > 5, name


@pytest.fixture
def copied(finished: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, list[ForkedProcess]]:
    """The finished run in another folder, and the processes that draw its report."""
    monkeypatch.setattr(drawing, "started_server", open_server_of_tests)
    started, start = list[ForkedProcess](), drawing._start

    def start_and_note(*arguments: Any) -> ForkedProcess | None:
        process = start(*arguments)
        assert process is not None
        started.append(process)
        return process

    monkeypatch.setattr(drawing, "_start", start_and_note)
    shutil.copytree(finished.folder, tmp_path / "run")
    return tmp_path / "run", started


def test_what_a_process_that_draws_cannot_do_is_an_error_of_the_run(copied: tuple[Path, list[ForkedProcess]]) -> None:
    folder, started = copied
    manifest, metrics = read_manifest(folder), read_json(folder / "metrics.json")
    (folder / "report.html").unlink()

    def kill(event: Event) -> None:
        os.kill(started[-1].pid, signal.SIGKILL)

    with pytest.raises(StageFailed, match=r"report: the process that draws it ended with code -9 .* --resume"):
        draw_report(folder, manifest, metrics, kill)
    (folder / "plan.json").write_text("{}")
    with pytest.raises(BadInput, match=r"plan\.json"):
        draw_report(folder, manifest, metrics, lambda event: None)
    assert len(started) == 2 and not (folder / "report.html").exists()


def test_a_process_that_draws_may_end_after_its_last_word(
    copied: tuple[Path, list[ForkedProcess]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of its standard input ends it, so that waits for the end of the process, not of its words."""
    folder, _ = copied
    # Ends with 1 where standard input ends within a second after its own output.
    ending = "import os, select, sys; sys.stdin.readline(); os.close(1); sys.exit(bool(select.select([0], [], [], 1)[0]))"

    def start(*arguments: Any) -> Any:
        return subprocess.Popen([sys.executable, "-c", ending], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    monkeypatch.setattr(drawing, "_start", start)
    draw_report(folder, read_manifest(folder), read_json(folder / "metrics.json"), lambda event: None)


def test_an_interrupt_ends_the_process_that_draws(copied: tuple[Path, list[ForkedProcess]]) -> None:
    folder, started = copied

    def interrupt(event: Event) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_report(folder, read_manifest(folder), read_json(folder / "metrics.json"), interrupt)
    (process,) = started
    assert process.returncode is not None and has_ended(process.pid)


def test_a_run_tells_how_far_its_report_is(finished: RunResult, heard: list[Event]) -> None:
    told = [event for event in heard if getattr(event, "stage", None) == REPORT]
    assert isinstance(told[0], StageStarted) and isinstance(told[-1], StageDone) and told[-1] is heard[-2]
    assert isinstance(heard[-1], RunLeft) and heard[-1].left_s == 0.0, "then nothing is left of the run"
    steps = [event for event in told if isinstance(event, StageProgress)]
    assert [*dict.fromkeys(event.phase for event in steps)] == [*PARTS]
    assert [event.done for event in steps if event.phase == PARTS[1]] == [*range(NUM_SIDES + 1)]
    assert REPORT not in finished.metrics["seconds"], "it is no stage that can be resumed"


def test_the_page_is_no_wider_than_a_phone_and_the_model_turns(page: Any) -> None:
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE_PX
    box = page.locator("#model").bounding_box()
    assert box["y"] < 844 / 2 and box["width"] > 0.9 * PHONE_PX
    first = page.locator("#model").get_attribute("src")
    page.mouse.move(box["x"] + 300, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 200, box["y"] + 40, steps=4)
    page.mouse.up()
    assert page.locator("#model").get_attribute("src") != first and page.locator("#side").input_value() != "0"


def test_plan_and_timeline_are_read_on_a_phone_without_scrolling(page: Any) -> None:
    lines = page.locator(".phone-chart .line")
    assert lines.count() >= 9, "a line per process"
    shown = "list => list.filter(one => one.checkVisibility()).map(one => one.getBoundingClientRect().toJSON())"
    for what in (".phone-chart .line", ".phone-chart .track i", ".phone-chart img", "figure img"):
        boxes = page.locator(what).evaluate_all(shown)
        assert boxes and all(box["left"] >= 0 and box["right"] <= PHONE_PX for box in boxes), what
    scrolled = "list => list.filter(one => one.checkVisibility() && one.scrollWidth > one.clientWidth + 1).length"
    assert page.locator("figure, .chart").evaluate_all(scrolled) == 0
    assert float(page.locator(".line").first.evaluate("line => parseFloat(getComputedStyle(line.firstElementChild).fontSize)")) >= 12
    # A map that is drawn for the phone is not shrunk: its letters are as large as they were set.
    plan = page.locator(".phone-chart img").first
    assert plan.bounding_box()["width"] > 0.85 * plan.evaluate("image => image.naturalWidth")
    assert not page.locator(".wide-chart").first.is_visible()
    page.set_viewport_size({"width": 1440, "height": 900})
    assert page.locator(".wide-chart").first.is_visible() and not lines.first.is_visible()


def test_printed_the_model_is_on_the_first_of_few_pages_in_black_on_white(page: Any) -> None:
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) <= 8
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert not page.locator("#side").is_visible()


def test_area_and_sampling_distance_are_those_of_the_scene() -> None:
    scene = scene_of(METRIC, depth_m=30.0)
    # A fiftieth of the points is left out on either side, as haze.
    assert observed_area(scene) == pytest.approx(64.0 * 0.96**2, rel=0.05)
    assert sampling_distance(scene) == pytest.approx(30.0 / scene.cameras.Ks[0, 0, 0], rel=1e-6)


def test_the_line_says_what_is_known_and_nothing_else() -> None:
    line = survey_of(scene_of(METRIC), 2, None).line
    assert line.startswith("4 of 6 photographs of ") and "at 47.37000° N 8.54000° W" in line and "EPSG:32629" in line
    assert line.endswith("cameras within 0.46 m of GPS (median).") and "taken" not in line
    unscaled = survey_of(scene_of(UNSCALED), 0, None)
    assert unscaled.line == "4 photographs, without scale or place: lengths are in units of their own."
    bare = dataclasses.replace(
        scene_of(METRIC), observations=np.zeros((0, 2), np.int64), points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8)
    )
    assert survey_of(bare, 0, None).area_m2 is None and survey_of(bare, 0, None).gsd_m is None


def test_the_date_is_that_of_the_photographs() -> None:
    town = sample_scenes_folder() / "town" / "images"
    names = tuple(sorted(path.name for path in town.iterdir()))[:4]
    scene = scene_of(METRIC)
    named = dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, names=names))
    assert survey_of(named, 0, town).dates == ("2025-06-14", "2025-06-14")
    assert survey_of(named, 0, town.parent).dates is None


def test_lengths_and_areas_are_read_at_a_glance() -> None:
    assert [length_text(metres) for metres in (0.0041, 0.106, 1.2)] == ["4.1 mm", "10.6 cm", "1.20 m"]
    assert [area_text(area) for area in (850, 18_400, 12.4e6)] == ["850 m²", "1.8 ha", "12.4 km²"]


def test_everything_that_is_missing_is_said_once() -> None:
    borders = [{"between": ["a", "b"], "seam_found": True}, {"between": ["b", "c"], "seam_found": False}]
    metrics = {"missing": {"east-1": "it stopped"}, "not_refined": {}, "borders": borders, "seam_found": True, "seam_excess_db": 1.25}
    few = {**metrics, "num_unplaced": 3, "images": [{}]}
    assert [text.split(":")[0] for text in gaps_of(few, UNSCALED)] == [
        "Not all of the site", "3 photographs could not be placed", "Metres and a place on the map", "A seamless whole",
        "Sure figures of quality",
    ]  # fmt: skip
    assert not [text for text in gaps_of(few, UNSCALED) if "east-1" in text or "device" in text], "machines say nothing to a client"
    assert notes_of(metrics, ["sfm: 3 have no pose"]) == ["No model came from east-1: it stopped", "sfm: 3 have no pose"]
    whole = {"missing": {}, "borders": borders, "seam_found": False, "ground_control": {"check": None}, "images": [{}] * 8}
    assert gaps_of(whole, METRIC) == [] == notes_of(whole, [])
    assert [text.split(":")[0] for text in gaps_of({**whole, "ground_control": None}, METRIC)] == ["A check on the ground"]


def test_words_between_backticks_are_code_and_nothing_is_markup() -> None:
    assert str(with_code("run `radiant <x>` & go")) == "run <code>radiant &lt;x&gt;</code> &amp; go"
    assert str(with_code("a ` alone")) == "a ` alone"


def test_the_title_is_the_place_and_not_the_word_images() -> None:
    assert [title_of(source) for source in ("/a/town/images", "/a/flight 7", "/a/quarry/DCIM")] == ["town", "flight 7", "quarry"]


def test_the_turntable_shows_the_box_from_every_side_and_nothing_beside_it() -> None:
    splats = ground_splats(6000)
    box = np.array([[-2.0, -2.0, -0.5], [2.0, 2.0, 0.5]])
    kept = crop_to(splats, box)
    assert 0 < len(kept) < len(splats) and np.abs(kept.means[:, :2]).max() <= 2 + MARGIN * 4
    images = list(turntable(splats, box, 4, (96, 64)))
    assert len(images) == 4
    for image in images:
        drawn: np.ndarray = np.less(image, 250).max(axis=2)
        assert drawn[16:48, 32:64].mean() > 0.5, "the middle is full"
        assert drawn[0].mean() < 0.5 and drawn.mean() < 0.95, "and not the whole picture"
    assert all(np.abs(image.astype(int) - images[0]).mean() > 5 for image in images[1:]), "every side is another picture"
