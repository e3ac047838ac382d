"""The time left of structure from motion, over all phases, on a clock that the test turns."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from radiant_core.sfm.config import Phase, SfmConfig, SfmProgress
from radiant_core.sfm.time_left import TimeLeft, predict_phases

PHASES: tuple[Phase, ...] = ("features", "pairs", "matching", "mapping", "refining", "triangulating", "undistorting")


class Job:
    """A job whose phases take given seconds; keeps when what was said to be left."""

    def __init__(self, predicted_s: Mapping[Phase, float]) -> None:
        self.now_s = 0.0
        self.shown: list[tuple[float, float | None]] = []
        self.tell = TimeLeft(report=self.hear, phases=PHASES, predicted_s=predicted_s, clock=lambda: self.now_s)

    def hear(self, progress: SfmProgress) -> None:
        self.shown.append((self.now_s, progress.left_s))

    def run(self, phase: Phase, seconds: float, steps: int = 40) -> None:
        """Report a phase that takes so long, at an even pace."""
        for done in range(steps + 1):
            self.tell(SfmProgress(phase=phase, done=done, total=steps))
            self.now_s += seconds / steps if done < steps else 0.0


@pytest.mark.parametrize("speed", [0.1, 1.0, 30.0])
def test_on_a_machine_of_any_speed_the_time_left_is_exact_where_phases_share_it_as_predicted(speed: float) -> None:
    predicted: dict[Phase, float] = dict(zip(PHASES, (20.0, 0.2, 15.0, 12.0, 4.0, 2.0, 3.0), strict=True))
    job = Job(predicted)
    for phase, seconds in predicted.items():
        job.run(phase, speed * seconds)
    assert job.shown[0][1] is None, "nothing is known at the beginning"
    known = [(at_s, left_s) for at_s, left_s in job.shown if left_s is not None]
    assert len(known) > 0.9 * len(job.shown)
    for at_s, left_s in known:
        assert left_s == pytest.approx(job.now_s - at_s, rel=1e-6, abs=1e-6 * job.now_s)


def test_a_phase_twice_as_long_as_predicted_is_noticed_within_it() -> None:
    predicted: dict[Phase, float] = dict(zip(PHASES, (20.0, 0.2, 15.0, 12.0, 4.0, 2.0, 3.0), strict=True))
    job = Job(predicted)
    for phase, seconds in predicted.items():
        job.run(phase, seconds * (2.0 if phase == "matching" else 1.0))
    for at_s, left_s in job.shown:
        if left_s is not None and at_s < 0.95 * job.now_s:
            assert left_s == pytest.approx(job.now_s - at_s, rel=0.5)


def test_phases_that_come_back_and_a_job_that_begins_anew() -> None:
    predicted: dict[Phase, float] = dict(zip(PHASES, (20.0, 1.0, 15.0, 12.0, 4.0, 2.0, 3.0), strict=True))
    job = Job(predicted)
    for phase in PHASES[:4]:
        job.run(phase, predicted[phase])
    job.run("matching", 3.0)
    again = job.shown[-1][1]
    assert again == pytest.approx((12 + 4 + 5) - 12, rel=0.2), "what follows mapping, which was reached"
    job.run("mapping", 6.0)
    assert job.shown[-1][1] == pytest.approx(9.0, rel=0.2)
    job.run("features", 20.0)
    assert job.shown[-1][1] == pytest.approx(37.0, rel=0.1), "all is done again thoroughly"


def test_the_first_of_a_phase_may_wait_for_libraries_and_threads() -> None:
    predicted: dict[Phase, float] = dict(zip(PHASES, (20.0, 0.2, 15.0, 12.0, 4.0, 2.0, 3.0), strict=True))
    job = Job(predicted)
    job.now_s = 3.0
    job.tell(SfmProgress(phase="features", done=0, total=40))
    job.now_s += 4.0
    job.tell(SfmProgress(phase="features", done=1, total=40))
    for done in range(2, 9):
        job.now_s += 0.5
        job.tell(SfmProgress(phase="features", done=done, total=40))
    assert job.shown[-1][1] == pytest.approx(16.0 + sum(predicted.values()) - 20.0, rel=0.2)


def test_threads_that_end_their_first_ones_together_say_nothing_about_the_pace() -> None:
    predicted: dict[Phase, float] = dict(zip(PHASES, (20.0, 0.2, 15.0, 12.0, 4.0, 2.0, 3.0), strict=True))
    job = Job(predicted)
    job.tell(SfmProgress(phase="features", done=0, total=40))
    for wave in range(1, 11):
        job.now_s = 2.0 * wave
        for done in range(4 * wave - 3, 4 * wave + 1):
            job.now_s += 0.01
            job.tell(SfmProgress(phase="features", done=done, total=40))
    shown = [(at_s, left_s) for at_s, left_s in job.shown if left_s is not None and at_s > 2.04]
    for at_s, left_s in shown:
        assert 0.6 < left_s / (sum(predicted.values()) - at_s) < 1.7


def test_photographs_of_no_size_and_empty_phases_divide_by_nothing() -> None:
    assert all(value >= 0 for value in predict_phases([], SfmConfig()).values())
    job = Job(predict_phases([], SfmConfig()))
    for phase in PHASES:
        job.tell(SfmProgress(phase=phase, done=0, total=0))
        job.now_s += 5.0
    assert all(left_s is None or left_s >= 0 for _, left_s in job.shown)


# Photographs, their size, and measured CPU seconds of one thread (docs/experiments/sfm.md).
MEASURED = {
    "brighton": (18, (1152, 648), (5.3, 0.0, 1.9, 1.1, 0.6, 0.2, 0.4)),
    "caliterra": (75, (1152, 864), (21.3, 0.2, 7.4, 22.4, 7.1, 2.0, 1.9)),
    "lewis": (55, (1152, 864), (19.9, 0.2, 8.9, 12.9, 2.7, 1.3, 1.4)),
    "town": (60, (640, 480), (8.6, 0.2, 7.2, 11.9, 3.6, 1.2, 0.8)),
    # Of two threads on one core, halved.
    "60 small ones": (60, (384, 288), (3.1, 0.3, 3.4, 3.9, 2.8, 0.4, 0.5)),
    "400": (400, (384, 288), (26.6, 2.4, 19.3, 40.5, 17.8, 2.4, 2.7)),
    "1,600": (1600, (384, 288), (92.0, 9.8, 76.8, 335.0, 95.7, 17.0, 16.5)),
}


# The same by the clock with two threads on two otherwise idle cores, 2026-11-26.
BY_CLOCK = {
    "brighton": (18, (1152, 648), (7.0, 0.1, 4.2, 1.4, 0.8, 0.3, 0.8)),
    "caliterra": (75, (1152, 864), (17.9, 0.5, 12.9, 43.7, 11.2, 3.4, 5.2)),
    "town": (60, (640, 480), (12.5, 0.8, 14.9, 26.1, 7.1, 2.1, 2.2)),
}


@pytest.mark.parametrize(("num_threads", "name"), [*((1, name) for name in MEASURED), *((2, name) for name in BY_CLOCK)])
def test_after_a_fifth_of_the_measured_phases_the_time_left_is_within_half_of_the_truth(num_threads: int, name: str) -> None:
    count, size_wh, seconds = (MEASURED if num_threads == 1 else BY_CLOCK)[name]
    job = Job(predict_phases([size_wh] * count, SfmConfig(num_threads=num_threads)))
    for phase, phase_s in zip(PHASES, seconds, strict=True):
        job.run(phase, phase_s)
    at_s, left_s = next((at_s, left_s) for at_s, left_s in job.shown if at_s >= 0.2 * job.now_s)
    assert left_s is not None and 1 / 1.5 < left_s / (job.now_s - at_s) < 1.5
