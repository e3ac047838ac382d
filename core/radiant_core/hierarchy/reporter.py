"""`Reporter`: receives what a node decides and how far it is. `Machine`: what a node may use."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from radiant_core.decisions import Decision
from radiant_core.render.contract import Backend
from radiant_core.train.few import KeptScores, NoKeptScores
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import Checkpoints, FitOptions, NoCheckpoints


class Reporter(Protocol):
    """Hears a node while it works."""

    @property
    def stage(self) -> str:
        """Name of the node, which its decisions carry."""
        ...

    def decide(self, decision: Decision) -> None:
        """Something was skipped or chosen."""
        ...

    def warn(self, message: str) -> None:
        """Something that a user should know; nothing stops."""
        ...

    def progress(self, done: float, total: float, note: str = "") -> None:
        """How far the node is."""
        ...


@dataclass(frozen=True, kw_only=True)
class Recorder:
    """A reporter that keeps decisions and warnings in lists."""

    stage: str = ""
    decisions: list[Decision] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def decide(self, decision: Decision) -> None:
        """Keep a decision."""
        self.decisions.append(decision)

    def warn(self, message: str) -> None:
        """Keep a warning."""
        self.warnings.append(message)

    def progress(self, done: float, total: float, note: str = "") -> None:
        """Nobody watches."""


@dataclass(frozen=True, kw_only=True)
class OneOfSeveral:
    """Hears one of several trainings of a node: how far it is counts, what it decides does not."""

    reporter: Reporter
    before: float
    """Work of those that ended, in units of the model's own training."""
    work: float
    """Of this one."""
    whole: float
    """Of all, as far as it is known."""
    name: str
    """What its progress and warnings call it."""

    @property
    def stage(self) -> str:
        """Name of the node."""
        return self.reporter.stage

    def decide(self, decision: Decision) -> None:
        """Of this training alone."""

    def warn(self, message: str) -> None:
        """With the training's name before it."""
        self.reporter.warn(f"{self.name}: {message}")

    def progress(self, done: float, total: float, note: str = "") -> None:
        """How far the node is."""
        self.reporter.progress(self.before + self.work * done / total, self.whole, f"{self.name}, {note}")


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What a node may use where it runs; no bit depends on it, unless memory is short."""

    base_bytes: int = 0
    """What the process holds before it loads photographs; counts where a task limits its memory."""
    free_bytes: Callable[[], float] = lambda: float("inf")
    """What the process may still take."""
    held_bytes: Callable[[], float] = lambda: 0.0
    """What it holds."""
    num_edges: int = 1
    """Edges that may join there side by side."""
    checkpoints: Callable[[Callable[[], str]], Checkpoints] = lambda key: NoCheckpoints()
    """Where the state of a training with that key is saved against interruption."""
    kept_scores: KeptScores = field(default_factory=NoKeptScores)
    """Where scores of trials are kept against interruption."""
    scratch: Path | None = None
    """Folder for pictures that need not stay in memory; None: they do."""
    clock: Callable[[], float] = time.monotonic
    """What a training's seconds are measured by."""


def fit_options(backend: Backend, reporter: Reporter, machine: Machine, key: Callable[[], str]) -> FitOptions:
    """How a node's training renders, reports and saves its state."""

    def report(progress: TrainProgress) -> None:
        done = progress.step if progress.spent is None else progress.spent * progress.num_steps
        reporter.progress(done, progress.num_steps, f"loss {progress.loss:.4f}")

    return FitOptions(backend=backend, report=report, checkpoints=machine.checkpoints(key), clock=machine.clock, scratch=machine.scratch)
