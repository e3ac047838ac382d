"""Models that must not be joined: one sentence, before anything is rendered; all others pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiant_core.aggregate.arrival import MAX_SPLATS, check_splats
from radiant_core.hierarchy.codec import load_device_model
from radiant_core.hierarchy.joining import model_problem
from radiant_core.io.array_file import save_arrays
from radiant_core.io.records import save_cameras
from radiant_core.io.transport.upload import count_uploaded, save_upload
from radiant_core.splats import Splats
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])
GROUND = ground_splats()


def arrived_in(folder: Path) -> Splats | str:
    """The model that an edge finds in a folder, or why it is not to be joined."""
    model = load_device_model(folder)
    return model if isinstance(model, str) else model_problem(model, len(CAMERAS)) or model.splats


def changed(**values: float) -> Splats:
    """The ground with one number of one array replaced."""
    arrays = {name: getattr(GROUND, name).copy() for name in values}
    for name, value in values.items():
        arrays[name].flat[7] = value
    return replace(GROUND, **arrays)


@pytest.mark.parametrize("upload", ["float32", "float16", "spz"])
def test_an_honest_model_passes_in_every_format(upload, tmp_path: Path) -> None:
    save_upload(tmp_path / "model.safetensors", GROUND, upload)
    assert count_uploaded(tmp_path / "model.safetensors") == len(GROUND)
    arrived = arrived_in(tmp_path)
    assert isinstance(arrived, Splats) and len(arrived) == len(GROUND)
    assert check_splats(GROUND, CAMERAS.select([])) is None


@pytest.mark.parametrize(
    ("model", "told"),
    [
        (GROUND.select(np.zeros(0, np.int64)), "it has 0 Gaussians, expected 1 to 5,000,000."),
        (changed(means=3e6), "a value of its means is 3e+06, expected at most 1e+06."),
        (changed(sh0=-1e6), "a value of its sh0 is 1e+06, expected at most 50."),
        (changed(log_scales=80.0), "a Gaussian has the log scale 80, expected at most 12."),
        (replace(GROUND, means=GROUND.means + np.float32(500)), "its own cameras see 0.0% of its Gaussians, expected 5% or more"),
        (replace(GROUND, means=-GROUND.means * [1, 1, 0] + np.float32([0, 0, 40])), "its own cameras see 0.0%"),
    ],
)
def test_what_is_wrong_is_said(model: Splats, told: str) -> None:
    found = check_splats(model, CAMERAS)
    assert found is not None and found.startswith(told) and "\n" not in found


def test_ten_million_gaussians_are_refused_by_the_header_alone(tmp_path: Path) -> None:
    """A header that says 10⁷ over a file that has them nearly in full would take 2 GB: here a file
    whose numbers are never read."""
    path = tmp_path / "model.safetensors"
    count = 10**7
    shapes = {"means": 3, "quats": 4, "log_scales": 3, "logit_opacities": None, "sh0": 3, "shN": 9}
    arrays = {name: np.zeros((count,) if width is None else (1, width), np.float32) for name, width in shapes.items()}
    save_arrays(path, "radiant.splats", arrays, {})
    assert arrived_in(tmp_path) == f"it has 10,000,000 Gaussians, expected 1 to {MAX_SPLATS:,}."


def test_as_many_as_allowed_are_allowed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    save_upload(tmp_path / "model.safetensors", GROUND, "float16")
    for limit, passes in ((len(GROUND), True), (len(GROUND) - 1, False)):
        monkeypatch.setattr("radiant_core.aggregate.arrival.MAX_SPLATS", limit)
        monkeypatch.setattr("radiant_core.hierarchy.codec.MAX_SPLATS", limit)
        assert (check_splats(GROUND, CAMERAS) is None) is passes
        assert isinstance(arrived_in(tmp_path), Splats) is passes


def test_files_that_are_no_model_are_refused_with_their_reason(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    assert "no such file" in str(arrived_in(tmp_path))
    path.write_bytes(b"\x00" * 100)
    assert "not a whole safetensors file" in str(arrived_in(tmp_path))
    save_cameras(path, CAMERAS)
    assert "cannot use" in str(arrived_in(tmp_path))
    save_arrays(path, "radiant.splats", {**GROUND.arrays(), "sh0": np.full_like(GROUND.sh0, np.nan)}, {})
    assert "sh0 has" in str(arrived_in(tmp_path)) and "not finite" in str(arrived_in(tmp_path))


@given(st.binary(max_size=400))
def test_no_bytes_end_a_run(data: bytes) -> None:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.safetensors"
        path.write_bytes(data)
        assert isinstance(arrived_in(Path(folder)), str)


@pytest.mark.parametrize(("name", "limit"), [("means", 1e6), ("sh0", 50.0), ("shN", 50.0), ("log_scales", 12.0)])
def test_what_is_expected_at_most_is_allowed(name: str, limit: float) -> None:
    with_bases = replace(GROUND, shN=np.zeros((len(GROUND), 3, 3)))
    for value, passes in ((limit, True), (np.nextafter(np.float32(limit), np.float32(np.inf)), False)):
        array = getattr(with_bases, name).copy()
        array.flat[7] = value
        found = check_splats(replace(with_bases, **{name: array}), CAMERAS)
        assert (found is None) is passes, found


def test_one_gaussian_in_twenty_in_sight_is_enough() -> None:
    for seen, passes in ((15, True), (14, False)):
        means = GROUND.means.copy()
        means[: len(GROUND) - seen] += np.float32(500)
        means[len(GROUND) - seen :] = [0.0, 0.0, 0.0]
        assert (check_splats(replace(GROUND, means=means), CAMERAS) is None) is passes
