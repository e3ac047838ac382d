"""Samples of pictures that are not 8-bit numbers from 0 to 255, and how they become such.

    shown = 255 (value − low) / (high − low), cut to 0 … 255

with one `low` and `high` for all photographs of one kind of samples: a stretch per picture would
give one ground two brightnesses. A thermal camera of 16 bits uses 4 % of its range, a survey of
reflectances values from 0 to 1. What says all it has to say in the upper 8 of 16 bits is left as it
is. Once per photograph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.photos.png import PNG_SIGNATURE
from radiant_core.io.photos.tiff import TIFF_SIGNATURES, Value, first_directory, number

BITS_PER_SAMPLE, SAMPLES_PER_PIXEL, SAMPLE_FORMAT, COMPRESSION = 0x0102, 0x0115, 0x0153, 0x0103
_FORMATS = {1: "unsigned integers", 2: "signed integers", 3: "floating point", 5: "complex integers", 6: "complex numbers"}
_COMPRESSIONS = {
    1: "",
    5: "LZW",
    6: "JPEG",
    7: "JPEG",
    8: "deflate",
    32773: "PackBits",
    32946: "deflate",
    34712: "JPEG 2000",
    50000: "Zstandard",
}
LEAST_SPAN_16 = 1 << 14
"""Values of 16 bits that span less would be fewer than 64 of 256 steps: they are stretched."""
DARK_16 = (1 << 12) + 255
"""What is never above looks black in 8 bits."""
SHARES = (0.1, 99.9)
"""Per cent of the values of a picture that lie below `low` and `high`: a hot chimney or a dead
pixel does not take the range from all else."""
MAX_SAMPLED = 1 << 20


@dataclass(frozen=True, kw_only=True)
class SampleKind:
    """What a file says of its samples."""

    bits: int = 8
    format: str = _FORMATS[1]
    bands: int = 3
    compression: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether every reader shows it as it is."""
        return self.bits <= 8 and self.format == _FORMATS[1]

    @property
    def is_wide(self) -> bool:
        """Whether its samples have 16 bits that other programs cut to 8."""
        return self.bits == 16 and self.format == _FORMATS[1]

    @property
    def is_usual(self) -> bool:
        """Whether pictures for the eye are like that."""
        return (self.is_plain or self.is_wide) and self.bands <= 4 and not self.compression.startswith("method")

    def __str__(self) -> str:
        packed = f", packed by {self.compression}" if self.compression else ""
        return f"{self.bands} band{'s' * (self.bands != 1)} of {self.bits}-bit {self.format}{packed}"


@dataclass(frozen=True, kw_only=True)
class SampleRange:
    """The values that a picture of unusual samples uses."""

    kind: SampleKind
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """What `low` and `high` become black and white, in all photographs of a kind of samples."""

    kind: SampleKind
    low: float
    high: float
    num_photographs: int

    @property
    def unstretched(self) -> str:
        """What they are and use, in one clause."""
        kind = f"{self.kind.bits}-bit {self.kind.format}"
        return f"{self.num_photographs} photographs have {kind}, of which they use {self.low:,.6g} to {self.high:,.6g}"

    @property
    def sentence(self) -> str:
        """The stretch in one sentence."""
        return f"{self.unstretched}: these are shown as 0 to 255, by one stretch for all of them."


def sample_kind(data: bytes) -> SampleKind:
    """What the head of a picture says of its samples."""
    if data.startswith(PNG_SIGNATURE) and len(data) > 25:
        return SampleKind(bits=int(data[24]), bands={0: 1, 4: 2, 6: 4}.get(data[25], 3))
    if not data.startswith(TIFF_SIGNATURES):
        return SampleKind()
    main = first_directory(data)
    return SampleKind(
        bits=_whole(main.get(BITS_PER_SAMPLE), 1),
        format=_FORMATS.get(_whole(main.get(SAMPLE_FORMAT), 1), "samples of an unknown kind"),
        bands=_whole(main.get(SAMPLES_PER_PIXEL), 1),
        compression=_COMPRESSIONS.get(code := _whole(main.get(COMPRESSION), 1), f"method {code}"),
    )


def _whole(value: Value | None, default: int) -> int:
    parsed = number(value)
    return default if parsed is None else int(parsed)


def range_of(kind: SampleKind, pixels: NDArray[Any]) -> SampleRange | None:
    """The values used in a picture (H,W) or (H,W,K); None where none is finite."""
    step = max(1, int(np.sqrt(pixels.size / MAX_SAMPLED)))
    colours = pixels[::step, ::step] if pixels.ndim == 2 else pixels[::step, ::step, :3]
    values = colours[np.isfinite(colours)].astype(np.float64)
    if not len(values):
        return None
    low, high = np.percentile(values, SHARES)
    return SampleRange(kind=kind, low=float(low), high=float(high))


def choose_stretches(ranges: Sequence[SampleRange]) -> tuple[Stretch, ...]:
    """One stretch for each kind of samples that needs one; none for 16 bits that are used well, and
    values from 0 to 1 of a floating point picture stay what they are."""
    stretches = []
    for kind in dict.fromkeys((sample_range.kind.bits, sample_range.kind.format) for sample_range in ranges):
        alike = [sample_range for sample_range in ranges if (sample_range.kind.bits, sample_range.kind.format) == kind]
        low, high = min(sample_range.low for sample_range in alike), max(sample_range.high for sample_range in alike)
        if kind == (16, _FORMATS[1]) and high - low >= LEAST_SPAN_16:
            continue
        if kind[1] == _FORMATS[3] and low >= 0 and 0.25 <= high <= 1:
            low, high = 0.0, 1.0
        stretches.append(Stretch(kind=replace(alike[0].kind, compression=""), low=low, high=high, num_photographs=len(alike)))
    return tuple(stretches)


def stretch_of(samples: SampleRange | None, stretches: Sequence[Stretch]) -> Stretch | None:
    """The stretch for a picture of these samples, if its kind has one."""
    if samples is None:
        return None
    kind = (samples.kind.bits, samples.kind.format)
    return next((stretch for stretch in stretches if (stretch.kind.bits, stretch.kind.format) == kind), None)


def stretched(pixels: NDArray[Any], stretch: Stretch) -> NDArray[np.uint8]:
    """A picture (H,W) or (H,W,K) in 8 bits, at most three bands; what is no number is black."""
    colours = pixels if pixels.ndim == 2 else pixels[..., :3]
    cut = np.clip(np.nan_to_num(colours.astype(np.float64), nan=stretch.low), stretch.low, stretch.high)
    span = stretch.high - stretch.low
    return np.round((cut - stretch.low) * (255 / span)).astype(np.uint8) if span > 0 else np.zeros(colours.shape, np.uint8)
