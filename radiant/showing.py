"""What long work says, shown while it runs."""

from __future__ import annotations

from contextlib import AbstractContextManager

from rich.console import Console

from radiant_app.report.progress import ProgressDisplay


def progress(*, decisions: bool = False) -> AbstractContextManager[ProgressDisplay]:
    """A bar per stage with the time left, on a terminal and in a notebook.

        with radiant.progress() as listen:
            result = radiant.train(scene, listen=listen)

    Args:
        decisions: whether what was decided and skipped is printed too, with its reason.

    Returns:
        A context manager; what it gives is a `listen`.
    """
    return ProgressDisplay(Console(stderr=True), with_decisions=decisions)
