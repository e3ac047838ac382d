"""`import radiant`: the stable surface works end to end, says what its objects are, and keeps its signatures."""

from __future__ import annotations

import ast
import doctest
import inspect
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import radiant
from radiant_app.events import Event, StageProgress
from radiant_app.files.system_file import dump_system
from radiant_core.train.optimizer import SelectiveAdam

SURFACE = Path(__file__).parent / "radiant_surface.json"


def surface() -> dict[str, dict[str, str]]:
    """Each name of the surface with the parameters of what can be called: required, or optional."""
    shown: dict[str, dict[str, str]] = {}
    for name in radiant.__all__:
        value = getattr(radiant, name)
        is_error = inspect.isclass(value) and issubclass(value, Exception)
        given = inspect.signature(value).parameters.values() if callable(value) and not is_error else ()
        shown[name] = {
            each.name: "required" if each.default is each.empty and each.kind is not each.VAR_KEYWORD else "optional" for each in given
        }
    return shown


def test_the_surface_is_what_was_promised() -> None:
    """What stands in the file may only grow before the next major version: names and parameters stay, new parameters are optional.

    `python -m tests.app.test_radiant_module` writes the file anew.
    """
    promised, offered = json.loads(SURFACE.read_text()), surface()
    assert set(promised) == set(offered), "a name was added or removed: write the file anew"
    for name, parameters in promised.items():
        assert parameters.items() <= offered[name].items(), f"{name} no longer takes what it took"
        assert {offered[name][new] for new in set(offered[name]) - set(parameters)} <= {"optional"}, f"{name} asks for more than it did"


def test_every_name_is_documented_with_what_it_takes() -> None:
    for name in radiant.__all__:
        value = getattr(radiant, name)
        assert not callable(value) or (value.__doc__ and not value.__doc__.startswith(f"{name}(")), name
    for name in ("picture", "train", "join", "evaluate", "export", "load_scene", "load_splats", "reconstruct", "plan_regions"):
        doc = inspect.getdoc(getattr(radiant, name)) or ""
        assert all(part in doc for part in ("Args:", "Returns:", "Raises:")), name
        documented = doc[doc.index("Args:") : doc.index("Returns:")]
        for parameter in inspect.signature(getattr(radiant, name)).parameters:
            assert f"\n    {parameter}: " in documented, f"{name} does not say what {parameter} is"


def examples() -> dict[str, list[doctest.Example]]:
    """Name of the surface → the lines of its example."""
    docs = {name: inspect.getdoc(getattr(radiant, name)) or "" for name in radiant.__all__}
    return {name: found for name, doc in docs.items() if (found := doctest.DocTestParser().get_examples(doc))}


WITH_EXAMPLE = {name for name in radiant.__all__ if inspect.isfunction(getattr(radiant, name))} | {
    "Cameras", "Lens", "Part", "RunConfig", "Scene", "SplatTensors", "Splats", "TrainConfig",
}  # fmt: skip


def test_what_users_call_says_when_and_how_in_a_few_lines() -> None:
    assert examples().keys() == WITH_EXAMPLE
    for name, lines in examples().items():
        assert 1 <= len(lines) <= 4, f"the example of {name} has {len(lines)} lines, three are enough"
        doc = inspect.getdoc(getattr(radiant, name)) or ""
        assert "Use it" in doc or not inspect.isfunction(getattr(radiant, name)), f"{name} does not say when to use it"
        for called, node in calls_of(lines):
            assert called in radiant.__all__, f"the example of {name} calls {called}, which is not promised"
            given = {each.arg: each.value for each in node.keywords if each.arg}
            inspect.signature(getattr(radiant, called)).bind_partial(*node.args, **given)


def calls_of(lines: list[doctest.Example]) -> Iterator[tuple[str, ast.Call]]:
    """What an example calls of radiant, as `radiant.train(scene)`."""
    calls = (node for line in lines for node in ast.walk(ast.parse(line.source)) if isinstance(node, ast.Call))
    for node in calls:
        match node.func:
            case ast.Attribute(value=ast.Name(id="radiant"), attr=name):
                yield name, node


@pytest.mark.parametrize("name", sorted(WITH_EXAMPLE))
def test_the_example_of_a_docstring_runs(
    name: str, hamlet_scene: Path, result: radiant.TrainResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "SCENE").symlink_to(hamlet_scene)
    radiant.save_splats(result.splats, tmp_path / "model.ply")
    (tmp_path / "system.toml").write_text(dump_system(radiant.even_system(1, 2)))
    known = {"radiant": radiant, "np": np, "torch": torch, "Path": Path, "replace": replace}
    test = doctest.DocTest(examples()[name], known, name, None, None, None)
    said: list[str] = []
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append).failed == 0, "".join(said)


@pytest.fixture(scope="module")
def scene(hamlet_scene: Path) -> radiant.Scene:
    return radiant.load_scene(hamlet_scene)


@pytest.fixture(scope="module")
def heard() -> list[Event]:
    return []


@pytest.fixture(scope="module")
def result(scene: radiant.Scene, heard: list[Event]) -> radiant.TrainResult:
    return radiant.train(scene, num_steps=30, long_side_px=64, listen=heard.append, fill_in=True)


def test_a_scene_says_what_it_is_and_parts_it_by_name(scene: radiant.Scene) -> None:
    assert repr(scene) == f"Scene(12 photographs, 2 held out, {len(scene.points):,} points, m)"
    held_out = scene.views("held_out", 64)
    assert repr(held_out) == "TrainingViews(Cameras(2, 64×48 px))"
    assert held_out.cameras.names == tuple(sorted(scene.cameras.names))[::8]
    assert sorted([*scene.indices("training"), *scene.indices("held_out")]) == list(scene.indices())
    assert np.asarray(held_out.images[0]).shape == (48, 64, 3)


def test_a_model_is_trained_scored_written_and_loaded(
    scene: radiant.Scene, result: radiant.TrainResult, heard: list[Event], tmp_path: Path
) -> None:
    assert result.num_steps == 30
    assert repr(result).startswith(f"TrainResult(Splats({len(result.splats):,} Gaussians, harmonics of degree 1), 30 steps in ")
    assert any(isinstance(event, StageProgress) and event.stage == "train" for event in heard)
    scores = radiant.evaluate(result.splats, scene, long_side_px=64)
    assert (
        scores.mean_psnr_db > 15
        and repr(scores) == f"Scores({scores.mean_psnr_db:.2f} dB PSNR, {np.mean(scores.ssim):.3f} SSIM, mean of 2 photographs)"
    )
    radiant.save_splats(result.splats, tmp_path / "model.ply")
    loaded = radiant.load_splats(tmp_path / "model.ply")
    assert all(np.array_equal(array, result.splats.arrays()[name]) for name, array in loaded.arrays().items())
    with pytest.raises(radiant.BadInput, match=r"ends in none of \.ply, \.spz, \.sog"):
        radiant.save_splats(result.splats, tmp_path / "model.obj")
    written = radiant.export(tmp_path / "model.ply", tmp_path / "new" / "model.sog")
    assert written["format"] == "sog" and (tmp_path / "new" / "model.sog").is_file()


def test_the_same_seed_trains_the_same_bits_as_the_command(scene: radiant.Scene, result: radiant.TrainResult) -> None:
    again = radiant.train(scene, num_steps=30, long_side_px=64, fill_in=True)
    assert np.array_equal(again.splats.means, result.splats.means)


def charbonnier(render: torch.Tensor, photograph: torch.Tensor) -> torch.Tensor:
    return ((render - photograph).square() + 1e-4).sqrt().mean()


class Thinned(radiant.Part):
    """Keeps every second Gaussian once, and notes what it is asked."""

    name = "thinned"

    def __init__(self) -> None:
        self.steps: list[int] = []

    def after_update(self, moment: radiant.Moment, splats: radiant.SplatTensors, optimizer: SelectiveAdam) -> radiant.SplatTensors:
        self.steps.append(moment.step)
        if moment.step != 10:
            return splats
        rows = torch.arange(0, len(splats), 2)
        fewer = replace(splats, **{name: tensor.detach()[rows] for name, tensor in splats.tensors().items()})
        optimizer.select_rows(fewer.tensors(), rows, torch.zeros(len(rows), dtype=torch.bool))
        return fewer


def test_a_loss_and_a_densification_of_ones_own_are_what_trains(scene: radiant.Scene) -> None:
    losses: list[float] = []

    def loss(render: torch.Tensor, photograph: torch.Tensor) -> torch.Tensor:
        assert render.shape == photograph.shape == (48, 64, 3) and float(photograph.max()) <= 1
        losses.append(float(charbonnier(render, photograph).detach()))
        return charbonnier(render, photograph)

    none: dict[str, Any] = {"density.kind": "none"}
    config = replace(radiant.train_preset("draft"), start_scale=1.0, light="none")
    plain = radiant.train(scene, config, num_steps=30, long_side_px=64, **none)
    thinned = Thinned()
    result = radiant.train(scene, config, num_steps=30, long_side_px=64, loss=loss, parts=[thinned], **none)
    assert thinned.steps == list(range(1, 31)) and len(losses) == 30
    assert abs(len(result.splats) - len(plain.splats) / 2) < 0.02 * len(plain.splats), "a few may show in no pixel and go in the end"
    assert (result.first_loss, result.last_loss) == (np.mean(losses[:3]), np.mean(losses[-3:]))
    assert np.mean(losses[20:]) < np.mean(losses[10:20]), "ten views, once each"
    with pytest.raises(radiant.BadInput, match=r"parts\[0\] is a int, expected an object of a subclass of radiant\.Part\."):
        radiant.train(scene, config, num_steps=1, parts=[3])  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match=r"a tensor of shape \(48, 64, 3\), expected a scalar tensor"):
        radiant.train(scene, config, num_steps=1, long_side_px=64, loss=lambda render, photograph: render)
    with pytest.raises(TypeError, match=r"a tensor of shape \(\) without a gradient"):
        radiant.train(scene, config, num_steps=1, long_side_px=64, loss=lambda render, photograph: photograph.mean())


def test_pictures_come_as_numpy_and_gradients_as_torch(scene: radiant.Scene, result: radiant.TrainResult) -> None:
    camera = scene.cameras.select([0]).scaled(64)
    (view,) = radiant.render(result.splats, camera)
    assert view.image.shape == (48, 64, 3) and view.depth.shape == view.alpha.shape == (48, 64)
    tensors = radiant.SplatTensors.from_splats(result.splats)
    tensors.sh0.requires_grad_()
    output = radiant.rasterize(
        tensors, torch.tensor(camera.cam_from_world), torch.tensor(camera.Ks), 64, 48, sh_degree=result.splats.sh_degree
    )
    assert np.allclose(output.images[0].detach().clamp(0, 1).numpy(), view.image, atol=1e-6)
    output.images.mean().backward()
    assert tensors.sh0.grad is not None and float(tensors.sh0.grad.abs().sum()) > 0


def test_a_plan_deals_every_camera_once_and_two_models_are_joined(scene: radiant.Scene, result: radiant.TrainResult) -> None:
    plan = radiant.plan_regions(scene, radiant.even_system(1, 2))
    assert repr(plan.system) == "System(1 edges: edge-1 with 2 devices)"
    first, second = (plan.cameras_of(device) for device in plan.devices)
    assert sorted([*first, *second]) == list(range(10))
    assert len(plan.strip_of(plan.devices[0])) >= 3
    assert repr(plan).startswith(f"RegionPlan(1 edges, cameras: edge-1-1 {len(first)}, edge-1-2 {len(second)}; ")
    with pytest.raises(radiant.BadInput, match="there is no device 'nobody'"):
        plan.cameras_of("nobody")
    training = scene.cameras.select(scene.indices("training"))
    joined = radiant.join([(result.splats, training.select(part)) for part in (first, second)], long_side_px=64, num_epochs=1)
    before = radiant.evaluate(result.splats, scene, long_side_px=64).mean_psnr_db
    # Twice the same model, which each half of the cameras vouches for.
    assert radiant.evaluate(joined, scene, long_side_px=64).mean_psnr_db > before - 0.5


def test_progress_is_a_listener(capsys: pytest.CaptureFixture[str]) -> None:
    with radiant.progress() as listen:
        listen(StageProgress(stage="train", done=1, total=2))
    assert callable(listen)


if __name__ == "__main__":
    SURFACE.write_text(json.dumps(surface(), indent=1, ensure_ascii=False) + "\n")
