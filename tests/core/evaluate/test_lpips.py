"""LPIPS against the formula in float64 numpy, with made-up weights of the published shapes; and
files that cannot be used."""

from __future__ import annotations

import os
import pickle  # noqa: TID251
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from safetensors.torch import save_file

from radiant_core.errors import BadInput
from radiant_core.evaluate.lpips import load_lpips, save_lpips

RNG = np.random.default_rng(5)
PHOTO = np.clip(np.cumsum(RNG.normal(scale=0.1, size=(37, 52, 3)), axis=1) + 0.5, 0, 1)
RENDER = np.clip(PHOTO + RNG.normal(scale=0.08, size=PHOTO.shape), 0, 1)

# torchvision's layers: (number, channels out, kernel, stride, padding) of a convolution with its
# ReLU, "tap", or a pool (kernel,).
LAYERS = {
    "alex": [
        *((0, 64, 11, 4, 2), "tap", (3,), (3, 192, 5, 1, 2), "tap", (3,), (6, 384, 3, 1, 1), "tap"),
        *((8, 256, 3, 1, 1), "tap", (10, 256, 3, 1, 1), "tap"),
    ],
    "vgg": [
        *((0, 64, 3, 1, 1), (2, 64, 3, 1, 1), "tap", (2,), (5, 128, 3, 1, 1), (7, 128, 3, 1, 1), "tap", (2,)),
        *((10, 256, 3, 1, 1), (12, 256, 3, 1, 1), (14, 256, 3, 1, 1), "tap", (2,)),
        *((17, 512, 3, 1, 1), (19, 512, 3, 1, 1), (21, 512, 3, 1, 1), "tap", (2,)),
        *((24, 512, 3, 1, 1), (26, 512, 3, 1, 1), (28, 512, 3, 1, 1), "tap"),
    ],
}
BACKBONES = {"alex": "alexnet-owt-7be5be79.pth", "vgg": "vgg16-397923af.pth"}
Weights = dict[str, torch.Tensor]


def made_up(network: str) -> tuple[Weights, Weights]:
    """Backbone and heads with signals that neither die out nor grow from layer to layer."""
    generator = torch.Generator().manual_seed(3)
    backbone, heads, channels = {}, {}, 3
    for layer in LAYERS[network]:
        if layer == "tap":
            heads[f"lin{len(heads)}.model.1.weight"] = torch.rand((1, channels, 1, 1), generator=generator)
        elif len(layer) == 5:
            number, out, kernel, *_ = layer
            backbone[f"features.{number}.weight"] = (
                torch.randn((out, channels, kernel, kernel), generator=generator) * (2 / (channels * kernel**2)) ** 0.5
            )
            backbone[f"features.{number}.bias"] = 0.1 * torch.randn(out, generator=generator)
            channels = out
    # The published files hold more than LPIPS uses.
    return {**backbone, "classifier.6.bias": torch.zeros(1000)}, heads


def plain_lpips(network: str, weights: Weights, a: np.ndarray, b: np.ndarray) -> float:
    """The formula, one window at a time as numpy sees it, all in float64."""
    shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    images = [((2 * image - 1 - shift) / scale).transpose(2, 0, 1) for image in (a, b)]
    total, tap = 0.0, 0
    for layer in LAYERS[network]:
        if layer == "tap":
            head = weights[f"lin{tap}.model.1.weight"].numpy().astype(np.float64).reshape(-1, 1, 1)
            unit = [image / (np.sqrt((image**2).sum(axis=0)) + 1e-10) for image in images]
            total += (head * (unit[0] - unit[1]) ** 2).sum(axis=0).mean()
            tap += 1
        elif len(layer) == 1:
            images = [sliding_window_view(image, (layer[0], layer[0]), axis=(1, 2))[:, ::2, ::2].max(axis=(3, 4)) for image in images]
        else:
            number, _, kernel, stride, padding = layer
            weight, bias = (weights[f"features.{number}.{name}"].numpy().astype(np.float64) for name in ("weight", "bias"))
            for index, image in enumerate(images):
                padded = np.pad(image, ((0, 0), (padding, padding), (padding, padding)))
                windows = sliding_window_view(padded, (kernel, kernel), axis=(1, 2))[:, ::stride, ::stride]
                images[index] = np.maximum(np.tensordot(weight, windows, axes=([1, 2, 3], [0, 3, 4])) + bias[:, None, None], 0)
    return float(total)


def write_folder(folder: Path, network: str, backbone: object, heads: object, *, old: bool = False) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in ((BACKBONES[network], backbone), (f"{network}.pth", heads)):
        torch.save(content, folder / name, _use_new_zipfile_serialization=not old)  # noqa: TID251
    return folder


@pytest.fixture(scope="module")
def alex(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("weights") / "alex", "alex", *made_up("alex"))


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_the_network_computes_the_formula(network: str, tmp_path: Path) -> None:
    backbone, heads = made_up(network)
    lpips = load_lpips(write_folder(tmp_path / "w", network, backbone, heads, old=network == "vgg"), network)
    expected = plain_lpips(network, {**backbone, **heads}, RENDER, PHOTO)
    assert expected > 0.01
    # float32 sums of up to 4,608 products in 13 layers against float64.
    assert lpips(RENDER, PHOTO) == pytest.approx(expected, rel=1e-4)
    assert lpips(PHOTO, PHOTO) == 0.0
    assert lpips(PHOTO, RENDER) == pytest.approx(lpips(RENDER, PHOTO), rel=1e-6)
    black = np.zeros_like(PHOTO)
    assert lpips(black, black) == 0.0 and 0 < lpips(black, PHOTO) < np.inf


def test_one_safetensors_with_both_parts_gives_the_same_as_the_folder(alex: Path, tmp_path: Path) -> None:
    backbone, heads = made_up("alex")
    save_file({**backbone, **heads}, tmp_path / "both.safetensors")
    from_folder, from_file = load_lpips(alex, "alex"), load_lpips(tmp_path / "both.safetensors", "alex")
    save_lpips(tmp_path / "needed.safetensors", from_folder)
    kept = load_lpips(tmp_path / "needed.safetensors", "alex")
    assert from_folder(RENDER, PHOTO) == from_file(RENDER, PHOTO) == kept(RENDER, PHOTO)
    assert "classifier.6.bias" not in kept.weights


def test_it_grows_with_the_error_and_takes_the_smallest_image_there_is(alex: Path) -> None:
    lpips = load_lpips(alex, "alex")
    noise = RNG.normal(size=PHOTO.shape)
    values = [lpips(np.clip(PHOTO + step * noise, 0, 1), PHOTO) for step in (0.01, 0.05, 0.2)]
    assert 0 < values[0] < values[1] < values[2]
    smallest = PHOTO[:31, :31]
    assert lpips(RENDER[:31, :31], smallest) > 0
    with pytest.raises(BadInput, match="too small for LPIPS alex: give at least 31 px"):
        lpips(RENDER[:30], PHOTO[:30])


@pytest.mark.parametrize("poison", [PHOTO[:20], PHOTO[:, :, :2], PHOTO * 255, PHOTO * np.nan], ids=["size", "channels", "0 to 255", "nan"])
def test_poison_images_are_bad_input(alex: Path, poison: np.ndarray) -> None:
    with pytest.raises(BadInput):
        load_lpips(alex, "alex")(poison, PHOTO)


def _without(name: str) -> Callable[[Weights], object]:
    return lambda part: {key: value for key, value in part.items() if key != name}


def _changed(name: str, change: Callable[[torch.Tensor], object]) -> Callable[[Weights], object]:
    return lambda part: {key: change(value) if key == name else value for key, value in part.items()}


def _with_nan(tensor: torch.Tensor) -> torch.Tensor:
    poisoned = tensor.clone()
    poisoned.view(-1)[-1] = float("nan")
    return poisoned


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_without("features.3.bias"), "has no tensor features.3.bias"),
        (_changed("features.0.weight", lambda w: w[:, :, :3, :3]), r"features.0.weight .* \(64, 3, 3, 3\), expected"),
        (_changed("features.6.weight", lambda w: w.transpose(0, 1)), "expected a floating type"),
        (_changed("features.6.bias", lambda w: w.to(torch.int32)), "torch.int32"),
        (_changed("features.10.weight", lambda w: w.to_sparse()), "features.10.weight"),
        (_changed("features.8.weight", _with_nan), "not finite"),
        (_changed("features.8.bias", lambda w: w.double() + 1e300), "not finite"),
        (_changed("features.8.bias", lambda w: w.numpy().tolist()), "has no tensor features.8.bias"),
        (lambda part: list(part.values()), "holds a list"),
        (lambda part: part["features.0.bias"], "holds a Tensor"),
    ],
)
def test_weights_of_another_network_or_damaged_ones_are_refused(spoil: Callable[[Weights], object], told: str, tmp_path: Path) -> None:
    backbone, heads = made_up("alex")
    with pytest.raises(BadInput, match=told) as raised:
        load_lpips(write_folder(tmp_path / "w", "alex", spoil(backbone), heads), "alex")
    assert "\n" not in str(raised.value)


class _MakesFolder:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("old", [False, True])
def test_a_pickle_that_would_run_code_is_refused_and_does_not_run(old: bool, tmp_path: Path) -> None:
    backbone, heads = made_up("alex")
    folder = write_folder(tmp_path / "w", "alex", backbone, {**heads, "extra": _MakesFolder(tmp_path / "ran")}, old=old)
    with pytest.raises(BadInput, match="cannot read"):
        load_lpips(folder, "alex")
    (folder / "alex.pth").write_bytes(pickle.dumps(_MakesFolder(tmp_path / "ran")))
    with pytest.raises(BadInput, match="cannot read"):
        load_lpips(folder, "alex")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("old", [False, True])
def test_truncated_and_mutated_heads_are_refused_or_read_whole(old: bool, alex: Path, tmp_path: Path) -> None:
    _, heads = made_up("alex")
    folder = write_folder(tmp_path / "w", "alex", {}, heads, old=old)
    (folder / BACKBONES["alex"]).unlink()
    (folder / BACKBONES["alex"]).symlink_to(alex / BACKBONES["alex"])
    path, whole = folder / "alex.pth", (folder / "alex.pth").read_bytes()
    rng = np.random.default_rng(9)
    for length in (0, 1, 60, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(BadInput):
            load_lpips(folder, "alex")
    for _ in range(40):
        mutated = bytearray(whole)
        for place in rng.integers(min(len(whole), 1500), size=3):
            mutated[place] = rng.integers(256)
        path.write_bytes(mutated)
        try:
            lpips = load_lpips(folder, "alex")
        except BadInput:
            continue
        assert all(bool(torch.isfinite(weight).all()) for weight in lpips.weights.values())


def test_missing_and_ambiguous_files_and_unknown_networks_are_refused(alex: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "none.safetensors").write_bytes(b"no safetensors at all")
    backbone, heads = made_up("alex")
    save_file(backbone, tmp_path / "half.safetensors")
    twice = write_folder(tmp_path / "twice", "alex", backbone, heads)
    (twice / "alexnet-other.pth").write_bytes(b"")
    cases = [
        (tmp_path / "nowhere", "alex", "there are no LPIPS weights"),
        (tmp_path / "empty", "alex", "holds 0 files alexnet*.pth and 0 alex.pth"),
        (twice, "alex", "holds 2 files alexnet*.pth"),
        (alex, "vgg", "holds 0 files vgg16*.pth and 0 vgg.pth"),
        (tmp_path / "none.safetensors", "alex", "not a whole safetensors"),
        (tmp_path / "half.safetensors", "alex", "has no tensor lin0.model.1.weight"),
        (alex, "squeeze", "use one of vgg, alex"),
    ]
    for path, network, told in cases:
        with pytest.raises(BadInput, match=re.escape(told)) as raised:
            load_lpips(path, network)
        assert "\n" not in str(raised.value)
