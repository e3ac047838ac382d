"""3D Tiles of Gaussians: GLB that comes back through our reader and gltf-validator, in its place on the globe."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from radiant_core.choices import TileContent
from radiant_core.errors import BadInput
from radiant_core.export.glb import COMPRESSION, EXTENSION, glb_bytes
from radiant_core.export.tiles import TileOptions, save_tiles
from radiant_core.frames import Frame, ecef_from_local, geodetic_from_enu
from radiant_core.lod.levels import LodLimits
from radiant_core.lod.merging import covariances
from radiant_core.numerics import rotmats_from_quats
from radiant_core.spherical_harmonics import sh_terms
from radiant_core.splats import Splats, concatenate_splats
from tests.core.io.glb_reader import load_glb
from tests.core.lod.test_levels import at, square
from tests.core.lod.test_merging import made_up

SMALL = LodLimits(num_levels=3, chunk_count=100, leaf_side_m=2.0, leaf_count=20)
ORIGIN = np.array([47.37, 8.54, 474.6])


def raw(data: bytes) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """JSON and attributes, from the specification of GLB alone."""
    size = struct.unpack_from("<I", data, 12)[0]
    content = json.loads(data[20 : 20 + size])
    binary = data[28 + size :]
    found = {}
    for name, index in content["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = content["accessors"][index]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = content["bufferViews"][accessor["bufferView"]]["byteOffset"]
        found[name.removeprefix(f"{EXTENSION}:")] = np.frombuffer(binary, "<f4", accessor["count"] * width, start).reshape(-1, width)
    return content, found


def colors(base: np.ndarray, rest: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Colour (3,) of coefficients in a direction, one Gaussian."""
    x, y, z = direction
    terms = np.array(sh_terms(x, y, z, {0: 0, 3: 1, 8: 2, 15: 3}[len(rest)]))
    return np.vstack([base, rest]).T @ terms


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_stands_in_a_glb_is_linear_y_up_and_of_the_same_look(degree: int) -> None:
    splats = made_up(20, degree=degree)
    content, found = raw(glb_bytes(splats))
    extension = content["meshes"][0]["primitives"][0]["extensions"][EXTENSION]  # pyright: ignore[reportIndexIssue]
    assert extension["kernel"] == "ellipse" and content["meshes"][0]["primitives"][0]["mode"] == 0  # pyright: ignore[reportIndexIssue]
    x, y, z = splats.means.T
    assert found["POSITION"] == pytest.approx(np.column_stack([x, z, -y]), abs=1e-6)
    assert found["SCALE"] == pytest.approx(np.exp(splats.log_scales), rel=1e-6), "linear, not logarithms"
    assert found["OPACITY"][:, 0] == pytest.approx(splats.opacities, abs=1e-6)
    assert np.linalg.norm(found["ROTATION"], axis=1) == pytest.approx(1.0, abs=1e-6)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    matrices = rotmats_from_quats(found["ROTATION"][:, [3, 0, 1, 2]])
    assert matrices == pytest.approx(turn @ rotmats_from_quats(splats.quats), abs=1e-5)
    rest = np.zeros((20, 0, 3))
    if degree:
        names = [f"SH_DEGREE_{band}_COEF_{n}" for band in range(1, degree + 1) for n in range(2 * band + 1)]
        rest = np.stack([found[name] for name in names], axis=1)
    for direction in np.random.default_rng(0).normal(size=(5, 3)):
        ray = direction / np.linalg.norm(direction)
        before = colors(splats.sh0[0], splats.shN[0], ray)
        assert colors(found["SH_DEGREE_0_COEF_0"][:1], rest[0], turn @ ray) == pytest.approx(before, abs=1e-5)


def test_our_reader_brings_a_model_back(tmp_path: Path) -> None:
    splats = made_up(50, degree=2)
    (tmp_path / "a.glb").write_bytes(glb_bytes(splats))
    back = load_glb(tmp_path / "a.glb")
    for name in ("means", "log_scales", "sh0", "shN"):
        assert getattr(back, name) == pytest.approx(getattr(splats, name), abs=2e-5), name
    assert back.opacities == pytest.approx(splats.opacities, abs=1e-6)
    assert rotmats_from_quats(back.quats) == pytest.approx(rotmats_from_quats(splats.quats), abs=1e-5)


@pytest.mark.parametrize("form", ["spz", "plain"])
def test_every_gaussian_of_the_finest_level_lies_where_it_lies_on_the_globe(tmp_path: Path, form: TileContent) -> None:
    splats = concatenate_splats([made_up(300), at(made_up(10, 4), (5000, 0, 0))])
    frame = Frame(kind="metric", origin_lat_lon_alt=ORIGIN)
    counts = save_tiles(tmp_path, splats, [square(-20.0), square(0.0)], TileOptions(frame=frame, limits=SMALL, form=form))
    assert counts[0] == 300 and counts == tuple(sorted(counts, reverse=True))
    tileset = json.loads((tmp_path / "tileset.json").read_text())
    assert tileset["asset"]["version"] == "1.1"
    assert tileset["extensions"]["3DTILES_content_gltf"].get("extensionsRequired", []) == (
        [EXTENSION, COMPRESSION] if form == "spz" else []
    )
    root = tileset["root"]
    placed, leaves, errors = [], 0, []
    for tile in root["children"]:
        world = matrix(root["transform"]) @ matrix(tile["transform"])
        chain = [tile]
        while "children" in chain[-1]:
            (finer,) = chain[-1]["children"]
            assert finer["geometricError"] < chain[-1]["geometricError"] and finer["refine"] == "REPLACE"
            chain.append(finer)
        errors.append(chain[0]["geometricError"])
        assert chain[-1]["geometricError"] == 0
        own = load_glb(tmp_path / chain[-1]["content"]["uri"]).means
        half = np.array(chain[-1]["boundingVolume"]["box"])
        assert (np.abs(own - half[:3]) <= half[[3, 7, 11]] + 1e-3).all()
        placed.append((world @ np.column_stack([own, np.ones(len(own))]).T).T[:, :3])
        leaves += 1
    assert root["geometricError"] > max(errors) and leaves > 3
    ecef = np.concatenate(placed)
    truth = splats.means.astype(float) @ ecef_from_local(ORIGIN)[:3, :3].T + ecef_from_local(ORIGIN)[:3, 3]
    assert len(ecef) == 310
    # 0.3 mm: float32 about a tile's middle, which is 5 km away for none, or steps of 0.24 mm.
    assert np.sort(ecef, axis=0) == pytest.approx(np.sort(truth, axis=0), abs=3e-4)


def matrix(numbers: list[float]) -> np.ndarray:
    return np.array(numbers).reshape(4, 4).T


def test_the_matrix_of_an_origin_agrees_with_its_geodetic_position() -> None:
    # The semi-axes of WGS84 themselves, then a place against the inverse path.
    assert ecef_from_local([0.0, 0, 0])[:3, 3] == pytest.approx([6378137.0, 0, 0])
    assert ecef_from_local([90.0, 0, 0])[:3, 3] == pytest.approx([0, 0, 6356752.3142], abs=1e-3)
    up = ecef_from_local(ORIGIN)
    higher = ecef_from_local(geodetic_from_enu([[0.0, 0, 100]], ORIGIN)[0])
    assert higher[:3, 3] == pytest.approx(up[:3, 3] + 100 * up[:3, 2], abs=1e-6)
    with pytest.raises(BadInput, match="latitude"):
        ecef_from_local([91.0, 0, 0])


def test_without_gps_there_is_no_transform_and_without_gaussians_one_sentence(tmp_path: Path) -> None:
    save_tiles(tmp_path, made_up(20), [square(-10.0)], TileOptions(limits=SMALL))
    assert "transform" not in json.loads((tmp_path / "tileset.json").read_text())["root"]
    with pytest.raises(BadInput, match="expected at least 1"):
        save_tiles(tmp_path, made_up(0), [square(0.0)])
    with pytest.raises(BadInput, match="cannot be a GLB"):
        glb_bytes(made_up(0))
    huge = Splats(**{**made_up(1).arrays(), "log_scales": np.full((1, 3), 100.0)})
    with pytest.raises(BadInput, match="larger than float32"):
        glb_bytes(huge)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_compressed_glb_has_what_cesium_reads_and_comes_back_within_its_steps(tmp_path: Path, degree: int) -> None:
    splats = made_up(50, degree=degree)
    data = glb_bytes(splats, np.array([1.0, 2, 3]), "spz")
    content = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["extensions"][EXTENSION]["extensions"][COMPRESSION] == {"bufferView": 0}
    # By the number of harmonics CesiumJS tells the degree: one more, of degree 0, and it drops them.
    assert sum("SH_DEGREE" in name for name in primitive["attributes"]) == splats.shN.shape[1]
    color = content["accessors"][primitive["attributes"]["COLOR_0"]]
    assert color == {
        "componentType": 5121,
        "count": 50,
        "type": "VEC4",
        "normalized": True,
    }
    (tmp_path / "a.glb").write_bytes(data)
    back = load_glb(tmp_path / "a.glb")
    assert back.means == pytest.approx(splats.means - [1, 2, 3], abs=2e-4)
    assert back.opacities == pytest.approx(splats.opacities, abs=0.5 / 255 + 1e-6)
    # A scale is off by up to 1/32 of its logarithm, so a covariance by up to 6.5 %.
    error = np.linalg.norm(covariances(back) - covariances(splats), axis=(1, 2))
    assert (error < 0.07 * np.linalg.norm(covariances(splats), axis=(1, 2))).all()
    # Off by half a step of 1/32, and turned, where the errors of a band's seven may add up.
    assert back.shN == pytest.approx(splats.shN, abs=0.04)


@pytest.mark.parametrize("broken", ["count", "view", "outside", "stream", "degree"])
def test_a_broken_compressed_glb_is_one_sentence(tmp_path: Path, broken: str) -> None:
    data = glb_bytes(made_up(9, degree=1), form="spz")
    size = struct.unpack_from("<I", data, 12)[0]
    content, binary = json.loads(data[20 : 20 + size]), bytearray(data[28 + size :])
    primitive = content["meshes"][0]["primitives"][0]
    if broken == "count":
        content["accessors"][0]["count"] = 8
    elif broken == "view":
        primitive["extensions"][EXTENSION]["extensions"][COMPRESSION] = {}
    elif broken == "outside":
        content["bufferViews"][0]["byteLength"] = len(binary) + 1
    elif broken == "stream":
        binary[len(binary) // 2] ^= 255
    else:
        del primitive["attributes"][f"{EXTENSION}:SH_DEGREE_1_COEF_0"]
    text = json.dumps(content).encode()
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    told = {"view": "names no SPZ", "outside": "lies outside", "stream": "gzip"}
    with pytest.raises(BadInput, match=told.get(broken, "attributes are not those")):
        load_glb(tmp_path / "a.glb")


ATTRIBUTES = "/meshes/0/primitives/0/attributes/"


@pytest.mark.skipif(shutil.which("gltf-validate") is None, reason="needs a command gltf-validate FILE on PATH (npm's gltf-validator)")
@pytest.mark.parametrize("form", ["spz", "plain"])
def test_the_validator_finds_nothing_but_names_that_it_does_not_know(tmp_path: Path, form: TileContent) -> None:
    (tmp_path / "a.glb").write_bytes(glb_bytes(made_up(20, degree=3), form=form))
    said = json.loads(subprocess.run(["gltf-validate", str(tmp_path / "a.glb")], check=True, capture_output=True).stdout)
    messages = said["issues"]["messages"]
    base = ["SH_DEGREE_0_COEF_0", "OPACITY"] if form == "plain" else []
    names = ["ROTATION", "SCALE", *base, *(f"SH_DEGREE_{degree}_COEF_{n}" for degree in range(1, 4) for n in range(2 * degree + 1))]
    allowed = {("MESH_PRIMITIVE_INVALID_ATTRIBUTE", f"{ATTRIBUTES}{EXTENSION}:{name}") for name in names}
    allowed |= {("UNSUPPORTED_EXTENSION", "/extensionsUsed/0")}
    if form == "spz":
        # The SPZ's view is named by the extension alone.
        allowed |= {("UNSUPPORTED_EXTENSION", "/extensionsUsed/1"), ("UNUSED_OBJECT", "/bufferViews/0")}
    assert {(message["code"], message["pointer"]) for message in messages} == allowed
    assert said["info"]["totalVertexCount"] == 20
