"""What the tests of the main job share: its smallest settings, and its commands."""

from __future__ import annotations

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pytest

from radiant_app.cli import app as cli
from radiant_app.commands.run.pipeline import RunResult
from radiant_app.config.run_config import PlanOptions, RunConfig, TrainOptions
from radiant_app.events import Event
from tests.forked import run_module

Finished = tuple[RunConfig, RunResult, list[Event]]
"""A finished run, as the fixture `finished` gives it to all tests of a session."""
TINY = TrainOptions(long_side_px=96, num_steps=100, max_num_splats=1500)
FOUR = PlanOptions(devices=4)
"""Two edges with two devices each, which a machine alone would not be."""
TINY_OPTIONS = ("--steps", TINY.num_steps, "--long-side-px", TINY.long_side_px, "--max-splats", TINY.max_num_splats)


def radiant(*arguments: object) -> subprocess.CompletedProcess[str]:
    return run_module("radiant_app", *arguments)


def refused(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The same in this process, without its signals and streams: for commands that do nothing but refuse."""
    words, said = [*map(str, arguments)], (StringIO(), StringIO())
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said[0]), redirect_stderr(said[1]):
        patch.setattr(sys, "argv", ["radiant", *words])
        for name in ("make_streams_last", "interrupt_on_signals", "stop_repeating_interrupt"):
            patch.setattr(cli, name, lambda: None)
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert isinstance(ended.value.code, int)
    return subprocess.CompletedProcess(words, ended.value.code, *(text.getvalue() for text in said))
