"""USD of Gaussians as usd-core reads it back: every value, the box of the ellipsoids, all of its validators silent."""

# usd-core comes without types.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdValidation, UsdVol
from scipy.spatial.transform import Rotation
from scipy.special import expit

from radiant_core.errors import BadInput
from radiant_core.export.usd import SUFFIXES, ellipsoid_extent, save_usd
from radiant_core.splats import SH_BASES, Splats
from tests.core.io.test_sog import model


def with_degree(count: int, degree: int) -> Splats:
    """Gaussians whose harmonics are all different."""
    splats = model(count)
    rest = np.random.default_rng(degree).normal(size=(count, SH_BASES[degree] - 1, 3)).astype(np.float32)
    return replace(splats, shN=rest)


def opened(path: Path) -> tuple[Usd.Stage, UsdVol.ParticleField3DGaussianSplat]:
    stage = Usd.Stage.Open(str(path))
    (prim,) = [each for each in stage.Traverse() if each.IsA(UsdVol.ParticleField3DGaussianSplat)]
    return stage, UsdVol.ParticleField3DGaussianSplat(prim)


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_usd_core_reads_back_every_value(suffix: str, degree: int, tmp_path: Path) -> None:
    splats = with_degree(200, degree)
    save_usd(tmp_path / f"town{suffix}", splats)
    assert [path.name for path in tmp_path.iterdir()] == [f"town{suffix}"]
    _, prim = opened(tmp_path / f"town{suffix}")
    # Text keeps nine digits, which is float32 exactly.
    np.testing.assert_array_equal(np.array(prim.GetPositionsAttr().Get()), splats.means)
    np.testing.assert_array_equal(np.array(prim.GetScalesAttr().Get()), np.exp(splats.log_scales))
    np.testing.assert_allclose(np.array(prim.GetOpacitiesAttr().Get()), expit(splats.logit_opacities), atol=1e-6)
    quats = np.array([[quat.GetReal(), *quat.GetImaginary()] for quat in prim.GetOrientationsAttr().Get()])
    np.testing.assert_allclose(quats, splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True), atol=1e-6)
    assert prim.GetRadianceSphericalHarmonicsDegreeAttr().Get() == degree
    coefficients = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()).reshape(200, SH_BASES[degree], 3)
    np.testing.assert_array_equal(coefficients[:, :1], splats.sh0)
    np.testing.assert_array_equal(coefficients[:, 1:], splats.shN)


def test_the_box_holds_the_surface_of_every_ellipsoid_and_no_more(tmp_path: Path) -> None:
    splats = model(60)
    save_usd(tmp_path / "a.usdc", splats)
    stage, prim = opened(tmp_path / "a.usdc")
    low, high = (np.array(corner) for corner in prim.GetExtentAttr().Get())
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = np.concatenate(
        [
            mean + 3 * (directions * np.exp(log_scales)) @ Rotation.from_quat(quat, scalar_first=True).as_matrix().T
            for mean, quat, log_scales in zip(splats.means, splats.quats, splats.log_scales, strict=True)
        ]
    )
    span = high - low
    assert (surface >= low - 1e-5 * span).all() and (surface <= high + 1e-5 * span).all()
    # 20,000 directions come within a thousandth of the farthest one.
    np.testing.assert_allclose([surface.min(axis=0), surface.max(axis=0)], [low, high], atol=1e-3 * span.max())
    box = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_]).ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedBox()
    np.testing.assert_allclose([box.GetMin(), box.GetMax()], [low, high], rtol=1e-6)
    np.testing.assert_array_equal(ellipsoid_extent(splats), [low, high])


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_all_validators_of_usd_are_silent(suffix: str, tmp_path: Path) -> None:
    save_usd(tmp_path / f"valid{suffix}", with_degree(30, 2), meters_per_unit=0.3048, about=["origin 47 8 430", "antialiased"])
    stage, _ = opened(tmp_path / f"valid{suffix}")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 20
    assert [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)] == []
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.3048 and UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert stage.GetRootLayer().customLayerData["radiant:about"] == "origin 47 8 430\nantialiased"


def test_nothing_is_written_of_no_gaussians(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="without Gaussians"):
        save_usd(tmp_path / "none.usdc", model(1).select(np.zeros(0, np.int64)))
    assert list(tmp_path.iterdir()) == []
