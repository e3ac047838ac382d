"""How long the pages are, that what is generated is as its source says, and what no page says."""

from __future__ import annotations

import re
from pathlib import Path

from tools.types_page import PAGE, page
from tools.words import LIMIT, ROOT, num_words, written_pages

FORBIDDEN = ("script that is not kept", "scripts that are not kept", "/work/")
"""Figures need a command that is in the repository; paths of one machine help nobody else."""
CHANGELOG_LINES = 60
README_WORDS, README_NUMBERS = 400, 25


def test_all_pages_together_keep_to_the_limit() -> None:
    assert sum(num_words(path) for path in written_pages()) <= LIMIT, "make words: which pages are long?"


def test_figures_have_commands_that_are_kept() -> None:
    said = [
        (path.name, words)
        for path in [*written_pages(), *Path(ROOT / "docs").rglob("*.md")]
        for words in FORBIDDEN
        if words in path.read_text()
    ]
    assert said == []


def test_the_changelog_is_short() -> None:
    assert len((ROOT / "CHANGELOG.md").read_text().splitlines()) <= CHANGELOG_LINES


def test_the_readme_is_read_in_two_minutes() -> None:
    assert num_words(ROOT / "README.md") <= README_WORDS
    assert len(re.findall(r"\d[\d.,]*", (ROOT / "README.md").read_text())) <= README_NUMBERS


def test_the_page_of_types_is_what_the_source_says() -> None:
    assert PAGE.read_text() == page(), "run `make docs`"
