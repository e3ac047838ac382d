"""Synthetic views on disk come back to the bit, and anything else is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, RadiantError, StoreDamaged
from radiant_core.io.array_file import save_arrays
from radiant_core.io.view_file import SCHEMA, WEIGHT_STEP, load_view, load_views, save_view, save_views


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


def smooth(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[:height, :width]
    image = np.stack([rows * 3, columns * 4, rows + columns], axis=-1) % 200
    return image.astype(np.uint8), (columns * 5 % 256).astype(np.uint8)


def test_views_of_an_edge_come_back_in_order(tmp_path: Path) -> None:
    sizes = [(40, 30), (16, 24), (1, 1)]
    views = [smooth(*size) for size in sizes]
    save_views(tmp_path / "v", views)
    for (image, weight), (first, second) in zip(load_views(tmp_path / "v", sizes), views, strict=True):
        assert np.abs(weight.astype(int) - second).max() <= WEIGHT_STEP / 2
        # JPEG of quality 90 on ramps with a few edges
        assert np.abs(image.astype(float) - first).mean() < 5 and image.flags.c_contiguous
    save_views(tmp_path / "v", [])
    assert load_views(tmp_path / "v", sizes) == []


def test_other_counts_and_sizes_of_views_are_refused(tmp_path: Path) -> None:
    save_views(tmp_path / "v", [smooth(8, 6), smooth(8, 6)])
    with pytest.raises(BadInput, match="views, expected 3"):
        load_views(tmp_path / "v", [(8, 6)] * 3)
    with pytest.raises(BadInput, match="expected 6 × 8"):
        load_views(tmp_path / "v", [(8, 6), (6, 8)])
    save_view(tmp_path / "w", *smooth(8, 6))
    with pytest.raises(BadInput):
        load_views(tmp_path / "w", [(8, 6)])


def test_mutated_views_give_typed_errors_or_views_of_these_sizes(tmp_path: Path) -> None:
    save_views(tmp_path / "v", [smooth(12, 9), smooth(10, 7)])
    whole = (tmp_path / "v").read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(400):
        mutated = bytearray(whole)
        mutated[rng.integers(len(whole))] = rng.integers(256)
        (tmp_path / "v").write_bytes(mutated[: rng.integers(len(whole))] if rng.random() < 0.2 else mutated)
        try:
            shapes = [(image.shape, weight.shape) for image, weight in load_views(tmp_path / "v", [(12, 9), (10, 7)])]
            assert shapes in ([((9, 12, 3), (9, 12)), ((7, 10, 3), (7, 10))], [])
        except RadiantError:
            refused += 1
    assert refused > 80
