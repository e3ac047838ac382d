"""The runs that were open last, for the start window. Needs the `desktop` extra."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSettings

KEY, MOST = "start/recent", 12


def recent_runs() -> list[Path]:
    """Paths of what was open, the last first."""
    stored = _settings().value(KEY)
    # A list of one comes back as its text.
    names = [stored] if isinstance(stored, str) else stored if isinstance(stored, list) else []
    return [Path(str(name)) for name in names]


def remember_run(path: Path) -> None:
    """Put a run, plan or model first in the list."""
    path = path.resolve()
    others = [run for run in recent_runs() if run != path]
    _settings().setValue(KEY, [str(run) for run in (path, *others)][:MOST])


def _settings() -> QSettings:
    return QSettings(QSettings.Format.IniFormat, QSettings.Scope.UserScope, "radiant", "inspector")
