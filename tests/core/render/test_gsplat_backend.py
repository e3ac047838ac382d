"""gsplat without CUDA: what is missing is said, and each argument arrives. With CUDA the contract
test runs it."""

from __future__ import annotations

import sys
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from radiant_core.errors import BadInput
from radiant_core.render import gsplat_backend
from radiant_core.render.backends import resolve_backend
from radiant_core.render.contract import SplatTensors
from radiant_core.render.finite import are_finite
from radiant_core.render.gsplat_backend import missing_for_gsplat
from radiant_core.render.rasterize import rasterize
from tests.contract import gaussians


def render(backend, tensors: SplatTensors, **options):
    cameras = gaussians.off_centre_cameras(48, 32, count=2, focal_px=40)
    poses, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    return rasterize(tensors, poses, Ks, 48, 32, sh_degree=2, background=torch.tensor([0.1, 0.2, 0.3]), backend=backend, **options)


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
def test_without_cuda_one_sentence_says_what_is_missing() -> None:
    assert resolve_backend("auto") == "native"
    with pytest.raises(BadInput, match=r"backend 'gsplat' cannot be used here, there is no CUDA device"):
        render("gsplat", SplatTensors.from_splats(gaussians.regular(10)))


@pytest.mark.skipif(missing_for_gsplat() is not None, reason=f"there is {missing_for_gsplat()}")
def test_tensors_elsewhere_are_refused() -> None:
    with pytest.raises(BadInput, match="takes float32 on CUDA"):
        render("gsplat", SplatTensors.from_splats(gaussians.regular(10)))


@pytest.mark.parametrize("antialiased", [False, True])
def test_every_argument_arrives(monkeypatch: pytest.MonkeyPatch, antialiased: bool) -> None:
    """gsplat's signature, drawn by the reference: what comes back must be what the reference draws
    of the splats themselves."""
    monkeypatch.setattr(gsplat_backend, "_check_gsplat", lambda *_: None)
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=_drawn_by_the_reference))  # type: ignore[arg-type]
    tensors = SplatTensors.from_splats(gaussians.regular(60, bases=16))
    got, exact = (render(backend, tensors, near_m=11.0, far_m=14.0, antialiased=antialiased) for backend in ("gsplat", "reference"))
    for part in ("images", "alphas", "depths", "means2d"):
        torch.testing.assert_close(getattr(got, part), getattr(exact, part), rtol=1e-5, atol=1e-5)
    assert got.radii_px.shape == exact.radii_px.shape
    assert ((got.radii_px > 0) == (exact.radii_px > 0)).all() and (exact.radii_px == 0).any()


def test_absolute_gradients_are_taken_where_gsplat_leaves_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gsplat_backend, "_check_gsplat", lambda *_: None)
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=_drawn_by_the_reference))  # type: ignore[arg-type]
    tensors = SplatTensors.from_splats(gaussians.regular(60, bases=16))
    tensors.means.requires_grad_()
    got, exact = (render(backend, tensors, absgrad=True) for backend in ("gsplat", "reference"))
    assert got.absgrad is not None and exact.absgrad is not None and not got.absgrad.any()
    seen: list[Tensor] = []
    got.means2d.register_hook(lambda _, absgrad=got.absgrad: seen.append(absgrad.clone()))
    for output in (got, exact):
        output.images.square().sum().backward()
    torch.testing.assert_close(got.absgrad, exact.absgrad, rtol=1e-4, atol=1e-5 * float(exact.absgrad.max()))
    assert torch.equal(seen[0], got.absgrad) and got.absgrad.any()
    assert render("gsplat", tensors).absgrad is None


def _drawn_by_the_reference(
    *, means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, viewmats: Tensor, Ks: Tensor, width: int,
    height: int, near_plane: float, far_plane: float, eps2d: float, sh_degree: int, backgrounds: Tensor, render_mode: str,
    rasterize_mode: str, packed: bool, absgrad: bool,
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:  # fmt: skip
    assert (eps2d, render_mode, packed, backgrounds.shape) == (0.3, "RGB+ED", False, (len(viewmats), 3))
    tensors = SplatTensors(
        means=means, quats=quats, log_scales=scales.log(), logit_opacities=opacities.logit(), sh0=colors[:, :1], shN=colors[:, 1:]
    )
    output = rasterize(
        tensors, viewmats, Ks, width, height, sh_degree=sh_degree, background=backgrounds[0], near_m=near_plane, far_m=far_plane,
        antialiased={"antialiased": True, "classic": False}[rasterize_mode], absgrad=absgrad, backend="reference",
    )  # fmt: skip
    if output.absgrad is not None and output.means2d.requires_grad:
        reference, absolute = weakref.ref(output.means2d), output.absgrad
        output.means2d.register_hook(lambda _: setattr(reference(), "absgrad", absolute))
    pictures = torch.cat([output.images, output.depths[..., None]], dim=-1)
    radii = output.radii_px.ceil().int()[..., None].expand(-1, -1, 2)
    return pictures, output.alphas[..., None], {"means2d": output.means2d, "radii": radii}


def test_the_reference_names_the_device_of_whatever_it_makes() -> None:
    """It stands in for gsplat on CUDA. A factory that names no device would make a tensor on the
    default one, which is "meta" here, and no operation takes that beside one of the CPU."""
    tensors = SplatTensors.from_splats(gaussians.regular(60, bases=16))
    leaves = [tensor.requires_grad_() for tensor in tensors.tensors().values()]
    plain = render("reference", tensors)
    cameras = gaussians.off_centre_cameras(48, 32, count=2, focal_px=40)
    poses, Ks, background = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), torch.tensor([0.1, 0.2, 0.3])
    with torch.device("meta"):
        there = rasterize(tensors, poses, Ks, 48, 32, sh_degree=2, background=background, backend="reference", absgrad=True)
        there.images.sum().backward()
    assert torch.equal(there.images, plain.images)
    assert all(leaf.grad is not None and leaf.grad.device.type == "cpu" for leaf in leaves)


def test_an_empty_model_is_not_handed_to_gsplat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gsplat_backend, "_check_gsplat", lambda *_: None)
    monkeypatch.setitem(sys.modules, "gsplat", None)  # type: ignore[arg-type]
    output = render("gsplat", SplatTensors.from_splats(gaussians.regular(60, bases=16).select(np.zeros(0, int))))
    torch.testing.assert_close(output.images, torch.tensor([0.1, 0.2, 0.3]).expand(2, 32, 48, 3))


@pytest.mark.parametrize("poison", [torch.nan, torch.inf, -torch.inf])
def test_sums_show_what_is_not_finite(poison: float) -> None:
    """What is asked of tensors on a GPU, where each search of its own would be waited for."""
    tensors = [torch.randn(50, 3, generator=torch.Generator().manual_seed(seed)) for seed in range(3)]
    assert are_finite(tensors) and are_finite([torch.zeros(0, 3), *tensors])
    tensors[1][7, 2] = poison
    assert not are_finite(tensors)
    # Opposite infinities do not cancel, and what overflows in a sum is searched.
    assert not are_finite([torch.tensor([torch.inf]), torch.tensor([-torch.inf])])
    assert not are_finite([torch.full((2,), 3e38)])
