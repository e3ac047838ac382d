"""The picture of the page for a browser under the dark theme, taken of a run that `radiant demo` or
sample_scenes made: `python -m tests.viewer.web_pictures RUN docs/pictures/web_dark.png`.

Chromium draws the model; the seam tour is at its worst place.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from PIL import Image

SIZE_WH = (1280, 800)
ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
PATIENCE_MS = 600_000
REST_MS = 15_000
"""So long after the last action the model is drawn in full, in software too."""


def dark_seam_tour(address: str, out: Path) -> None:
    """Open the page, go to the worst seam under the dark theme, and keep what is seen."""
    from playwright import sync_api

    with sync_api.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page: Any = browser.new_page(viewport={"width": SIZE_WH[0], "height": SIZE_WH[1]})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address)
        page.locator("iframe[data-loaded]").wait_for()
        page.locator("tr[data-camera]").first.click()
        page.locator("[data-kind='difference']").click()
        page.locator("[data-tab='seams']").click()
        page.get_by_text("Next", exact=True).click()
        page.locator("tr[data-seam].chosen").wait_for()
        page.locator("[data-action='theme']").click()
        page.wait_for_function("document.querySelector('.v-theme--dark') !== null")
        page.mouse.move(SIZE_WH[0] / 2, SIZE_WH[1] - 20)
        page.wait_for_timeout(REST_MS)
        page.screenshot(path=str(out))
        # 256 colours take a third of the bytes; refined, or small patches of the legend change theirs.
        Image.open(out).convert("RGB").quantize(256, kmeans=8).save(out, optimize=True)
        browser.close()


def main() -> int:
    """Serve the run as `radiant inspect RUN --web` does, and take the picture."""
    command = [sys.executable, "-m", "radiant_app", "inspect", sys.argv[1], "--web", "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    found = re.search(r"http://\S+", server.stdout.readline())
    assert found, "the page gave no address"
    dark_seam_tour(found.group(), Path(sys.argv[2]))
    server.send_signal(signal.SIGINT)
    server.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
