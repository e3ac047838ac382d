"""When a window and a page of a run stand there, by clock and CPU: `python -m tests.viewer.open_times RUN [RADIANT …]`, where
RADIANT are commands of installations to compare, in turns, by default this one's.

    window     the first time that the screen is not empty; the last time that it changes, the model drawn in full
    page       the address is printed; Chromium shows the first picture; it shows a frame of the server

The window is watched from outside, in the pages of memory that Xvfb draws into, so that any version can be measured; of
three turns the median. On a machine that does more, the CPU seconds of `radiant` and its processes are what compares.
"""

from __future__ import annotations

import mmap
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.browsers import chromium
from tests.viewer.first_picture import browser_cpu_s
from tests.viewer.web_first_picture import FIRST, FRAME
from tests.viewer.window_kit import patient, virtual_display

SIZE_WH = (1440, 900)
TURNS, POLL_S, REST_S, PATIENCE_S = 3, 0.05, 3.0, 900.0
"""A screen that has not changed for `REST_S` of a machine that does nothing else shows all there is."""


@contextmanager
def begun(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process outside of every checkout, whose packages would be taken for the installed ones; ended at last."""
    with tempfile.TemporaryDirectory() as home:
        env = os.environ | {"XDG_CONFIG_HOME": home} | environment
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=home, env=env)
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


@contextmanager
def watched_display() -> Iterator[tuple[str, mmap.mmap]]:
    """A display, and the memory that it draws into."""
    with (
        tempfile.TemporaryDirectory() as memory,
        virtual_display(f"{SIZE_WH[0]}x{SIZE_WH[1]}x24", "-fbdir", memory) as display,
        (Path(memory) / "Xvfb_screen0").open("rb") as file,
    ):
        yield display, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def open_window(radiant: str, run: Path) -> tuple[float, float, float]:
    """Seconds until the first paint and until the screen is still, and CPU seconds until then."""
    first_s, last_s, cpu_s = 0.0, 0.0, 0.0
    with watched_display() as (display, memory):
        shown, began = memory[:], time.monotonic()
        with begun([radiant, "inspect", str(run)], {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}) as process:
            while (now := time.monotonic() - began) < PATIENCE_S and (not first_s or now - last_s < patient(REST_S)):
                time.sleep(POLL_S)
                if (screen := memory[:]) != shown:
                    last_s, shown, cpu_s = time.monotonic() - began, screen, browser_cpu_s(process.pid)
                    first_s = first_s or last_s
    assert first_s, "no window came"
    return first_s, last_s, cpu_s


def open_page(radiant: str, run: Path) -> tuple[float, float, float, float]:
    """Seconds until the address, until Chromium shows the first picture, until a frame; CPU seconds of the server until then."""
    began = time.monotonic()
    with begun([radiant, "inspect", str(run), "--web", "--port", "0"], {}) as server, chromium() as browser:
        assert server.stdout is not None
        printed = re.search(r"http://\S+", server.stdout.readline())
        assert printed, "the page gave no address"
        address_s = time.monotonic() - began
        page: Any = browser.new_page(viewport={"width": SIZE_WH[0], "height": SIZE_WH[1]})
        page.set_default_timeout(1000 * PATIENCE_S)
        asked, seen = time.monotonic(), []
        page.goto(printed.group(), wait_until="commit")
        for what in (f"{FIRST} || {FRAME}", FRAME):
            page.wait_for_function(what, polling=50)
            seen.append(address_s + time.monotonic() - asked)
        cpu_s = browser_cpu_s(server.pid)
        page.close()
    return address_s, seen[0], seen[1], cpu_s


def main(run: Path, *radiant: str) -> None:
    """Print the medians of every installation."""
    commands = radiant or (shutil.which("radiant") or str(Path(sys.executable).parent / "radiant"),)
    for name, open_it, words in (
        ("window", open_window, "first paint {:.1f} s, all of it {:.1f} s, {:.1f} CPU s"),
        ("page", open_page, "address {:.1f} s, first picture {:.1f} s, frame {:.1f} s, {:.1f} CPU s"),
    ):
        seconds: dict[str, list[tuple[float, ...]]] = {command: [] for command in commands}
        for _ in range(TURNS):
            for command in commands:
                seconds[command].append(open_it(command, run))
        for command in commands:
            medians = [statistics.median(column) for column in zip(*seconds[command], strict=True)]
            print(f"{command}: {name} {words.format(*medians)}, load {os.getloadavg()[0]:.1f}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), *sys.argv[2:])
