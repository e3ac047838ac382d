"""Every `radiant …` that a page shows is a command with these options, and sets settings that exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from benchmarks.cli import app as benchmarks
from radiant_app.cli.app import app
from radiant_app.config.fields import config_fields
from tests.architecture.test_pages import EXPERIMENTS, GENERATED, PAGES, ROOT, page_id

SHOWN = [page for page in [*PAGES, *EXPERIMENTS] if page != GENERATED]


def commands(text: str) -> Iterator[list[str]]:
    """The words after `radiant` of every command line of a page, and of every one in its prose."""
    whole_lines = text.replace("\\\n", " ")
    yield from (
        line.split() for line in re.findall(r"^ {4,}(?:\w+=\S+ )*(?:nice (?:-n \d+ )?)?radiant ([^\n#]*)", whole_lines, re.MULTILINE)
    )
    unwrapped = re.sub(r"\n(?! {4}|\n)", " ", text)
    yield from (line.split() for line in re.findall(r"`radiant ([^`#]+)`", unwrapped))


def faults(words: list[str]) -> list[str]:
    """What of a command line is not there: its command, options, settings."""
    meant: list[Any] = [get_command(app)]
    rest = list(words)
    while rest and hasattr(meant[0], "commands") and not rest[0].startswith("-"):
        name = rest.pop(0)
        meant = [meant[0].commands.get(each) for each in name.split("|")]
        if None in meant:
            return [name]
        if name == "bench":
            meant = [get_command(benchmarks)]
    known = {option for command in meant for param in command.params for option in (*param.opts, *param.secondary_opts)}
    options = [re.match(r"\[?(--[a-z][a-z0-9-]*|-[a-z]\b)", word) for word in rest]
    wrong = [option[1] for option in options if option and option[1] not in {*known, "--help"}]
    settings = re.findall(r"--set[ =]'?([\w.-]+)=", " ".join(rest))
    return wrong + [path for path in settings if path.replace("-", "_") not in config_fields()]


@pytest.mark.parametrize("page", SHOWN, ids=page_id)
def test_every_command_of_a_page_can_be_typed(page: Path) -> None:
    shown = [words for words in commands(page.read_text()) if words]
    assert [(" ".join(words), wrong) for words in shown if (wrong := faults(words))] == []


@pytest.mark.parametrize("page", [*EXPERIMENTS, ROOT / "README.md"], ids=page_id)
def test_every_page_of_figures_names_a_command_that_makes_them(page: Path) -> None:
    text = page.read_text()
    made = [words for words in commands(text) if words and words[0] in ("bench", "run", "train", "plan", "export", "machine", "join")]
    modules = [*re.findall(r"python -m ((?:tests|benchmarks)\.[\w.]+)", text), *re.findall(r"pytest (?:-m stress )?(tests/[\w/]+)", text)]
    is_linked = page.name == "README.md" and "[figures](docs/experiments/" in text
    assert made or modules or is_linked
    assert [name for name in modules if not any(_is_kept(name.replace(".", "/"), ending) for ending in ("", ".py"))] == []


def _is_kept(name: str, ending: str) -> bool:
    return (ROOT / f"{name}{ending}").exists()


def test_what_cannot_be_typed_is_found() -> None:
    lines = "    nice radiant trian X    # comment\n    radiant run X --set train.nothing=1\n"
    page = f"Type `radiant sfm\nPHOTOS --set sfm.effort=thorough` or\n\n{lines}"
    assert [faults(words) for words in commands(page)] == [["trian"], ["train.nothing"], ["--set"]]
    assert sum(len(list(commands(page.read_text()))) for page in SHOWN) > 200
