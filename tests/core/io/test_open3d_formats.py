"""What Open3D is given is what it reads itself from our PLY."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io import open3d_formats
from radiant_core.io.open3d_formats import open3d_point_cloud, splats_from_spz, spz_bytes
from radiant_core.io.ply import save_ply
from radiant_core.splats import SH_BASES, Splats


def unit_splats(count: int, degree: int) -> Splats:
    rng = np.random.default_rng(4)
    quats = rng.standard_normal((count, 4), dtype=np.float32)
    return Splats(
        means=rng.standard_normal((count, 3), dtype=np.float32),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        log_scales=rng.standard_normal((count, 3), dtype=np.float32),
        logit_opacities=rng.standard_normal(count, dtype=np.float32),
        sh0=rng.standard_normal((count, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((count, SH_BASES[degree] - 1, 3), dtype=np.float32),
    )


@pytest.mark.parametrize("degree", [1, 2])
def test_the_cloud_equals_what_open3d_reads_from_the_ply(tmp_path: Path, degree: int) -> None:
    import open3d as o3d

    splats = unit_splats(40, degree)
    save_ply(tmp_path / "a.ply", splats)
    read = o3d.t.io.read_point_cloud(tmp_path / "a.ply").point
    given = open3d_point_cloud(splats).point
    for name in ("positions", "scale", "rot", "opacity", "f_dc", "f_rest"):
        assert given[name].shape == read[name].shape, name
        assert given[name].dtype == read[name].dtype, name
        # A float32 exponential and a normalisation: a few units in the last place of values near 1.
        np.testing.assert_allclose(given[name].numpy(), read[name].numpy(), rtol=5e-7, atol=2e-7, err_msg=name)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_beyond_the_shader_are_cut(degree: int) -> None:
    assert open3d_point_cloud(unit_splats(3, 3), max_sh_degree=degree).point.f_rest.shape[1] == SH_BASES[degree] - 1


def test_quaternions_of_any_length_become_unit_and_zero_the_identity() -> None:
    arrays = dict(unit_splats(2, 0).arrays())
    arrays["quats"] = np.array([[0, 0, 0, 0], [1e-30, 0, 0, 1e-30]], np.float32)
    rot = open3d_point_cloud(Splats(**arrays)).point.rot.numpy()
    # One float32 rounding.
    np.testing.assert_allclose(rot, [[1, 0, 0, 0], [0.5**0.5, 0, 0, 0.5**0.5]], atol=1e-7)


def test_what_it_cannot_draw_is_bad_input() -> None:
    with pytest.raises(BadInput, match="max_sh_degree"):
        open3d_point_cloud(unit_splats(1, 0), max_sh_degree=4)
    arrays = dict(unit_splats(1, 0).arrays())
    arrays["log_scales"] = np.full((1, 3), 100.0, np.float32)
    with pytest.raises(BadInput, match="log scale 100"):
        open3d_point_cloud(Splats(**arrays))


def test_opacities_at_the_ends_of_spz_come_back_as_a_quarter_of_its_last_step() -> None:
    splats = replace(unit_splats(3, 1), logit_opacities=np.array([-40, 0, 40], np.float32))
    again = splats_from_spz(spz_bytes(splats), 3, 1)
    end = np.log((255 - 0.25) / 0.25)
    # 0.5 is 127.5 of 255 steps.
    np.testing.assert_allclose(again.logit_opacities, [-end, 0, end], atol=0.01)
    np.testing.assert_allclose(again.log_scales, splats.log_scales, atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(np.linalg.norm(again.quats, axis=1), 1, atol=1e-6)
    assert again.shN.shape == (3, 3, 3) and splats_from_spz(spz_bytes(unit_splats(2, 0)), 2, 0).shN.shape == (2, 0, 3)


def test_spz_of_another_count_degree_or_length_is_refused_before_open3d_sees_it() -> None:
    data = spz_bytes(unit_splats(3, 1))
    for wrong, count, degree in (
        (data, 4, 1),
        (data, 3, 0),
        (data, 3, 2),
        (data + b"x", 3, 1),
        (data[:-1], 3, 1),
        (data[:40], 3, 1),
        (b"", 3, 1),
    ):
        told = f"these {len(wrong)} bytes are no SPZ of version 4 with {count} Gaussians of degree {degree}: send it again"
        with pytest.raises(StoreDamaged, match=told):
            splats_from_spz(wrong, count, degree)
    for at in (0, 4, 8, 12):
        with pytest.raises(StoreDamaged, match="no SPZ of version 4"):
            splats_from_spz(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :], 3, 1)


def test_what_a_library_prints_meanwhile_goes_to_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    with open3d_formats._log_instead_of_output():
        os.write(1, b"inside")
    os.write(1, b"outside")
    assert capfd.readouterr() == ("outside", "inside")


@pytest.mark.parametrize("degree", [-1, 4])
def test_a_degree_is_0_to_3(degree: int) -> None:
    with pytest.raises(BadInput, match=f"max_sh_degree is {degree}, expected 0 to 3"):
        open3d_point_cloud(unit_splats(1, 0), max_sh_degree=degree)


def test_a_model_that_packs_well_is_read() -> None:
    one = unit_splats(1, 1).select(np.zeros(20_000, np.int64))
    data = spz_bytes(one)
    assert len(data) < 20_000 * 29 / 100
    np.testing.assert_allclose(splats_from_spz(data, 20_000, 1).means, one.means, atol=1 / 4096)


def test_the_flag_of_spz_says_how_a_model_is_drawn() -> None:
    plain = spz_bytes(unit_splats(3, 0))
    marked = spz_bytes(replace(unit_splats(3, 0), antialiased=True))
    assert [index for index, (a, b) in enumerate(zip(plain, marked, strict=True)) if a != b] == [14] and marked[14] == plain[14] | 1
    assert splats_from_spz(marked, 3, 0).antialiased and not splats_from_spz(plain, 3, 0).antialiased
