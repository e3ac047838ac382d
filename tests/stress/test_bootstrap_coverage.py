"""Coverage of the paired bootstrap over many designs: 2,000 experiments each."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.evaluate.bootstrap import paired_bootstrap

pytestmark = pytest.mark.stress


@pytest.mark.parametrize("seeds", [1, 3, 5])
@pytest.mark.parametrize("images", [8, 20])
@pytest.mark.parametrize("spreads", [(0, 1, 0.2), (0.3, 1, 0.5), (0, 0, 1), (1, 0.2, 0.2)])
def test_bounds_hold_about_as_often_as_they_say(seeds: int, images: int, spreads: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    of_seed, of_image, of_both = spreads
    repeats, held = 2000, np.zeros(2)
    for repeat in range(repeats):
        seed_effect = of_seed * rng.normal(size=(seeds, 1)) if seeds > 1 else 0
        d = seed_effect + of_image * rng.normal(size=images) + of_both * rng.normal(size=(seeds, images))
        found = paired_bootstrap(d, np.zeros_like(d), num_draws=1000, seed=repeat)
        held += [found.low <= 0 <= found.high, found.at_least <= 0]
    # 2,000 repeats scatter by 0.005. Residuals are counted twice, so that bounds may hold too
    # often, up to always.
    assert (held / repeats >= 0.925).all()
    if of_both < max(of_seed, of_image) / 2:
        assert (held / repeats <= 0.98).all()
