"""Whether a model that arrived can be joined, decided before it is rendered. Once per arrival.

By its count (read from the file's head: `io.messages`), numbers, extent and what its cameras see.
"""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.splats import Splats

MAX_SPLATS = 5_000_000
"""Of one sender: 1.2 GB with harmonics of degree 3. The paper's devices send 0.3 to 3 million."""
MAX_COORDINATE_M = 1e6
MAX_LOG_SCALE = 12.0
"""e¹² m: more than any sky."""
MAX_HARMONIC = 50.0
"""A coefficient of 3.5 is black or white already; training strays to ten."""
MIN_SEEN_SHARE = 0.05
"""Of the Gaussians in sight of the cameras that made them: all but the sky usually are."""
NUM_TRIED = 20_000
LARGEST = {"means": MAX_COORDINATE_M, "sh0": MAX_HARMONIC, "shN": MAX_HARMONIC}
"""The largest sizes of values."""


def check_splats(splats: Splats, cameras: Cameras) -> str | None:
    """What is wrong with a model of C cameras, one sentence, or None; without cameras what they see
    is not asked."""
    if not 0 < len(splats) <= MAX_SPLATS:
        return f"it has {len(splats):,} Gaussians, expected 1 to {MAX_SPLATS:,}."
    for name, limit in LARGEST.items():
        largest = float(np.abs(getattr(splats, name)).max(initial=0))
        if largest > limit:
            return f"a value of its {name} is {largest:.3g}, expected at most {limit:g}."
    if float(splats.log_scales.max()) > MAX_LOG_SCALE:
        return f"a Gaussian has the log scale {splats.log_scales.max():.3g}, expected at most {MAX_LOG_SCALE:g}."
    if len(cameras):
        tried = splats.means[np.linspace(0, len(splats) - 1, min(len(splats), NUM_TRIED)).astype(np.int64)]
        share = float(cameras.any_sees(tried).mean())
        if share < MIN_SEEN_SHARE:
            return f"its own cameras see {share:.1%} of its Gaussians, expected {MIN_SEEN_SHARE:.0%} or more: is its frame another?"
    return None
