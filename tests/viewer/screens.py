"""What a user sees at first, in both themes, on a phone, 1440 × 900 and 1920 × 1080: the page of a run, the page and the
window on which a run is begun, and the window of a run: `python -m tests.viewer.screens RUN PHOTOS OUT [page|start|window] …`.

Writes OUT/<what>_<width>_<theme>.png, which are to be looked at. Minutes; needs chromium and Xvfb.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.browsers import chromium
from tests.viewer.window_kit import ROOT, patient, virtual_display

PHONE_WH = (390, 844)
DESKS_WH = ((1440, 900), (1920, 1080))
THEMES = ("light", "dark")
DRAWING = ("--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader")
PATIENCE_MS = 600_000
REST_MS = 12_000
"""So long after the last action the browser has drawn the model in full, in software too."""


@contextmanager
def address_of(*arguments: object, folder: Path | None = None) -> Iterator[str]:
    """The address that `radiant inspect ARGUMENTS --web`, begun in a folder, prints while it serves."""
    command = [sys.executable, "-m", "radiant_app", "inspect", *map(str, arguments), "--web", "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)
    assert server.stdout is not None
    try:
        printed = re.search(r"http://\S+", server.stdout.readline())
        assert printed, "the page gave no address"
        yield printed.group()
    finally:
        server.send_signal(signal.SIGINT)
        server.wait()


def picture_page(run: Path, photos: Path, out: Path) -> None:
    """The page of a run as it opens; with a camera's photograph and the seams; on a phone its sheets."""
    del photos
    with address_of(run) as address, chromium(*DRAWING) as browser:
        for size_wh in (PHONE_WH, *DESKS_WH):
            # One page after another has the theme: all that are open share it.
            page = _opened(browser, size_wh, "light", address)
            page.locator("iframe[data-loaded]").wait_for()
            page.locator("[data-layer='Regions']").first.wait_for(state="attached")
            for theme in THEMES:
                if not page.locator(f".v-theme--{theme}").count():
                    page.locator("[data-action='theme']").click()
                    page.locator(f".v-theme--{theme}").first.wait_for(state="attached")
                _walk_page(page, size_wh, lambda name, theme=theme, page=page: _save(page, out, name, theme), is_first=theme == "light")
            page.context.close()


def _walk_page(page: Any, size_wh: tuple[int, int], save: Callable[[str], None], *, is_first: bool) -> None:
    page.locator("[data-tab='cameras']").click()
    page.wait_for_timeout(REST_MS)
    if is_first or size_wh == PHONE_WH:
        save("page")
    if size_wh == PHONE_WH:
        page.locator("[data-action='layers']").tap()
        page.wait_for_timeout(1000)
        save("page_layers")
        page.mouse.click(195, 60)
        page.wait_for_timeout(1000)
    page.locator("tr[data-camera]").first.click()
    page.locator(".rad-photo img").first.wait_for()
    page.wait_for_timeout(1000)
    save("page_chosen")
    if size_wh == PHONE_WH:
        page.locator("[data-action='close']").tap()
    for tab in ("seams", "plan"):
        page.locator(f"[data-tab='{tab}']").click()
        if tab == "seams":
            following = page.get_by_role("button", name="Next", exact=True)
            # Of one region there is no seam.
            if following.is_enabled():
                following.click()
        page.wait_for_timeout(REST_MS if tab == "seams" else 1000)
        save(f"page_{tab}")
    page.locator("[data-action='fit']").click()


def picture_start(run: Path, photos: Path, out: Path) -> None:
    """The page on which a run is begun: empty, of photographs with machines listed, of a run that ended."""
    for theme in THEMES:
        for size_wh in (PHONE_WH, *DESKS_WH):
            with address_of() as address, chromium() as browser:
                page = _opened(browser, size_wh, theme, address)
                page.locator("#qualities input").first.wait_for()
                _save(page, out, "start", theme)
                for path in (photos, run):
                    page.locator("#path").fill(str(path))
                    page.locator("#look").click()
                    page.locator("#start:enabled").wait_for()
                    if path == photos:
                        page.locator("#machines").select_option("form")
                        page.locator("#line", has_text="--system").wait_for()
                    else:
                        page.locator("#model:visible").wait_for()
                    page.wait_for_timeout(1000)
                    _save(page, out, "start_photographs" if path == photos else "start_run", theme, full_page=True)


def picture_window(run: Path, photos: Path, out: Path) -> None:
    """The windows on which a run is begun, and of a run, in processes of their own."""
    for width, height in DESKS_WH:
        with virtual_display(f"{width}x{height}x24") as display, tempfile.TemporaryDirectory() as home:
            command = [sys.executable, "-m", "tests.viewer.window_screens", str(run), str(photos), str(out)]
            hidden = {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "XDG_CONFIG_HOME": home}
            subprocess.run(
                ["env", *(f"{name}={value}" for name, value in hidden.items()), *command], cwd=ROOT, check=True, timeout=patient(900)
            )


def _opened(browser: Any, size_wh: tuple[int, int], theme: str, address: str) -> Any:
    is_phone = size_wh == PHONE_WH
    viewport = {"width": size_wh[0], "height": size_wh[1]}
    context = browser.new_context(viewport=viewport, has_touch=is_phone, is_mobile=is_phone, color_scheme=theme)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    return page


def _save(page: Any, out: Path, name: str, theme: str, *, full_page: bool = False) -> None:
    path = out / f"{name}_{page.viewport_size['width']}_{theme}.png"
    page.screenshot(path=str(path), full_page=full_page)
    print(path, flush=True)


PICTURES: dict[str, Callable[[Path, Path, Path], None]] = {"page": picture_page, "start": picture_start, "window": picture_window}


def main(run: str, photos: str, out: str, *names: str) -> None:
    """All of them, or those named."""
    Path(out).mkdir(parents=True, exist_ok=True)
    for name in names or PICTURES:
        PICTURES[name](Path(run).resolve(), Path(photos).resolve(), Path(out).resolve())


if __name__ == "__main__":
    main(*sys.argv[1:])
