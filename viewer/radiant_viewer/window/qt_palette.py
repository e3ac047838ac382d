"""A theme's colours for Qt's widgets. Needs the `desktop` extra."""

from __future__ import annotations

from PySide6.QtGui import QColor, QPalette

from radiant_viewer.layers.themes import Theme


def qt_palette(theme: Theme) -> QPalette:
    """The colours of widgets under a theme."""
    roles = {
        QPalette.ColorRole.Window: theme.panel,
        QPalette.ColorRole.Base: theme.field,
        QPalette.ColorRole.AlternateBase: theme.panel,
        QPalette.ColorRole.Button: theme.panel,
        QPalette.ColorRole.ToolTipBase: theme.field,
        QPalette.ColorRole.WindowText: theme.text,
        QPalette.ColorRole.Text: theme.text,
        QPalette.ColorRole.ButtonText: theme.text,
        QPalette.ColorRole.ToolTipText: theme.text,
        QPalette.ColorRole.PlaceholderText: theme.soft_text,
        QPalette.ColorRole.Highlight: theme.accent,
        QPalette.ColorRole.HighlightedText: theme.field,
    }
    palette = QPalette()
    for role, color in roles.items():
        palette.setColor(role, QColor(*color))
    for role in (QPalette.ColorRole.WindowText, QPalette.ColorRole.Text, QPalette.ColorRole.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, role, QColor(*theme.soft_text))
    return palette
