"""The shape checks that all tests run under do find a wrong shape, where the types themselves stay silent for speed."""

from __future__ import annotations

import pytest
import torch

from radiant_core.render.contract import SplatTensors


def tensors(**changed: torch.Tensor) -> dict[str, torch.Tensor]:
    right = {"means": (7, 3), "quats": (7, 4), "log_scales": (7, 3), "logit_opacities": (7,), "sh0": (7, 1, 3), "shN": (7, 8, 3)}
    return {name: torch.zeros(shape) for name, shape in right.items()} | changed


def test_splat_tensors_of_the_declared_shapes_pass() -> None:
    assert len(SplatTensors(**tensors())) == 7


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("quats", torch.zeros(7, 3)),
        ("logit_opacities", torch.zeros(7, 1)),
        ("sh0", torch.zeros(6, 1, 3)),
        ("means", torch.zeros(7, 3, dtype=torch.int64)),
    ],
)
def test_a_wrong_shape_count_or_number_is_found_and_named(name: str, wrong: torch.Tensor) -> None:
    with pytest.raises(TypeError, match="SplatTensors"):
        SplatTensors(**tensors(**{name: wrong}))
