"""What can be chosen before a run, and the words for it: the same in the window and on the page."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_atomic

QUALITIES = (
    ("quick", "Quick look", "Is everything there? A third of the usual steps on smaller photographs"),
    ("usual", "Usual", "What radiant run does without options"),
    ("fine", "Fine", "Three times the steps at twice the pixels a side: many times as long"),
)
VERBS = {"run": "Start", "plan": "Make the plan", "open": "Open"}
HERE, FILE, FORM = "This machine alone", "Machines of a system file", "Machines listed here"
COLUMNS = ("Site", "Machine", "Number", "Kind", "Memory GB", "Mbit/s")
KIND = COLUMNS.index("Kind")
FIRST_ROW = ("office", "computer", "2", "", "16", "1000")
NO_KIND = "not measured"
NOTHING_CHOSEN = "Time, memory and quality are shown here once something is chosen."


def forecast_text(answer: Mapping[str, Any]) -> str:
    """The lines of a forecast, as `start_worker` answers it."""
    rows = [("Time", answer["time"]), ("Memory", answer["memory"]), ("Quality", answer["quality"]), ("", answer["warning"])]
    return "\n".join(f"{name}: {text}".lstrip(": ") for name, text in rows if text)


def result_path(step: str, out: Path) -> Path:
    """What is opened once a command has ended well: the folder of a run, the file of a plan."""
    return out / "plan.json" if step == "plan" and out.suffix != ".json" else out


def list_path(out: Path) -> Path:
    """Where the system file of listed machines lies, beside a result."""
    return out.with_name(f"{out.name}_machines.toml")


class ListedMachines:
    """The system file of machines that are listed by hand. It lies in a folder of its own until the
    run begins or its line is copied; only then it is written where the line names it."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="radiant-")
        self.tried = Path(self._folder.name) / "machines.toml"

    def keep(self, path: Path) -> None:
        """Write the file to `path`; BadInput where another lies there."""
        text = self.tried.read_bytes()
        if path.exists() and path.read_bytes() != text:
            raise BadInput(f"{path} exists with other machines: choose another name for the list.")
        write_atomic(path, text)

    def end(self) -> None:
        """Forget what was not kept."""
        self._folder.cleanup()
