"""Synthetic views on disk come back to the bit, and anything else is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from radiant_core.errors import BadInput, RadiantError, StoreDamaged
from radiant_core.io.array_file import header_of, load_arrays, save_arrays, schema_of, stream_arrays
from radiant_core.io.view_file import SCHEMA, load_view, save_view


def view(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.integers(0, 256, (height, width, 3), np.uint8), rng.integers(0, 256, (height, width), np.uint8)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (40, 30), (7, 301)])
def test_a_view_comes_back_to_the_bit_also_where_its_weight_is_zero(tmp_path: Path, width: int, height: int) -> None:
    image, weight = view(width, height)
    weight[0] = 0
    save_view(tmp_path / "v", image, weight)
    again = load_view(tmp_path / "v", width, height)
    np.testing.assert_array_equal(again[0], image)
    np.testing.assert_array_equal(again[1], weight)
    assert all(array.dtype == np.uint8 and array.flags.c_contiguous for array in again)


def test_other_sizes_types_and_shapes_are_refused(tmp_path: Path) -> None:
    image, weight = view(8, 6)
    for wrong in [(image[:5], weight), (image.astype(np.float32), weight), (image[..., :2], weight), (image[:0], weight[:0])]:
        with pytest.raises(BadInput, match="expected \\(H,W,3\\)"):
            save_view(tmp_path / "v", *wrong)
    assert list(tmp_path.iterdir()) == []
    save_view(tmp_path / "v", image, weight)
    with pytest.raises(BadInput, match="a view of 8 × 6 px, expected 6 × 8"):
        load_view(tmp_path / "v", 6, 8)
    with pytest.raises(StoreDamaged):
        load_view(tmp_path / "none", 8, 6)


def test_mutated_bytes_give_typed_errors_or_a_view_of_that_size(tmp_path: Path) -> None:
    save_view(tmp_path / "v", *view(12, 9))
    whole = (tmp_path / "v").read_bytes()
    rng = np.random.default_rng(6)
    refused = 0
    for _ in range(300):
        mutated = bytearray(whole)
        mutated[rng.integers(len(whole))] = rng.integers(256)
        (tmp_path / "v").write_bytes(mutated[: rng.integers(len(whole))] if rng.random() < 0.2 else mutated)
        try:
            image, weight = load_view(tmp_path / "v", 12, 9)
            assert image.shape == (9, 12, 3) and weight.shape == (9, 12)
        except RadiantError:
            refused += 1
    assert refused > 60


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n" + b"\0" * 15, b"\x88PNG\r\n\x1a\n" + b"\0" * 8 + b"\0\0\0\x08\0\0\0\x06"])
def test_what_is_no_picture_is_told_before_it_is_decoded(tmp_path: Path, content: bytes) -> None:
    save_arrays(tmp_path / "v", SCHEMA, {"png": np.frombuffer(content, np.uint8)}, {"size_wh": [8, 6]})
    with pytest.raises(BadInput, match="a view of 0 × 0 px, expected 8 × 6"):
        load_view(tmp_path / "v", 8, 6)


def test_files_say_what_they_hold_by_names_that_do_not_change(tmp_path: Path) -> None:
    save_view(tmp_path / "v", *view(8, 6))
    assert header_of(tmp_path / "v")[0] == {"schema": "radiant.view", "version": "1", "about": {"size_wh": [8, 6]}}
    assert set(header_of(tmp_path / "v")[1]) == {"png"} and schema_of(tmp_path / "v") == "radiant.view"
    save_file({"a": np.zeros(2)}, tmp_path / "x")
    assert (schema_of(tmp_path / "x"), header_of(tmp_path / "x")) == ("", ({}, {"a": (2,)}))
    for wrong in ("[]", "3"):
        save_file({"a": np.zeros(2)}, tmp_path / "x", {"radiant": wrong})
        assert (schema_of(tmp_path / "x"), header_of(tmp_path / "x")[0]) == ("", {})


def test_the_same_content_gives_the_same_bytes_whatever_the_order_of_what_is_said(tmp_path: Path) -> None:
    for name, about in (("a", {"x": 1, "y": {"q": 2, "p": 3}}), ("b", {"y": {"p": 3, "q": 2}, "x": 1})):
        save_arrays(tmp_path / name, "s", {"a": np.zeros(2)}, about)
        stream_arrays(tmp_path / f"{name}-streamed", "s", {"a": np.zeros(2)}, about)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1
    with pytest.raises(ValueError, match="Out of range float"):
        save_arrays(tmp_path / "c", "s", {"a": np.zeros(2)}, {"x": float("nan")})


def test_a_file_without_metadata_or_of_another_version_is_told(tmp_path: Path) -> None:
    save_file({"a": np.zeros(2)}, tmp_path / "x")
    with pytest.raises(BadInput, match=r"cannot use .*x: it says schema and version \(None, None\), expected \('s', '1'\)"):
        load_arrays(tmp_path / "x", "s", None)
    save_file({"a": np.zeros(2)}, tmp_path / "x", {"radiant": json.dumps({"schema": "s", "version": "2", "about": {}})})
    with pytest.raises(BadInput, match=r"it says schema and version \('s', '2'\)"):
        load_arrays(tmp_path / "x", "s", None)
    save_arrays(tmp_path / "x", "s", {"a": np.zeros(2)}, {"k": 1})
    arrays, about = load_arrays(tmp_path / "x", "s", None)
    assert (set(arrays), about) == ({"a"}, {"k": 1})
    with pytest.raises(BadInput, match=r"it holds the arrays \{'a': 'F64'\}, expected \{'a': 'F32'\}"):
        load_arrays(tmp_path / "x", "s", {"a": "F32"})


PNG_HEAD = b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + b"\0\0\0\x08\0\0\0\x06"


def test_a_head_of_24_bytes_says_a_size_and_23_none(tmp_path: Path) -> None:
    for content, told in ((PNG_HEAD, "holds no whole picture"), (PNG_HEAD[:-1], "a view of 0 × 0 px")):
        save_arrays(tmp_path / "v", SCHEMA, {"png": np.frombuffer(content, np.uint8)}, {"size_wh": [8, 6]})
        with pytest.raises(RadiantError, match=told):
            load_view(tmp_path / "v", 8, 6)
    save_arrays(tmp_path / "v", SCHEMA, {"png": np.frombuffer(PNG_HEAD, np.uint8)}, {"size_wh": [6, 8]})
    with pytest.raises(BadInput, match="a view of 8 × 6 px, expected 6 × 8"):
        load_view(tmp_path / "v", 6, 8)
