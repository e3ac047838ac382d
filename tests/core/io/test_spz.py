"""SPZ of versions 2 and 3: what comes back, what Open3D reads of it, and what is refused."""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.choices import GzipSpzVersion
from radiant_core.errors import BadInput
from radiant_core.export.scene import save_spz
from radiant_core.io.spz import fraction_bits_for, gzip_spz_bytes, splats_from_gzip_spz
from radiant_core.lod.merging import covariances
from tests.core.lod.test_merging import made_up


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_open3d_reads_what_our_reader_reads(tmp_path: Path, version: GzipSpzVersion, degree: int) -> None:
    import open3d as o3d

    splats = replace(made_up(200, degree=degree), antialiased=degree == 1)
    data = gzip_spz_bytes(splats, version)
    assert data == gzip_spz_bytes(splats, version), "no time in it"
    own = splats_from_gzip_spz(data)
    assert own.antialiased == splats.antialiased and own.sh_degree == degree
    (tmp_path / "a.spz").write_bytes(data)
    point = {name: tensor.numpy() for name, tensor in o3d.t.io.read_point_cloud(tmp_path / "a.spz").point.items()}
    # Floats of two programs, a few units in the last place.
    assert point["positions"] == pytest.approx(own.means, abs=1e-6)
    assert np.log(point["scale"]) == pytest.approx(own.log_scales, abs=1e-6)
    assert np.abs((point["rot"] * own.quats).sum(axis=1)) == pytest.approx(1, abs=1e-6)
    assert point["f_dc"] == pytest.approx(own.sh0[:, 0], abs=1e-6)
    assert degree == 0 or point["f_rest"] == pytest.approx(own.shN, abs=1e-6)


@pytest.mark.parametrize("version", [2, 3])
def test_an_ellipsoid_keeps_its_shape_although_version_2_has_three_bytes_for_its_rotation(version: GzipSpzVersion) -> None:
    splats = made_up(2000)
    needles = replace(splats, log_scales=np.tile(np.float32([-4, -1, -4]), (2000, 1)))
    for model, limit in ((splats, 0.07), (needles, 0.02)):
        back = splats_from_gzip_spz(gzip_spz_bytes(model, version))
        error = np.linalg.norm(covariances(back) - covariances(model), axis=(1, 2)) / np.linalg.norm(covariances(model), axis=(1, 2))
        # Of the first, scales are off by 1/32 of their logarithms; of needles, which scales of a
        # sixteenth hold, the rotation alone: half a step of 1/127.5 on three axes is 0.8°.
        assert error.max() < limit


def test_steps_of_centres_follow_the_gaussians_and_the_room_that_is_needed() -> None:
    splats = made_up(100)
    fine = replace(splats, means=splats.means * np.float32(1e-3), log_scales=splats.log_scales - 7)
    far = replace(splats, means=splats.means * np.float32(1e4))
    assert fraction_bits_for(splats) == 12 < fraction_bits_for(fine) and fraction_bits_for(far) < 12
    for model in (splats, fine, far):
        bits = fraction_bits_for(model)
        back = splats_from_gzip_spz(gzip_spz_bytes(model, 2, bits))
        assert np.abs(back.means - model.means).max() <= 2.0**-bits
    with pytest.raises(BadInput, match="beyond 2048 units"):
        gzip_spz_bytes(far, 3)
    with pytest.raises(BadInput, match="without Gaussians"):
        gzip_spz_bytes(made_up(0), 3)


def test_a_foreign_or_broken_spz_is_one_sentence() -> None:
    data = gzip_spz_bytes(made_up(5, degree=1), 3)
    raw = zlib.decompress(data, 31)

    def packed(content: bytes) -> bytes:
        packer = zlib.compressobj(wbits=31)
        return packer.compress(content) + packer.flush()

    assert len(splats_from_gzip_spz(packed(raw))) == 5
    for wrong in (b"", b"NGSP", data[:-9], data + b"x", packed(raw + b"x"), packed(raw[:-1]), packed(raw[:9]), packed(b"x" + raw[1:])):
        with pytest.raises(BadInput, match="SPZ"):
            splats_from_gzip_spz(wrong)
    for at, value in ((4, 4), (8, 0), (11, 255), (12, 4), (13, 24)):
        with pytest.raises(BadInput, match="SPZ"):
            splats_from_gzip_spz(packed(raw[:at] + bytes([value]) + raw[at + 1 :]))


def test_the_three_versions_of_a_file_say_so(tmp_path: Path) -> None:
    splats = made_up(20)
    for version in (2, 3, 4):
        save_spz(tmp_path / f"{version}.spz", splats, version)
        data = (tmp_path / f"{version}.spz").read_bytes()
        head = data if version == 4 else zlib.decompress(data, 31)
        assert head[:4] == b"NGSP" and head[4] == version
