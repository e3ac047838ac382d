"""Paths that a user wrote into a file or an option: one sentence where they can name nothing."""

from __future__ import annotations

from pathlib import Path

from radiant_core.errors import BadInput


def path_of_text(text: str, where: str) -> Path:
    """The path that was written at `where` (plan.file), with ~ replaced.

    Raises:
        BadInput: it has NUL or half a character, which no name of a file has, or names the home of
            nobody.
    """
    if "\0" in text or any("\ud800" <= letter < "\udc80" or "\udcff" < letter <= "\udfff" for letter in text):
        raise BadInput(f"{where} is {text[:200]!r}, which holds a character that no path can have: correct it there.")
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise BadInput(f"{where} is {text[:200]!r}, and there is no such user here: write the folder itself.") from None


def absolute_path(path: Path, base: Path, where: str) -> Path:
    """A path that is relative to `base`, with links followed; BadInput for links that lead to each
    other."""
    try:
        return (base / path).resolve()
    except (RuntimeError, OSError) as error:
        raise BadInput(
            f"{where} is '{str(path)[:200]}', which cannot be followed ({_reason(error)}): give the path of a file or folder."
        ) from error


def _reason(error: RuntimeError | OSError) -> str:
    # Before Python 3.13 pathlib raises a RuntimeError of its own.
    return str(error.strerror or error) if isinstance(error, OSError) else "its links lead to each other"
