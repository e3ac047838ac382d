"""When a browser shows a first picture of a run, and the first frame: `python -m tests.viewer.web_first_picture RUN`.

At 390 × 844 and 1440 × 900, without WebGL; the load of the machine stands beside them.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

PATIENCE_MS = 600_000
SIZES_WH = ((390, 844), (1440, 900))
FIRST = "(() => { const one = document.querySelector('#rad-first img'); return one && !one.hidden; })()"
FRAME = """(() => { const pane = document.querySelector("[data-view='3D']");
  return pane && [...pane.querySelectorAll('img')].some((one) => one.src.startsWith('blob:') && one.naturalWidth > 1); })()"""


def main() -> int:
    """Serve the run as `radiant inspect RUN --web` does, and open it at both sizes."""
    from playwright import sync_api

    command = [sys.executable, "-m", "radiant_app", "inspect", sys.argv[1], "--web", "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    found = re.search(r"http://\S+", server.stdout.readline())
    assert found, "the page gave no address"
    with sync_api.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for width, height in SIZES_WH:
            page: Any = browser.new_page(viewport={"width": width, "height": height})
            page.set_default_timeout(PATIENCE_MS)
            begun_s, seconds = time.monotonic(), []
            page.goto(found.group(), wait_until="commit")
            for seen in (f"{FIRST} || {FRAME}", FRAME):
                page.wait_for_function(seen, polling=50)
                seconds.append(time.monotonic() - begun_s)
            load = Path("/proc/loadavg").read_text().split()[0]
            print(f"{width} × {height}: first picture after {seconds[0]:.1f} s, first frame after {seconds[1]:.1f} s, load {load}")
            page.close()
        browser.close()
    server.send_signal(signal.SIGINT)
    server.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
