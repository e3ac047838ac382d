"""One rendered picture as numpy, without gradients, for views, scores and commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, SplatTensors, ViewOptions
from radiant_core.render.rasterize import FAR_M, rasterize_sound
from radiant_core.render.reach import NEAR_M
from radiant_core.splats import Splats
from radiant_core.threads import in_order, single_opencv_thread, usual_threads

MOST_AT_ONCE = 8
"""Pictures that threads draw at the same time: each takes memory that grows with the model."""
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """image (H,W,3), alpha (H,W) in 0..1; depth (H,W) m, 0 where nothing was hit; all float32."""

    name: str
    image: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]

    @property
    def image_bytes(self) -> NDArray[np.uint8]:
        """The image in 8 bits (H,W,3)."""
        return (self.image * 255).round().astype(np.uint8)


def render_views(splats: Splats, cameras: Cameras, backend: Backend = "auto", near_m: FloatArray | None = None) -> Iterator[RenderedView]:
    """Render every camera at its size, one picture in memory at a time.

    Use it for pictures in numpy; `rasterize` has gradients, in torch.

    Args:
        splats: the model.
        cameras: in the frame of the model.
        backend: the renderer; auto: gsplat where it can be used, else native.
        near_m: (C,) the depth from which on each camera shows Gaussians (`reach.py`); None: all
            that are before it.

    Yields:
        One picture per camera, in their order.

    Example:
        >>> scene, splats = radiant.load_scene("SCENE"), radiant.load_splats("model.ply")
        >>> view = next(radiant.render(splats, scene.cameras.select([0]).scaled(64)))
        >>> view.image.shape, view.depth.shape
        ((48, 64, 3), (48, 64))
    """
    drawn = _Drawn(splats, cameras, backend, near_m)
    for index in range(len(cameras)):
        yield drawn.view(index, usual_threads())


def use_views(splats: Splats, cameras: Cameras, use: Callable[[int, RenderedView], Result]) -> Iterator[Result]:
    """What `use` makes of each camera's index and picture, in their order. As many threads as torch
    has, at most `MOST_AT_ONCE`, draw a picture each and use it: small ones leave little to share
    out, and `use` has one thread."""
    drawn, num_threads = _Drawn(splats, cameras, "auto", None), usual_threads()
    at_once = min(MOST_AT_ONCE, num_threads) if drawn.renderer == "native" else 1
    with single_opencv_thread():
        yield from in_order(lambda index: use(index, drawn.view(index, num_threads // at_once)), range(len(cameras)), at_once)


class _Drawn:
    """A model as cameras see it, for several threads at once."""

    def __init__(self, splats: Splats, cameras: Cameras, backend: Backend, near_m: FloatArray | None) -> None:
        self.renderer = resolve_backend(backend)
        self._backend: Backend = backend
        self._cameras, self._sh_degree = cameras, splats.sh_degree
        self._near = np.full(len(cameras), NEAR_M) if near_m is None else np.asarray(near_m, np.float64)
        self._tensors = SplatTensors.from_splats(splats, device=device_of(self.renderer))
        self._black = torch.zeros(3, device=device_of(self.renderer))

    def view(self, index: int, num_threads: int) -> RenderedView:
        cameras, (width, height) = self._cameras, self._cameras.sizes_wh[index].tolist()
        viewmats, Ks = torch.tensor(cameras.cam_from_world[index : index + 1]), torch.tensor(cameras.Ks[index : index + 1])
        options = ViewOptions(
            width=width,
            height=height,
            sh_degree=self._sh_degree,
            near_m=float(self._near[index]),
            far_m=FAR_M,
            antialiased=self._tensors.antialiased,
            background=self._black,
        )
        with torch.no_grad():
            output = rasterize_sound(self._tensors, viewmats, Ks, options, self._backend, num_threads)
        # Torch would clamp with threads, which spin on and take a core from the rasterizer.
        image, alpha, depth = (part[0].cpu().numpy() for part in (output.images, output.alphas, output.depths))
        return RenderedView(name=cameras.names[index], image=np.clip(image, 0, 1), alpha=np.clip(alpha, 0, 1), depth=depth)
