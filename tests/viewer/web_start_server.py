"""The page on which runs are begun, with runs as short as they can be: `python -m
tests.viewer.web_start_server`, until interrupted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from radiant_app.commands.inspect.feeds import start_feeds
from radiant_app.commands.run.control import BegunCommand
from radiant_app.interrupts import interrupt_on_signals
from radiant_viewer.web.server import open_start_page

KNOWN = Path(__file__).parents[2] / "sample_scenes/hamlet/known"
SMALL = ("--steps", "60", "--long-side-px", "96", "--max-splats", "2000", "--poses", str(KNOWN), "--set", "refine.rounds=1")

if __name__ == "__main__":
    # As the command does: whoever began this may have had interrupts ignored.
    interrupt_on_signals()
    feeds = replace(start_feeds(), begin=lambda line: BegunCommand((*line, *SMALL) if line[0] == "run" else line))
    open_start_page(feeds, lambda text: print(text, flush=True), 0)
