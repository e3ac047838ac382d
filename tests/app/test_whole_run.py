"""The time left of a whole run: there from the start, corrected by what ended, 0 at the end alone; the number of phases stays."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from rich.console import Console

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.events import (
    PHASES,
    Event,
    Foreseen,
    Outlined,
    RunLeft,
    StageDone,
    StageProgress,
    StageSkipped,
    StageStarted,
    decode,
    encode,
)
from radiant_app.files.event_file import EventFile, read_progress
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.foreseen import foresee
from radiant_app.run.this_machine import machine_of, system_of
from radiant_app.run.whole_run import WholeRun, phase_of
from radiant_core.aggregate.tree import refined_at
from radiant_core.io.run_store import write_json

FORESEEN_S = (20.0, 60.0, 10.0, 40.0, 10.0, 20.0)
DEVICES = ("devices/a", "devices/b")
NODES = (*DEVICES, "edges/e", "cloud")
REFINED = tuple(refined_at(node) for node in NODES)


@dataclass
class Run:
    """A run that is played: what is heard of it, at which second, and what it ends with."""

    listen: WholeRun = field(init=False)
    now_s: float = 0.0
    heard: list[tuple[float, Event]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.listen = WholeRun(listen=lambda event: self.heard.append((self.now_s, event)), clock=lambda: self.now_s)

    @property
    def told(self) -> list[tuple[float, RunLeft]]:
        return [(at_s, event) for at_s, event in self.heard if isinstance(event, RunLeft)]

    def stage(self, *stages: str, seconds: float) -> None:
        """Stages side by side that take so long, and tell of every tenth."""
        for stage in stages:
            self.listen(StageStarted(stage=stage))
        for tenth in range(1, 10):
            self.now_s += seconds / 10
            for stage in stages:
                self.listen(StageProgress(stage=stage, done=tenth, total=10))
        self.now_s += seconds / 10
        for stage in stages:
            self.listen(StageDone(stage=stage, seconds=seconds))

    def play(self, factor: float) -> float:
        """All phases, each so many times as long as foreseen; the seconds of the run."""
        self.listen(Outlined(stages=("sfm", *(f"devices/{name}" for name in "abcd"), "edges/e", "edges/f", "cloud", "evaluation")))
        self.listen(Foreseen(phases_s=FORESEEN_S, units=(0,) * 6))
        self.stage("sfm", seconds=factor * FORESEEN_S[0])
        self.listen(Outlined(stages=("sfm", *NODES, *REFINED, "evaluation")))
        self.stage(*DEVICES, seconds=factor * FORESEEN_S[1])
        for node in ("edges/e", "cloud"):
            self.stage(node, seconds=factor * FORESEEN_S[2] / 2)
        self.stage(*REFINED[:2], seconds=factor * FORESEEN_S[3] / 2)
        for node in REFINED[2:]:
            self.stage(node, seconds=factor * FORESEEN_S[3] / 4)
        self.stage("evaluation", seconds=factor * FORESEEN_S[4])
        self.stage("report", seconds=factor * FORESEEN_S[5])
        return self.now_s


def test_every_stage_belongs_to_a_phase() -> None:
    stages = ("sfm", "positions", *NODES, *REFINED, "evaluation", "devices/a/score", "report")
    assert [PHASES[index] for stage in stages if (index := phase_of(stage)) is not None] == [
        "placing photographs", "placing photographs", "training", "training", "joining", "joining",
        "refining", "refining", "refining", "refining", "scoring", "scoring", "report",
    ]  # fmt: skip
    assert phase_of("devices/a/uplink") is None and phase_of("plan") is None


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_time_left_stands_from_the_start_and_is_corrected_as_phases_end(factor: float) -> None:
    run = Run()
    whole_s = run.play(factor)
    assert run.told[0][0] == 0.0
    assert run.told[0][1].left_s is None and run.told[1][0] == 0.0
    assert run.told[1][1].left_s == pytest.approx(sum(FORESEEN_S)), "as soon as it is foreseen"
    assert {event.num_phases for _, event in run.told} == {len(PHASES)}
    numbers = [event.number for _, event in run.told]
    assert numbers == sorted(numbers) and numbers[-1] == len(PHASES)
    off = [abs(event.left_s - (whole_s - at_s)) / whole_s for at_s, event in run.told if event.left_s is not None and event.number > 1]
    assert max(off) < 0.12, "once the first phase is over, a machine that is this much slower is known for it"
    assert [event.left_s for _, event in run.told if event.left_s == 0.0] == [0.0], "nothing is left when the report stands, never before"
    assert run.told[-1][1].left_s == 0.0 and run.told[-1][1].elapsed_s == pytest.approx(whole_s)


def test_what_an_earlier_run_did_takes_no_time() -> None:
    run = Run()
    run.listen(Outlined(stages=("sfm", *NODES, *REFINED, "evaluation")))
    run.listen(Foreseen(phases_s=FORESEEN_S, units=(0,) * 6))
    for stage in ("sfm", *DEVICES):
        run.listen(StageSkipped(stage=stage))
    run.now_s = 3.0
    run.listen(StageStarted(stage="edges/e"))
    run.now_s = 5.0
    run.listen(StageProgress(stage="edges/e", done=1, total=10))
    assert run.told[-1][1].left_s == pytest.approx(sum(FORESEEN_S[2:]), rel=0.25) and run.told[-1][1].phase == "joining"


def test_a_device_that_fails_is_not_waited_for() -> None:
    run = Run()
    run.listen(Outlined(stages=(*NODES, "evaluation")))
    run.listen(Foreseen(phases_s=FORESEEN_S, units=(0,) * 6))
    run.listen(StageStarted(stage="devices/b"))
    run.stage("devices/a", seconds=60.0)
    assert run.told[-1][1].phase == "training"
    run.stage("edges/e", seconds=5.0)
    run.listen(StageStarted(stage="cloud"))
    left_s = run.told[-1][1].left_s
    assert run.told[-1][1].phase == "joining" and left_s is not None and left_s < 1.2 * sum(FORESEEN_S[2:])


@pytest.mark.parametrize("terminal", [True, False])
def test_terminal_and_record_tell_the_whole_run(tmp_path: Path, terminal: bool) -> None:
    """As the start window and the terminal read it: one number of phases, and 100 % at the end alone."""
    out = io.StringIO()
    write_json(tmp_path / "manifest.json", {"status": "running"})
    run = Run()
    console = Console(file=out, force_terminal=terminal, width=200 if terminal else None, color_system=None)
    display = ProgressDisplay(console, clock=lambda: run.now_s)
    with EventFile(tmp_path, display, clock=lambda: run.now_s) as file, display:

        def listen(event: Event) -> None:
            assert decode(encode(event)) == event
            file(event)
            display._progress.refresh()

        run.listen = WholeRun(listen=listen, clock=lambda: run.now_s)
        run.play(2.0)
    lines = [line for line in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", out.getvalue()).splitlines() if "run: " in line]
    assert {found for line in lines for found in re.findall(r"run: .*? of (\d+)", line)} == {"6"}
    assert not any("stages" in line for line in lines)
    texts = [line for line in lines if "report, 6 of 6" in line]
    assert re.search(r"left about \d:\d\d ± \d+ %", texts[0])
    if terminal:
        assert all("100 %" not in line for line in lines if "left about" in line)
        assert "100 %" in texts[-1]
    whole = read_progress(tmp_path).whole
    assert whole is not None and whole.share == 1.0 and (whole.phase, whole.number, whole.num_phases) == ("report", 6, 6)


def test_a_run_is_foreseen_before_its_photographs_are_placed(tmp_path: Path) -> None:
    source = sample_scenes_folder() / "town" / "images"
    seconds = {}
    for name, num_devices, num_steps in (("short", 1, 100), ("long", 1, 1000), ("joined", 4, 1000)):
        config = RunConfig(source=source, out=tmp_path / "run", train=TrainOptions(num_steps=num_steps))
        foreseen = foresee(config, system_of(config) if num_devices == 1 else machine_of(num_devices))
        assert foreseen is not None and min(foreseen.phases_s[:2]) > 0 and min(foreseen.phases_s[4:]) > 0
        seconds[name] = foreseen.phases_s
    assert seconds["long"][1] > 2 * seconds["short"][1] and seconds["long"][0] == seconds["short"][0]
    assert seconds["long"][3] == 0 < seconds["joined"][3], "one device refines nothing"
    assert foresee(RunConfig(source=tmp_path / "nothing", out=tmp_path / "run"), machine_of(1)) is None
