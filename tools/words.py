"""Count the words of every page that is written by hand: `make words`.

Generated pages (docs/cli.md, docs/types.md) count apart. A word is what blanks separate, as for `wc`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT = 45_000
GENERATED = ("docs/cli.md", "docs/types.md")
AT_ROOT = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")


def written_pages() -> Iterator[Path]:
    """The pages of docs/ and those at the root, without the generated ones."""
    pages = [*sorted((ROOT / "docs").rglob("*.md")), *(ROOT / name for name in AT_ROOT)]
    return (page for page in pages if page.relative_to(ROOT).as_posix() not in GENERATED)


def num_words(page: Path) -> int:
    """The number of words of a page, tables and code included."""
    return len(page.read_text().split())


def main() -> None:
    """Print every page with its words, the longest first, and the sum."""
    counts = {page.relative_to(ROOT).as_posix(): num_words(page) for page in written_pages()}
    for name, count in sorted(counts.items(), key=lambda item: -item[1]):
        print(f"{count:7,}  {name}")
    print(f"{sum(counts.values()):7,}  in all, of {LIMIT:,}")


if __name__ == "__main__":
    main()
