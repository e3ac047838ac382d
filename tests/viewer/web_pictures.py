"""The pictures of the page for a browser, taken of a run that `radiant demo` or sample_scenes made:
`python -m tests.viewer.web_pictures RUN docs/pictures` writes web_start.png, web_light.png and web_dark.png there.

Chromium draws the model; start: a run of the town before it begins; light: the worst photograph; dark: its difference, and
the seam tour at its worst place.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from tests.browsers import chromium
from tests.viewer.screens import DRAWING, PATIENCE_MS, address_of
from tests.viewer.window_kit import ROOT

SIZE_WH = (1280, 800)
REST_MS = 15_000
"""So long after the last action the model is drawn in full, in software too."""


def _take_start(out: Path) -> None:
    with tempfile.TemporaryDirectory() as name, address_of(folder=Path(name)) as address, chromium() as browser:
        (Path(name) / "town").symlink_to(ROOT / "sample_scenes/town/images")
        page = browser.new_page(viewport={"width": SIZE_WH[0], "height": SIZE_WH[1]})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address)
        page.locator("#path").fill("town")
        page.locator("#look").click()
        page.locator("#start:enabled").wait_for()
        page.locator("#machines").select_option("form")
        page.locator("#line", has_text="--system").wait_for()
        _take(page, out)


def _take(page: Any, out: Path) -> None:
    page.mouse.move(SIZE_WH[0] / 2, SIZE_WH[1] - 20)
    page.wait_for_timeout(REST_MS)
    page.screenshot(path=str(out))
    # 256 colours take a third of the bytes; refined, or small patches of the legend change theirs.
    Image.open(out).convert("RGB").quantize(256, kmeans=8).save(out, optimize=True)
    print(out, flush=True)


def main(run: Path, out: Path) -> None:
    """Serve the run as `radiant inspect RUN --web` does, and take all."""
    _take_start(out / "web_start.png")
    with address_of(run) as address, chromium(*DRAWING) as browser:
        page = browser.new_page(viewport={"width": SIZE_WH[0], "height": SIZE_WH[1]})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address)
        page.locator("iframe[data-loaded]").wait_for()
        page.locator("[data-layer='Seams']").wait_for()
        page.locator("tr[data-camera]").first.click()
        page.locator(".rad-photo img").first.wait_for()
        _take(page, out / "web_light.png")
        page.locator("[data-kind='difference']").click()
        page.locator("[data-tab='seams']").click()
        page.get_by_text("Next", exact=True).click()
        page.locator("tr[data-seam].chosen").wait_for()
        page.locator("[data-action='theme']").click()
        page.locator(".v-theme--dark").first.wait_for(state="attached")
        _take(page, out / "web_dark.png")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
