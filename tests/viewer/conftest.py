"""A display for windows and browsers for pages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.browsers import chromium
from tests.viewer.window_kit import display

__all__ = ["browser", "display", "drawing_browser"]


@pytest.fixture
def browser() -> Iterator[Any]:
    """Chromium without WebGL: what the server draws is in sight."""
    quiet = (f"--disable-{part}" for part in ("gpu", "quic", "background-networking", "component-update", "sync", "3d-apis"))
    with chromium("--headless=new", "--no-first-run", *quiet) as opened:
        yield opened


@pytest.fixture
def drawing_browser() -> Iterator[Any]:
    """Chromium with WebGL, which its processor computes."""
    with chromium("--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader") as opened:
        yield opened
