"""What strangers wrote reaches a terminal without effect: the status, the errors, and what a node says."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from radiant_app.commands.network.node import Running
from radiant_app.events import Decided, StageProgress, StageStarted, Warned
from radiant_app.network.home import accept_invitation, invitation_text, make_home, new_invitation
from radiant_app.network.line import Answer
from radiant_app.plain_text import plain_text, shown_text
from radiant_app.report.progress import ProgressDisplay
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from tests.app.network_nodes import listening

MOVING = [
    *map(chr, range(32)),
    *map(chr, range(127, 160)),
    *"\u061c\u200b\u200e\u200f\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff\ud800",
]


@pytest.mark.parametrize("letter", MOVING, ids=[f"U+{ord(letter):04X}" for letter in MOVING])
def test_nothing_that_moves_a_cursor_or_turns_a_line_is_passed_on(letter: str) -> None:
    assert plain_text(f"a{letter}b") == "a b"
    shown = shown_text(f"a{letter}b")
    assert shown == "a\nb" if letter == "\n" else shown == f"a{ascii(letter)[1:-1]}b", "two names stay two"


@pytest.mark.parametrize("text", ["a b", "Köln, Straße", "東京/写真.jpg", "می\u200cشود", "👩\u200d🔬", "שלום"])
def test_text_of_any_language_is_shown_as_it_is(text: str) -> None:
    assert shown_text(text) == text


@pytest.mark.parametrize("terminal", [False, True])
def test_nothing_of_a_run_that_is_shown_moves_the_cursor(terminal: bool) -> None:
    """Warnings of an edge quote its devices, notes of a stage that was skipped are read from what came."""
    console = Console(file=io.StringIO(), force_terminal=terminal, color_system=None, width=200)
    display = ProgressDisplay(console, clock=iter(range(0, 10**6, 1000)).__next__)
    odd = "a\x1b]0;owned\x07\u202eb\x9b2J"
    decision = Decision(stage="edges/n", topic=odd, choice=odd, figure=1.0, unit=odd, reason=odd)
    with display:
        for event in (
            StageStarted(stage="edges/n"),
            Warned(stage="edges/n", message=odd),
            Decided(decision=decision),
            StageProgress(stage="edges/n", done=1, total=2, note=odd, phase=odd),
        ):
            display(event)
    assert isinstance(console.file, io.StringIO)
    # Those are rich's own, which draws the bar of a terminal.
    said = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", console.file.getvalue())
    assert said.count(r"a\x1b]0;owned\x07\u202eb\x9b2J") >= 4
    assert not {*"\x07\x1b\x9b\u202e"} & {*said}


def test_what_a_node_says_of_others_is_plain() -> None:
    said: list[str] = []
    Running(say=said.append).tell("edges/north: refused, \x1b]0;x\x07\nedges/south: done.")
    Running(say=said.append).tell(Answer(status=403, body=b'{"reason": "a\\u001b[2Jb"}', headers={}).reason)
    assert said == ["edges/north: refused,  ]0;x  edges/south: done.", "a [2Jb"]


@pytest.mark.parametrize("name", ["url", "upper"])
def test_a_join_file_that_would_draw_on_the_screen_is_refused(tmp_path: Path, name: str) -> None:
    """What stands there is shown to who agrees to it."""
    cloud = make_home(tmp_path / "cloud", listening())
    home = make_home(tmp_path / "edge", None)
    invitation = new_invitation(cloud, "north")
    given = invitation.url if name == "url" else invitation.upper
    text = invitation_text(invitation).replace(f'"{name}": "{given}"', f'"{name}": "{given}/\\u001b[2J\\u202e"')
    (tmp_path / "north.join").write_text(text)
    with pytest.raises(BadInput, match="characters that cannot be printed in what it names"):
        accept_invitation(home, tmp_path / "north.join")


def test_an_error_shows_a_name_with_escapes_as_such(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "radiant_app", "inspect", str(tmp_path / "a\x1b[2J\u202eb"), "--screenshot", "x.png"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert ended.returncode == 2 and r"a\x1b[2J\u202eb" in ended.stderr and "\x1b" not in ended.stderr
