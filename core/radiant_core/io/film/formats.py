"""Which files are films, and where their subtitles lie. Imports nothing heavy."""

from __future__ import annotations

from pathlib import Path

FILM_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts")


def films_in(source: Path) -> tuple[Path, ...]:
    """A film, or the films directly in a folder, by name."""
    if source.is_file():
        return (source,) if source.suffix.lower() in FILM_SUFFIXES else ()
    return tuple(sorted(path for path in source.iterdir() if path.suffix.lower() in FILM_SUFFIXES and path.is_file()))


def srt_beside(film: Path) -> Path | None:
    """The subtitles of a film: the file of its name that ends in .srt, in any letter case."""
    subtitles = sorted(path for path in film.parent.iterdir() if path.stem == film.stem and path.suffix.lower() == ".srt")
    return subtitles[0] if subtitles else None
