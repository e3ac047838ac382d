"""Imported in a process of an example: reports of its runs have blank pictures there, which no fork of a server draws."""

from __future__ import annotations

import pytest

from radiant_app.report import drawing
from tests.app.blank_reports import leave_pictures_blank

_patch = pytest.MonkeyPatch()
leave_pictures_blank(_patch)
_patch.setattr(drawing, "started_server", lambda *asked: None)
