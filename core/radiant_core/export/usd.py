"""Gaussians as OpenUSD's ParticleField3DGaussianSplat (USD 26.03 and later), by Pixar's usd-core.
Once per export.

    /Scene          the default prim, an Xform
    /Scene/Splats   positions, orientations (real part first), scales (standard deviations, exp of
                    the stored), opacities (sigmoid of the stored), harmonics: (degree + 1)² triples
                    a Gaussian, the constant one first

`extent` is what nothing computes and viewers frame a scene by: the box around all ellipsoids of
three standard deviations, centre ± 3 √diag(R S² Rᵀ). Positions stay float32, since halves are wrong
by centimetres at 100 m. z is up, and the numbers stay as they are. The schema has no word for
antialiased opacities: that stands in the layer's own data. `.usda` is text, `.usdz` a package.
"""

# usd-core comes without types.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput, CannotWrite, way_to_write
from radiant_core.io.run_store import atomic_path, require_room
from radiant_core.numerics import FloatArray, rotmats_from_quats, unit_quats
from radiant_core.splats import Splats

SUFFIXES = (".usd", ".usdc", ".usda", ".usdz")
EXTENT_SIGMAS = 3.0
ROOT, SPLATS = "/Scene", "/Scene/Splats"
AT_ONCE = 1 << 20


def save_usd(path: Path, splats: Splats, meters_per_unit: float = 1.0, about: Sequence[str] = ()) -> None:
    """Write at least one Gaussian to a file with one of `SUFFIXES`, atomically, with lines of text
    `about` it in the layer's own data. Raises BadInput without any, CannotWrite if it fails."""
    from pxr import Tf, UsdUtils

    if not len(splats):
        raise BadInput("a model without Gaussians cannot be written as USD: nothing would be drawn.")
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder, atomic_path(path) as temporary:
            layer = Path(folder) / f"scene{'.usdc' if path.suffix.lower() in ('.usd', '.usdz') else path.suffix.lower()}"
            _write_stage(layer, splats, meters_per_unit, about)
            if path.suffix.lower() == ".usdz":
                package = Path(folder) / "package.usdz"
                if not UsdUtils.CreateNewUsdzPackage(str(layer), str(package)):
                    require_room(path.parent)
                    raise CannotWrite(f"cannot write {path}: the package of its layer failed: write .usdc instead.")
                layer = package
            layer.replace(temporary)
    except (OSError, Tf.ErrorException) as error:
        raise CannotWrite(f"cannot write {path}: {error}: {way_to_write(error)}.") from error


def ellipsoid_extent(splats: Splats) -> NDArray[np.float32]:
    """Corners (2,3) of the box around all Gaussians up to `EXTENT_SIGMAS` standard deviations."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, len(splats), AT_ONCE):
        part = splats.select(np.arange(start, min(start + AT_ONCE, len(splats))))
        reach = EXTENT_SIGMAS * np.sqrt(_variances(part))
        low = np.minimum(low, (part.means - reach).min(axis=0))
        high = np.maximum(high, (part.means + reach).max(axis=0))
    return np.array([low, high], np.float32)


def _variances(splats: Splats) -> FloatArray:
    """Of each Gaussian along x, y and z (N,3): the diagonal of R S² Rᵀ."""
    rotations = rotmats_from_quats(splats.quats)
    return np.einsum("nij,nj->ni", rotations**2, np.exp(2 * splats.log_scales.astype(np.float64)))


def _write_stage(path: Path, splats: Splats, meters_per_unit: float, about: Sequence[str]) -> None:
    from pxr import Usd, UsdGeom, UsdVol

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, ROOT).GetPrim())
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, SPLATS)
    _fill(prim, splats)
    metadata: dict[str, Any] = {"radiant:about": "\n".join(about)} if about else {}
    if splats.antialiased:
        metadata["radiant:antialiased"] = True
    if metadata:
        stage.GetRootLayer().customLayerData = metadata
    _require_lengths(prim, len(splats), splats.sh_degree)
    stage.GetRootLayer().Save()


def _fill(prim: Any, splats: Splats) -> None:
    from pxr import UsdVol, Vt

    tokens = UsdVol.Tokens
    # USD keeps a quaternion's real part last in memory, whatever it prints.
    xyzw = np.ascontiguousarray(unit_quats(splats.quats)[:, [1, 2, 3, 0]], np.float32)
    harmonics = np.concatenate([splats.sh0, splats.shN], axis=1).reshape(-1, 3)
    prim.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(splats.means)))
    prim.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(xyzw))
    prim.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.exp(splats.log_scales)))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(np.ascontiguousarray(splats.opacities, np.float32)))
    # The schema takes degree 3 where none is said.
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(splats.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(harmonics, np.float32)))
    prim.CreateProjectionModeHintAttr(tokens.perspective)
    prim.CreateSortingModeHintAttr(tokens.zDepth)
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(ellipsoid_extent(splats)))


def _require_lengths(prim: Any, count: int, degree: int) -> None:
    """Readers cut longer arrays and leave out shorter ones without a word, and no validator
    counts them."""
    wanted = {
        prim.GetPositionsAttr(): count,
        prim.GetOrientationsAttr(): count,
        prim.GetScalesAttr(): count,
        prim.GetOpacitiesAttr(): count,
        prim.GetRadianceSphericalHarmonicsCoefficientsAttr(): count * (degree + 1) ** 2,
        prim.GetExtentAttr(): 2,
    }
    for attribute, length in wanted.items():
        assert len(attribute.Get()) == length, f"{attribute.GetName()} has {len(attribute.Get())} values, expected {length}"
