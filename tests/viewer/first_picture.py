"""When the page of a scene shows its first picture in Chromium, by the clock and in processor time
of all of the browser's processes: `python -m tests.viewer.first_picture PAGE [WIDTH HEIGHT]`.

PAGE is a folder of `radiant export RUN PAGE --format viewer`. Stages: the script runs, the engine
has started, the coarsest level is on the screen, the viewer says that it is loaded.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

from radiant_viewer.share.serving import served

ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
STAGES = ("engine", "picture", "loaded")
# Read by the page itself, so that asking does not take the processor from it.
WATCH = """
window.stages = {};
const noted = (name) => { window.stages[name] ??= performance.now() / 1000; };
const timer = setInterval(() => {
  const viewer = window.radiantViewer;
  if (!viewer) return;
  noted('engine');
  if (!viewer.watched) {
    viewer.watched = true;
    viewer.app.on('frameend', () => { if (viewer.app.stats.frame.gsplats > 0) noted('picture'); });
  }
  if (viewer.state.loaded) { noted('loaded'); clearInterval(timer); }
}, 20);
"""


def browser_cpu_s(root: int) -> float:
    """User and system time of a process and of all below it that are alive."""
    children: dict[int, list[int]] = {}
    spent: dict[int, float] = {}
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split() if entry.name.isdigit() else []
        except OSError:
            continue
        if fields:
            children.setdefault(int(fields[1]), []).append(int(entry.name))
            spent[int(entry.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    found, total = [root], 0.0
    while found:
        process = found.pop()
        total += spent.get(process, 0.0)
        found += children.get(process, [])
    return total


def first_picture(folder: Path, size_wh: tuple[int, int]) -> dict[str, tuple[float, float]]:
    """Seconds since the page was asked for, and processor seconds, of each stage."""
    from playwright import sync_api

    with sync_api.sync_playwright() as tool, served(folder) as address:
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page: Any = browser.new_page(viewport={"width": size_wh[0], "height": size_wh[1]})
        page.add_init_script(WATCH)
        # The driver is our child, and the browser the driver's.
        before, found = browser_cpu_s(os.getpid()) - time.process_time(), {}
        page.goto(f"{address}?webgl", wait_until="commit")
        while len(found) < len(STAGES):
            stages = page.evaluate("window.stages ?? {}")
            cpu_s = browser_cpu_s(os.getpid()) - time.process_time() - before
            found |= {name: (at, cpu_s) for name, at in stages.items() if name not in found}
            time.sleep(0.1)
        browser.close()
    return found


def main() -> int:
    """Print the stages of three openings."""
    folder, size = Path(sys.argv[1]), (int(sys.argv[2]), int(sys.argv[3])) if len(sys.argv) > 3 else (1280, 800)
    for _ in range(3):
        stages = first_picture(folder, size)
        print(
            f"load {os.getloadavg()[0]:.1f}: "
            + ", ".join(f"{name} {stages[name][0]:.1f} s ({stages[name][1]:.1f} s CPU)" for name in STAGES)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
