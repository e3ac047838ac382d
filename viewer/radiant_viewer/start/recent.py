"""The runs that were open last, for the start window. Needs the `desktop` extra."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSettings

KEY, MOST = "start/recent", 12


def recent_runs() -> list[Path]:
    """Paths of what was open, the last first."""
    held = _settings().value(KEY)
    # A list of one comes back as its text.
    names = [held] if isinstance(held, str) else held if isinstance(held, list) else []
    return [Path(str(name)) for name in names]


def remember_run(path: Path) -> None:
    """Put a run, plan or model first in the list."""
    path = path.resolve()
    others = [each for each in recent_runs() if each != path]
    _settings().setValue(KEY, [str(each) for each in (path, *others)][:MOST])


def _settings() -> QSettings:
    return QSettings(QSettings.Format.IniFormat, QSettings.Scope.UserScope, "radiant", "inspector")
