"""Bad input is named by every rasterizer: poison, shapes, types, and what no camera has."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import TENSORS

from . import gaussians

INPUTS = ("means", "quats", "log_scales", "logit_opacities", "sh0", "shN", "viewmats", "Ks", "background")


def valid_inputs() -> dict[str, torch.Tensor]:
    """10 Gaussians and 2 cameras."""
    cameras = gaussians.off_centre_cameras(16, 16, count=2)
    views = {"viewmats": torch.tensor(cameras.cam_from_world), "Ks": torch.tensor(cameras.Ks), "background": torch.zeros(3)}
    return {**SplatTensors.from_splats(gaussians.regular(10)).tensors(), **views}


def rasterize_changed(name: str, tensor: torch.Tensor, **options):
    """`rasterize` of `valid_inputs` with one of them replaced."""
    inputs = {**valid_inputs(), **{key: options.pop(key) for key in set(options) & set(INPUTS)}}
    viewmats, Ks, background = (tensor if name == view else inputs.pop(view) for view in ("viewmats", "Ks", "background"))
    splats = SplatTensors(**{key: inputs[key] for key in TENSORS})
    if name in SplatTensors.__dataclass_fields__:
        # Set afterwards: the tests check the shapes of every product when it is made.
        object.__setattr__(splats, name, tensor)
    options = {"width": 16, "height": 16, "sh_degree": 3, "background": background, "backend": "native", **options}
    return rasterize(splats, viewmats, Ks, **options)


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_poison_is_named_counted_and_located_in_every_input(name: str, value: float, backend: str) -> None:
    tensor = valid_inputs()[name]
    tensor.view(-1)[[1, -1]] = value
    first = tuple(int(i) for i in np.unravel_index(1, tensor.shape))
    with pytest.raises(BadInput, match=rf"^{name} has 2 values that are not finite, the first at index {re.escape(str(first))}"):
        rasterize_changed(name, tensor, backend=backend)


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("name", INPUTS)
def test_a_wrong_shape_or_type_of_every_input_is_named(name: str, backend: str) -> None:
    tensor = valid_inputs()[name]
    # means and viewmats say how many Gaussians and cameras there are, so another one is blamed when
    # they have too few rows.
    fewer = [] if name in ("means", "viewmats") else [tensor[:-1]]
    for wrong in (tensor[None], tensor[..., :-1], tensor.reshape(-1)[0], *fewer):
        with pytest.raises(BadInput, match=rf"^{name} has shape {re.escape(str(tuple(wrong.shape)))}, expected \("):
            rasterize_changed(name, wrong, backend=backend)
    with pytest.raises(BadInput, match=rf"^{name} is torch.int32"):
        rasterize_changed(name, tensor.int(), backend=backend)


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_values_no_camera_has_are_refused(backend: str) -> None:
    for near_m, far_m in ((-1.0, 10.0), (2.0, 1.0), (float("nan"), 10.0), (0.1, float("nan"))):
        with pytest.raises(BadInput, match="near_m is"):
            rasterize_changed("Ks", valid_inputs()["Ks"], near_m=near_m, far_m=far_m, backend=backend)
    for place, value in (((0, 0, 0), 0.0), ((1, 1, 1), -220.0), ((0, 0, 1), 3.0), ((1, 2, 2), 2.0)):
        Ks = valid_inputs()["Ks"]
        Ks[place] = value
        with pytest.raises(BadInput, match="Ks has another form"):
            rasterize_changed("Ks", Ks, backend=backend)
    with pytest.raises(BadInput, match="viewmats holds no camera"):
        rasterize_changed("viewmats", valid_inputs()["viewmats"][:0], Ks=valid_inputs()["Ks"][:0], backend=backend)
    for width in (0, 1_000_001):
        with pytest.raises(BadInput, match=rf"the image is {width} × 16 px"):
            rasterize_changed("Ks", valid_inputs()["Ks"], width=width, backend=backend)


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("kind", ["scaled", "sheared", "mirrored", "transposed", "last row", "huge"])
def test_a_pose_that_is_not_rigid_is_refused(kind: str, backend: str) -> None:
    poses = valid_inputs()["viewmats"]
    changes = {
        "scaled": poses[1] * torch.tensor([2.0, 2.0, 2.0, 1.0])[:, None],
        "sheared": poses[1] @ torch.tensor([[1, 0.3, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=poses.dtype),
        "mirrored": poses[1] @ torch.diag(torch.tensor([-1, 1, 1, 1], dtype=poses.dtype)),
        "transposed": poses[1].T.clone(),
        "last row": poses[1] + torch.tensor([[0.0], [0.0], [0.0], [4.0]]),
        "huge": poses[1] * 1e300,
    }
    poses[1] = changes[kind]
    with pytest.raises(BadInput, match=r"viewmats\[1\] is not a rotation and a translation"):
        rasterize_changed("viewmats", poses, backend=backend)
