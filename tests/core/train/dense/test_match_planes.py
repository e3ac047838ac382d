"""The native matching against the same cost in numpy, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.numerics import FloatArray

SIZE_HW = (60, 80)
CAMERA = np.array([70.0, 72.0, 39.0, 30.5, 1, 3])
LIMITS = np.array([0.02, 1.0, 0.17, 0.01])
SHAPE = (20, 26)
OFFSETS = [(4 * (i % 4) - 7 + 2 * ((i // 4) % 2), 2 * (i // 4) - 7) for i in range(32)]


def pictures(count: int, seed: int = 0) -> list[NDArray[np.uint8]]:
    rng = np.random.default_rng(seed)
    rough = rng.uniform(0, 255, (count, *SIZE_HW))
    # A mean over neighbours: bilinear values of white noise would amplify rounding of positions.
    soft = (rough + np.roll(rough, 1, 1) + np.roll(rough, 1, 2) + np.roll(rough, (1, 1), (1, 2))) / 4
    return [np.ascontiguousarray(image, np.uint8) for image in soft]


def some_maps(count: int, seed: int = 0) -> FloatArray:
    """Nearly the identity, moved by some pixels."""
    rng = np.random.default_rng(seed)
    matrices = np.eye(3) + rng.normal(size=(count, 3, 3)) * [[0.02, 0.02, 0.5], [0.02, 0.02, 0.5], [1e-4, 1e-4, 1e-3]]
    return np.concatenate([matrices.reshape(count, 9), rng.normal(size=(count, 3)) * [20, 20, 0.02]], axis=1)


def some_planes(seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(0.05, 0.5, SHAPE), rng.normal(size=SHAPE) * 2e-3, rng.normal(size=SHAPE) * 2e-3]).astype(np.float32)


def call(images: list[NDArray[np.uint8]], maps: FloatArray, candidates: NDArray[np.float32], **changed: Any) -> NDArray[np.float32]:
    given: dict[str, Any] = {"camera": CAMERA, "limits": LIMITS, "passes": np.zeros(0), "seed": 0, "num_threads": 1, "instruction_set": ""}
    return _native.match_planes(images[0], images[1:], maps, candidates, **{**given, **changed})


def grey_at(image: FloatArray, u: float, v: float) -> float:
    x, y = int(u), int(v)
    top = image[y, x] + (u - x) * (image[y, x + 1] - image[y, x])
    bottom = image[y + 1, x] + (u - x) * (image[y + 1, x + 1] - image[y + 1, x])
    return top + (v - y) * (bottom - top)


def plain_source_cost(images: list[NDArray[np.uint8]], index: int, one: FloatArray, pixel: tuple[int, int], plane: FloatArray) -> float:
    """The cost of a plane at a pixel against one source, pixel by pixel in float64."""
    x, y = pixel
    height, width = SIZE_HW
    reference, source = images[0].astype(float), images[index].astype(float)
    window = np.array([reference[np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)] for dx, dy in OFFSETS])
    weights = np.exp(-np.abs(window - reference[y, x]) / 16)
    weights /= weights.sum()
    mean = weights @ window
    variance = weights @ (window - mean) ** 2
    w, a, b = plane
    matrix, offset = one[:9].reshape(3, 3), one[9:]
    p = matrix @ [x, y, 1] + offset * w
    along_x, along_y = matrix[:, 0] + offset * a, matrix[:, 1] + offset * b
    middle = p[:2] / p[2]
    steps = np.stack([(along_x[:2] - middle * along_x[2]) / p[2], (along_y[:2] - middle * along_y[2]) / p[2]], axis=1)
    span = 7 * np.abs(steps).sum(axis=1)
    if variance <= 2 or p[2] <= 0 or (middle < span).any() or (middle + span >= np.array([width, height]) - 2).any():
        return 2.0
    seen = np.array([grey_at(source, *(middle + steps @ np.array(offset_px))) for offset_px in OFFSETS])
    spread = weights @ (seen - weights @ seen) ** 2
    return 2.0 if spread <= 2 else float(np.clip(1 - weights @ ((window - mean) * seen) / np.sqrt(variance * spread), 0, 2))


def plain_cost(images: list[NDArray[np.uint8]], maps: FloatArray, pixel: tuple[int, int], plane: FloatArray) -> float:
    fx, fy, cx, cy = CAMERA[:4]
    w, a, b = plane
    ray = np.array([(pixel[0] - cx) / fx, (pixel[1] - cy) / fy, 1])
    normal = np.array([a * fx, b * fy, w - a * fx * ray[0] - b * fy * ray[1]])
    if not LIMITS[0] <= w <= LIMITS[1] or w < LIMITS[2] * np.linalg.norm(normal) * np.linalg.norm(ray):
        return 2.0
    costs = sorted(plain_source_cost(images, 1 + k, one, pixel, plane) for k, one in enumerate(maps))
    return float(np.mean(costs[:2]))


@pytest.mark.parametrize("build", _native.instruction_sets())
@pytest.mark.parametrize("num_sources", [1, 2, 3])
def test_costs_are_those_of_the_formula(num_sources: int, build: str) -> None:
    images, maps, planes = pictures(1 + num_sources), some_maps(num_sources), some_planes()
    found = call(images, maps, planes[None], instruction_set=build)
    np.testing.assert_array_equal(found[:3], planes)
    nodes = [(r, c) for r in range(0, SHAPE[0], 2) for c in range(r % 3, SHAPE[1], 3)]
    plain = np.array([plain_cost(images, maps, (1 + 3 * c, 1 + 3 * r), planes[:, r, c].astype(float)) for r, c in nodes])
    assert (plain < 1.9).sum() > 20
    # A window at the edge of a picture may fall in or out by rounding: of 87 nodes hardly one.
    assert (np.abs(found[3][tuple(np.transpose(nodes))] - plain) > 1e-4).sum() <= 1


def test_the_best_candidate_is_taken() -> None:
    images, maps = pictures(3), some_maps(2)
    each = np.stack([some_planes(seed) for seed in range(4)])
    alone = np.stack([call(images, maps, planes[None])[3] for planes in each])
    found = call(images, maps, each)
    np.testing.assert_array_equal(found[3], alone.min(axis=0))


@pytest.mark.parametrize("build", _native.instruction_sets())
def test_threads_change_nothing_and_seeds_do(build: str) -> None:
    images, maps, passes = pictures(4), some_maps(3), np.array([4, 3.0, 2, 1.0, 1, 0.3])
    one, three, other = (
        call(images, maps, some_planes()[None], passes=passes, num_threads=threads, seed=seed, instruction_set=build)
        for threads, seed in ((1, 0), (3, 0), (1, 1))
    )
    np.testing.assert_array_equal(one, three)
    assert (one != other).any()
    assert (one[3] <= call(images, maps, some_planes()[None], instruction_set=build)[3]).all()


@pytest.mark.parametrize("level", [0, 128, 255])
def test_without_texture_nothing_matches(level: int) -> None:
    flat = [np.full(SIZE_HW, level, np.uint8)] * 3
    found = call(flat, some_maps(2), some_planes()[None], passes=np.array([4, 3.0]))
    np.testing.assert_array_equal(found[3], 2)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e38])
def test_a_hostile_plane_is_no_match_and_spreads_nowhere(value: float) -> None:
    images, maps, planes = pictures(3), some_maps(2), some_planes()
    planes[:, 5, 5] = value
    found = call(images, maps, planes[None], passes=np.array([2, 1.0]))
    assert np.isfinite(found[3]).all()
    good = found[3] < 2
    assert np.isfinite(found[:3, good]).all()


@pytest.mark.parametrize("size_hw", [(2, 2), (2, 50), (50, 2)])
def test_tiny_pictures_match_nothing(size_hw: tuple[int, int]) -> None:
    tiny = [np.arange(size_hw[0] * size_hw[1], dtype=np.uint8).reshape(size_hw)] * 2
    found = call(tiny, some_maps(1), np.full((1, 3, 1, 1), 0.1, np.float32), passes=np.array([1, 1.0]))
    np.testing.assert_array_equal(found[3], 2)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"camera": np.zeros(5)}, "camera has 5 numbers, expected 6"),
        ({"limits": np.array([0, 1, np.nan, 1])}, "limits has a number that is not finite at index 2"),
        ({"passes": np.zeros(3)}, "pairs of reach and amplitude"),
        ({"passes": np.array([17.0, 1.0])}, "reach of 17"),
        ({"instruction_set": "mmx"}, "'mmx' is unknown"),
    ],
)
def test_wrong_arguments_are_named(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(pictures(2), some_maps(1), some_planes()[None], **changed)


def test_wrong_arrays_are_named() -> None:
    images, maps = pictures(2), some_maps(1)
    with pytest.raises(ValueError, match="sources has 0 images"):
        call(images[:1], maps[:0], some_planes()[None])
    with pytest.raises(ValueError, match="maps has 12 numbers, expected 24"):
        call([*images, images[1]], maps, some_planes()[None])
    with pytest.raises(ValueError, match="candidates has another shape"):
        call(images, maps, np.zeros((1, 2, *SHAPE), np.float32))
    with pytest.raises(ValueError, match="reference has shape"):
        call([np.zeros((1, 9), np.uint8), images[1]], maps, some_planes()[None])
