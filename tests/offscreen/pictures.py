"""The views of a small made-up run with a planted seam, reduced to a quarter, and the baselines
they are compared with.

python -m tests.offscreen.pictures      # renews the baselines: look at each before it is committed
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import get_args

import cv2
import numpy as np

from radiant_core.choices import View
from radiant_viewer.pictures.images import Image, load_image, save_png
from radiant_viewer.runs.run_pictures import screenshot
from tests.viewer.made_up_run import made_up_town, save_run

FOLDER = Path(__file__).parent / "baselines"
SIZE_WH, REDUCED_BY = (640, 420), 4
VIEWS = get_args(View)


def picture(run: Path, view: str) -> Image:
    """One view as its baseline keeps it."""
    image = screenshot(run, view, SIZE_WH)
    size_wh = (image.shape[1] // REDUCED_BY, image.shape[0] // REDUCED_BY)
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), np.uint8)


def baseline(view: str) -> Image:
    """The picture that was last found good."""
    return load_image(FOLDER / f"{view}.png")


def main() -> None:
    """Write all baselines."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        save_run(Path(folder) / "run", made_up_town(step_levels=40))
        for view in VIEWS:
            save_png(FOLDER / f"{view}.png", picture(Path(folder) / "run", view))


if __name__ == "__main__":
    main()
