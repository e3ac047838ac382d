"""What listeners heard of a run."""

from __future__ import annotations

from collections.abc import Iterable

from radiant_app.events import Event, StageDone
from radiant_app.report.html import REPORT


def stages_done(events: Iterable[Event]) -> list[str]:
    """The stages that a run took, in the order of their ends; its report is written by every run."""
    return [event.stage for event in events if isinstance(event, StageDone) and event.stage != REPORT]
