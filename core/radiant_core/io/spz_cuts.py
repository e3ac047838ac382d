"""What SPZ cannot hold of a model, counted before it is written. Once per export.

A centre has 24 bits, of which b are a fraction: steps of 2^−b within 2047 · 2^(12 − b) units. 12
are what every writer takes. A scene whose Gaussians are so fine that a step would be more than a
sixteenth of the median one gets more, as far as the farthest leaves room; a larger scene gets
fewer, as long as a step stays below a quarter, and what then lies farther out is left out. Sizes
end at e^−10 and 379 units, colours at ±3.33 and harmonics at ±1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.open3d_formats import SPZ_MAX_LOG_SCALE, SPZ_MAX_MEAN
from radiant_core.io.spz import SPZ_FRACTION_BITS
from radiant_core.splats import Splats

MIN_LOG_SCALE = -10.0
MAX_SH0, MAX_SHN = 0.5 / 0.15, 1.0
COARSEST_STEP, FINE_STEP = 0.25, 1 / 16
"""Of the median Gaussian's longest standard deviation."""
MAX_FRACTION_BITS = 20
"""Steps of 1e-6 within eight units, float32's own there."""


@dataclass(frozen=True, kw_only=True)
class SpzCuts:
    """Gaussians left out because they lie beyond the reach of the file, made smaller (to 379
    units), made larger (to e^−10), and with colours that were clamped; and the step of a centre in
    the model's unit, twice the greatest error."""

    num_left_out: int = 0
    num_shrunk: int = 0
    num_grown: int = 0
    num_clamped: int = 0
    step: float = 2.0**-SPZ_FRACTION_BITS

    def sentence(self) -> str:
        """What is lost, for a warning; empty where nothing is."""
        reach = SPZ_MAX_MEAN * self.step * 2**SPZ_FRACTION_BITS
        finest = 2.0**-SPZ_FRACTION_BITS
        parts = [
            (self.num_left_out, f"{self.num_left_out:,} Gaussians lie beyond {reach:,.0f} units of the origin and are left out"),
            (self.num_shrunk, f"{self.num_shrunk:,} Gaussians are larger than {np.exp(SPZ_MAX_LOG_SCALE):.0f} units and become smaller"),
            (self.num_grown, f"{self.num_grown:,} Gaussians are smaller than {np.exp(MIN_LOG_SCALE):.2g} units and become larger"),
            (self.num_clamped, f"{self.num_clamped:,} Gaussians have colours beyond SPZ's range, which are clamped"),
            (self.step > finest, f"centres are in steps of {self.step:.3g} units, not {finest:.2g}, to reach {reach:,.0f} units"),
        ]
        losses = "; ".join(text for count, text in parts if count)
        return f"SPZ does not hold all of this model: {losses}." if losses else ""


def fraction_bits_of(splats: Splats) -> int:
    """Bits of a fraction for a file: 12; more where Gaussians are finer than 16 of its steps and
    lie near enough; fewer where some lie beyond 2,047 units, and no fewer than leave steps of a
    quarter of the median Gaussian."""
    if not len(splats):
        return SPZ_FRACTION_BITS
    farthest = float(np.abs(splats.means).max())
    # frexp: the least k with farthest < 2047 · 2^k; negative where there is room for more bits.
    room = SPZ_FRACTION_BITS - math.frexp(farthest / SPZ_MAX_MEAN)[1] if farthest > 0 else MAX_FRACTION_BITS
    typical = float(np.median(splats.log_scales.max(axis=1)))
    needed, wanted = (int(np.ceil(-np.log2(step) - typical / np.log(2))) for step in (COARSEST_STEP, FINE_STEP))
    if room > SPZ_FRACTION_BITS:
        return int(np.clip(wanted, SPZ_FRACTION_BITS, min(room, MAX_FRACTION_BITS)))
    return int(np.clip(max(room, needed), 0, SPZ_FRACTION_BITS))


def within_reach(splats: Splats, fraction_bits: int) -> NDArray[np.bool_]:
    """Which Gaussians (N,) so many bits can place."""
    reach = SPZ_MAX_MEAN * 2.0 ** (SPZ_FRACTION_BITS - fraction_bits)
    return np.asarray(np.abs(splats.means).max(axis=1, initial=0.0) < reach)


def spz_cuts(splats: Splats, fraction_bits: int = SPZ_FRACTION_BITS) -> SpzCuts:
    """What a file of so many fraction bits loses of a model."""
    inside = within_reach(splats, fraction_bits)
    longest = splats.log_scales.max(axis=1, initial=-np.inf)
    clamped = (np.abs(splats.sh0) > MAX_SH0).any(axis=(1, 2)) | (np.abs(splats.shN) > MAX_SHN).any(axis=(1, 2))
    return SpzCuts(
        num_left_out=int((~inside).sum()),
        num_shrunk=int((inside & (longest > SPZ_MAX_LOG_SCALE)).sum()),
        # The longest axis: a flat Gaussian looks the same a little thicker.
        num_grown=int((inside & (longest < MIN_LOG_SCALE)).sum()),
        num_clamped=int((inside & clamped).sum()),
        step=2.0**-fraction_bits,
    )
