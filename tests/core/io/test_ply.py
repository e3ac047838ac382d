"""PLY files: nothing is lost, other programs read the same, any file raises BadInput at most."""

from __future__ import annotations

import os
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.ply import CHUNK_ROWS, LOG_SCALES, MEANS, QUATS, SH0, load_ply, save_ply
from radiant_core.io.ply_elements import CACHED_ROWS
from radiant_core.splats import SH_BASES, Splats


def random_splats(count: int, degree: int, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.standard_normal((count, 3), dtype=np.float32),
        quats=rng.standard_normal((count, 4), dtype=np.float32),
        log_scales=rng.standard_normal((count, 3), dtype=np.float32),
        logit_opacities=rng.standard_normal(count, dtype=np.float32),
        sh0=rng.standard_normal((count, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((count, SH_BASES[degree] - 1, 3), dtype=np.float32),
    )


def same_bits(a: Splats, b: Splats) -> bool:
    return all(np.array_equal(a.arrays()[name], b.arrays()[name]) for name in a.arrays())


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 37, CHUNK_ROWS + 1])
def test_what_is_saved_comes_back_bit_for_bit(tmp_path: Path, degree: int, count: int) -> None:
    splats = random_splats(count, degree)
    save_ply(tmp_path / "model.ply", splats)
    assert same_bits(load_ply(tmp_path / "model.ply"), splats)


def test_the_layout_is_that_of_the_original_3dgs_code(tmp_path: Path) -> None:
    splats = random_splats(2, 3)
    save_ply(tmp_path / "model.ply", splats)
    header, body = (tmp_path / "model.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in header.splitlines() if line.startswith(b"property float")]
    rest = [f"f_rest_{i}" for i in range(45)]
    dc, scale, rot = ["f_dc_0", "f_dc_1", "f_dc_2"], ["scale_0", "scale_1", "scale_2"], ["rot_0", "rot_1", "rot_2", "rot_3"]
    assert names == ["x", "y", "z", "nx", "ny", "nz", *dc, *rest, "opacity", *scale, *rot]
    rows = np.frombuffer(body, "<f4").reshape(2, 62)
    # f_rest holds all 15 bases of red first, so the second basis of green is number 15 + 1.
    assert rows[1, 9 + 16] == splats.shN[1, 1, 1]
    assert rows[0, 54:].tolist() == [splats.logit_opacities[0], *splats.log_scales[0], *splats.quats[0]]


def test_open3d_reads_the_same_values(tmp_path: Path) -> None:
    import open3d as o3d

    splats = random_splats(50, 3)
    save_ply(tmp_path / "model.ply", splats)
    point = o3d.t.io.read_point_cloud(tmp_path / "model.ply").point
    assert np.array_equal(point.positions.numpy(), splats.means)
    assert np.array_equal(point.rot.numpy(), splats.quats)
    assert np.array_equal(point.opacity.numpy()[:, 0], splats.logit_opacities)
    assert np.array_equal(point.f_dc.numpy(), splats.sh0[:, 0])
    assert np.array_equal(point.f_rest.numpy(), splats.shN)
    # Open3D stores the linear scale: one float32 exponential, a few units in the last place apart.
    np.testing.assert_allclose(point.scale.numpy(), np.exp(splats.log_scales), rtol=5e-7)


def test_extra_scalar_properties_and_doubles_are_read_over(tmp_path: Path) -> None:
    wanted = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    wanted += ["rot_0", "rot_1", "rot_2", "rot_3"]
    properties = [("uchar", "red"), *(("double", name) for name in reversed(wanted)), ("int", "label")]
    record = np.dtype([(name, {"uchar": "u1", "double": "<f8", "int": "<i4"}[kind]) for kind, name in properties])
    rows = np.zeros(3, record)
    for value, name in enumerate(wanted):
        rows[name] = value
    header = "".join(f"property {kind} {name}\n" for kind, name in properties)
    text = f"ply\nformat binary_little_endian 1.0\ncomment made by somebody\nelement vertex 3\n{header}end_header\n"
    (tmp_path / "other.ply").write_bytes(text.encode() + rows.tobytes())
    splats = load_ply(tmp_path / "other.ply")
    assert splats.means.tolist() == [[0, 1, 2]] * 3
    assert splats.sh0[:, 0].tolist() == [[3, 4, 5]] * 3
    assert splats.logit_opacities.tolist() == [6] * 3
    assert splats.log_scales.tolist() == [[7, 8, 9]] * 3
    assert splats.quats.tolist() == [[10, 11, 12, 13]] * 3


@pytest.mark.parametrize(
    ("names", "layout"),
    [
        (("char", "int8"), "b"), (("uchar", "uint8"), "B"), (("short", "int16"), "<h"), (("ushort", "uint16"), "<H"),
        (("int", "int32"), "<i"), (("uint", "uint32"), "<I"), (("float", "float32"), "<f"), (("double", "float64"), "<d"),
    ],
)  # fmt: skip
def test_a_scalar_has_its_width_under_both_names_of_its_type_and_a_coordinate_is_a_float(
    tmp_path: Path, names: tuple[str, str], layout: str
) -> None:
    wanted = [*MEANS, *SH0, "opacity", *LOG_SCALES, *QUATS]
    for name in names:
        for first in ("skipped", "x"):
            header = f"property {name} {first}\n" + "".join(f"property float {other}\n" for other in wanted if other != first)
            text = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{header}end_header\n"
            numbers = [value for value, other in enumerate(wanted) if other != first]
            (tmp_path / "a.ply").write_bytes(text.encode() + struct.pack(layout, 0) + struct.pack(f"<{len(numbers)}f", *numbers))
            if first == "skipped" or layout in ("<f", "<d"):
                assert load_ply(tmp_path / "a.ply").means.tolist() == [[0, 1, 2]]
            else:
                with pytest.raises(BadInput, match="no property 'x' of a floating type"):
                    load_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_by_name(tmp_path: Path, value: float) -> None:
    path = tmp_path / "model.ply"
    save_ply(path, random_splats(4, 0))
    data = bytearray(path.read_bytes())
    data[-4:] = np.array([value], "<f4").tobytes()
    path.write_bytes(bytes(data))
    with pytest.raises(BadInput, match=r"model\.ply.*quats has 1 values"):
        load_ply(path)


HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nend_header\n"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "header ends early"),
        (b"PLY\nformat ascii 1.0\nelement vertex 1\n", "does not begin as a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", "header ends early"),
        (HEADER % 1000, "expected 1000 Gaussians"),
        (HEADER % 0, "no property 'y'"),
        (HEADER.replace(b"%d", b"1" * 5000), "over 1000 bytes"),
        (HEADER.replace(b"%d", b"-1"), "header line 'element vertex -1'"),
        (HEADER.replace(b"float x", b"list uchar int x") % 0, "no property 'x'"),
        (HEADER.replace(b"float x", b"list float int x") % 0, "header line 'property list"),
        (HEADER.replace(b"property", b"comment " + b"A" * 1100 + b"\nproperty") % 0, "over 1000 bytes"),
        (HEADER.replace(b"property", b"comment a\n" * 3000 + b"property") % 0, "over 2000 lines"),
        (HEADER.replace(b"property float x", b"property float x\nproperty float x") % 0, "header line 'property float x'"),
        (HEADER.replace(b"property float x", b"property float f_rest_0") % 0, "1 f_rest properties"),
    ],
)
def test_a_crafted_header_is_refused_with_its_reason(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "crafted.ply").write_bytes(data)
    with pytest.raises(BadInput, match=said):
        load_ply(tmp_path / "crafted.ply")


def test_a_count_beyond_the_file_takes_no_memory(tmp_path: Path) -> None:
    (tmp_path / "crafted.ply").write_bytes(HEADER % 50_000_000)
    tracemalloc.start()
    with pytest.raises(BadInput, match="expected 50000000 Gaussians"):
        load_ply(tmp_path / "crafted.ply")
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Python's own tables (interned strings) grow by megabytes at a time, whoever is running; the
    # promised Gaussians would be 200 MB.
    assert peak_bytes < 64e6


def test_folders_pipes_and_missing_files_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    for name in ("", "pipe.ply", "absent.ply"):
        with pytest.raises(BadInput):
            load_ply(tmp_path / name)


def test_twenty_thousand_mutated_files_give_bad_input_or_finite_splats(tmp_path: Path) -> None:
    path = tmp_path / "mutated.ply"
    save_ply(path, random_splats(3, 1))
    good = path.read_bytes()
    header_bytes = good.index(b"end_header\n") + 11
    rng = np.random.default_rng(7)
    num_read = 0
    for _ in range(20_000):
        # A new file: cutting the old one makes some file systems write to disk, 20,000 times.
        path.unlink()
        path.write_bytes(mutated(good, header_bytes, rng))
        try:
            splats = load_ply(path)
        except BadInput:
            continue
        num_read += 1
        assert all(np.isfinite(array).all() for array in splats.arrays().values())
    # Both ends must be reached, or the mutations test nothing.
    assert 1000 < num_read < 19_000


TOKENS = (b"list", b"double", b"vertex", b"999999999999", b"-1", b"nan", b"\n", b" ", b"f_rest_9", b"end_header\n")


def mutated(good: bytes, header_bytes: int, rng: np.random.Generator) -> bytes:
    """The file with one byte of the Gaussians changed, or up to three damages anywhere: bytes lost
    or doubled, tokens put in."""
    data = bytearray(good)
    if rng.random() < 0.3:
        data[int(rng.integers(header_bytes, len(data)))] = int(rng.integers(0, 256))
        return bytes(data)
    for _ in range(rng.integers(1, 4)):
        limit = header_bytes if rng.random() < 0.6 else len(data)
        at = int(rng.integers(0, max(1, min(limit, len(data)))))
        span = int(rng.integers(1, 20))
        match rng.integers(0, 5):
            case 0:
                data[at : at + 1] = bytes([rng.integers(0, 256)])
            case 1:
                del data[at : at + span]
            case 2:
                data[at:at] = data[at : at + span]
            case 3:
                data[at:at] = TOKENS[rng.integers(len(TOKENS))]
            case _:
                del data[int(rng.integers(at, len(data) + 1)) :]
    return bytes(data)


@pytest.mark.parametrize("antialiased", [False, True])
def test_how_a_model_was_trained_to_be_drawn_stands_in_the_file(tmp_path: Path, antialiased: bool) -> None:
    path = tmp_path / "a.ply"
    save_ply(path, replace(random_splats(3, 1), antialiased=antialiased))
    assert (b"comment antialiased\n" in path.read_bytes()) is antialiased and load_ply(path).antialiased is antialiased
    # Somebody else's comments say nothing of it.
    path.write_bytes(path.read_bytes().replace(b"element", b"comment made by us\ncomment\nelement", 1))
    assert load_ply(path).antialiased is antialiased


def header_of(lines: bytes) -> bytes:
    return b"ply\nformat binary_little_endian 1.0\n" + lines


ALL = b"".join(b"property float %s\n" % name.encode() for name in (*MEANS, *SH0, "opacity", *LOG_SCALES, *QUATS))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (b"element vertex 0\n" + ALL + b"comment x\n" * 1984 + b"end_header\n", None),
        (b"element vertex 0\n" + ALL + b"comment x\n" * 1985 + b"end_header\n", "its header has over 2000 lines"),
        (b"element vertex 0\n" + ALL + b"obj_info " + b"x" * 990 + b"\nend_header\n", None),
        (b"element vertex 0\n" + ALL + b"obj_info " + b"x" * 991 + b"\nend_header\n", "has a line of over 1000 bytes"),
        (b"element vertex 000000000000000\n" + ALL + b"end_header\n", None),
        (b"element vertex 0000000000000000\n" + ALL + b"end_header\n", "header line 'element vertex 0000000000000000'"),
        (b"element vertex 0\nelement vertex 0\n" + ALL + b"end_header\n", "header line 'element vertex 0' is not one"),
        (b"element face 0\n" + ALL + b"end_header\n", "no element 'vertex', only 'face'"),
        (ALL + b"element vertex 0\nend_header\n", "header line 'property float x'"),
        (b"element vertex 0\nend_header\n", "no property 'x'"),
        (b"end_header\n", "header line 'end_header'"),
        (b"element vertex 0\n" + ALL + b"y" * 90 + b"\n", f"header line '{'y' * 80}' is not one"),
    ],
)
def test_a_header_ends_at_its_limits(tmp_path: Path, lines: bytes, said: str | None) -> None:
    (tmp_path / "a.ply").write_bytes(header_of(lines))
    if said is None:
        assert len(load_ply(tmp_path / "a.ply")) == 0
    else:
        with pytest.raises(BadInput, match=rf"cannot use .*a\.ply: .*{said}.*: export it as a binary 3DGS PLY file\."):
            load_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"plY\nformat binary_little_endian 1.0\n", "does not begin as a PLY file"),
        (b"ply\nformat binary_middle_endian 1.0\n", "header line 'format binary_middle_endian 1.0'"),
        (b"ply\nformat binary_little_endian 1.1\n", "header line 'format binary_little_endian 1.1'"),
    ],
)
def test_another_first_line_or_format_is_refused(tmp_path: Path, start: bytes, said: str) -> None:
    (tmp_path / "a.ply").write_bytes(start + b"element vertex 0\n" + ALL + b"end_header\n")
    with pytest.raises(BadInput, match=said):
        load_ply(tmp_path / "a.ply")


def test_bytes_too_few_or_too_many_are_counted(tmp_path: Path) -> None:
    save_ply(tmp_path / "a.ply", random_splats(2, 0))
    data = (tmp_path / "a.ply").read_bytes()
    for content, left in ((data[:-1], 135), (data + b"x", 137)):
        (tmp_path / "a.ply").write_bytes(content)
        with pytest.raises(BadInput, match=rf"it has {left} bytes after the header, expected 2 Gaussians of 68 bytes"):
            load_ply(tmp_path / "a.ply")
    with pytest.raises(BadInput, match=r"cannot read .*none\.ply: No such file or directory: check the path"):
        load_ply(tmp_path / "none.ply")


def test_a_double_beyond_float32_is_refused_and_rows_over_the_cache_are_all_read(tmp_path: Path) -> None:
    wanted = [*MEANS, *SH0, "opacity", *LOG_SCALES, *QUATS]
    rows = np.random.default_rng(5).normal(size=(2 * CACHED_ROWS + 1, len(wanted)))
    head = b"element vertex %d\n" % len(rows) + ALL.replace(b"float", b"double") + b"end_header\n"
    (tmp_path / "a.ply").write_bytes(header_of(head) + rows.astype("<f8").tobytes())
    np.testing.assert_array_equal(load_ply(tmp_path / "a.ply").quats, rows[:, -4:].astype(np.float32))
    rows[-1, 0] = 1e39
    (tmp_path / "a.ply").write_bytes(header_of(head) + rows.astype("<f8").tobytes())
    with pytest.raises(BadInput, match="means has 1 values that are not finite"):
        load_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("comment", ["antialiased", "antialiased 1", "SplatRenderMode: mip"])
def test_the_words_of_three_programs_mark_an_antialiased_model(tmp_path: Path, comment: str) -> None:
    save_ply(tmp_path / "a.ply", replace(random_splats(3, 0), antialiased=True))
    data = (tmp_path / "a.ply").read_bytes()
    assert data.count(b"comment ") == 2 and b"\ncomment SplatRenderMode: mip\n" in data
    head, body = data.split(b"end_header\n", 1)
    kept = b"\n".join(line for line in head.split(b"\n") if not line.startswith(b"comment"))
    for other, marked in ((f"comment {comment}\n", True), ("comment antialiased 0\ncomment SplatRenderMode: default\n", False)):
        (tmp_path / "b.ply").write_bytes(kept.replace(b"element vertex", other.encode() + b"element vertex") + b"end_header\n" + body)
        assert load_ply(tmp_path / "b.ply").antialiased == marked
