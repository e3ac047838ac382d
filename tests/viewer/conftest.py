"""A display for windows and browsers for pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from tests.viewer.window_kit import display

__all__ = ["browser", "display", "drawing_browser"]

SERVER_DRAWS = [
    "--headless=new",
    "--no-sandbox",
    *(f"--disable-{part}" for part in ("gpu", "quic", "background-networking", "component-update", "sync")),
    "--no-first-run",
    # No WebGL: what the server draws is in sight.
    "--disable-3d-apis",
]
BROWSER_DRAWS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]


@contextmanager
def chromium(arguments: Sequence[str]) -> Iterator[Any]:
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: it comes with the extra 'test'")
    with playwright.sync_playwright() as tool:
        opened = tool.chromium.launch(executable_path=path, args=list(arguments))
        yield opened
        opened.close()


@pytest.fixture
def browser() -> Iterator[Any]:
    """Chromium without WebGL."""
    with chromium(SERVER_DRAWS) as opened:
        yield opened


@pytest.fixture
def drawing_browser() -> Iterator[Any]:
    """Chromium with WebGL, which its processor computes."""
    with chromium(BROWSER_DRAWS) as opened:
        yield opened
