"""What strangers wrote reaches a terminal without effect: the status, the errors, and what a node says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from radiant_app.commands.node import Running
from radiant_app.network.home import accept_invitation, invitation_text, make_home, new_invitation
from radiant_app.network.line import Answer
from radiant_app.plain_text import plain_text, shown_text
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
