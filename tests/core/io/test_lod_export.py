"""Streamed SOG: what is written comes back level by level, also through the format's own tool."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.export.lod import LodFigures, save_lod
from radiant_core.export.sog import save_sog, save_sog_folder
from radiant_core.io.lod_reader import load_lod_level, load_lod_meta
from radiant_core.io.ply import load_ply
from radiant_core.io.sog_reader import load_sog
from radiant_core.lod.cells import whole_region
from radiant_core.lod.levels import LodLimits
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats, morton_order
from tests.core.lod.test_levels import SMALL, at, square
from tests.core.lod.test_merging import made_up
from tests.core.scenes import cameras_above, ground_splats


def written(folder: Path, splats: Splats, limits: LodLimits = SMALL) -> LodFigures:
    folder.mkdir()
    return save_lod(folder, splats, [square(-20.0), square(0.0)], limits)


def test_every_level_comes_back_with_its_count_and_the_finest_looks_the_same(tmp_path: Path) -> None:
    ground = ground_splats(900)
    sky = at(made_up(30, 5, degree=0), (4000, 0, 900))
    figures = written(tmp_path / "lod", concatenate_splats([ground, sky]))
    meta = load_lod_meta(tmp_path / "lod" / "lod-meta.json")
    assert meta.counts == figures.counts and figures.num_far == 30 and meta.environment == "env/meta.json"
    assert meta.counts[0] == 900 and len(meta.files[0]) == figures.num_chunks > 2
    cameras = cameras_above([(0.0, 0.0), (1.0, 1.0)], size_wh=(96, 72))
    back = load_lod_level(tmp_path / "lod" / "lod-meta.json")
    assert len(back) == 930
    for truth, found in zip(render_views(ground, cameras), render_views(back, cameras), strict=True):
        # 256 values of each colour and scale, 8 bits of opacity: about 8 bits of every pixel.
        assert -10 * np.log10(((truth.image - found.image) ** 2).mean()) > 45
    for level in (1, 2):
        assert len(load_lod_level(tmp_path / "lod" / "lod-meta.json", level)) == meta.counts[level] + 30
    with pytest.raises(BadInput, match="has 0 to 2"):
        load_lod_level(tmp_path / "lod" / "lod-meta.json", 3)


def test_chunks_of_other_regions_keep_their_bytes(tmp_path: Path) -> None:
    splats = made_up(700)
    west, east = splats.select(splats.means[:, 0] < -1), splats.select(splats.means[:, 0] > 1)
    written(tmp_path / "before", concatenate_splats([west, east]))
    written(tmp_path / "after", concatenate_splats([west, at(east, (0, 0, 0.5)), made_up(5).select([0])]))
    names = {path.relative_to(tmp_path / "before") for path in (tmp_path / "before").glob("*_*/*")}
    of_west = {name for name in names if int(name.parts[0].split("_")[1]) % 1000 == 0}
    assert of_west and of_west < names
    assert all((tmp_path / "before" / name).read_bytes() == (tmp_path / "after" / name).read_bytes() for name in of_west)
    assert any((tmp_path / "before" / name).read_bytes() != (tmp_path / "after" / name).read_bytes() for name in names - of_west)


def test_the_same_model_gives_the_same_bytes_and_nothing_but_gaussians(tmp_path: Path) -> None:
    for name in ("a", "b"):
        written(tmp_path / name, made_up(300))
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert all((tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes() for file in files)
    assert {file.suffix for file in files} == {".json", ".webp"}
    assert json.loads((tmp_path / "a" / "lod-meta.json").read_text())["asset"].keys() == {"generator"}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_our_reader_reads_both_forms_of_sog(tmp_path: Path, degree: int) -> None:
    splats = replace(made_up(200, degree=degree), antialiased=degree == 2)
    errors = save_sog(tmp_path / "a.sog", splats)
    ordered = splats.select(morton_order(splats.means))
    save_sog_folder(tmp_path / "a", ordered)
    zipped, loose = load_sog(tmp_path / "a.sog"), load_sog(tmp_path / "a" / "meta.json")
    assert all(np.array_equal(a, b) for a, b in zip(zipped.arrays().values(), loose.arrays().values(), strict=True))
    assert zipped.antialiased == splats.antialiased and zipped.sh_degree == degree
    assert np.abs(zipped.means - ordered.means).max() <= errors.position_max_m * (1 + 1e-3)
    assert np.abs(zipped.opacities - ordered.opacities).max() <= 0.5 / 255 + 1e-6
    unit = ordered.quats / np.linalg.norm(ordered.quats, axis=1, keepdims=True)
    assert np.abs((zipped.quats * unit).sum(axis=1)).min() > np.cos(0.01)


def test_an_antialiased_model_says_so_in_the_words_of_others(tmp_path: Path) -> None:
    save_sog_folder(tmp_path / "a", replace(made_up(3), antialiased=True))
    assert json.loads((tmp_path / "a" / "meta.json").read_text())["model"] == "antialiased"
    save_sog_folder(tmp_path / "b", made_up(3))
    assert "model" not in json.loads((tmp_path / "b" / "meta.json").read_text())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"version": 2}, "version"),
        ({"counts": [1, 2, 3]}, "counts"),
        ({"filenames": ["../x/meta.json"]}, "below"),
        ({"environment": "/etc/passwd"}, "below"),
        ({"lodLevels": 10**9}, "lodLevels"),
        ({"tree": {"bound": {"min": [0, 0, 0], "max": [-1, 0, 0]}, "lods": {}}}, "goes from"),
        ({"surplus": 1}, "no lod-meta"),
    ],
)
def test_what_is_wrong_in_a_strangers_file_is_named(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    written(tmp_path / "lod", made_up(60))
    path = tmp_path / "lod" / "lod-meta.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(BadInput, match=sentence) as error:
        load_lod_meta(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_texture_of_another_folder_is_refused(tmp_path: Path) -> None:
    save_sog_folder(tmp_path / "a", made_up(3))
    path = tmp_path / "a" / "meta.json"
    path.write_text(path.read_text().replace("quats.webp", "../quats.webp"))
    with pytest.raises(BadInput, match="does not lie beside"):
        load_sog(path)


def test_no_gaussians_and_a_folder_that_is_there_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no Gaussians"):
        save_lod(tmp_path, made_up(0), [square(0.0)])
    with pytest.raises(BadInput, match="cannot make"):
        save_sog_folder(tmp_path, made_up(3))


@pytest.mark.skipif(shutil.which("splat-transform") is None, reason="needs splat-transform of npm's @playcanvas/splat-transform on PATH")
def test_splat_transform_reads_every_level(tmp_path: Path) -> None:
    splats = made_up(3000, degree=2)
    folder = tmp_path / "lod"
    folder.mkdir()
    figures = save_lod(folder, splats, [whole_region(splats.means)], replace(SMALL, chunk_count=1000))
    for level, count in enumerate(figures.counts):
        out = tmp_path / f"{level}.ply"
        subprocess.run(["splat-transform", "-L", str(level), str(folder / "lod-meta.json"), str(out)], check=True, capture_output=True)
        back, own = load_ply(out), load_lod_level(folder / "lod-meta.json", level)
        assert len(back) == count
        near = own.select(np.arange(count))
        order_back, order_own = np.lexsort(back.means.T), np.lexsort(near.means.T)
        assert back.means[order_back] == pytest.approx(near.means[order_own], abs=1e-5)
        assert back.log_scales[order_back] == pytest.approx(near.log_scales[order_own], abs=1e-5)
        assert back.shN[order_back] == pytest.approx(near.shN[order_own], abs=1e-5)
