"""`radiant export` to USD: by the name's ending, in the metres of the model or the unit of a system; without the extra one sentence."""

# usd-core comes without types.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdVol

from radiant_core import extras
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from tests.app.test_output_commands import radiant, run  # noqa: F401 the fixture of a made-up run


def positions(path: Path) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))
    return np.array(UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Splats")).GetPositionsAttr().Get())


def test_a_run_goes_out_as_usd_with_its_place(run: Path, tmp_path: Path) -> None:  # noqa: F811
    said = json.loads(radiant("export", run, tmp_path / "town.usdz", "--json"))
    assert said["format"] == "usd" and said["gaussians"] == 9000
    np.testing.assert_array_equal(positions(tmp_path / "town.usdz"), load_ply(run / "scene.ply").means)
    said = json.loads(radiant("export", run, tmp_path / "feet.usdc", "--crs", "EPSG:32631", "--json"))
    radiant("export", run, tmp_path / "same.ply", "--crs", "EPSG:32631")
    np.testing.assert_array_equal(positions(tmp_path / "feet.usdc"), load_ply(tmp_path / "same.ply").means)
    beside = json.loads((tmp_path / "feet.georef.json").read_text())
    assert beside["file"] == "feet.usdc" and "offset" in said
    assert UsdGeom.GetStageMetersPerUnit(Usd.Stage.Open(str(tmp_path / "feet.usdc"))) == 1


def test_without_the_extra_one_sentence_says_how_to_get_it(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "pxr" else object())
    with pytest.raises(BadInput, match=r"no USD can be written because pxr is not installed: .*radiant-splats\[usd\]"):
        radiant("export", run, tmp_path / "town.usdc")
    assert not (tmp_path / "town.usdc").exists()
