"""What Open3D is given is what it reads itself from our PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.open3d_formats import open3d_point_cloud
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
    np.testing.assert_allclose(rot, [[1, 0, 0, 0], [0.5**0.5, 0, 0, 0.5**0.5]], atol=1e-7)  # one float32 rounding


def test_what_it_cannot_draw_is_bad_input() -> None:
    with pytest.raises(BadInput, match="max_sh_degree"):
        open3d_point_cloud(unit_splats(1, 0), max_sh_degree=4)
    arrays = dict(unit_splats(1, 0).arrays())
    arrays["log_scales"] = np.full((1, 3), 100.0, np.float32)
    with pytest.raises(BadInput, match="log scale 100"):
        open3d_point_cloud(Splats(**arrays))
