"""SOG as another program reads it: a decoder from the specification alone, textures by OpenCV."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.export import sog
from radiant_core.export.sog import BEYOND_USUAL, FINE_M, SIZE_POWER, USUAL_SHARE, finer_shift, save_sog
from radiant_core.splats import Splats, morton_order


def model(count: int, degree: int = 2, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    bases = (degree + 1) ** 2 - 1
    return Splats(
        means=rng.normal(0, [80, 50, 8], (count, 3)),
        quats=rng.normal(0, 1, (count, 4)),
        log_scales=rng.normal(-3, 1, (count, 3)),
        logit_opacities=rng.normal(0, 3, count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=0.1 * rng.normal(0, 1, (count, bases, 3)),
    )


def decoded(path: Path) -> dict[str, np.ndarray]:
    """Means, quats wxyz, log scales, opacities, sh0, shN in the order of the file, as sections 3.1
    to 3.5 of the specification say."""
    archive = zipfile.ZipFile(path)
    meta = json.loads(archive.read("meta.json"))
    assert meta["version"] == 2
    count = meta["count"]

    def image(name: str) -> np.ndarray:
        data = archive.read(name)
        assert data[:4] == b"RIFF"
        assert data[8:16] == b"WEBPVP8L" or data[8:16] == b"WEBPVP8X", "lossless, or extended by an alpha channel"
        bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert bgr is not None
        # Where all is opaque the file has no alpha: it is 255.
        opaque = np.full((*bgr.shape[:2], 4 - bgr.shape[2]), 255, np.uint8)
        return np.concatenate([bgr, opaque], axis=2)[..., [2, 1, 0, 3]]

    def pixels(name: str) -> np.ndarray:
        array = image(name)
        assert array.shape[0] * array.shape[1] >= count
        return array.reshape(-1, 4)[:count].astype(np.int64)

    low, high = (pixels(name) for name in meta["means"]["files"])
    share = ((high[:, :3] << 8) | low[:, :3]) / 65535
    logs = np.array(meta["means"]["mins"]) + share * (np.array(meta["means"]["maxs"]) - meta["means"]["mins"])
    quat_px = pixels(meta["quats"]["files"][0])
    quats = np.zeros((count, 4))
    for row, (r, g, b, a) in enumerate(quat_px):
        assert 252 <= a <= 255
        kept = [(c / 255 - 0.5) * 2 / np.sqrt(2) for c in (r, g, b)]
        kept.insert(a - 252, np.sqrt(max(0.0, 1 - sum(c * c for c in kept))))
        quats[row] = kept
    color_px = pixels(meta["sh0"]["files"][0])
    found = {
        "means": np.sign(logs) * (np.exp(np.abs(logs)) - 1),
        "quats": quats,
        "log_scales": np.array(meta["scales"]["codebook"])[pixels(meta["scales"]["files"][0])[:, :3]],
        "sh0": np.array(meta["sh0"]["codebook"])[color_px[:, :3]],
        "opacities": color_px[:, 3] / 255,
    }
    if "shN" in meta:
        bases = (3, 8, 15)[meta["shN"]["bands"] - 1]
        palette = image(meta["shN"]["files"][0])[..., :3]
        assert palette.shape[1] == 64 * bases
        label_px = pixels(meta["shN"]["files"][1])
        labels = label_px[:, 0] + (label_px[:, 1] << 8)
        assert labels.max() < meta["shN"]["count"]
        columns = (labels % 64)[:, None] * bases + np.arange(bases)
        found["shN"] = np.array(meta["shN"]["codebook"])[palette[(labels // 64)[:, None], columns]]
    return found


def test_another_decoder_reads_what_was_written_within_the_errors_that_were_said(tmp_path: Path) -> None:
    splats = model(3001)
    errors = save_sog(tmp_path / "scene.sog", splats)
    found, truth = decoded(tmp_path / "scene.sog"), splats.select(morton_order(splats.means))
    assert np.abs(found["means"] - truth.means).max() == pytest.approx(errors.position_max_m, rel=1e-3)
    # Half of 1/65535 of the logarithmic range of ±300 m, at 300 m.
    assert errors.position_max_m < 0.5 / 65535 * 2 * np.log(301) * 301
    for name, said, atol in (("log_scales", errors.log_scale_rms, 0.03), ("sh0", errors.sh0_rms, 0.02), ("shN", errors.shN_rms, 0.005)):
        exact = getattr(truth, name).reshape(found[name].shape)
        counted = np.minimum(exact.astype(np.float64), np.quantile(exact, USUAL_SHARE, method="lower") + BEYOND_USUAL)
        worth = np.exp(SIZE_POWER * counted) if name == "log_scales" else None
        rms = float(np.sqrt(np.average((found[name] - exact) ** 2, weights=worth)))
        assert rms == pytest.approx(said, rel=1e-3)
        assert rms < atol, f"{name}: 256 values leave less"
    # 3 components in 255 steps of √2: at most half a step each, and the fourth by what they leave.
    unit = truth.quats / np.linalg.norm(truth.quats, axis=1, keepdims=True)
    assert np.abs((found["quats"] * unit).sum(axis=1)).min() > np.cos(0.01)
    opacities = 1 / (1 + np.exp(-truth.logit_opacities.astype(float)))
    assert np.abs(found["opacities"] - opacities).max() <= 0.5 / 255 + 1e-6


def test_more_rows_than_the_palette_holds_share_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sog, "MAX_ROWS", 256)
    splats = model(4000, degree=1)
    errors = save_sog(tmp_path / "scene.sog", splats)
    found, truth = decoded(tmp_path / "scene.sog"), splats.select(morton_order(splats.means))
    rms = float(np.sqrt(np.mean((found["shN"] - truth.shN) ** 2)))
    assert rms == pytest.approx(errors.shN_rms, rel=1e-3)
    # Nine dimensions in 256 cells: 1.85 cells an axis, so at least half of the spread of 0.1 is
    # left out, and not all of it is kept.
    assert 0.03 < rms < 0.08


def test_large_gaussians_keep_their_size_best(tmp_path: Path) -> None:
    splats = model(20_000, degree=0)
    tail = splats.log_scales + np.where(np.arange(20_000) % 100 == 0, 4.0, 0.0)[:, None]
    splats = replace(splats, log_scales=np.where(np.arange(20_000)[:, None] == 7, -80.0, tail).astype(np.float32))
    save_sog(tmp_path / "scene.sog", splats)
    found, truth = decoded(tmp_path / "scene.sog"), splats.select(morton_order(splats.means))
    large = truth.log_scales > 0
    wrong = np.abs(found["log_scales"] - truth.log_scales)
    small = (truth.log_scales < -3) & (truth.log_scales > -10)
    assert large.sum() > 200 and wrong[large].max() < 0.2
    assert np.mean(wrong[large]) < 0.01 < np.mean(wrong[small]) < 0.05
    # One that is 10¹³ times as large, though nobody sees it, leaves the others their values.
    outlier = replace(splats, log_scales=np.where(np.arange(20_000)[:, None] == 9, 30.0, splats.log_scales).astype(np.float32))
    save_sog(tmp_path / "outlier.sog", outlier)
    again = np.abs(decoded(tmp_path / "outlier.sog")["log_scales"] - outlier.select(morton_order(outlier.means)).log_scales)
    assert np.mean(again[large]) < 0.02 and np.mean(again[small]) < 0.1


@pytest.mark.parametrize("degree", [0, 3])
def test_degenerate_models_come_back(tmp_path: Path, degree: int) -> None:
    one = model(1, degree)
    save_sog(tmp_path / "one.sog", one)
    found = decoded(tmp_path / "one.sog")
    assert found["means"] == pytest.approx(one.means, abs=1e-4)
    assert ("shN" in found) == (degree > 0)
    same = model(70, degree).select(np.zeros(70, np.int64))
    save_sog(tmp_path / "same.sog", same)
    assert decoded(tmp_path / "same.sog")["log_scales"] == pytest.approx(same.log_scales, abs=1e-6)
    far = model(2, degree).select([0, 1, 0])
    errors = save_sog(tmp_path / "far.sog", Splats(**{**far.arrays(), "means": far.means * np.float32(1e5)}))
    assert np.isfinite(errors.position_max_m)


def test_the_same_model_gives_the_same_bytes_and_none_gives_one_sentence(tmp_path: Path) -> None:
    for name in ("a.sog", "b.sog"):
        save_sog(tmp_path / name, model(50))
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()
    with pytest.raises(BadInput, match="no Gaussians"):
        save_sog(tmp_path / "c.sog", model(0))
    assert not (tmp_path / "c.sog").exists()


@pytest.mark.parametrize("count", [1, 16, 17, 64, 65, 3001])
def test_textures_are_nearly_square_without_a_row_too_many(tmp_path: Path, count: int) -> None:
    save_sog(tmp_path / "a.sog", model(count, degree=1))
    archive = zipfile.ZipFile(tmp_path / "a.sog")
    assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}, "the earliest a zip can say, always the same"
    for name in ("means_l.webp", "quats.webp", "scales.webp", "shN_labels.webp"):
        picture = cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), cv2.IMREAD_UNCHANGED)
        assert picture is not None
        height, width = picture.shape[:2]
        assert height % 4 == width % 4 == 0 and width <= 4 * np.ceil(np.sqrt(count) / 4)
        assert (height - 4) * width < count <= height * width
    palette = cv2.imdecode(np.frombuffer(archive.read("shN_centroids.webp"), np.uint8), cv2.IMREAD_UNCHANGED)
    assert palette is not None and palette.shape[:2] == (np.ceil(count / 64), 64 * 3)
    about = json.loads(archive.read("meta.json"))
    assert about["asset"]["generator"].startswith("radiant ") and about["antialias"] is False


def test_a_texture_holds_16383_pixels_a_side_and_what_needs_more_is_told() -> None:
    most = (16383 // 4 * 4) ** 2
    assert sog._texture_shape(most) == (16380, 16380)
    with pytest.raises(BadInput, match=r"268,304,401 Gaussians do not fit into SOG's textures of 16383² pixels"):
        sog._texture_shape(most + 1)


@pytest.mark.parametrize(
    "values", [np.linspace(-2, 5, 1500), np.random.default_rng(3).normal(0, 1, 1500), np.repeat([-7.0, 0.0, 3.0], [5, 900, 95])]
)
def test_256_values_leave_hardly_more_than_the_best_256(values: np.ndarray) -> None:
    """Against Lloyd's iteration on the sorted values, run to its end from equal shares."""
    codes, book = sog._quantize(values)
    assert (np.diff(book) >= 0).all() and codes.dtype == np.uint8
    ordered = np.sort(values)
    best = np.array([part.mean() for part in np.array_split(ordered, 256)])
    for _ in range(60):
        cuts = np.searchsorted(ordered, (best[1:] + best[:-1]) / 2)
        best = np.array([part.mean() if len(part) else value for part, value in zip(np.split(ordered, cuts), best, strict=True)])
    least = np.abs(ordered[:, None] - best).min(axis=1)
    left = np.abs(values - book[codes])
    # Theirs starts worse and ends better; the histogram's bins and twelve rounds may cost a tenth.
    assert np.sqrt(np.mean(left**2)) <= 1.1 * np.sqrt(np.mean(least**2)) + 1e-12
    # Every value is coded by the mean of its cell.
    for code in np.unique(codes):
        assert book[code] == pytest.approx(values[codes == code].mean(), abs=1e-12)


def test_errors_are_zero_where_nothing_is_lost(tmp_path: Path) -> None:
    one = model(1, degree=0)
    errors = save_sog(tmp_path / "a.sog", one)
    assert (errors.log_scale_rms < 1e-12, errors.sh0_rms < 1e-12, errors.shN_rms) == (True, True, 0.0)
    far = Splats(**{**one.arrays(), "logit_opacities": np.array([300.0], np.float32)})
    save_sog(tmp_path / "b.sog", far)
    assert decoded(tmp_path / "b.sog")["opacities"] == 1


def test_rows_are_split_at_the_mean_of_their_widest_axis_and_equal_ones_stay_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sog, "MAX_ROWS", 4)
    rows = np.array([[0, 0], [0, 1], [10, 0], [10, 1], [10, 1]], np.float32)
    labels, palette = sog._row_palette(rows)
    assert labels.tolist() == [0, 1, 2, 3, 3]
    np.testing.assert_array_equal(palette[labels], rows)
    monkeypatch.setattr(sog, "MAX_ROWS", 5)
    assert sog._row_palette(rows)[0].tolist() == [0, 1, 2, 3, 4]
    monkeypatch.setattr(sog, "MAX_ROWS", 2)
    labels, palette = sog._row_palette(rows)
    assert labels.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_allclose(palette, [[0, 0.5], [10, 2 / 3]])


def test_the_format_has_16_bit_labels_and_64_rows_a_line() -> None:
    assert (sog.MAX_ROWS, sog.ROWS_PER_LINE, sog.CODES) == (2**16, 64, 2**8)


@pytest.mark.parametrize(("low", "high"), [(30.0, 80.0), (-45.0, 45.0), (0.0, 70.0), (-210.0, -110.0)])
def test_whole_hundreds_farther_out_centres_keep_a_millimetre(low: float, high: float, tmp_path: Path) -> None:
    means = np.random.default_rng(0).uniform(low, high, (2000, 3))
    shift = finer_shift(means, 0.95 * FINE_M)
    assert (shift % 100 == 0).all() and shift.any() == (low != 30.0)
    moved = replace(model(2000), means=(means + shift).astype(np.float32))
    assert save_sog(tmp_path / "a.sog", moved).position_max_m < FINE_M
    assert np.abs(decoded(tmp_path / "a.sog")["means"] - moved.select(morton_order(moved.means)).means).max() < FINE_M


def test_no_shift_where_none_is_enough() -> None:
    assert not finer_shift(np.random.default_rng(0).uniform(-200, 200, (2000, 3)), FINE_M).any()
