"""Uploads: the result of each format against float64; extremes, mutated bytes, and limits."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from radiant_core.choices import UploadFormat
from radiant_core.errors import BadInput, RadiantError, StoreDamaged
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.array_file import header_of, save_arrays
from radiant_core.io.open3d_formats import splats_from_spz
from radiant_core.io.records import save_cameras
from radiant_core.io.transport.upload import BYTES_FACTORS, load_upload, save_upload, upload_problem
from radiant_core.numerics import rotmats_from_quats
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_BASES, Splats
from tests.core.scenes import cameras_above, ground_splats

FORMATS: tuple[UploadFormat, ...] = ("float32", "float16", "spz")
EXTENT_M = 500.0


def trained_like(count: int = 300, degree: int = 1, seed: int = 0) -> Splats:
    """Gaussians in the ranges of a trained model of half a kilometre, quaternions of any length."""
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.uniform(-EXTENT_M / 2, EXTENT_M / 2, (count, 3)) + np.array([3000, -7000, 50]),
        quats=rng.normal(size=(count, 4)) * rng.uniform(0.3, 2, (count, 1)),
        log_scales=rng.uniform(-5, 3, (count, 3)),
        logit_opacities=rng.uniform(-5.5, 7, count),
        sh0=rng.uniform(-2, 3.3, (count, 1, 3)),
        shN=rng.uniform(-0.5, 0.5, (count, SH_BASES[degree] - 1, 3)),
    )


def there_and_back(path: Path, splats: Splats, upload_format: UploadFormat) -> Splats:
    save_upload(path / "upload.safetensors", splats, upload_format)
    return load_upload(path / "upload.safetensors")


def opacities(splats: Splats) -> np.ndarray:
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))


def max_errors(before: Splats, after: Splats) -> dict[str, float]:
    """Largest differences in float64, rotations and opacities after activation."""
    a, b = ({name: array.astype(np.float64) for name, array in splats.arrays().items()} for splats in (before, after))
    pairs = {name: (a[name], b[name]) for name in ("means", "log_scales", "sh0", "shN")}
    pairs |= {
        "rotations": (rotmats_from_quats(a["quats"]), rotmats_from_quats(b["quats"])),
        "opacities": (opacities(before), opacities(after)),
    }
    return {name: float(np.abs(left - right).max(initial=0)) for name, (left, right) in pairs.items()}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_float32_comes_back_to_the_bit(tmp_path: Path, degree: int) -> None:
    splats = trained_like(degree=degree)
    after = there_and_back(tmp_path, splats, "float32")
    assert all(array.tobytes() == after.arrays()[name].tobytes() for name, array in splats.arrays().items())


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_float16_keeps_centres_to_21_bits_of_the_box_and_the_rest_to_11(tmp_path: Path, degree: int) -> None:
    splats = trained_like(degree=degree)
    errors = max_errors(splats, there_and_back(tmp_path, splats, "float16"))
    # Half a step of 21 bits, and half a step of the float32 at 7 km that the centres come back as.
    assert errors["means"] <= 0.5 * EXTENT_M / (2**21 - 1) + 0.5 * np.spacing(np.float32(7250))
    # Half of float16's spacing at the largest value: 5, 3.3, 0.5; a quaternion of length 1 moves
    # the rotation by twice its error.
    half_step = 0.5 * 2.0**-10
    assert errors["log_scales"] <= 4 * half_step and errors["sh0"] <= 2 * half_step and errors["shN"] <= 0.5 * half_step
    assert errors["rotations"] <= 8 * half_step and errors["opacities"] <= 1e-3


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_keeps_what_its_steps_allow(tmp_path: Path, degree: int) -> None:
    splats = trained_like(degree=degree)
    errors = max_errors(splats, there_and_back(tmp_path, splats, "spz"))
    # 500 m around their middle take a factor 4 within ±2048 (8 would leave it): half a step of
    # 1/4096 over that, and float32's at 7 km.
    assert errors["means"] <= 0.5 / 4096 / 4 + 0.51 * np.spacing(np.float32(7250))
    assert errors["log_scales"] <= 0.5 / 16 + 1e-5
    assert errors["opacities"] <= 0.5 / 255 + 1e-6
    assert errors["sh0"] <= 0.5 / (255 * 0.15) + 1e-6
    # Rounded twice: to 1/128, then to its own step.
    assert errors["shN"] <= (0.5 / 16 if degree == 1 else 0.5 / 8) + 0.5 / 128 + 1e-6
    assert errors["rotations"] <= 0.01  # 9 bits and a sign for each of the three smaller components


@pytest.mark.parametrize(("name", "least_db"), [("float16", 55), ("spz", 35)])
def test_a_decoded_model_looks_like_the_sent_one(tmp_path: Path, name: UploadFormat, least_db: float) -> None:
    ground, rng = ground_splats(), np.random.default_rng(1)
    spread = replace(ground, quats=rng.normal(size=(300, 4)), log_scales=ground.log_scales + rng.normal(size=(300, 3)) / 2)
    sent = replace(spread, shN=rng.normal(size=(300, 8, 3)) / 10)
    cameras = cameras_above([(-1, 0), (1, 1)])
    pairs = zip(render_views(sent, cameras), render_views(there_and_back(tmp_path, sent, name), cameras), strict=True)
    assert min(psnr_db(before.image, after.image) for before, after in pairs) > least_db


def test_files_take_the_bytes_that_the_planner_counts_with(tmp_path: Path) -> None:
    splats = trained_like(20_000)
    sizes = {}
    for name in FORMATS:
        save_upload(tmp_path / name, splats, name)
        sizes[name] = (tmp_path / name).stat().st_size
    assert sizes["float16"] / sizes["float32"] == pytest.approx(BYTES_FACTORS["float16"], abs=0.005)
    # Random numbers compress less than a trained model, for which the factor was measured.
    assert BYTES_FACTORS["spz"] < sizes["spz"] / sizes["float32"] < 1.6 * BYTES_FACTORS["spz"]


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_model_gives_the_same_bytes(tmp_path: Path, name: UploadFormat) -> None:
    written = set()
    for index in range(3):
        save_upload(tmp_path / str(index), trained_like(50), name)
        written.add((tmp_path / str(index)).read_bytes())
    assert len(written) == 1, "keys of stages hash these bytes"


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("degree", [0, 3])
def test_no_gaussian_and_one_gaussian_come_back(tmp_path: Path, name: UploadFormat, degree: int) -> None:
    for count in (0, 1):
        splats = trained_like(count, degree)
        after = there_and_back(tmp_path, splats, name)
        assert (len(after), after.sh_degree) == (count, degree)
        assert max_errors(splats, after)["means"] <= np.spacing(np.float32(7250))


@pytest.mark.parametrize("name", ["float16", "spz"])
def test_saturated_opacities_stay_finite_and_zero_quaternions_the_identity(tmp_path: Path, name: UploadFormat) -> None:
    splats = trained_like(6)
    arrays = {**splats.arrays(), "logit_opacities": np.array([3e38, -3e38, 50, -50, 7, 0]), "quats": np.zeros((6, 4))}
    arrays["quats"][1] = 1e-30  # far below the smallest float16
    after = there_and_back(tmp_path, Splats(**arrays), name)
    np.testing.assert_allclose(opacities(after), opacities(Splats(**arrays)), atol=0.5 / 255)
    np.testing.assert_allclose(rotmats_from_quats(after.quats)[0], np.eye(3), atol=1e-3)
    np.testing.assert_allclose(rotmats_from_quats(after.quats)[1], rotmats_from_quats([1, 1, 1, 1]), atol=5e-3)


def test_float16_holds_the_whole_range_of_float32_where_activation_does(tmp_path: Path) -> None:
    splats = trained_like(4)
    means = np.array([[3.4e38, 0, 1e-40], [-3.4e38, 1e-45, 0], [0, 0, 0], [1e38, 0, 0]], np.float32)
    tiny = np.array([1e-7, -1e-7, 1e-45, 0], np.float32)
    log_scales = np.array([[3e38] * 3, [-3e38] * 3, [88] * 3, [-20] * 3], np.float32)
    splats = replace(splats, means=means, log_scales=log_scales, sh0=np.repeat(tiny, 3).reshape(4, 1, 3))
    after = there_and_back(tmp_path, splats, "float16")
    assert np.abs(after.means.astype(np.float64) - means).max(axis=0)[0] <= 6.8e38 / 2**21
    with np.errstate(over="ignore"):
        # 88 has steps of 1/16.
        np.testing.assert_allclose(np.exp(after.log_scales), np.exp(log_scales), rtol=0.04)
    assert np.abs(after.sh0 - splats.sh0).max() <= 2.0**-25, "half a step of float16's denormals"


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("count", [0, 5])
def test_how_a_model_was_trained_to_be_drawn_comes_back(tmp_path: Path, name: UploadFormat, antialiased: bool, count: int) -> None:
    assert there_and_back(tmp_path, replace(trained_like(count), antialiased=antialiased), name).antialiased is antialiased


def test_a_model_of_any_size_is_brought_to_the_steps_of_spz(tmp_path: Path) -> None:
    """Ten orders of magnitude about a far centre in float32; beyond 2^±40 the steps stay."""
    splats, errors = trained_like(50), []
    for factor in (1e-3, 1.0, 1e3, 1e6):
        scaled = replace(splats, means=(splats.means - splats.means.mean(axis=0)) * factor, log_scales=splats.log_scales + np.log(factor))
        after = there_and_back(tmp_path, scaled, "spz")
        errors.append(float(np.abs(after.means - scaled.means).max()) / factor)
    assert max(errors) < 2e-4, "half a step of 1/4096 over 4 or 2, at every size"


def test_the_exponent_of_spz_ends_at_40(tmp_path: Path) -> None:
    path = tmp_path / "upload.safetensors"
    point = replace(trained_like(1), means=np.zeros((1, 3)), log_scales=np.full((1, 3), -25.0))
    save_upload(path, point, "spz")
    data, (record, _) = load_file(path), header_of(path)
    assert record["about"]["exponent"] == 40
    for exponent, passes in ((40, True), (-40, True), (41, False), (-41, False)):
        save_arrays(path, "radiant.splats.spz", data, {**record["about"], "exponent": exponent})
        if passes:
            assert len(load_upload(path)) == 1
        else:
            with pytest.raises(BadInput, match=f"exponent {exponent}"):
                load_upload(path)


def test_what_a_format_cannot_hold_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    bright = replace(trained_like(5), sh0=np.full((5, 1, 3), 7e4))
    far = trained_like(50)
    means, log_scales = far.means.copy(), far.log_scales.copy()
    means[0], log_scales[1] = 1e9, 60
    cases: list[tuple[Splats, Any, str]] = [
        (bright, "float16", r"a colour coefficient is 7e\+04, float16 ends at 65504: use --upload float32"),
        (replace(far, means=means), "spz", "use --upload float16"),
        (replace(far, log_scales=log_scales), "spz", "use --upload float16"),
        (replace(far, means=far.means * np.float32(1e34)), "spz", "use --upload float16"),
        (far, "zip", "'zip' is unknown: use one of float32, float16, spz"),
    ]
    for splats, name, told in cases:
        with pytest.raises(BadInput, match=told):
            save_upload(tmp_path / "upload.safetensors", splats, name)
    assert list(tmp_path.iterdir()) == []
    assert upload_problem(replace(far, sh0=np.full((50, 1, 3), -65504.0)), "float16") is None
    assert upload_problem(far, "spz") is None and upload_problem(replace(far, means=means), "float16") is None


@pytest.mark.parametrize("name", ["float16", "spz"])
def test_mutated_bytes_give_typed_errors_or_a_finite_model(tmp_path: Path, name: UploadFormat) -> None:
    path = tmp_path / "upload.safetensors"
    save_upload(path, trained_like(30), name)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(400):
        mutated = bytearray(whole)
        for place in rng.integers(len(whole) if rng.random() < 0.5 else 700, size=rng.integers(1, 4)):
            mutated[place] = rng.integers(256)
        path.write_bytes(mutated[: rng.integers(len(whole))] if rng.random() < 0.1 else mutated)
        try:
            assert all(np.isfinite(array).all() for array in load_upload(path).arrays().values())
        except RadiantError:
            refused += 1
    assert refused > (350 if name == "spz" else 100)


def test_a_stranger_in_place_of_a_model_is_refused(tmp_path: Path) -> None:
    save_cameras(tmp_path / "cameras", cameras_above([(0, 0)]))
    (tmp_path / "text").write_text("no model")
    save_upload(tmp_path / "box", trained_like(3), "float16")
    arrays = load_file(tmp_path / "box")
    head = {"schema": "radiant.splats.float16", "version": "1", "about": {}}
    for key, wrong in {"box": arrays["box"][::-1].copy(), "means": arrays["means"] | np.uint64(1 << 63)}.items():
        save_file({**arrays, key: wrong}, tmp_path / key, {"radiant": json.dumps(head)})
    save_file({**arrays, "box": arrays["box"] * np.nan}, tmp_path / "nan", {"radiant": json.dumps(head)})
    save_file(arrays, tmp_path / "old", {"radiant": json.dumps({**head, "version": "0"})})
    errors = {
        "cameras": BadInput,
        "text": StoreDamaged,
        "box": BadInput,
        "means": BadInput,
        "nan": BadInput,
        "old": BadInput,
        "none": StoreDamaged,
    }
    for name, error in errors.items():
        with pytest.raises(error, match=name):
            load_upload(tmp_path / name)


def test_spz_that_lies_about_its_sizes_never_reaches_open3d(tmp_path: Path) -> None:
    save_upload(tmp_path / "upload", trained_like(20), "spz")
    data = load_file(tmp_path / "upload")["spz"].tobytes()
    assert len(splats_from_spz(data, 20, 1)) == 20
    count = bytearray(data)
    struct.pack_into("<I", count, 8, 21)  # Gaussians by the header
    stream = bytearray(data)
    struct.pack_into("<Q", stream, 40, 20 * 9 + 1)  # the unpacked size of the first stream
    for wrong in (b"", data[:20], data[:-1], data + b"x", bytes(count), bytes(stream), b"PLY " + data[4:]):
        with pytest.raises(StoreDamaged, match="no SPZ of version 4 with 20 Gaussians"):
            splats_from_spz(wrong, 20, 1)
    with pytest.raises(StoreDamaged, match="10 Gaussians of degree 1"):
        splats_from_spz(data, 10, 1)


def test_reading_spz_leaves_standard_output_to_the_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    there_and_back(tmp_path, trained_like(5), "spz")
    assert capfd.readouterr().out == ""
