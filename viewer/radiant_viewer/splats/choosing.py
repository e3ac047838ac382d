"""Which renderer draws the model of a main view: a measured `Decision`, once when it is opened.

Ours draws one picture. Where there is a graphics card, Open3D's scene draws the same in a process
of its own, with what a view needs of it: colours and depths in the computer's memory. Open3D's is
taken where it is faster and its depths are ours, for layers are hidden by depth.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from radiant_core.decisions import Decision
from radiant_core.splats import Splats
from radiant_viewer.layers.backdrop import Rgbd
from radiant_viewer.pictures.splat_picture import fit_camera

SIZE_WH = (640, 400)
MAX_DEPTH_ERROR = 0.01
"""Of the distance: half a metre at 50 m, from where a camera at a wall would be hidden wrongly."""
PATIENCE_S = 30.0
OURS, OPEN3D = "our renderer", "Open3D's scene"
Measured = tuple[float, float] | str
"""Seconds and depth error of Open3D's picture, or why there is none."""


def has_graphics_card() -> bool:
    """Whether a device that draws is there, as far as the system tells."""
    if sys.platform != "linux":
        return True
    return Path("/dev/nvidia0").exists() or any(Path("/dev/dri").glob("renderD*"))


def choose_renderer(
    splats: Splats, path: Path, card: Callable[[], bool] = has_graphics_card, measure: Callable[[Path, Path], Measured] | None = None
) -> Decision:
    """Draw one picture of a model of at least one Gaussian, which lies in the PLY `path`."""
    # The window shows the words of this module, and does not wait for torch.
    from radiant_core.render.rasterize import resolve_backend
    from radiant_viewer.splats.rgbd import ModelRenderer

    low, high = np.quantile(splats.means.astype(np.float64), [0.05, 0.95], axis=0)
    camera = fit_camera(np.stack([low, high]), SIZE_WH)
    picture: Rgbd = np.zeros((SIZE_WH[1], SIZE_WH[0], 4), np.float32)
    ours = ModelRenderer(splats)
    began = time.monotonic()
    ours.draw(camera, (0, 0, 0), picture)
    seconds, backend = time.monotonic() - began, resolve_backend("auto")
    if not card():
        return _decision(False, backend, seconds, "there is no graphics card, on which Open3D's scene could be the faster one")
    with TemporaryDirectory(prefix="radiant-") as folder:
        arrays_path = Path(folder) / "ours.npz"
        np.savez(arrays_path, picture=picture, K=camera.Ks[0], cam_from_world=camera.cam_from_world[0])
        measured = (measure or _open3d_measured)(path, arrays_path)
    if isinstance(measured, str):
        return _decision(False, backend, seconds, f"Open3D's scene drew nothing: {measured}")
    other_s, error = measured
    if other_s >= seconds:
        return _decision(False, backend, seconds, f"Open3D's scene takes {other_s:.3f} s")
    if error > MAX_DEPTH_ERROR:
        fault = f"depths off by up to {100 * error:.1f} % of the distance" if error < 1 else "other pixels"
        return _decision(False, backend, seconds, f"Open3D's scene takes {other_s:.3f} s but has {fault}, and layers are hidden by depth")
    return _decision(True, backend, other_s, f"our renderer ({backend}) takes {seconds:.3f} s, and depths agree within {100 * error:.1f} %")


def _decision(open3d: bool, backend: str, seconds: float, reason: str) -> Decision:
    choice = OPEN3D if open3d else f"{OURS} ({backend})"
    return Decision(stage="view", topic="renderer", choice=choice, figure=round(seconds, 4), unit="s a picture of 640 × 400", reason=reason)


def _open3d_measured(path: Path, arrays_path: Path) -> Measured:
    command = [sys.executable, "-m", "radiant_viewer.splats.open3d_rgbd", str(path), str(arrays_path)]
    try:
        ended = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired:
        return f"no picture within {PATIENCE_S:.0f} s"
    try:
        answer = json.loads(ended.stdout)
        return float(answer["seconds"]), float(answer["depth_error"])
    except (ValueError, KeyError, TypeError):
        return f"its process ended with exit code {ended.returncode}"
