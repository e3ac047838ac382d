"""Gaussians as a file holds them, before anything of them is checked, and what of them can be used.
Once per file.

    strangers in a run    `checked`: one number that is not finite refuses the model
    a user's own file     `usable`: such Gaussians are left out and counted, and what has one
                          sensible meaning is taken for it:
        opacity of ±∞     what 8 bits round to 0 and 255: logits of ±6.9 (SPZ's converters write ∞)
        log scale of −∞   e^−20, flat (2D Gaussians are written as discs without a thickness)
        scale beyond e^88 infinite in float32, so left out
        rotation of 0     none, the identity
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.splats import SH_BASES, Splats

END_OPACITY = 0.25 / 255
"""What the ends of 8-bit opacities, 0 and 1, are read as: the middle of what was rounded to
them."""
END_LOGIT = float(np.log((1 - END_OPACITY) / END_OPACITY))
FLAT_LOG_SCALE = -20.0
MAX_LOG_SCALE = 88.0
"""e^88.7 is the largest float32."""
_MOST_BASES = SH_BASES[-1] - 1
_DEGREE_4_BASES = 24


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredGaussians:
    """Arrays of N Gaussians in the shapes of `Splats`, of any floating type and any value; shN may
    have the 24 bases of degree 4, which are read to degree 3."""

    means: NDArray[Any]
    quats: NDArray[Any]
    log_scales: NDArray[Any]
    logit_opacities: NDArray[Any]
    sh0: NDArray[Any]
    shN: NDArray[Any]
    antialiased: bool = False
    notes: tuple[str, ...] = ()
    """What the reader has to say of the file, sentences without its name."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFile:
    """A model that a user gave, and what was left out or taken for something else, in sentences for
    people."""

    splats: Splats
    notes: tuple[str, ...] = ()


def stored(splats: Splats, notes: tuple[str, ...] = ()) -> StoredGaussians:
    """The arrays of a model."""
    return StoredGaussians(**splats.arrays(), antialiased=splats.antialiased, notes=notes)


def checked(gaussians: StoredGaussians) -> Splats:
    """All Gaussians; BadInput for a value that is not finite, with its tensor and index."""
    return Splats(
        means=gaussians.means,
        quats=gaussians.quats,
        log_scales=gaussians.log_scales,
        logit_opacities=gaussians.logit_opacities,
        sh0=gaussians.sh0,
        shN=gaussians.shN[:, :_MOST_BASES],
        antialiased=gaussians.antialiased,
    )


def usable(gaussians: StoredGaussians) -> ModelFile:
    """The Gaussians that can be drawn, in the order of the file, and what became of the others;
    BadInput where there are some and none can be."""
    gaussians = _as_float32(gaussians)
    notes = list(gaussians.notes)
    if gaussians.shN.shape[1] == _DEGREE_4_BASES:
        notes.append("its spherical harmonics of degree 4 are read to degree 3")
    gaussians = _saturated(gaussians, notes)
    is_finite = _are_finite(gaussians)
    lost = int((~is_finite).sum())
    if lost and not is_finite.any():
        raise BadInput(f"none of its {len(gaussians):,} Gaussians has numbers that are all finite")
    if lost:
        why = f"have a number that is not finite, or a size beyond e^{MAX_LOG_SCALE:g}, and are left out"
        notes.append(f"{lost:,} of its {len(gaussians):,} Gaussians {why}")
        gaussians = _select(gaussians, is_finite)
    if zeros := int((gaussians.quats == 0).all(axis=1).sum()):
        notes.append(f"{zeros:,} Gaussians have a rotation of length 0 and are taken as not rotated")
    return ModelFile(splats=checked(gaussians), notes=tuple(notes))


def _as_float32(gaussians: StoredGaussians) -> StoredGaussians:
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        return replace(gaussians, **{name: np.asarray(array, np.float32) for name, array in _arrays(gaussians).items()})


def _saturated(gaussians: StoredGaussians, notes: list[str]) -> StoredGaussians:
    """With infinite opacities and scales of 0 as what they stand for; says so in `notes`."""
    logits, log_scales = gaussians.logit_opacities, gaussians.log_scales
    if ends := int(np.isinf(logits).sum()):
        notes.append(f"{ends:,} Gaussians have an opacity of exactly 0 or 1 and are taken as {END_OPACITY:.1g} from it")
        logits = np.where(np.isinf(logits), np.float32(END_LOGIT) * np.sign(logits), logits)
    is_flat = np.isneginf(log_scales)
    if flat := int(is_flat.any(axis=1).sum()):
        notes.append(f"{flat:,} Gaussians have no thickness and are taken as e^{FLAT_LOG_SCALE:g} thick")
        log_scales = np.where(is_flat, np.float32(FLAT_LOG_SCALE), log_scales)
    return replace(gaussians, logit_opacities=logits, log_scales=log_scales)


def _are_finite(gaussians: StoredGaussians) -> NDArray[np.bool_]:
    """Which Gaussians (N,) have only finite values and scales that float32 can say."""
    good = [(gaussians.log_scales <= MAX_LOG_SCALE).all(axis=1)]
    # Counted: an array of no harmonics has no other axis that could be left to numpy.
    good += [np.isfinite(array).reshape(len(array), int(np.prod(array.shape[1:]))).all(axis=1) for array in _arrays(gaussians).values()]
    return np.logical_and.reduce(good)


def _arrays(gaussians: StoredGaussians) -> dict[str, NDArray[Any]]:
    return {name: getattr(gaussians, name) for name in ("means", "quats", "log_scales", "logit_opacities", "sh0", "shN")}


def _select(gaussians: StoredGaussians, chosen: NDArray[np.bool_]) -> StoredGaussians:
    return replace(gaussians, **{name: array[chosen] for name, array in _arrays(gaussians).items()})
