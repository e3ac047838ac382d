"""The native module: power cells against a numpy twin, effects of importing it, and its build."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from radiant_core import _native

# Southern-hemisphere UTM: eastings near 5e5 m, northings near 1e7 m, the largest coordinates there
# are on Earth.
UTM_M = np.array([500_000.0, 9_999_000.0])


def twin(positions: NDArray, sites: NDArray, weights: NDArray) -> NDArray:
    """The same law in numpy; argmin takes the smallest index among equals."""
    squared = np.square(positions[:, None, :] - sites[None, :, :])
    return np.argmin(squared[..., 0] + squared[..., 1] - weights, axis=1).astype(np.int32)


@given(data=st.data(), num_positions=st.integers(0, 40), num_sites=st.integers(1, 9))
def test_equals_the_numpy_twin_to_the_last_bit_ties_included(data: st.DataObject, num_positions: int, num_sites: int) -> None:
    # Few distinct values make exact ties common; the kernel keeps IEEE order and rounding, so
    # equality is exact.
    values = st.one_of(st.integers(-3, 3).map(float), st.floats(-1e7, 1e7))
    positions = data.draw(arrays(np.float64, (num_positions, 2), elements=values))
    sites = data.draw(arrays(np.float64, (num_sites, 2), elements=values))
    weights = data.draw(arrays(np.float64, num_sites, elements=values))
    cells = _native.assign_power_cells(positions, sites, weights)
    assert cells.dtype == np.int32
    assert cells.shape == (num_positions,)
    np.testing.assert_array_equal(cells, twin(positions, sites, weights))


def test_ties_on_a_lattice_go_to_the_smallest_index() -> None:
    lattice = np.stack(np.meshgrid(np.arange(-4.0, 5.0), np.arange(-4.0, 5.0)), axis=-1).reshape(-1, 2)
    sites = np.array([[2.0, 0.0], [-2.0, 0.0], [2.0, 0.0]])
    cells = _native.assign_power_cells(lattice, sites, np.zeros(3))
    np.testing.assert_array_equal(cells, np.where(lattice[:, 0] >= 0, 0, 1))


def test_a_common_weight_changes_no_cell() -> None:
    rng = np.random.default_rng(0)
    positions, sites, weights = rng.uniform(0, 500, (2000, 2)), rng.uniform(0, 500, (8, 2)), rng.uniform(-1e4, 1e4, 8)
    before = _native.assign_power_cells(positions, sites, weights)
    # 2^20 m² is exact beside these weights, so only a position within rounding of a border could
    # change: none of 2000 is.
    np.testing.assert_array_equal(before, _native.assign_power_cells(positions, sites, weights + 2.0**20))


def test_utm_coordinates_give_the_cells_of_local_ones_to_a_nanometre() -> None:
    rng = np.random.default_rng(1)
    # Multiples of 1/1024 m: the shift to UTM is exact, so the cells must be the same, not nearly
    # the same.
    positions, sites = rng.integers(0, 1 << 19, (5000, 2)) / 1024, rng.integers(0, 1 << 19, (16, 2)) / 1024
    weights = rng.uniform(-1e4, 1e4, 16)
    local = _native.assign_power_cells(positions, sites, weights)
    np.testing.assert_array_equal(local, _native.assign_power_cells(positions + UTM_M, sites + UTM_M, weights))
    # A millimetre to either side of a border at UTM northings: |x|² − 2x·P + |P|², rounded near
    # 1e14 m², would miss it.
    border = UTM_M + np.array([[50.0 - 1e-3, 0.0], [50.0 + 1e-3, 0.0]])
    two = UTM_M + np.array([[0.0, 0.0], [100.0, 0.0]])
    assert _native.assign_power_cells(border, two, np.zeros(2)).tolist() == [0, 1]


def test_a_weight_moves_the_border_by_its_half_over_the_distance() -> None:
    sites, weight_m2 = np.array([[0.0, 0.0], [100.0, 0.0]]), 1200.0
    border_m = 50.0 + weight_m2 / (2 * 100.0)
    positions = np.array([[border_m - 1e-6, 7.0], [border_m + 1e-6, -7.0]])
    assert _native.assign_power_cells(positions, sites, np.array([weight_m2, 0.0])).tolist() == [0, 1]


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["positions", "sites", "weights"])
def test_a_value_that_is_not_finite_is_named_counted_and_located(name: str, poison: float) -> None:
    tensors = {"positions": np.zeros((5, 2)), "sites": np.ones((4, 2)), "weights": np.zeros(4)}
    tensors[name].flat[[3, -1]] = poison
    where = "(3,)" if name == "weights" else "(1, 1)"
    # weights has 4 values, so index 3 is the last one: one value there, two elsewhere.
    count = "1 value that is" if name == "weights" else "2 values that are"
    with pytest.raises(ValueError, match="not finite") as raised:
        _native.assign_power_cells(**tensors)
    assert str(raised.value) == f"{name} holds {count} not finite, the first at index {where}"


@pytest.mark.parametrize(
    ("positions", "sites", "weights", "message"),
    [
        ((5, 3), (4, 2), (4,), "positions has shape (5, 3), expected (C, 2)"),
        ((10,), (4, 2), (4,), "positions has shape (10,), expected (C, 2)"),
        ((5, 2), (4, 2, 1), (4,), "sites has shape (4, 2, 1), expected (E, 2)"),
        ((5, 2), (4, 2), (5,), "weights has shape (5,), expected (4,), one per site"),
        ((5, 2), (0, 2), (0,), "sites has shape (0, 2), expected at least one site"),
    ],
)
def test_a_wrong_shape_is_named_with_what_was_expected(positions: tuple, sites: tuple, weights: tuple, message: str) -> None:
    with pytest.raises(ValueError, match="shape") as raised:
        _native.assign_power_cells(np.zeros(positions), np.zeros(sites), np.zeros(weights))
    assert str(raised.value) == message


def test_positions_whose_squared_distance_overflows_are_refused_not_misplaced() -> None:
    with pytest.raises(ValueError, match=r"positions is too far from every site at index \(1,\)"):
        _native.assign_power_cells(np.array([[0.0, 0.0], [1e200, 0.0]]), np.eye(2), np.zeros(2))


def test_denormal_weights_still_decide_a_tie() -> None:
    assert _native.assign_power_cells(np.zeros((1, 2)), np.zeros((2, 2)), np.array([0.0, 5e-324])).tolist() == [1]


def test_views_that_are_not_contiguous_give_the_same_cells() -> None:
    rng = np.random.default_rng(2)
    wide = rng.uniform(0, 9, (300, 4))
    positions, sites, weights = wide[::3, ::2], wide[:14:2, 1::2], wide[:7, 3][::-1]
    np.testing.assert_array_equal(_native.assign_power_cells(positions, sites, weights), twin(positions, sites, weights))


def test_the_interpreter_runs_on_while_cells_are_assigned() -> None:
    rng = np.random.default_rng(3)
    positions, sites = rng.uniform(0, 9, (200_000, 2)), rng.uniform(0, 9, (500, 2))
    worker = threading.Thread(target=_native.assign_power_cells, args=(positions, sites, np.zeros(500)))
    worker.start()
    ticks = 0
    while worker.is_alive():
        time.sleep(1e-3)
        ticks += 1
    # 1e8 distances take some 100 ms; with the lock held, no tick or one would pass.
    assert ticks >= 5


def test_importing_the_module_leaves_denormals_alone_in_the_whole_process() -> None:
    # A fresh process: one that already flushed them, or a thread with a saved control word, would
    # hide the fault.
    code = "import radiant_core._native, numpy as np; print((np.full(9, 1e-310) / 2).tolist() == [5e-311] * 9, 5e-324 / 1.0 > 0)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["True", "True"]


def test_building_without_a_compiler_says_in_one_sentence_what_to_install(tmp_path: Path) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    cmake, ninja = shutil.which("cmake", path=path), shutil.which("ninja", path=path)
    if cmake is None or ninja is None:
        pytest.skip("needs cmake and ninja, which pip brings only while it builds")
    root = str(Path(__file__).parents[2])
    configure = [cmake, "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}", "-S", root, "-B", str(tmp_path)]
    for _ in range(2):  # what was not found is looked for again
        result = subprocess.run(configure, env={**os.environ, "CXX": "no-such-compiler"}, capture_output=True, text=True, check=False)
        if "or higher is required" in result.stderr:
            pytest.skip("this cmake is too old for the project, pip brings a newer one")
        assert result.returncode == 1
        assert "No C++ compiler was found" in result.stderr and "apt-get install g++" in result.stderr
        assert "CMAKE_CXX_COMPILER:" not in (tmp_path / "CMakeCache.txt").read_text()
