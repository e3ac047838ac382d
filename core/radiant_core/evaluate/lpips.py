"""LPIPS (Zhang et al. 2018) 0.1: the distance of two images in a network's features. Per image.

    LPIPS(a, b) = Σ over taps l of mean over pixels of Σ over channels c of w_lc (â_lc − b̂_lc)²

with â the features after a ReLU, divided at every pixel by their length over the channels, and
inputs x in 0..1 scaled to (2x − 1 − shift) / scale. The networks are the convolutions of
torchvision's VGG16 or AlexNet with five taps. Trained weights are the user's to bring
(`load_lpips`): a backbone as torchvision publishes it and the heads w as the authors' package
`lpips` does.
"""

from __future__ import annotations

import pickle  # noqa: TID251 - for the name of its error alone
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import torch
import torch.nn.functional as F
from numpy.typing import ArrayLike
from safetensors import SafetensorError, safe_open
from torch import Tensor

from radiant_core.choices import LpipsNetwork
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import LPIPS_SIDE_PX
from radiant_core.evaluate.image_pair import check_image_pair
from radiant_core.io.array_layout import require_layout
from radiant_core.io.run_store import write_atomic

INPUT_SHIFT = (-0.030, -0.088, -0.188)
INPUT_SCALE = (0.458, 0.448, 0.450)
LENGTH_EPSILON = 1e-10
MAX_FILE_BYTES = 2**30
"""torchvision's VGG16 has 528 MiB, most of it layers that are not needed."""


@dataclass(frozen=True, kw_only=True)
class _Conv:
    """A convolution with its ReLU: its number in `features`, and a max-pool of stride 2 before."""

    number: int
    channels: tuple[int, int]
    """From, to."""
    kernel_px: int = 3
    stride_px: int = 1
    padding_px: int = 1
    pool_px: int = 0
    tap: bool = False
    """Whether its output is compared."""


@dataclass(frozen=True, kw_only=True)
class _Network:
    convs: tuple[_Conv, ...]
    backbone_files: str
    """Pattern of the names that torchvision publishes the backbone under."""


_NETWORKS: dict[LpipsNetwork, _Network] = {
    "vgg": _Network(
        convs=(
            _Conv(number=0, channels=(3, 64)),
            _Conv(number=2, channels=(64, 64), tap=True),
            _Conv(number=5, channels=(64, 128), pool_px=2),
            _Conv(number=7, channels=(128, 128), tap=True),
            _Conv(number=10, channels=(128, 256), pool_px=2),
            _Conv(number=12, channels=(256, 256)),
            _Conv(number=14, channels=(256, 256), tap=True),
            _Conv(number=17, channels=(256, 512), pool_px=2),
            _Conv(number=19, channels=(512, 512)),
            _Conv(number=21, channels=(512, 512), tap=True),
            _Conv(number=24, channels=(512, 512), pool_px=2),
            _Conv(number=26, channels=(512, 512)),
            _Conv(number=28, channels=(512, 512), tap=True),
        ),
        backbone_files="vgg16*.pth",
    ),
    "alex": _Network(
        convs=(
            _Conv(number=0, channels=(3, 64), kernel_px=11, stride_px=4, padding_px=2, tap=True),
            _Conv(number=3, channels=(64, 192), kernel_px=5, padding_px=2, pool_px=3, tap=True),
            _Conv(number=6, channels=(192, 384), pool_px=3, tap=True),
            _Conv(number=8, channels=(384, 256), tap=True),
            _Conv(number=10, channels=(256, 256), tap=True),
        ),
        backbone_files="alexnet*.pth",
    ),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Lpips:
    """A network with its weights: `distance = lpips(render, photograph)`. Made by `load_lpips`."""

    network: LpipsNetwork
    weights: Mapping[str, Tensor]
    """`features.N.weight` (out,in,k,k), `features.N.bias` (out,), `linL.model.1.weight` (1,C,1,1);
    finite float32."""

    @property
    def min_side_px(self) -> int:
        """Shorter images have no LPIPS."""
        return LPIPS_SIDE_PX[self.network]

    def __call__(self, render: ArrayLike, photograph: ArrayLike) -> float:
        """LPIPS of two images (H,W,3) in 0..1, 0 where they are equal; BadInput on other shapes or
        values, or a side that is too short."""
        pair = check_image_pair(render, photograph)
        height, width = pair[0].shape[:2]
        if min(height, width) < self.min_side_px:
            raise BadInput(
                f"images of {width}×{height} px are too small for LPIPS {self.network}: give at least {self.min_side_px} px a side."
            )
        device = "cuda" if torch.cuda.is_available() else "cpu"
        weights = {name: weight.to(device) for name, weight in self.weights.items()}
        shift, scale = (torch.tensor(values, device=device)[:, None, None] for values in (INPUT_SHIFT, INPUT_SCALE))
        # One image at a time: at a megapixel the first layer of VGG16 alone takes 256 MB for each.
        images = [(2 * torch.tensor(image, dtype=torch.float32, device=device).permute(2, 0, 1) - 1 - shift) / scale for image in pair]
        distance, tap = 0.0, 0
        with torch.no_grad(), torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False):
            for conv in _NETWORKS[self.network].convs:
                images = [_convolve(image, conv, weights) for image in images]
                if conv.tap:
                    distance += _tap_distance(images[0], images[1], weights[_head(tap)])
                    tap += 1
        return distance


def load_lpips(path: Path, network: LpipsNetwork) -> Lpips:
    """The network with weights from `path`: a folder with torchvision's backbone (`vgg16*.pth`,
    `alexnet*.pth`) and the heads of `lpips` 0.1 (`vgg.pth`, `alex.pth`), or one safetensors file
    with the tensors of both.

    Nothing in a .pth is executed. Raises BadInput when a file is missing, ambiguous, broken or over
    1 GiB, or a tensor is missing, of another shape, not of a floating type or not finite.
    """
    if network not in get_args(LpipsNetwork):
        raise BadInput(f"LPIPS network {network!r} is unknown: use one of {', '.join(get_args(LpipsNetwork))}.")
    if path.is_dir():
        heads = path / f"{network}.pth"
        backbones = sorted(path.glob(_NETWORKS[network].backbone_files))
        if len(backbones) != 1 or not heads.is_file():
            raise BadInput(
                f"{path} holds {len(backbones)} files {_NETWORKS[network].backbone_files} and {int(heads.is_file())} {heads.name}:"
                " put torchvision's backbone and the heads of lpips 0.1 there, one of each."
            )
        tensors: dict[str, Any] = {**_read_pth(backbones[0]), **_read_pth(heads)}
    elif path.is_file():
        tensors = _read_safetensors(path, network)
    else:
        raise BadInput(f"there are no LPIPS weights at {path}: give a folder with the .pth files or one safetensors file.")
    weights = {name: _check_tensor(path, name, tensors.get(name), shape) for name, shape in _shapes(network).items()}
    return Lpips(network=network, weights=weights)


def save_lpips(path: Path, lpips: Lpips) -> None:
    """Write the needed weights, 59 MB of VGG16, as safetensors; raises as `write_atomic`."""
    from safetensors.torch import save

    write_atomic(path, save(dict(lpips.weights)))


def _shapes(network: LpipsNetwork) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor that the network needs."""
    shapes: dict[str, tuple[int, ...]] = {}
    taps = 0
    for conv in _NETWORKS[network].convs:
        fan_in, out = conv.channels
        shapes[f"features.{conv.number}.weight"] = (out, fan_in, conv.kernel_px, conv.kernel_px)
        shapes[f"features.{conv.number}.bias"] = (out,)
        if conv.tap:
            shapes[_head(taps)] = (1, out, 1, 1)
            taps += 1
    return shapes


def _head(tap: int) -> str:
    return f"lin{tap}.model.1.weight"


def _convolve(image: Tensor, conv: _Conv, weights: Mapping[str, Tensor]) -> Tensor:
    """(C,H,W) after pooling, convolution and ReLU."""
    image = image[None]
    if conv.pool_px:
        image = F.max_pool2d(image, conv.pool_px, stride=2)
    weight, bias = (weights[f"features.{conv.number}.{name}"] for name in ("weight", "bias"))
    return F.relu_(F.conv2d(image, weight, bias, stride=conv.stride_px, padding=conv.padding_px))[0]


def _tap_distance(a: Tensor, b: Tensor, head: Tensor) -> float:
    """Mean over the pixels of the weighted squared difference of two features (C,H,W) after each is
    made one long."""
    squared = (a / (a.norm(dim=0) + LENGTH_EPSILON)).sub_(b / (b.norm(dim=0) + LENGTH_EPSILON)).square_()
    return float(torch.tensordot(head[0, :, 0, 0], squared, dims=1).mean(dtype=torch.float64))


def _read_pth(path: Path) -> dict[Any, Any]:
    """What a file of `torch.save` holds, if that is a dictionary; other names are ignored."""
    _require_size(path)
    try:
        # weights_only: a pickle of anything but tensors and plain containers is refused, not run.
        with warnings.catch_warnings():
            # It warns of odd pickles; what comes of them is checked below.
            warnings.simplefilter("ignore")
            state = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    except (
        *(pickle.UnpicklingError, struct.error, EOFError, OSError, RuntimeError, OverflowError, MemoryError, AssertionError),
        *(ValueError, TypeError, AttributeError, LookupError),
    ) as error:
        raise BadInput(f"cannot read {path} as a state dict of tensors: it is cut, damaged or another file; fetch it again.") from error
    if not isinstance(state, dict):
        raise BadInput(f"{path} holds a {type(state).__name__}, expected a state dict of tensors: check which file it is.")
    return state


def _read_safetensors(path: Path, network: LpipsNetwork) -> dict[str, Tensor]:
    _require_size(path)
    require_layout(path)
    try:
        with safe_open(path, framework="pt") as file:
            names = set(file.keys())
            return {name: file.get_tensor(name) for name in _shapes(network) if name in names}
    except (SafetensorError, OSError, ValueError) as error:
        raise BadInput(f"cannot read {path} as safetensors ({error}): give that, or a folder with the .pth files.") from error


def _require_size(path: Path) -> None:
    num_bytes = path.stat().st_size
    if num_bytes > MAX_FILE_BYTES:
        raise BadInput(f"{path} has {num_bytes} bytes, expected at most {MAX_FILE_BYTES}: it holds no LPIPS weights.")


def _check_tensor(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> Tensor:
    if not isinstance(value, Tensor):
        raise BadInput(f"{path} has no tensor {name}: give torchvision's backbone and the heads of lpips 0.1 for this network.")
    # The shape comes first: an expanded tensor of a small file could be of any size.
    if tuple(value.shape) != shape or not value.is_floating_point() or value.layout is not torch.strided or value.is_quantized:
        raise BadInput(
            f"{name} in {path} is {value.dtype} {tuple(value.shape)}, expected a floating type {shape}: it is of another network."
        )
    tensor = value.detach().to("cpu", torch.float32).contiguous()
    if not bool(torch.isfinite(tensor).all()):
        raise BadInput(f"{name} in {path} has values that are not finite: fetch the file again.")
    return tensor
