"""`Splats`: a 3D Gaussian model as numpy arrays of the stored values (before activation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import check_array

TENSORS = ("means", "quats", "log_scales", "logit_opacities", "sh0", "shN")
"""The arrays of a model, in this order."""
SH_BASES = (1, 4, 9, 16)
"""Number of spherical-harmonics bases K for degree 0 to 3."""

SH_C0 = 0.28209479177387814
"""Value of the constant basis function, sqrt(1/4π): colour = 0.5 + SH_C0 · sh0."""

_MORTON_MASKS = (0x1F00000000FFFF, 0x1F0000FF0000FF, 0x100F00F00F00F00F, 0x10C30C30C30C30C3, 0x1249249249249249)


@dataclass(frozen=True, kw_only=True, eq=False)
class Splats:
    """N Gaussians, float32: means (N,3) m; quats (N,4) wxyz; log_scales (N,3) ln m; logit_opacities
    (N,); sh0 (N,1,3); shN (N,K-1,3) with K in 1, 4, 9, 16.

    Raises BadInput on a wrong shape or a value that is not finite, naming the tensor, the count and
    the first index.

    Example:
        >>> splats = radiant.load_splats("model.ply")
        >>> low = splats.select(splats.means[:, 2] < np.median(splats.means[:, 2]))
        >>> 0 < len(low) < len(splats)
        True
    """

    means: NDArray[np.float32]
    quats: NDArray[np.float32]
    log_scales: NDArray[np.float32]
    logit_opacities: NDArray[np.float32]
    sh0: NDArray[np.float32]
    shN: NDArray[np.float32]
    antialiased: bool = False
    """Whether it was fitted, and is to be drawn, with opacities that fade where a Gaussian is
    smaller than a pixel (Mip-Splatting)."""

    def __post_init__(self) -> None:
        # A single number has no length; its shape is refused below.
        count = (*np.shape(self.means), 0)[0]
        shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (1, 3), "shN": (None, 3)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, check_array(name, getattr(self, name), (count, *shape), np.float32))
        if self.shN.shape[1] + 1 not in SH_BASES:
            raise BadInput(f"shN has {self.shN.shape[1]} bases, expected 0, 3, 8 or 15 (degree 0 to 3): pad or cut it.")

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        return f"Splats({len(self):,} Gaussians, harmonics of degree {self.sh_degree}{', antialiased' * self.antialiased})"

    @property
    def sh_degree(self) -> int:
        """Degree 0 to 3 of the spherical harmonics."""
        return SH_BASES.index(self.shN.shape[1] + 1)

    @property
    def opacities(self) -> NDArray[np.float64]:
        """Opacity (N,) of each, 0 to 1: the logistic function of what is stored."""
        return expit(self.logit_opacities.astype(np.float64))

    @property
    def num_bytes(self) -> int:
        """Bytes of the six arrays."""
        return sum(array.nbytes for array in self.arrays().values())

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """The six arrays by name."""
        return {name: getattr(self, name) for name in TENSORS}

    def select(self, chosen: ArrayLike) -> Splats:
        """The Gaussians that a mask (N,) bool or an index list (K,) int chooses."""
        chosen = np.asarray(chosen)
        return replace(self, **{name: array[chosen] for name, array in self.arrays().items()})


def concatenate_splats(parts: Sequence[Splats]) -> Splats:
    """All Gaussians of `parts`, SH degrees padded to the highest; BadInput unless all or none are
    antialiased, and without parts."""
    if not parts:
        raise BadInput("no models to concatenate: pass at least one.")
    if len({part.antialiased for part in parts}) > 1:
        raise BadInput("some of the models are antialiased and some are not, which no picture can show: train all the same way.")
    bases = max(part.shN.shape[1] for part in parts)
    padded = [{**part.arrays(), "shN": _padded(part.shN, bases)} for part in parts]
    return replace(parts[0], **{name: np.concatenate([arrays[name] for arrays in padded]) for name in padded[0]})


def _padded(shN: NDArray[np.float32], bases: int) -> NDArray[np.float32]:
    # np.pad copies also where it adds nothing, and these are most of a model's bytes.
    missing = bases - shN.shape[1]
    return np.pad(shN, ((0, 0), (0, missing), (0, 0))) if missing else shN


def morton_order(means: ArrayLike) -> NDArray[np.int64]:
    """Order (N,) of points (N,3) along a Z curve: what is near in space is near in memory.

    The bits of a coordinate are spread by doubling gaps (x | x ≪ 32, 16, 8, 4, 2). 21 bits an axis;
    stable.
    """
    points = np.asarray(means, np.float64)
    if not len(points):
        return np.zeros(0, np.int64)
    low, high = points.min(0), points.max(0)
    side = float((high - low).max()) or 1.0
    cells = ((points - low) / side * (2**21 - 1)).astype(np.uint64)
    for shift, mask in zip((32, 16, 8, 4, 2), _MORTON_MASKS, strict=True):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return np.argsort(cells[:, 0] | (cells[:, 1] << np.uint64(1)) | (cells[:, 2] << np.uint64(2)), kind="stable")
