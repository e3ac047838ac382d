"""The pages of a run that are sent to others, and whether they are older than its cleaning."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from radiant_core.geometry.cleaning_file import cleaning_path

SENT_PAGES = ("report.html", "scene.html")


def older_pages(run: Path) -> tuple[str, ...]:
    """Names of the pages of a run's folder that were written before the last change of its
    cleaning; empty for a model alone."""
    cleaning, older = cleaning_path(run), []
    if not (run.is_dir() and cleaning.is_file()):
        return ()
    for name in SENT_PAGES:
        with suppress(FileNotFoundError):
            if (run / name).stat().st_mtime_ns < cleaning.stat().st_mtime_ns:
                older.append(name)
    return tuple(older)


def older_sentence(run: Path) -> str:
    """Which pages show the model as it was cleaned before; empty where none does."""
    names = older_pages(run)
    return f"{' and '.join(names)} show{'s' * (len(names) == 1)} an earlier cleaning" if names else ""
