"""A bar for loops over benchmarks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import track

_Item = TypeVar("_Item")


def track_items(items: Sequence[_Item], description: str) -> Iterator[_Item]:
    """The items, with a bar on a terminal, for a loop whose items take about equally long."""
    console = Console(stderr=True)
    return iter(track(items, description=description, console=console, disable=not console.is_terminal))
