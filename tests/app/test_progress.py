"""What a user is told while work goes on: steps by name, times that a pace was measured for, names as they are, lines that grep finds."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.events import (
    Decided,
    Event,
    Outlined,
    RunLeft,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
    TimeLeft,
    Warned,
    decode,
    encode,
)
from radiant_app.files.event_file import EventFile, read_progress
from radiant_app.pace import Pace, RunPace, clock_text
from radiant_app.report.progress import ProgressDisplay
from radiant_app.report.tables import finish, print_figures
from radiant_app.report.verdict import verdict_of
from radiant_core.decisions import Decision
from radiant_core.io.run_store import write_json
from radiant_core.sfm.config import SfmProgress, number_phases
from radiant_core.sfm.reconstruct import PHASES

NAMES = ("[/x].jpg", "[bold]y.jpg", "[link=file:///]z.jpg", "[red", "{task.nothing}.jpg", ":heart:.jpg")


@dataclass
class Clock:
    """A clock that a test turns."""

    now_s: float = 0.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Told:
    """A display and what stands on its console."""

    clock: Clock = field(default_factory=Clock)
    terminal: bool = False
    out: io.StringIO = field(default_factory=io.StringIO)

    def __post_init__(self) -> None:
        console = Console(file=self.out, force_terminal=self.terminal, width=200 if self.terminal else None, color_system=None)
        self.display = ProgressDisplay(console, clock=self.clock)

    @property
    def lines(self) -> list[str]:
        """Lines, without what moves a terminal's cursor."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", self.out.getvalue()).splitlines()


def steps_of_sfm(clock: Clock, mapping_s: float) -> Iterator[StageProgress]:
    """Structure from motion of 60 photographs whose first steps are quick and whose mapping takes `mapping_s`, as it tells of itself."""
    heard: list[SfmProgress] = []
    report = number_phases(heard.append, PHASES)
    for phase, total, step_s in (
        ("checking photographs", 60, 0.01),
        ("features", 60, 0.05),
        ("matching", 1770, 0.001),
        ("mapping", 60, None),
    ):
        for done in range(total + 1):
            report(SfmProgress(phase=phase, done=done, total=total))
            yield StageProgress(stage="sfm", **asdict(heard[-1]))
            clock.now_s += mapping_s / total if step_s is None else step_s
    report(SfmProgress(phase="refining", done=0, total=60))
    yield StageProgress(stage="sfm", **asdict(heard[-1]))


@pytest.mark.parametrize("mapping_s", [15.0, 900.0])
def test_a_long_step_after_short_ones_has_its_own_time_left(mapping_s: float) -> None:
    clock = Clock()
    pace = Pace(clock=clock)
    errors = []
    for event in steps_of_sfm(clock, mapping_s):
        pace.update(event)
        if event.phase == "mapping":
            left_s = pace.left_s
            assert left_s is None or left_s > 0
            assert not pace.text.endswith("about 0:00")
            if 0.2 * event.total <= event.done < event.total:
                assert left_s is not None and "left in step about" in pace.text
                errors.append(abs(left_s - mapping_s * (1 - event.done / event.total)) / mapping_s)
    assert max(errors) < 1e-9, "at an even pace it is exact"
    assert pace.left_s is None and "left" not in pace.text, "of a step that only begins nothing is known"


def test_time_left_converges_at_a_pace_that_changes() -> None:
    """Each photograph takes longer than the one before, as while mapping: the error falls with what is left."""
    clock = Clock()
    pace = Pace(clock=clock)
    total = 100
    ends_s = np.cumsum(np.arange(1, total + 1) * 0.1)
    off_s = []
    pace.update(StageProgress(stage="s", done=0, total=total))
    for done in range(1, total):
        clock.now_s = float(ends_s[done - 1])
        pace.update(StageProgress(stage="s", done=done, total=total))
        if pace.left_s is not None:
            off_s.append(abs(pace.left_s - (ends_s[-1] - clock.now_s)))
    assert off_s[-1] < 0.06 * off_s[0] and off_s[-1] < 0.015 * ends_s[-1]


def test_time_left_grows_while_nothing_is_heard() -> None:
    clock = Clock()
    pace = Pace(clock=clock)
    for done in (0, 50, 90):
        pace.update(StageProgress(stage="s", done=done, total=100))
        clock.now_s += 5.0
    before_s, clock.now_s = pace.left_s, clock.now_s + 600.0
    assert before_s is not None and pace.left_s is not None and pace.left_s > before_s > 0


@pytest.mark.parametrize("counts", [(0, 0), (5, 3), (float("nan"), 10), (3, float("nan")), (-1, 10)])
def test_numbers_that_say_nothing_give_no_time(counts: tuple[float, float]) -> None:
    clock = Clock()
    pace = Pace(clock=clock)
    for _ in range(3):
        pace.update(StageProgress(stage="s", done=counts[0], total=counts[1]))
        clock.now_s += 20.0
    assert pace.left_s is None and pace.text == "elapsed 1:00"


def test_a_clock_is_read_as_one() -> None:
    def told(off_percent: float | None) -> str:
        pace = RunPace(clock=lambda: 0.0)
        pace.update(RunLeft(phase="poses", number=1, num_phases=6, elapsed_s=3.0, left_s=40.0, off_percent=off_percent))
        return pace.text.removeprefix("elapsed 0:03, left about 0:40")

    # No range below zero.
    assert [told(percent) for percent in (None, 45.0, 99.4, 100.0, 115.0)] == [
        "",
        " ± 45 %",
        " ± 99 %",
        *[" (may be twice as long or more)"] * 2,
    ]
    assert [clock_text(seconds) for seconds in (0.0, 3.4, 59.6, 760.0, 3723.0)] == ["0:00", "0:03", "1:00", "12:40", "1:02:03"]


def test_a_log_names_the_step_and_never_promises_0_s() -> None:
    told = Told()
    with told.display as display:
        display(StageStarted(stage="sfm"))
        for event in steps_of_sfm(told.clock, 900.0):
            display(event)
    assert len(told.lines) > 50
    assert not any(re.search(r"\b0 s left|left (in step )?about 0:00", line) for line in told.lines)
    half = next(line for line in told.lines if ", 52 %, " in line)
    assert re.fullmatch(r"sfm: mapping, step 4 of 7, 52 %, elapsed 7:50, left in step about 7:15", half)
    assert all(re.match(r"sfm: [a-z ]+, step [1-7] of 7, ", line) for line in told.lines)


def test_a_bar_says_elapsed_and_left_before_the_figures() -> None:
    told = Told(terminal=True)
    with told.display as display:
        display(StageStarted(stage="devices/a"))
        display(StageProgress(stage="devices/a", done=1, total=200, note="loss 0.5"))
        display._progress.refresh()
        told.clock.now_s = 20.0
        display(StageProgress(stage="devices/a", done=101, total=200, note="loss 0.25"))
        display._progress.refresh()
    bars = [line for line in told.lines if "devices/a" in line]
    begins, last = bars[0], bars[-1]
    assert "elapsed 0:00" in begins and "left" not in begins
    assert re.search(r"50 % elapsed 0:20, left about 0:20 +loss 0.25", last)


@pytest.mark.parametrize("terminal", [True, False])
def test_names_are_no_markup(terminal: bool) -> None:
    told = Told(terminal=terminal)
    with told.display as display:
        for name in NAMES:
            stage = f"job {name}"
            decision = Decision(stage=stage, topic=name, choice=f"{name} is left out", figure=None, unit="", reason=f"as {name}")
            display(StageStarted(stage=stage))
            told.clock.now_s += 11.0
            display(StageProgress(stage=stage, done=1, total=3, note=name, phase=name))
            display._progress.refresh()
            display(Warned(stage=stage, message=f"{name} is truncated"))
            display(Decided(decision=decision))
            display(StageSkipped(stage=stage) if name == NAMES[0] else StageDone(stage=stage, seconds=2.0))
    for name in NAMES:
        assert f"warning job {name}: {name} is truncated" in told.lines
        assert f"decided job {name}, {name}: {name} is left out (as {name})" in told.lines
        ended = f"skipped job {name}: finished before" if name == NAMES[0] else f"done job {name} in 2.0 s"
        assert ended in told.lines
        assert any(line.lstrip("⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏ ").startswith(f"job {name}: {name}") for line in told.lines)


def test_names_are_no_markup_in_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    figures = dict.fromkeys(("psnr_db", "ssim", "psnr_cc_db", "ssim_cc", "flip", "lpips"), 1.0)
    long = "a_name_of_a_photograph_that_is_longer_than_half_of_a_line_of_a_terminal.jpg"
    rows = [{"name": name, **figures} for name in (*NAMES, long)]
    print_figures({"images": rows, "median": figures, **figures})
    shown = capsys.readouterr().out
    assert all(name in shown for name in (*NAMES, long)), "whole names, in a file too"


def test_lines_of_a_log_are_not_wrapped() -> None:
    told = Told()
    message = "word " * 60 + "end"
    with told.display as display:
        display(Warned(stage="sfm", message=message))
        display(Decided(decision=Decision(stage="sfm", topic="t", choice=message, figure=None, unit="", reason="r")))
        display(TimeLeft(seconds=0.2, correction=1.2, after="devices/a"))
    assert told.lines[0] == f"warning sfm: {message}" and told.lines[1] == f"decided sfm, t: {message} (r)"
    assert told.lines[2] == "devices and edges: left about 0:01, 1.20 × what was planned" and len(told.lines) == 3


def test_decisions_can_be_left_to_the_report() -> None:
    out = io.StringIO()
    decision = Decision(stage="sfm", topic="t", choice="c", figure=None, unit="", reason="r")
    with ProgressDisplay(Console(file=out), with_decisions=False) as display:
        display(Decided(decision=decision))
        display(Warned(stage="sfm", message="w"))
    assert out.getvalue() == "warning sfm: w\n" and display.num_decisions == 1


def test_a_decision_that_changes_nothing_is_for_the_report_alone(tmp_path: Path) -> None:
    told = Told()
    decision = Decision(stage="s", topic="blur", choice="0 of 3 are left out", figure=0.0, unit="", reason="r", changes_nothing=True)
    with told.display as display:
        display(Decided(decision=decision))
    assert told.lines == [] and decode(encode(Decided(decision=decision))) == Decided(decision=decision)


def test_a_run_says_how_many_of_its_stages_are_finished(tmp_path: Path) -> None:
    write_json(tmp_path / "manifest.json", {"status": "running"})
    events: list[Event] = [
        Outlined(stages=("sfm", "devices/a", "devices/b", "cloud")),
        StageSkipped(stage="sfm"),
        Outlined(stages=("sfm", "devices/a", "cloud")),
        StageStarted(stage="devices/a"),
        StageStarted(stage="devices/a/score"),
        StageDone(stage="devices/a/score", seconds=0.2),
        StageDone(stage="devices/a", seconds=2.0),
    ]
    told = Told()
    with EventFile(tmp_path, told.display) as tell:
        for event in events:
            assert decode(encode(event)) == event
            tell(event)
        tell(StageStarted(stage="cloud"))
        tell(StageProgress(stage="cloud", done=1, total=4, note="loss 0.5", phase="matching", step=3, num_steps=6))
    assert told.lines == [
        "skipped sfm: finished before; 1 of 4 stages finished",
        "done devices/a/score in 0.2 s",
        "done devices/a in 2.0 s; 2 of 3 stages finished",
    ]
    seen = read_progress(tmp_path)
    assert seen.expected == ("sfm", "devices/a", "cloud") and seen.stages[-1].note == "matching, step 3 of 6, loss 0.5"
    pytest.importorskip("PySide6")
    from radiant_viewer.runs.progress_summary import progress_summary
    from radiant_viewer.runs.run_feeds import WholeRunState

    assert "2 of 3 stages finished" in progress_summary(seen)
    whole = WholeRunState(phase="training", number=2, num_phases=6, elapsed_s=60.0, left_s=300.0, off_percent=45.0)
    assert progress_summary(replace(seen, is_running=True, status="running", whole=whole)).endswith("about 5 min ± 45 % left")
    assert progress_summary(replace(seen, is_running=True, status="running", whole=replace(whole, off_percent=115.0))).endswith(
        "about 5 min left (may be twice as long or more)"
    )
    with EventFile(tmp_path, Told().display) as tell:
        for event in (*events, StageDone(stage="cloud", seconds=1.0), StageStarted(stage="report"), StageDone(stage="report", seconds=1.0)):
            tell(event)
    assert "4 of 4 stages finished" in progress_summary(read_progress(tmp_path)), "as many as there are rows"


def test_libraries_write_to_a_file_and_python_is_heard(tmp_path: Path) -> None:
    script = (
        "import os, sys; from pathlib import Path; from radiant_app.commands.run.steps import libraries_log_to\n"
        "with libraries_log_to(Path(sys.argv[1])):\n"
        "    os.write(2, b'I2026 undistorters.cc:208]\\n'); print('a bar', file=sys.stderr)\n"
        "os.write(2, b'afterwards\\n'); print('at the end', file=sys.stderr)"
    )
    for times in (1, 2):
        command = [sys.executable, "-c", script, tmp_path / "log.txt"]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
        assert done.stderr.splitlines() == ["a bar", "afterwards", "at the end"]
        # What is resumed keeps what was said before it was interrupted.
        assert (tmp_path / "log.txt").read_text() == times * "I2026 undistorters.cc:208]\n"


def test_sfm_gives_one_object_with_lists_and_a_log_of_its_own(tmp_path: Path) -> None:
    for name, target in (("images", "images"), ("sparse", "known")):
        (tmp_path / name).symlink_to(sample_scenes_folder() / "hamlet" / target)
    command = [sys.executable, "-m", "radiant_app", "sfm", str(tmp_path), "--out", str(tmp_path / "scene"), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert told["unregistered"] == [] and told["warnings"] != "none"
    assert "; ".join(line.removeprefix("warning sfm: ") for line in done.stderr.splitlines()) == told["warnings"]
    assert (tmp_path / "scene" / "log.txt").is_file()


def test_time_left_stands_beside_the_bar_of_a_terminal_and_in_a_log_at_intervals() -> None:
    shown, log = Told(terminal=True), Told()
    for told in (shown, log):
        with told.display as display:
            display(Outlined(stages=("devices/a", "devices/b")))
            for seconds in (80.0, 70.0, 60.0):
                display(TimeLeft(seconds=seconds, correction=1.0, after="devices/a"))
                told.clock.now_s += 6.0
            display._progress.refresh()
    assert "devices and edges: left about 1:00" in [line for line in shown.lines if line.strip()][-1]
    assert log.lines == [f"devices and edges: left about {left}" for left in ("1:20", "1:00")]


def test_words_for_quality_follow_the_worse_of_both_figures() -> None:
    def word(psnr_db: float, ssim: float) -> str:
        return verdict_of({"psnr_db": psnr_db, "ssim": ssim, "images": [{}] * 8}).word

    assert [word(*figures) for figures in ((30, 0.9), (30, 0.8), (24.4, 0.79), (22, 0.7), (22, 0.4), (13, 0.9))] == [
        "very good", "good", "good", "fair", "poor", "poor",
    ]  # fmt: skip
    few = verdict_of({"psnr_db": 13.406, "ssim": 0.372, "images": [{}]})
    assert few.line == "poor: 13.41 dB PSNR and SSIM 0.37 on 1 held-out photograph (too few to be sure)"


@pytest.mark.parametrize(
    ("known", "word", "doubt"),
    [
        ({}, "very good", ""),
        ({"num_unplaced": 1, "num_photographs": 60}, "very good", ""),
        ({"num_unplaced": 12, "num_photographs": 48}, "fair", "12 of 60 photographs could not be placed"),
        ({"num_unplaced": 40, "num_photographs": 20}, "poor", "40 of 60"),
        ({"missing": {"devices/north-1": "lost"}}, "fair", "no model arrived from devices/north-1"),
        ({"seam_found": True}, "fair", "a seam was found"),
        ({"doubts": ["up may be wrong."]}, "fair", "in doubt (1 warning)"),
        ({"num_unscored": 3}, "good", "3 of 11 held-out photographs are not scored"),
        (
            {"ground_control": {"check": {"rms_axis_m": 0.5, "expected_axis_m": 0.05}}},
            "fair",
            "check points are off by 10 times the expected error",
        ),
        ({"images": [{"mean_color_psnr_db": 31.0}] * 8}, "poor", "no better than one flat colour"),
        ({"images": [{}]}, "good", "too few to be sure"),
    ],
)
def test_the_weakest_part_gives_the_word(known: dict[str, Any], word: str, doubt: str) -> None:
    verdict = verdict_of({"psnr_db": 30.0, "ssim": 0.9, "images": [{}] * 8, **known})
    assert verdict.word == word and doubt in verdict.doubt
    assert verdict.line.startswith(f"{word}: 30.00 dB") and (word == "very good") == (verdict.doubt == "")


def test_the_first_sign_of_life_comes_before_heavy_libraries() -> None:
    """On a terminal; nothing of it is in a log."""
    script = (
        "import pty, os, sys, time\n"
        "pid, fd = pty.fork()\n"
        "if pid == 0: os.execv(sys.executable, [sys.executable, '-m', 'radiant_app', 'run', 'no/such/folder', '--out', '/nowhere/run'])\n"
        "said = b''\n"
        "try:\n"
        "    while part := os.read(fd, 65536): said += part\n"
        "except OSError: pass\n"
        "sys.stdout.write(said.decode())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 0 <= done.stdout.find("starting") < done.stdout.find("radiant: ")
    command = [sys.executable, "-m", "radiant_app", "run", "no/such/folder", "--out", "/nowhere/run"]
    log = subprocess.run(command, capture_output=True, text=True, check=False)
    assert log.returncode == 2 and len(log.stderr.splitlines()) == 1 and log.stdout == ""


def test_printed_figures_are_rounded_and_json_keeps_all_digits(capsys: pytest.CaptureFixture[str]) -> None:
    result = {
        "makespan_s": 63.32781686763339,
        "area_m2": 1234567.891,
        "ssim": 0.68094732,
        "planned": 12,
        "rows": [1.5],
        "status": "optimal",
    }
    finish(result, as_json=False)
    assert capsys.readouterr().out.splitlines() == [
        "makespan: 63.33 s",
        "area: 1,234,567.9 m²",
        "SSIM: 0.681",
        "positions planned: 12",
        "status: optimal",
    ]
    finish(result, as_json=True)
    assert json.loads(capsys.readouterr().out) == result
