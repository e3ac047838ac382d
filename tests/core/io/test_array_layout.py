"""Headers of safetensors files written by hand: one that fits is taken, each way of not fitting is
told before anything is allocated."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import load_file

from radiant_core.errors import StoreDamaged
from radiant_core.io import array_layout
from radiant_core.io.array_layout import require_layout

A = {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24]}
B = {"dtype": "U8", "shape": [4], "data_offsets": [24, 28]}
BODY = bytes(28)
MISFIT = "no known type, shape and place that fit each other"


def written(path: Path, header: Any, body: bytes = BODY) -> Path:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + body)
    return path


def test_what_fits_is_taken_and_the_library_reads_it(tmp_path: Path) -> None:
    path = written(tmp_path / "a", {"__metadata__": {"who": "me"}, "b": B, "a": A})
    require_layout(path)
    assert {name: array.shape for name, array in load_file(path).items()} == {"a": (2, 3), "b": (4,)}
    require_layout(written(tmp_path / "none", {}, b""))
    require_layout(written(tmp_path / "empty", {"a": {"dtype": "F64", "shape": [0, 7], "data_offsets": [0, 0]}}, b""))
    # The longest side there is, of nothing.
    require_layout(written(tmp_path / "long", {"a": {"dtype": "U8", "shape": [0, 2**63 - 1], "data_offsets": [0, 0]}}, b""))


@pytest.mark.parametrize(
    ("dtype", "item_bytes"),
    [
        ("BOOL", 1),
        ("I8", 1),
        ("F16", 2),
        ("BF16", 2),
        ("I16", 2),
        ("U32", 4),
        ("F64", 8),
        ("I64", 8),
        ("U8", 1),
        ("U16", 2),
        ("F32", 4),
        ("I32", 4),
        ("U64", 8),
    ],
)
def test_every_type_has_its_width(tmp_path: Path, dtype: str, item_bytes: int) -> None:
    entry = {"dtype": dtype, "shape": [5], "data_offsets": [0, 5 * item_bytes]}
    require_layout(written(tmp_path / "a", {"a": entry}, bytes(5 * item_bytes)))
    for wrong in (5 * item_bytes - 1, 5 * item_bytes + 1):
        with pytest.raises(StoreDamaged, match=MISFIT):
            require_layout(written(tmp_path / "a", {"a": {**entry, "data_offsets": [0, wrong]}}, bytes(wrong)))


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ([A], "its header is no object"),
        ({"__metadata__": ["me"], "a": A, "b": B}, "its metadata are no texts"),
        ({"__metadata__": {"n": 1}, "a": A, "b": B}, "its metadata are no texts"),
        ({"a": A, "b": [0, 1]}, f"its array 'b' has {MISFIT}"),
        ({"a": A, "b": {**B, "more": 1}}, MISFIT),
        ({"a": A, "b": {"dtype": "U8", "shape": [4]}}, MISFIT),
        ({"a": A, "b": {**B, "dtype": "F8"}}, MISFIT),
        ({"a": A, "b": {**B, "dtype": ["U8"]}}, MISFIT),
        ({"a": A, "b": {**B, "shape": 4}}, MISFIT),
        ({"a": A, "b": {**B, "shape": {"4": 4}}}, MISFIT),
        ({"a": A, "b": {**B, "shape": ["4"]}}, MISFIT),
        ({"a": A, "b": {**B, "shape": [4.0]}}, MISFIT),
        ({"a": A, "b": {**B, "shape": [True, 4]}}, MISFIT),
        ({"a": A, "b": {**B, "shape": [-2, -2]}}, MISFIT),
        ({"a": A, "b": {**B, "shape": [0, 4]}}, MISFIT),
        ({"a": A, "b": {"dtype": "U8", "shape": [0, 2**63], "data_offsets": [24, 24]}}, MISFIT),
        ({"a": A, "b": {**B, "data_offsets": [24, 28, 28]}}, MISFIT),
        ({"a": A, "b": {**B, "data_offsets": [28, 24]}}, MISFIT),
        ({"a": A, "b": {**B, "data_offsets": [20, 24]}}, "leave a gap or overlap at byte 24"),
        ({"a": A, "b": {**B, "data_offsets": [25, 29]}}, "leave a gap or overlap at byte 24"),
        ({"a": A}, "its arrays take 24 bytes, the file has 28"),
        (b'{"a": 1, "a": 2}', "a key comes twice"),
        (b"{x", "its header is not valid JSON"),
    ],
)
def test_what_does_not_fit_is_told(tmp_path: Path, header: Any, told: str) -> None:
    with pytest.raises(StoreDamaged, match=told):
        require_layout(written(tmp_path / "a", header))


def test_dimensions_and_header_end_at_their_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for dimensions, passes in ((8, True), (9, False)):
        path = written(tmp_path / "a", {"a": {"dtype": "U8", "shape": [1] * dimensions, "data_offsets": [0, 1]}}, b"x")
        if passes:
            require_layout(path)
        else:
            with pytest.raises(StoreDamaged, match=MISFIT):
                require_layout(path)
    path = written(tmp_path / "a", {"a": A, "b": B})
    num_header = path.stat().st_size - 8 - len(BODY)
    monkeypatch.setattr(array_layout, "MAX_HEADER_BYTES", num_header)
    require_layout(path)
    monkeypatch.setattr(array_layout, "MAX_HEADER_BYTES", num_header - 1)
    with pytest.raises(StoreDamaged, match=f"a header of {num_header} bytes"):
        require_layout(path)
    for content in (b"", (1).to_bytes(8, "little") + b"0", (3).to_bytes(8, "little") + b"{}"):
        (tmp_path / "short").write_bytes(content)
        with pytest.raises(StoreDamaged, match="it says a header of"):
            require_layout(tmp_path / "short")


def test_a_header_ends_at_16_mib(tmp_path: Path) -> None:
    for size, told in ((16 * 2**20, None), (16 * 2**20 + 1, "it says a header of 16777217 bytes")):
        path = written(tmp_path / "a", json.dumps({"a": A, "b": B}).encode().ljust(size))
        if told is None:
            require_layout(path)
        else:
            with pytest.raises(StoreDamaged, match=told):
                require_layout(path)


def test_what_is_no_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(StoreDamaged, match=r"cannot read .*none: No such file or directory: run the stage"):
        require_layout(tmp_path / "none")
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(StoreDamaged, match=r"is not a file|Is a directory"):
            require_layout(path)
    with pytest.raises(StoreDamaged, match=rf"its array '{'n' * 40}' has {MISFIT}"):
        require_layout(written(tmp_path / "a", {"n" * 50: 3}))
