"""Text of others on its way to a terminal: nothing in it moves the cursor, colours or turns it."""

from __future__ import annotations

JOINERS = "\u200c\u200d"
"""Invisible letters that words of some languages, and names of files in them, are written with."""


def plain_text(text: str) -> str:
    """One line of a stranger's text: blanks in place of control characters, ends of lines, marks of
    direction and all else that has no shape of its own."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def shown_text(text: str) -> str:
    """A message of ours, of several lines too, that may quote names of files and strangers: what
    has no shape of its own as its escape, which tells such a name from another one."""
    return "".join(letter if letter.isprintable() or letter in f"\n{JOINERS}" else ascii(letter)[1:-1] for letter in text)
