"""Model files of other programs: what they mean by numbers, what becomes of bad ones, and that no
file gets more memory than its bytes can fill.

The right values come from programs that write or read the format on their own: gsplat 1.5.3's
exporter and Open3D 0.20, which are installed, and PlayCanvas's splat-transform 2.7.1, whose files of
the five Gaussians below are kept in base64 with what it reads of them.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import struct
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.export.lod import META_NAME, save_lod
from radiant_core.export.scene import save_spz
from radiant_core.export.sog import save_sog, save_sog_folder
from radiant_core.io import claimed_counts
from radiant_core.io.lod_reader import load_lod_level
from radiant_core.io.model_reader import SPZ_AXES, ModelKind, model_kind, read_model
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import save_splats
from radiant_core.io.sog_reader import load_sog
from radiant_core.io.spz import splats_from_gzip_spz
from radiant_core.io.stored_gaussians import END_LOGIT, FLAT_LOG_SCALE
from radiant_core.lod.cells import whole_region
from radiant_core.lod.levels import LodLimits
from radiant_core.numerics import unit_quats
from radiant_core.splats import Splats, morton_order
from tests.core.lod.test_merging import made_up

FIVE = Splats(
    means=[[-1.725, 0.276, -6.335], [-4.191, -2.27, -0.667], [2.214, 0.337, -1.28], [-0.952, -0.653, -0.936], [-2.382, -2.192, -0.192]],
    quats=[
        [-0.28, -0.983, 0.165, 0.278],
        [-0.622, -0.396, 0.065, 1.165],
        [-1.435, -0.342, 2.191, -0.56],
        [-1.371, 0.398, -0.074, 0.766],
        [0.119, -0.297, 0.723, -0.603],
    ],
    log_scales=[
        [-3.812, -4.634, -2.114],
        [-4.607, -3.138, -1.54],
        [-2.83, -3.678, -1.497],
        [-1.146, -4.164, -4.124],
        [-5.622, -3.171, -4.065],
    ],
    logit_opacities=[2.047, -1.556, 1.551, 2.883, -0.34],
    sh0=[[[1.401, -0.833, 0.443]], [[-0.754, 0.535, 1.081]], [[-0.179, 0.506, 0.661]], [[-0.348, 0.351, 0.06]], [[0.086, 0.384, -0.62]]],
    shN=np.array(
        [
            [0.018, -0.039, 0.217, -0.123, 0.188, -0.139, -0.116, 0.045, 0.252],
            [-0.067, 0.106, -0.259, -0.236, -0.186, -0.3, -0.117, 0.124, 0.042],
            [0.044, 0.136, 0.055, 0.218, -0.246, 0.076, -0.113, 0.292, 0.118],
            [-0.113, 0.2, -0.208, -0.072, 0.387, 0.104, 0.103, -0.19, 0.028],
            [-0.001, -0.313, -0.074, 0.37, 0.424, -0.231, -0.105, 0.062, 0.002],
        ]
    )
    .reshape(5, 3, 3)
    .transpose(0, 2, 1),
)
"""Of no order and no symmetry, so that an axis or a component in another's place shows."""

BY_SPLAT_TRANSFORM = {
    "a.spz": (
        "H4sIAAAAAAAAAwGhAF7/TkdTUAMAAAAFAAAAAQwAAGbk/5b7/1xlAPK8/1IkAKwKAG0jAJz6/3sUAMXw/3MKAPoOAOPZ/xIjABIDAOIs0vFqtW"
        "CQY5SpeZOZco2Cg45oY1Z+Vm6Hc2WIjl1eRm1fvezyBkaJ8IyAWcpFVYUY61bajk2AkJCIaHigcKCIoJBwmHBgWIh4aJBwoFiIiJCQiHBoUJho"
        "kIiAUJCoSHh4YIBPArXvoQAAAA=="
    ),
    "b.spz": (
        "TkdTUAQAAAAFAAAAAQwABiAAAAAAAAAAAAAAAAAAAAA2AAAAAAAAAC0AAAAAAAAADgAAAAAAAAAFAAAAAAAAABgAAAAAAAAADwAAAAAAAAAYAA"
        "AAAAAAAA8AAAAAAAAAHQAAAAAAAAAUAAAAAAAAADMAAAAAAAAALQAAAAAAAAAotS/9IC1pAQBm5P+W+/9cZQDyvP9SJACsCgBtIwCc+v97FADF"
        "8P9zCgD6DgDj2f8SIwASAwAotS/9IAUpAADiLNLxaii1L/0gD3kAALVgkGOUqXmTmXKNgoOOaCi1L/0gD3kAAGNWflZuh3NliI5dXkZtXyi1L/"
        "0gFKEAAL3s8gZGifCMgFnKRVWFGOtW2o5NKLUv/SAtVQEA0oIJEcAlHW7YJ1LDYSrV98P+/68LJGaAYKG+IWO/DcU3DYKDV4s161MA"
    ),
    "c.compressed.ply": (
        "cGx5CmZvcm1hdCBiaW5hcnlfbGl0dGxlX2VuZGlhbiAxLjAKY29tbWVudCBHZW5lcmF0ZWQgYnkgc3BsYXQtdHJhbnNmb3JtIDIuNy4xCmVsZW"
        "1lbnQgY2h1bmsgMQpwcm9wZXJ0eSBmbG9hdCBtaW5feApwcm9wZXJ0eSBmbG9hdCBtaW5feQpwcm9wZXJ0eSBmbG9hdCBtaW5fegpwcm9wZXJ0"
        "eSBmbG9hdCBtYXhfeApwcm9wZXJ0eSBmbG9hdCBtYXhfeQpwcm9wZXJ0eSBmbG9hdCBtYXhfegpwcm9wZXJ0eSBmbG9hdCBtaW5fc2NhbGVfeA"
        "pwcm9wZXJ0eSBmbG9hdCBtaW5fc2NhbGVfeQpwcm9wZXJ0eSBmbG9hdCBtaW5fc2NhbGVfegpwcm9wZXJ0eSBmbG9hdCBtYXhfc2NhbGVfeApw"
        "cm9wZXJ0eSBmbG9hdCBtYXhfc2NhbGVfeQpwcm9wZXJ0eSBmbG9hdCBtYXhfc2NhbGVfegpwcm9wZXJ0eSBmbG9hdCBtaW5fcgpwcm9wZXJ0eS"
        "BmbG9hdCBtaW5fZwpwcm9wZXJ0eSBmbG9hdCBtaW5fYgpwcm9wZXJ0eSBmbG9hdCBtYXhfcgpwcm9wZXJ0eSBmbG9hdCBtYXhfZwpwcm9wZXJ0"
        "eSBmbG9hdCBtYXhfYgplbGVtZW50IHZlcnRleCA1CnByb3BlcnR5IHVpbnQgcGFja2VkX3Bvc2l0aW9uCnByb3BlcnR5IHVpbnQgcGFja2VkX3"
        "JvdGF0aW9uCnByb3BlcnR5IHVpbnQgcGFja2VkX3NjYWxlCnByb3BlcnR5IHVpbnQgcGFja2VkX2NvbG9yCmVsZW1lbnQgc2ggNQpwcm9wZXJ0"
        "eSB1Y2hhciBmX3Jlc3RfMApwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfMQpwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfMgpwcm9wZXJ0eSB1Y2hhciBmX3"
        "Jlc3RfMwpwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfNApwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfNQpwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfNgpwcm9w"
        "ZXJ0eSB1Y2hhciBmX3Jlc3RfNwpwcm9wZXJ0eSB1Y2hhciBmX3Jlc3RfOAplbmRfaGVhZGVyCqwchsCuRxHAUrjKwC2yDUBEi6w+pptEvm3ns8"
        "C6SZTAz/eDwCGwkr/+1EjAsp2/vw4Zkz4NsIc+q3OmPswsZT++oiY/1xBOPwA4n2JEQcZrHgaAZ+KfAP9hBwAAIsKky93/Hzos//8A//9ASEmc"
        "ZKUuQB8AagDjYwffc4GqhOgUAAjq//Fm3TCU/v//aZH2h/93tJ/SwPpEgH6GfIZ7fIGIfYN3eHp2fIOBf3V9i414fIGAfIZ5fYyDg3mAgYSBhn"
        "iCfImD"
    ),
}
"""splat-transform 2.7.1: SPZ of version 3, of version 4, and the compressed PLY of `FIVE`."""
FIRST_BY_SPLAT_TRANSFORM = {
    "a.spz": (
        [-1.72509765625, 0.27587890625, -6.3349609375],
        [0.2615326, 0.9170871, -0.1535985, -0.2587651],
        [1.3986928, -0.8235293, 0.4313727],
    ),
    "b.spz": (
        [-1.72509765625, 0.27587890625, -6.3349609375],
        [0.2615326, 0.9170871, -0.1535985, -0.2587651],
        [1.3986928, -0.8235293, 0.4313727],
    ),
    "c.compressed.ply": ([-1.7253722, 0.2758387, -6.335], [0.2605858, 0.9171421, -0.1541396, -0.2592034], [1.401, -0.833, 0.4406235]),
}
"""Centre, rotation wxyz and base colour of its first Gaussian, as splat-transform writes them to
CSV."""
HALF_TURN = np.array([1, -1, -1])
"""splat-transform turns SPZ by 180° about x on the way in and out; Open3D and we do not."""


def near(found: Splats, wanted: Splats, tolerances: dict[str, float]) -> None:
    for name, tolerance in tolerances.items():
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=tolerance), name
    assert np.abs((unit_quats(found.quats) * unit_quats(wanted.quats)).sum(axis=1)).min() > 1 - 1e-4


@pytest.mark.parametrize("name", list(BY_SPLAT_TRANSFORM))
def test_files_of_splat_transform_mean_what_it_reads_of_them(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(base64.b64decode(BY_SPLAT_TRANSFORM[name]))
    read = read_model(tmp_path / name)
    flip = HALF_TURN if name.endswith(".spz") else np.ones(3)
    mean, quat, color = FIRST_BY_SPLAT_TRANSFORM[name]
    order = np.argsort(np.abs(read.splats.means - flip * np.array(mean)).max(axis=1))
    first = read.splats.select(order[:1])
    assert first.means[0] == pytest.approx(flip * np.array(mean), abs=1e-6)
    # A half turn about x turns the axis of a rotation as it turns a place.
    assert abs(first.quats[0] @ np.array([quat[0], *(flip * np.array(quat[1:]))])) == pytest.approx(1, abs=1e-6)
    assert first.sh0[0, 0] == pytest.approx(color, abs=1e-6)
    turned = replace(FIVE, means=FIVE.means * flip, quats=FIVE.quats * np.array([1, *flip]))
    # A step of each format; harmonics are rounded to 1/128 and then to 1/16. splat-transform turns
    # those too, by the signs (−, −, +) of y z x.
    signs = np.array([-1, -1, 1]) if name.endswith(".spz") else np.ones(3)
    turned = replace(turned, shN=FIVE.shN * signs[None, :, None])
    steps = {"means": 2e-3, "log_scales": 0.032, "logit_opacities": 0.06, "sh0": 0.014, "shN": 1 / 32 + 1 / 256}
    near(read.splats.select(np.argsort(read.splats.means[:, 0])), turned.select(np.argsort(turned.means[:, 0])), steps)
    assert any(SPZ_AXES in note for note in read.notes) == name.endswith(".spz")


@pytest.mark.parametrize(("form", "name"), [("ply", "a.ply"), ("ply_compressed", "a.compressed.ply"), ("splat", "a.splat")])
def test_what_gsplat_exports_is_read(tmp_path: Path, form: str, name: str) -> None:
    import torch
    from gsplat import export_splats

    splats = made_up(700, degree=1)
    tensors = {key: torch.from_numpy(array.copy()) for key, array in splats.arrays().items()}
    given = {"means": tensors["means"], "scales": tensors["log_scales"], "quats": tensors["quats"], "opacities": tensors["logit_opacities"]}
    export_splats(**given, sh0=tensors["sh0"], shN=tensors["shN"], format=form, save_to=str(tmp_path / name))
    found = read_model(tmp_path / name).splats
    if form == "ply":
        assert all(np.array_equal(a, b) for a, b in zip(found.arrays().values(), splats.arrays().values(), strict=True))
        return
    # Rows are sorted by place in the file: each is compared with the nearest of the model.
    nearest = np.linalg.norm(found.means[:, None] - splats.means[None], axis=2).argmin(axis=1)
    # Its compressed form leaves out what is nearly transparent.
    kept = range(700) if form == "splat" else np.flatnonzero(splats.opacities > 1 / 255)
    assert sorted(nearest.tolist()) == list(kept)
    wanted = splats.select(nearest)
    if form == "splat":
        assert np.array_equal(found.means, wanted.means) and found.shN.shape[1] == 0
        assert found.log_scales == pytest.approx(wanted.log_scales, abs=1e-5)
        # Colours and opacities are cut, not rounded, to 255 steps; colours to 0 … 1.
        shown = np.clip(0.5 + 0.28209479177387814 * wanted.sh0, 0, 1)
        assert 0.5 + 0.28209479177387814 * found.sh0 == pytest.approx(shown, abs=1 / 255 + 1e-6)
        assert found.opacities == pytest.approx(wanted.opacities, abs=1 / 255 + 1e-6)
        assert np.abs((unit_quats(found.quats) * unit_quats(wanted.quats)).sum(axis=1)).min() > np.cos(0.03)
        return
    spans = {axis: float(np.ptp(getattr(splats, axis), axis=0).max()) for axis in ("means", "log_scales")}
    near(found, wanted, {axis: span / 1023 for axis, span in spans.items()} | {"sh0": 0.05, "shN": 1 / 32 + 1e-6})
    assert found.opacities == pytest.approx(wanted.opacities, abs=0.5 / 255 + 1e-6)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_our_own_spz_is_a_model_again_and_open3d_reads_the_same_places(tmp_path: Path, version: int) -> None:
    import open3d as o3d

    path = tmp_path / "a.spz"
    save_spz(path, FIVE, version)
    found = read_model(path).splats
    wanted = FIVE if version == 4 else FIVE.select(morton_order(FIVE.means))
    assert found.means == pytest.approx(wanted.means, abs=2**-13 + 1e-6)
    assert found.logit_opacities == pytest.approx(wanted.logit_opacities, abs=0.06)
    assert o3d.t.io.read_point_cloud(path).point.positions.numpy() == pytest.approx(found.means, abs=1e-6)


def first_spz(splats: Splats) -> bytes:
    """SPZ of version 1, as Niantic's library reads it: halves for centres, else the bytes of version 2."""
    quats = unit_quats(splats.quats) * np.where(unit_quats(splats.quats)[:, :1] < 0, -1, 1)
    bytes_of = lambda values: np.clip(np.round(values), 0, 255).astype(np.uint8).tobytes()  # noqa: E731
    parts = [
        splats.means.astype("<f2").tobytes(),
        bytes_of(255 / (1 + np.exp(-splats.logit_opacities))),
        bytes_of(splats.sh0 * 0.15 * 255 + 127.5),
        bytes_of((splats.log_scales + 10) * 16),
        bytes_of(quats[:, 1:] * 127.5 + 127.5),
        bytes_of(splats.shN * 128 + 128),
    ]
    return gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 1, len(splats), splats.sh_degree, 12, 0, 0) + b"".join(parts))


def test_the_first_version_of_spz_has_halves_for_centres(tmp_path: Path) -> None:
    (tmp_path / "a.spz").write_bytes(first_spz(FIVE))
    found = read_model(tmp_path / "a.spz").splats
    # Halves between 4 and 8 are 1/256 apart; xyz of a rotation has 8 bits, of which w is made.
    steps = {"means": 1 / 512, "log_scales": 1 / 32 + 1e-6, "logit_opacities": 0.06, "sh0": 0.5 / 38.25 + 1e-6, "shN": 1 / 256 + 1e-6}
    for name, tolerance in steps.items():
        assert getattr(found, name) == pytest.approx(getattr(FIVE, name), abs=tolerance), name
    assert np.abs((unit_quats(found.quats) * unit_quats(FIVE.quats)).sum(axis=1)).min() > 0.999
    cut = gzip.compress(gzip.decompress(first_spz(FIVE))[:-1])
    (tmp_path / "b.spz").write_bytes(cut)
    with pytest.raises(BadInput, match="not as long as 5 Gaussians of degree 1"):
        read_model(tmp_path / "b.spz")


def every_kind(folder: Path) -> dict[Path, ModelKind]:
    """A file of each kind, version and form that is taken, with five Gaussians."""
    (folder / "i.spz").write_bytes(first_spz(FIVE))
    save_spz(folder / "j.spz", FIVE, 3)
    (folder / "k.compressed.ply").write_bytes(base64.b64decode(BY_SPLAT_TRANSFORM["c.compressed.ply"]))
    camera, line = b"element camera 1\nproperty float fov\nproperty list uchar int used\n", b"0.5 2 7 8\n"
    for name, form in (("l.ply", "ascii"), ("m.ply", "binary_big_endian"), ("n.ply", "binary_little_endian")):
        rows = rows_of(5)
        rows[:, 6:15] *= 0.1
        write_rows(folder / name, rows, form, after=camera)
        order = ">" if "big" in form else "<"
        more = line if form == "ascii" else struct.pack(f"{order}fB2i", 0.5, 2, 7, 8)
        (folder / name).write_bytes((folder / name).read_bytes() + more)
    save_ply(folder / "a.ply", FIVE)
    save_spz(folder / "b.spz", FIVE)
    save_spz(folder / "c.spz", FIVE, 4)
    save_sog(folder / "d.sog", FIVE)
    save_sog_folder(folder / "e", FIVE)
    (folder / "f").mkdir()
    save_lod(folder / "f", FIVE, [whole_region(FIVE.means)], LodLimits(num_levels=1))
    save_splats(folder / "g.safetensors", FIVE)
    rows = np.zeros((5, 8), "<f4")
    rows[:, :3], rows[:, 3:6] = FIVE.means, np.exp(FIVE.log_scales)
    rows.view(np.uint8)[:, 24:] = 200
    (folder / "h.splat").write_bytes(rows.tobytes())
    kinds: dict[str, ModelKind] = {"a.ply": "ply", "b.spz": "spz", "c.spz": "spz", "d.sog": "sog", "e/meta.json": "sog"}
    kinds |= {"f/lod-meta.json": "lod", "g.safetensors": "safetensors", "h.splat": "splat"}
    kinds |= {"i.spz": "spz", "j.spz": "spz", "k.compressed.ply": "ply", "l.ply": "ply", "m.ply": "ply", "n.ply": "ply"}
    return {folder / name: kind for name, kind in kinds.items()}


def test_a_kind_is_told_by_the_content_and_every_kind_is_read(tmp_path: Path) -> None:
    for path, kind in every_kind(tmp_path).items():
        assert model_kind(path) == kind
        assert len(read_model(path).splats) == 5, path
        if kind in ("ply", "spz") or path.suffix == ".sog":
            other = path.rename(path.with_name(f"{path.stem}_renamed.bin"))
            assert model_kind(other) == kind and len(read_model(other).splats) == 5
    for name, data, said in [
        ("a.glb", b"glTF" + bytes(20), "a GLB, which is written here and not read"),
        ("a.ksplat", bytes(40), "a .ksplat, which is not read"),
        ("a.txt", b"hello", "neither a run nor a model that is read here, but a file that begins with b'hello'"),
        ("a.splat", bytes(33), "expected a multiple of 32"),
        ("a.sog", b"hello", "is not a zip file"),
        ("a.ply", b"hello\n", "does not begin as a PLY file"),
        ("none.ply", None, "No such file"),
    ]:
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(BadInput, match=said) as error:
            read_model(tmp_path / name)
        assert str(error.value).count(name) == 1 and "\n" not in str(error.value)


BAD = {"x": 0, "f_dc_0": 3, "f_rest_2": 8, "opacity": 15, "scale_0": 16, "rot_0": 19}
"""A property of each tensor of a PLY of degree 1, and its place in a row without normals."""


def rows_of(count: int = 6) -> np.ndarray:
    rows = np.random.default_rng(3).normal(size=(count, 23)).astype("<f4")
    rows[:, 16:19] -= 3
    return rows


def write_rows(path: Path, rows: np.ndarray, form: str = "binary_little_endian", before: bytes = b"", after: bytes = b"") -> None:
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9)), "opacity"]
    names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    head = f"ply\nformat {form} 1.0\n".encode() + before
    head += (
        f"element vertex {len(rows)}\n".encode() + b"".join(f"property float {name}\n".encode() for name in names) + after + b"end_header\n"
    )
    if form == "ascii":
        body = "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in rows).encode()
    else:
        body = rows.astype(">f4" if "big" in form else "<f4").tobytes()
    path.write_bytes(head + body)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", list(BAD))
def test_a_users_file_loses_the_gaussians_that_cannot_be_drawn_and_says_how_many(tmp_path: Path, name: str, value: float) -> None:
    rows = rows_of()
    rows[2, BAD[name]] = value
    write_rows(tmp_path / "a.ply", rows)
    # Within a run the same file is refused as a whole.
    with pytest.raises(BadInput, match=r"not finite.*'radiant export .*a\.ply NEW\.ply' leaves such Gaussians out"):
        load_ply(tmp_path / "a.ply")
    read = read_model(tmp_path / "a.ply")
    meant = {"opacity": np.isinf(value), "scale_0": np.isneginf(value)}.get(name, False)
    if not meant:
        assert len(read.splats) == 5 and np.array_equal(read.splats.means, np.delete(rows[:, :3], 2, axis=0))
        assert "a.ply: 1 of its 6 Gaussians have a number that is not finite" in read.notes[0]
    elif name == "opacity":
        assert read.splats.logit_opacities[2] == pytest.approx(np.sign(value) * END_LOGIT) and "exactly 0 or 1" in read.notes[0]
    else:
        assert read.splats.log_scales[2, 0] == FLAT_LOG_SCALE and "1 Gaussians have no thickness" in read.notes[0]


def test_sizes_beyond_float32_zero_rotations_and_files_without_one_good_gaussian(tmp_path: Path) -> None:
    rows = rows_of()
    rows[1, 16], rows[3, 19:] = 89, 0
    write_rows(tmp_path / "a.ply", rows)
    read = read_model(tmp_path / "a.ply")
    assert len(read.splats) == 5 and [note.split(": ")[1][:18] for note in read.notes] == ["1 of its 6 Gaussia", "1 Gaussians have a"]
    rows[:, 0] = np.nan
    write_rows(tmp_path / "a.ply", rows)
    with pytest.raises(BadInput, match=r"a\.ply: none of its 6 Gaussians has numbers that are all finite"):
        read_model(tmp_path / "a.ply")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_the_vertices_of_any_ply_are_read_whatever_stands_around_them(tmp_path: Path, form: str) -> None:
    rows = rows_of()
    write_rows(tmp_path / "plain.ply", rows)
    wanted = load_ply(tmp_path / "plain.ply")
    order = ">" if "big" in form else "<"
    after = b"element extrinsic 16\nproperty float extrinsic\nelement face 2\nproperty list uchar int vertex_indices\n"
    write_rows(tmp_path / "after.ply", rows, form, after=after)
    with (tmp_path / "after.ply").open("ab") as file:
        file.write(b"1\n" * 16 + b"3 0 1 2\n" * 2 if form == "ascii" else bytes(64) + 2 * struct.pack(f"{order}B3i", 3, 0, 1, 2))
    before = b"element camera 1\nproperty double f\nelement face 2\nproperty list uchar int vertex_indices\nproperty uchar flag\n"
    write_rows(tmp_path / "before.ply", rows, form, before=before)
    data = (tmp_path / "before.ply").read_bytes()
    at = data.index(b"end_header\n") + 11
    faces = [struct.pack(f"{order}d", 1.5), *(struct.pack(f"{order}B{n}iB", n, *range(n), 7) for n in (3, 4))]
    lines = b"1.5\n3 0 1 2 7\n4 0 1 2 3 7\n" if form == "ascii" else b"".join(faces)
    (tmp_path / "before.ply").write_bytes(data[:at] + lines + data[at:])
    for name in ("after.ply", "before.ply"):
        for read in (load_ply(tmp_path / name), read_model(tmp_path / name).splats):
            assert all(np.array_equal(a, b) for a, b in zip(read.arrays().values(), wanted.arrays().values(), strict=True)), name
    (tmp_path / "cut.ply").write_bytes((tmp_path / "before.ply").read_bytes()[:-60])
    with pytest.raises(BadInput, match=r"Gaussians|has not 23 numbers"):
        load_ply(tmp_path / "cut.ply")


def test_harmonics_of_degree_4_are_read_to_degree_3_and_it_is_said(tmp_path: Path) -> None:
    names = [f"f_rest_{i}" for i in range(72)]
    rows = np.random.default_rng(4).normal(size=(3, 86)).astype("<f4")
    all_names = [
        "x",
        "y",
        "z",
        "f_dc_0",
        "f_dc_1",
        "f_dc_2",
        *names,
        "opacity",
        "scale_0",
        "scale_1",
        "scale_2",
        "rot_0",
        "rot_1",
        "rot_2",
        "rot_3",
    ]
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n" + "".join(f"property float {n}\n" for n in all_names) + "end_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + rows.tobytes())
    read = read_model(tmp_path / "a.ply")
    assert read.splats.sh_degree == 3 and "degree 4 are read to degree 3" in read.notes[0]
    # All 24 of red, then of green: the second of green is number 25.
    assert read.splats.shN[1, 1, 1] == rows[1, 6 + 24 + 1]


def test_records_behind_an_spz_are_passed_over_and_no_more_than_its_count_is_unpacked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    save_spz(tmp_path / "a.spz", FIVE, 3)
    raw = zlib.decompress((tmp_path / "a.spz").read_bytes(), 31)

    def packed(content: bytes) -> bytes:
        packer = zlib.compressobj(wbits=31)
        return packer.compress(content) + packer.flush()

    extended = raw[:14] + bytes([raw[14] | 2]) + raw[15:] + bytes(40)
    assert len(splats_from_gzip_spz(packed(extended))) == 5
    with pytest.raises(BadInput, match="not as long as 5 Gaussians"):
        splats_from_gzip_spz(packed(raw + bytes(40)))
    monkeypatch.setattr(claimed_counts, "FREE_COUNT", 3)
    monkeypatch.setattr(claimed_counts, "PER_BYTE", 0)
    with pytest.raises(BadInput, match=r"it says 5 Gaussians in \d+ bytes, expected at most 3"):
        splats_from_gzip_spz(packed(raw))
    save_spz(tmp_path / "b.spz", FIVE, 4)
    for name in ("a.spz", "b.spz"):
        with pytest.raises(BadInput, match=rf"{name}: it says 5 Gaussians in \d+ bytes, expected at most 3"):
            read_model(tmp_path / name)


def test_a_sog_is_held_against_its_bytes_before_anything_of_it_is_unpacked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    splats = made_up(300, degree=1)
    save_sog(tmp_path / "a.sog", splats)
    save_sog_folder(tmp_path / "a", splats)
    (tmp_path / "lod").mkdir()
    save_lod(tmp_path / "lod", splats, [whole_region(splats.means)], LodLimits(num_levels=1))
    readers = [
        lambda: load_sog(tmp_path / "a.sog"),
        lambda: load_sog(tmp_path / "a/meta.json"),
        lambda: load_lod_level(tmp_path / "lod" / META_NAME),
    ]
    assert [len(read()) for read in readers] == [300] * 3
    monkeypatch.setattr(claimed_counts, "FREE_COUNT", 99)
    monkeypatch.setattr(claimed_counts, "PER_BYTE", 0)
    for read in readers:
        with pytest.raises(BadInput, match=r"it says 300 Gaussians in .* bytes, expected at most 99"):
            read()


@pytest.mark.parametrize(
    ("limit", "least", "said"),
    [("MAX_META_BYTES", 10, "its file meta.json has .* bytes, expected at most 10"), ("MAX_PX_BYTES", 0, "its file means_l.webp has")],
)
def test_a_member_of_a_zip_is_unpacked_only_if_it_says_a_size_that_it_may_have(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, limit: str, least: int, said: str
) -> None:
    save_sog(tmp_path / "a.sog", made_up(300, degree=1))
    opened: list[str] = []
    read = zipfile.ZipFile.read
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda self, member, pwd=None: opened.append(member.filename) or read(self, member, pwd))
    load_sog(tmp_path / "a.sog")
    assert "means_l.webp" in opened
    opened.clear()
    monkeypatch.setattr(f"radiant_core.io.sog_reader.{limit}", least)
    monkeypatch.setattr("radiant_core.io.sog_reader.MAX_SPARE_PX", 0)
    with pytest.raises(BadInput, match=said):
        load_sog(tmp_path / "a.sog")
    assert "means_l.webp" not in opened


def test_a_member_packed_otherwise_than_a_sogs_is_refused(tmp_path: Path) -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("meta.json", b"{}")
    (tmp_path / "a.sog").write_bytes(content.getvalue())
    with pytest.raises(BadInput, match=r"its file meta\.json is packed in a way that SOG does not have"):
        load_sog(tmp_path / "a.sog")


def test_levels_that_name_a_file_twice_or_say_another_count_are_refused(tmp_path: Path) -> None:
    (tmp_path / "lod").mkdir()
    path = tmp_path / "lod" / META_NAME
    save_lod(path.parent, FIVE, [whole_region(FIVE.means)], LodLimits(num_levels=1))
    good = json.loads(path.read_text())
    path.write_text(json.dumps({**good, "filenames": good["filenames"] * 2}))
    with pytest.raises(BadInput, match="name a file twice"):
        load_lod_level(path)
    leaf = good["tree"]
    while "children" in leaf:
        leaf = leaf["children"][0]
    leaf["lods"]["0"]["count"] -= 1
    path.write_text(json.dumps({**good, "counts": [sum(good["counts"]) - 1]}))
    with pytest.raises(BadInput, match=r"it says 5 Gaussians, its lod-meta\.json 4"):
        load_lod_level(path)
