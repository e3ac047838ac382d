"""Radiance fields of benchmarks with fewer entries, rays and samples: for tests that ask what is made and kept, not how good it is."""

from __future__ import annotations

import pytest

from benchmarks.fields.fit import FitFieldConfig
from benchmarks.fields.hash_grid import GridConfig
from benchmarks.fields.render import Sampling

LOG2_ENTRIES, RAYS_A_STEP, SAMPLES = 12, 256, 12


@pytest.fixture
def small_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables of 2¹² in place of 2¹⁷ entries, an eighth of the rays and a fifth of the samples; tests/bench/fields is of their laws."""
    for config, defaults in (
        (GridConfig, {"log2_entries": LOG2_ENTRIES}),
        (FitFieldConfig, {"rays_a_step": RAYS_A_STEP}),
        (Sampling, {"num_coarse": SAMPLES, "num_fine": SAMPLES}),
    ):
        for name, value in defaults.items():
            monkeypatch.setitem(config.__init__.__kwdefaults__, name, value)
