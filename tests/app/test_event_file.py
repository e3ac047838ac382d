"""The event stream on disk: what a run tells is what a watcher reads, while it runs, after it ended, and after it was killed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.inspect.feeds import feeds_of
from radiant_app.events import Event, Failed, StageDone, StageProgress, StageSkipped, StageStarted, TimeLeft, Warned
from radiant_app.files.event_file import EVENTS_NAME, EventFile, read_progress
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock, write_json
from radiant_viewer.runs.run_feeds import RunProgress

STREAM = (
    StageSkipped(stage="sfm"),
    StageStarted(stage="devices/a"),
    StageProgress(stage="devices/a", done=10, total=100, note="step 10"),
    Warned(stage="devices/a", message="few points"),
    StageStarted(stage="devices/b"),
    StageDone(stage="devices/a", seconds=12.5),
    TimeLeft(seconds=40, correction=1.1, after="devices/a"),
    Failed(stage="devices/b", message="no memory", exit_code=1),
    StageStarted(stage="edges/e"),
)


def test_a_watcher_reads_what_the_run_told(tmp_path: Path) -> None:
    write_json(tmp_path / "manifest.json", {"status": "running"})
    heard: list[Event] = []
    with RunLock(tmp_path), EventFile(tmp_path, heard.append, clock=lambda: 0.0) as tell:
        for event in STREAM:
            tell(event)
        # Of progress within half a second only the first is written; all of it is passed on.
        tell(StageProgress(stage="devices/a", done=99, total=100))
        with (tmp_path / EVENTS_NAME).open("a") as file:
            file.write('{"event": "StageDo')
        seen = read_progress(tmp_path)
    assert heard == [*STREAM, StageProgress(stage="devices/a", done=99, total=100)]
    assert (tmp_path / EVENTS_NAME).read_text().count("StageProgress") == 1
    states = {stage.stage: (stage.state, stage.seconds, stage.note) for stage in seen.stages}
    assert states == {
        "sfm": ("skipped", None, "finished before"),
        "devices/a": ("done", 12.5, ""),
        "devices/b": ("failed", None, "no memory"),
        "edges/e": ("running", None, ""),
    }
    assert (seen.is_running, seen.status, seen.seconds_left, seen.warnings) == (True, "running", 40, ("devices/a: few points",))
    # Nobody holds the lock any more: the run was killed, whatever its record says.
    after = read_progress(tmp_path)
    assert (after.is_running, after.status) == (False, "interrupted")
    # What was at work then was stopped with the run; it did not fail.
    assert [stage.state for stage in after.stages] == ["skipped", "done", "failed", "interrupted"]


def test_a_watcher_hears_that_a_run_was_resumed_and_reads_only_what_is_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readings: list[Path] = []

    def counted(run: Path) -> RunProgress:
        readings.append(run)
        return read_progress(run)

    monkeypatch.setattr("radiant_app.commands.inspect.feeds.read_progress", counted)
    write_json(tmp_path / "manifest.json", {"status": "interrupted"})
    with EventFile(tmp_path, lambda event: None) as tell:
        tell(StageStarted(stage="sfm"))
    progress = feeds_of(tmp_path).progress
    states = [[(seen.status, seen.is_running, seen.stages[0].state) for seen in (progress(), progress())]]
    assert len(readings) == 1
    with RunLock(tmp_path), EventFile(tmp_path, lambda event: None) as tell:
        write_json(tmp_path / "manifest.json", {"status": "running"})
        tell(StageStarted(stage="sfm"))
        states.append([(seen.status, seen.is_running, seen.stages[0].state) for seen in (progress(), progress())])
    assert states == [[("interrupted", False, "interrupted")] * 2, [("running", True, "running")] * 2]
    assert len(readings) == 2


def test_a_new_phase_is_told_at_once(tmp_path: Path) -> None:
    checking = [(float(done), 10.0, "checking") for done in range(11)]
    # Features of two photographs are there from before; mapping ends at once, with as many as are
    # refined then.
    phases = [(2.0, 10.0, "features"), (3.0, 10.0, "features"), (0.0, 45.0, "matching"), (0.0, 9.0, "mapping"), (9.0, 9.0, "mapping")]
    ticks = iter(np.arange(1000) * 0.06)
    with EventFile(tmp_path, lambda event: None, clock=lambda: float(next(ticks))) as tell:
        tell(StageStarted(stage="sfm"))
        for done, total, note in [*checking, *phases, (0.0, 9.0, "refining")]:
            tell(StageProgress(stage="sfm", done=done, total=total, note=note))
            assert read_progress(tmp_path).stages[0].note == note
    told = (tmp_path / EVENTS_NAME).read_text()
    # Within a phase two lines a second; checking took 0.66 s.
    assert [told.count(f'"{note}"') for note in ("checking", "features", "matching", "mapping", "refining")] == [2, 1, 1, 1, 1]


@pytest.mark.parametrize(
    "counts",
    [
        [(0.0, 10.0 + number) for number in range(1000)],
        [(1000.0 - number, 1000.0) for number in range(1000)],
        [(float("nan"), 10.0)] * 1000,
        [(1.0, float("nan"))] * 1000,
    ],
)
def test_no_numbers_flood_the_file(tmp_path: Path, counts: list[tuple[float, float]]) -> None:
    ticks = iter(np.arange(len(counts)) * 1e-3)
    with EventFile(tmp_path, lambda event: None, clock=lambda: float(next(ticks))) as tell:
        for done, total in counts:
            tell(StageProgress(stage="sfm", done=done, total=total))
    assert (tmp_path / EVENTS_NAME).read_text().count("\n") <= 21


def test_no_stream_a_broken_one_and_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    assert read_progress(tmp_path).stages == ()
    assert feeds_of(tmp_path).progress().stages == ()
    (tmp_path / EVENTS_NAME).write_text("nonsense\n")
    with pytest.raises(BadInput, match=EVENTS_NAME):
        read_progress(tmp_path)
    heard: list[Event] = []
    with EventFile(tmp_path / "none", heard.append) as tell:
        tell(STREAM[0])
    assert heard == [STREAM[0]]


def test_a_stage_that_tells_what_is_left_of_it_says_so_beside_its_step(tmp_path: Path) -> None:
    with EventFile(tmp_path, lambda event: None) as tell:
        tell(StageProgress(stage="sfm", done=3, total=60, phase="features", step=2, num_steps=7, left_s=95.2))
    assert read_progress(tmp_path).stages[0].note == "features, step 2 of 7, about 1:35 left"
