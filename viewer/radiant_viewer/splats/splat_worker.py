"""A renderer process: `python -m radiant_viewer.splats.splat_worker MODEL.ply FRAMES PAINTER`.

One JSON line per request on standard input: {"id", "K", "cam_from_world", "size_wh", "background",
"box", "max_gaussians", "kept", "slot"}; box is null or the lower and upper corner (2,3) of what is
drawn, max_gaussians null or the most that are drawn, the weightiest ones, kept null or the .npy
file of a mask (N,) of those that are drawn. The picture, H·W·4 float32 of colour and depth
(`render_rgbd`), is written at the start of the file FRAMES<slot>, which only grows: who asks maps
it, so that no pixel goes through a pipe. Per answer one JSON line {"id", "size_wh", "seconds"}; the
first line is {"ready", "num_gaussians"}. Ends with its standard input.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import OrderedDict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.choices import Painter
from radiant_core.errors import RadiantError
from radiant_core.io.ply import load_ply
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.layers.splat_layer import inside_box
from radiant_viewer.splats.drawers import Drawer, make_drawer

MAX_PARTS = 4
"""Parts of the model that are kept: the whole, the ground of the map, few Gaussians, a box."""


class Parts:
    """Parts of a model, each cut out once, of which the latest few are kept."""

    def __init__(self, splats: Splats, painter: Painter) -> None:
        self._splats = splats
        self._painter: Painter = painter
        self._renderers: OrderedDict[str, Drawer | None] = OrderedDict()

    def renderer(self, box: list[list[float]] | None, max_gaussians: int | None, keep_path: str | None) -> Drawer | None:
        """The renderer of the weightiest Gaussians in the box; None where there are none."""
        key = json.dumps([box, max_gaussians, keep_path])
        if key not in self._renderers:
            chosen = np.ones(len(self._splats), bool) if keep_path is None else np.load(keep_path)
            inside = np.flatnonzero(chosen if box is None else chosen & inside_box(self._splats.means, box))
            if max_gaussians is not None and len(inside) > max_gaussians:
                weights = _weights(self._splats)[inside]
                inside = inside[np.sort(np.argpartition(-weights, max_gaussians)[:max_gaussians])]
            self._renderers[key] = make_drawer(self._painter, self._splats.select(inside)) if len(inside) else None
        self._renderers.move_to_end(key)
        while len(self._renderers) > MAX_PARTS:
            self._renderers.popitem(last=False)
        return self._renderers[key]


def _weights(splats: Splats) -> NDArray[np.float32]:
    """How much of a picture each Gaussian may fill (N,): opacity times the area of its two longest
    axes."""
    log_scales = np.sort(splats.log_scales, axis=1)
    return np.asarray(np.exp(log_scales[:, 1] + log_scales[:, 2]) / (1 + np.exp(-splats.logit_opacities)), np.float32)


def serve(path: Path, frames: str, painter: Painter, requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until the stream ends."""
    splats = load_ply(path)
    parts = Parts(splats, painter)
    _answer(answers, {"ready": True, "num_gaussians": len(splats)})
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
        began = time.monotonic()
        renderer = parts.renderer(request["box"], request["max_gaussians"], request["kept"])
        picture = _map_frame(Path(f"{frames}{int(request['slot'])}"), width, height)
        if renderer is None:
            picture[:] = (red / 255, green / 255, blue / 255, 0.0)
        else:
            renderer.draw(camera, (red, green, blue), picture)
        _answer(answers, {"id": request["id"], "size_wh": [width, height], "seconds": time.monotonic() - began})


def _map_frame(path: Path, width: int, height: int) -> Rgbd:
    """Map the start of a file as a picture (H,W,4). It is never made shorter: somebody may have
    mapped it."""
    num_bytes = 16 * width * height
    with path.open("a+b") as file:
        if os.fstat(file.fileno()).st_size < num_bytes:
            os.ftruncate(file.fileno(), num_bytes)
    return np.asarray(np.memmap(path, np.float32, "r+", shape=(height, width, 4)))


def _answer(answers: IO[bytes], header: dict[str, Any]) -> None:
    answers.write(json.dumps(header).encode() + b"\n")
    answers.flush()


def main() -> int:
    """Run the process and return its exit code."""
    # Graphics drivers write to standard output: it becomes standard error; answers keep the pipe.
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        painter: Painter = "vtk" if sys.argv[3] == "vtk" else "open3d" if sys.argv[3] == "open3d" else "radiant"
        serve(Path(sys.argv[1]), sys.argv[2], painter, sys.stdin.buffer, pipe)
    except BrokenPipeError:
        return 0
    except RadiantError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
