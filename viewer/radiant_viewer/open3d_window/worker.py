"""The process that draws with Open3D: `python -m radiant_viewer.open3d_window.worker JOB.json`.

JOB.json: {"source", "picture", "size_wh", "camera"}; picture null for a window, camera null or a
photograph's name. Open3D can end its process by a signal, and holds one renderer per process: here
it takes nothing with it. Exit code 2 with one sentence on standard error for what a user can mend.
"""

from __future__ import annotations

import sys
from pathlib import Path

from radiant_core.errors import RadiantError
from radiant_core.io.run_store import read_json
from radiant_viewer.open3d_window.content import load_content
from radiant_viewer.open3d_window.gui_window import show_window
from radiant_viewer.open3d_window.picture import draw_picture
from radiant_viewer.pictures.images import save_png


def main() -> int:
    """Do the job of the file and return the exit code."""
    try:
        job = read_json(Path(sys.argv[1]), ("source", "picture", "size_wh", "camera"))
        content = load_content(Path(job["source"]))
        width, height = (int(side) for side in job["size_wh"])
        if job["picture"] is not None:
            save_png(Path(job["picture"]), draw_picture(content, (width, height), job["camera"]))
            return 0
        return show_window(content, (width, height), job["camera"])
    except RadiantError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
