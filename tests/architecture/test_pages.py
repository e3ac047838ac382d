"""What holds for every page: its links and pictures exist, the modules that it names do too, and its prose is 100 columns wide."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *sorted(DOCS.glob("*.md")),
    *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "sample_scenes/README.md")),
]
EXPERIMENTS = sorted((DOCS / "experiments").glob("*.md"))
GENERATED = DOCS / "cli.md"
WRAPPED = [page for page in PAGES if page not in (GENERATED, DOCS / "types.md", ROOT / "README.md", ROOT / "ARCHITECTURE.md")]
MAX_PROSE_COLUMNS = 100
SOURCE_FOLDERS = ("core", "viewer", "radiant_app", "radiant", "benchmarks", "examples", "sample_scenes", "tests", "tools")


def page_id(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def prose(page: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, code blocks left out."""
    fenced = False
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            yield number, line


def links(page: Path) -> Iterator[tuple[str, str]]:
    """Relative links as (path, heading), either of them empty where it is not given."""
    for _number, line in prose(page):
        for target in re.findall(r"\]\(([^)\s]+)\)", line):
            if not re.match(r"[a-z]+:", target):
                path, _, heading = target.partition("#")
                yield path, heading


def heading_names(page: Path) -> set[str]:
    """The names that GitHub gives a page's headings in links."""
    headings = [line.lstrip("#").strip() for _number, line in prose(page) if line.startswith("#")]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@cache
def source_paths() -> tuple[str, ...]:
    """Every source file as "/core/…", so that a path's end can be compared."""
    return tuple(f"/{path.relative_to(ROOT).as_posix()}" for folder in SOURCE_FOLDERS for path in (ROOT / folder).rglob("*.*"))


def is_module(dotted: str) -> bool:
    """Whether a dotted name is a module or something of one."""
    parts = dotted.split(".")
    ends = ["/" + "/".join(parts[:count]) + end for count in (len(parts), len(parts) - 1) for end in (".py", "/__init__.py")]
    return any(path.endswith(end) for end in ends for path in source_paths())


@pytest.mark.parametrize("page", [*PAGES, *EXPERIMENTS], ids=page_id)
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    dead = []
    for path, heading in links(page):
        target = page.parent / path if path else page
        if not target.exists() or (heading and heading not in heading_names(target)):
            dead.append(f"{path}#{heading}")
    assert dead == []


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_every_module_that_a_page_names_exists(page: Path) -> None:
    code = [name for _number, line in prose(page) for name in re.findall(r"`([^`]+)`", line)]
    files = [file for text in code for file in re.findall(r"(?<![\w./*-])[\w.-]+(?:/[\w.-]+)+\.(?:py|cpp|h)\b", text)]
    modules = [name for text in code for name in re.findall(r"\bradiant_(?:core|viewer|app)(?:\.\w+)+", text)]
    assert [file for file in files if not any(path.endswith(f"/{file}") for path in source_paths())] == []
    assert [name for name in modules if not is_module(name)] == []


@pytest.mark.parametrize("page", WRAPPED, ids=page_id)
def test_prose_is_at_most_100_columns_wide(page: Path) -> None:
    wide = [
        f"{page_id(page)}:{number}"
        for number, line in prose(page)
        if len(line) > MAX_PROSE_COLUMNS and not line.startswith("|") and "](" not in line
    ]
    assert wide == []


def test_every_picture_is_shown() -> None:
    shown = {(page.parent / path).resolve() for page in [*PAGES, *EXPERIMENTS] for path, _heading in links(page)}
    assert [picture.name for picture in sorted((DOCS / "pictures").iterdir()) if picture.resolve() not in shown] == []


def test_the_types_are_defined_where_the_table_says() -> None:
    rows = [line.split("|")[1:3] for _number, line in prose(DOCS / "types.md") if line.startswith("| `")]
    assert rows
    for names, module in rows:
        (path,) = re.findall(r"`([^`]+)`", module)
        source = (ROOT / path).read_text()
        assert [name for name in re.findall(r"`(\w+)`", names) if not re.search(rf"^class {name}\b", source, re.MULTILINE)] == [], path
