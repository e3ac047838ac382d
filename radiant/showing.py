"""What long work says while it runs, and what a run looks like."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from radiant_app.report.progress import ProgressDisplay
from radiant_core.choices import View
from radiant_viewer.runs.run_pictures import SIZE_WH, screenshot


def progress(*, decisions: bool = False) -> AbstractContextManager[ProgressDisplay]:
    """A bar per stage with the time left, on a terminal and in a notebook.

    Use it around whatever takes longer than a few seconds.

    Args:
        decisions: whether what was decided and skipped is printed too, with its reason.

    Returns:
        A context manager; what it gives is a `listen`.

    Example:
        >>> scene = radiant.load_scene("SCENE")
        >>> with radiant.progress() as listen:
        ...     result = radiant.train(scene, num_steps=10, long_side_px=64, listen=listen)
    """
    return ProgressDisplay(Console(stderr=True), with_decisions=decisions)


def picture(
    folder: str | Path, view: View | None = None, size_wh: tuple[int, int] = SIZE_WH, photograph: str | None = None
) -> NDArray[np.uint8]:
    """Draw a view of a run, a training or a scene, as `radiant inspect --screenshot`.

    Use it in notebooks and reports; `radiant inspect` opens a window.

    Args:
        folder: of `radiant run`, `train` or `sfm`.
        view: regions (the plan), cameras, seams, splats (the model in 3D) or compare (photographs
            beside renders); None: the usual one.
        size_wh: width and height in px, at least 640 × 420; by default 1,280 × 900.
        photograph: whose viewpoint "splats" takes, or the only row of "compare".

    Returns:
        A picture (H,W,3).

    Raises:
        BadInput: an unknown view or photograph, or the folder holds nothing to draw.

    Example:
        >>> pixels = radiant.picture("SCENE", "cameras", size_wh=(640, 480))
        >>> pixels.shape
        (480, 640, 3)
    """
    return screenshot(Path(folder), view, size_wh, photograph)
