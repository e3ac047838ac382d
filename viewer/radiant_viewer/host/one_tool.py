"""One tool at a time takes the clicks in the views. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtGui import QAction
from PySide6.QtWidgets import QAbstractButton


def keep_one_on(switches: Sequence[QAction | QAbstractButton]) -> None:
    """Let each of the checkable switches turn the others off when it is turned on."""
    for switch in switches:
        others = [button for button in switches if button is not switch]
        switch.toggled.connect(lambda is_on, others=others: [button.setChecked(False) for button in others] if is_on else None)
