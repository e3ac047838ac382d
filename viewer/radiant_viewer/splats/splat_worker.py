"""A renderer process: `python -m radiant_viewer.splats.splat_worker {own|open3d} MODEL.ply`.

One JSON line per request on standard input: {"id", "K", "cam_from_world", "size_wh", "background",
"box"}; box is null or the lower and upper corner (2,3) of what is drawn. Per answer one JSON line
{"id", "size_wh", "seconds"} and the picture, H·W·3 bytes of RGB; the first line is {"ready",
"num_gaussians"}. Ends with its standard input. Open3D aborts at the exit of a process that had
several of its renderers, so this one exits without cleanup.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import RadiantError
from radiant_core.io.ply import load_ply
from radiant_core.splats import Splats
from radiant_viewer.pictures.images import Image

if TYPE_CHECKING:
    import open3d as o3d

NEAR_SHARE = 1e-3
"""Near plane as a share of the distance to the farthest Gaussian: the one that Open3D chooses cuts
what lies close to the camera."""


class Renderer(Protocol):
    """Draws a model for a camera over a background (3,), 0 to 255."""

    def draw(self, camera: Cameras, background: tuple[int, int, int]) -> Image:
        """Return the picture (H,W,3)."""
        ...


class OwnRenderer:
    """Our own rasterizer: exact; its time grows with pixels and Gaussians."""

    def __init__(self, splats: Splats) -> None:
        self._splats = splats

    def draw(self, camera: Cameras, background: tuple[int, int, int]) -> Image:
        from radiant_core.render.rendered_view import render_views

        view = next(render_views(self._splats, camera))
        over = view.image + (1 - view.alpha[..., None]) * (np.array(background, np.float32) / 255)
        return np.rint(255 * np.clip(over, 0, 1)).astype(np.uint8)


class Open3DRenderer:
    """Open3D's rasterizer on its graphics driver; harmonics to degree 2, positions in 16 bits."""

    def __init__(self, splats: Splats) -> None:
        self._cloud = _open3d_cloud(splats)
        self._means = splats.means
        self._renderer: Any = None
        self._size_wh = (0, 0)

    def draw(self, camera: Cameras, background: tuple[int, int, int]) -> Image:
        """See `Renderer`; a new size makes a new renderer, which takes a second or two."""
        import open3d as o3d

        width, height = (int(side) for side in camera.sizes_wh[0])
        if self._size_wh != (width, height):
            self._renderer = None
            self._renderer = o3d.visualization.rendering.OffscreenRenderer(width, height)
            self._size_wh = (width, height)
            material = o3d.visualization.rendering.MaterialRecord()
            material.shader = "gaussianSplat"
            self._renderer.scene.scene.enable_sun_light(False)
            self._renderer.scene.view.set_post_processing(False)
            self._renderer.scene.add_geometry("splats", self._cloud, material)
        K, pose = camera.Ks[0], camera.cam_from_world[0]
        far = 1.1 * max(float((self._means @ pose[2, :3]).max() + pose[2, 3]), 1e-3)
        self._renderer.scene.set_background([*(level / 255 for level in background), 1.0])
        self._renderer.setup_camera(K, pose, width, height)
        self._renderer.scene.camera.set_projection(K, NEAR_SHARE * far, far, width, height)
        return np.ascontiguousarray(np.asarray(self._renderer.render_to_image())[:, :, :3])


def _open3d_cloud(splats: Splats) -> o3d.t.geometry.PointCloud:
    import open3d as o3d

    degree = min(splats.sh_degree, 2)
    bases = (degree + 1) ** 2 - 1
    cloud = o3d.t.geometry.PointCloud()

    def tensor(values: NDArray[np.float32]) -> o3d.core.Tensor:
        return o3d.core.Tensor.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).clone()

    cloud.point.positions = tensor(splats.means)
    cloud.point["scale"] = tensor(np.exp(splats.log_scales))
    cloud.point["rot"] = tensor(splats.quats / np.maximum(np.linalg.norm(splats.quats, axis=1, keepdims=True), 1e-12))
    cloud.point["opacity"] = tensor(splats.logit_opacities[:, None])
    cloud.point["f_dc"] = tensor(splats.sh0[:, 0])
    if bases:
        cloud.point["f_rest"] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(splats.shN[:, :bases])).clone()
    return cloud


class CroppedModel:
    """A model cropped to a box; crops anew only when the box changes."""

    def __init__(self, splats: Splats, kind: str) -> None:
        self._splats, self._kind = splats, kind
        self._box: list[list[float]] | None = None
        self._renderer = self._make_renderer(splats)

    def renderer(self, box: list[list[float]] | None) -> Renderer | None:
        """Return the renderer of the Gaussians in the box; None where there are none."""
        if box != self._box:
            self._box = box
            inside = np.arange(len(self._splats)) if box is None else np.flatnonzero(inside_box(self._splats.means, box))
            self._renderer = self._make_renderer(self._splats.select(inside)) if len(inside) else None
        return self._renderer

    def _make_renderer(self, splats: Splats) -> Renderer:
        return OwnRenderer(splats) if self._kind == "own" else Open3DRenderer(splats)


def inside_box(means: NDArray[np.float32], box: list[list[float]]) -> NDArray[np.bool_]:
    """Return whether each position (N,3) lies in the box of lower and upper corner (2,3)."""
    low, high = np.asarray(box, np.float64)
    return ((means >= low) & (means <= high)).all(axis=1)


def serve(kind: str, path: Path, requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until the stream ends."""
    boxed = CroppedModel(splats := load_ply(path), kind)
    _answer(answers, {"ready": kind, "num_gaussians": len(splats)})
    for line in requests:
        request = json.loads(line)
        width, height = (int(side) for side in request["size_wh"])
        camera = Cameras(
            names=("view",),
            Ks=np.array([request["K"]], np.float64),
            cam_from_world=np.array([request["cam_from_world"]], np.float64),
            sizes_wh=np.array([[width, height]]),
        )
        red, green, blue = (int(level) for level in request["background"])
        background = (red, green, blue)
        began = time.monotonic()
        renderer = boxed.renderer(request["box"])
        image = np.tile(np.array(background, np.uint8), (height, width, 1)) if renderer is None else renderer.draw(camera, background)
        _answer(answers, {"id": request["id"], "size_wh": [width, height], "seconds": time.monotonic() - began}, image)


def _answer(answers: IO[bytes], header: dict[str, Any], image: Image | None = None) -> None:
    answers.write(json.dumps(header).encode() + b"\n")
    if image is not None:
        answers.write(np.ascontiguousarray(image).tobytes())
    answers.flush()


def main() -> int:
    """Run the process and return its exit code."""
    # Graphics drivers write to standard output: it becomes standard error; answers keep the pipe.
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        serve(sys.argv[1], Path(sys.argv[2]), sys.stdin.buffer, pipe)
    except BrokenPipeError:
        return 0
    except RadiantError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)
