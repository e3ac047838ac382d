"""A device: memory limits its Gaussians before training, and every decision has its name."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import Frame
from radiant_core.hierarchy import device
from radiant_core.hierarchy.decisions import shapes_decision
from radiant_core.hierarchy.device import prepare_training, train_device
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Machine, Recorder
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.few import KeptScores
from radiant_core.train.memory import MIN_SPLATS
from radiant_core.train.needs import PIXELS_OF_FEW
from radiant_core.train.results import TrainResult
from radiant_core.train.shapes import ShapeCounts
from radiant_core.train.trainer import Checkpoints, FitOptions, NoCheckpoints, fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.hierarchy.grounds import TRAIN
from tests.core.scenes import cameras_above, ground_splats

LIMIT_BYTES = 140e6


@pytest.fixture(scope="module")
def given() -> tuple[DeviceTask, TrainingViews]:
    """A device's task and its four photographs of a made-up ground."""
    return task_above([(-1, -1), (-1, 1), (1, -1), (1, 1)])


def task_above(places: list[tuple[float, float]]) -> tuple[DeviceTask, TrainingViews]:
    """A device's task and its photographs of a made-up ground from above these places."""
    truth, cameras = ground_splats(), cameras_above(places)
    scene = SfmScene(
        cameras=cameras,
        points=truth.means.astype(float),
        colors=np.full((len(truth), 3), 128, np.uint8),
        observations=np.indices((len(truth), len(cameras))).reshape(2, -1).T,
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3), residual_m=0.0),
    )
    views = TrainingViews(cameras=cameras, images=tuple(view.image_bytes for view in render_views(truth, cameras)))
    return DeviceTask(scene=scene, train=TRAIN, backend="native"), views


def most_splats(task: DeviceTask, views: TrainingViews, base_bytes: int = 0) -> int:
    """How many Gaussians the limit of memory allows, by the decision."""
    reporter = Recorder()
    prepare_training(task, views, reporter, Machine(base_bytes=base_bytes))
    (choice,) = (decision.choice for decision in reporter.decisions if decision.topic == "memory")
    return int(choice.removeprefix("at most ").split(" ")[0].replace(",", ""))


def test_a_device_trains_the_same_model_each_time_and_names_itself_in_its_decisions(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    reporter = Recorder(stage="devices/a-1")
    model, again = train_device(task, views, reporter), train_device(task, views, Recorder())
    for name, array in model.splats.arrays().items():
        np.testing.assert_array_equal(array, again.splats.arrays()[name], err_msg=name)
    assert {decision.stage for decision in reporter.decisions} == {"devices/a-1"} and not reporter.warnings
    assert [decision.topic for decision in reporter.decisions][:6] == [
        "repeated photographs",
        "blurred photographs",
        "light",
        "Gaussians left out at random",
        "Gaussians after growth",
        "sky",
    ]
    assert model.summary["num_steps"] == TRAIN.num_steps and model.summary["num_photographs"] == 4
    assert model.initial is not None and model.summary["num_splats"] == len(model.splats)
    assert model.cameras.names == task.scene.cameras.names and model.received == {}
    assert (
        model.splats.means != train_device(replace(task, train=replace(TRAIN, seed=1)), views, Recorder()).splats.means[: len(model.splats)]
    ).any()


def test_a_limit_of_memory_limits_gaussians_and_what_the_process_holds_counts(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    many = replace(task, train=replace(TRAIN, max_num_splats=10**9), memory_bytes=LIMIT_BYTES)
    free, held = most_splats(many, views), most_splats(many, views, base_bytes=20_000_000)
    assert MIN_SPLATS <= held < free < 10**9
    whole = tuple(np.full(image.shape[:2], 255, np.uint8) for image in views.images)
    masked = TrainingViews(cameras=views.cameras, images=views.images, weights=whole)
    assert most_splats(many, masked) < free
    assert most_splats(replace(many, train=TRAIN), views) == TRAIN.max_num_splats


def test_a_limit_that_leaves_no_room_for_sparse_points_is_warned_of_once(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    few = len(task.scene.points) // 2

    def warnings(**changes: object) -> list[str]:
        reporter = Recorder()
        train_device(replace(task, train=replace(TRAIN, num_steps=2, **changes)), views, reporter)
        return reporter.warnings

    assert not warnings()
    (warning,) = warnings(max_num_splats=few)
    assert f"{len(task.scene.points):,} sparse points are thinned out to the limit of {few:,} Gaussians" in warning
    assert "gained 1.2 dB" in warning and "Raise --max-splats" in warning
    assert not warnings(max_num_splats=few, density=NoDensification()), "nothing was to grow"


def test_a_limit_beyond_what_was_asked_for_changes_no_bit(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    limited = prepare_training(replace(task, memory_bytes=4e9), views, Recorder())
    assert limited.config == prepare_training(task, views, Recorder()).config and limited.config.max_num_splats == TRAIN.max_num_splats
    assert limited.key == prepare_training(task, views, Recorder()).key


def test_a_limit_that_leaves_room_for_no_model_is_refused_with_what_would_do(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    with pytest.raises(BadInput, match=r"expected 1,000 or more: give [\d,]+ MB"):
        train_device(replace(task, memory_bytes=9e7), views, Recorder())


def test_the_key_follows_what_decides_the_bits(given: tuple[DeviceTask, TrainingViews]) -> None:
    task, views = given
    key = prepare_training(task, views, Recorder()).key
    assert key == prepare_training(replace(task, checkpoint_every_s=99.0, upload="spz"), views, Recorder(stage="other")).key
    assert key != prepare_training(replace(task, train=replace(TRAIN, num_steps=21)), views, Recorder()).key
    darker = TrainingViews(cameras=views.cameras, images=(views.images[0] // 2, *views.images[1:]))
    assert key != prepare_training(task, darker, Recorder()).key


def test_a_preset_without_limits_of_shape_says_what_it_left_out() -> None:
    # 3DGS limits no shape: an f-string of None ended every such training that left a Gaussian out.
    decision = shapes_decision("train", train_preset("standard"), ShapeCounts(num_dead=7))
    assert decision.choice.endswith("7 that no pixel shows are left out")
    assert decision.reason == "an opacity below 1/255 is never drawn"
    assert "10 times the second axis, 0.333 of the distance" in shapes_decision("train", train_preset("default"), ShapeCounts()).reason


@dataclass(frozen=True, kw_only=True)
class Watching(Recorder):
    """Keeps how far a node was, as a share, and its notes."""

    shares: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def progress(self, done: float, total: float, note: str = "") -> None:
        """Keep it."""
        self.shares.append(done / total)
        self.notes.append(note)


@dataclass
class InMemory(KeptScores):
    """Scores of trials by their key."""

    scores: dict[str, FloatArray] = field(default_factory=dict)

    def find(self, key: str) -> FloatArray | None:
        """As kept."""
        return self.scores.get(key)

    def keep(self, key: str, figures: FloatArray) -> None:
        """Keep it."""
        self.scores[key] = figures


class Unused(Checkpoints):
    """Saves nothing, and is not what a trial is given."""


EIGHT = [(x, y) for x in (-1.5, -0.5, 0.5, 1.5) for y in (-1.0, 1.0)]
ASKING = with_settings(TRAIN, {"cross_validate": "always", "density.kind": "planned", "num_steps": 30})
CHOICE = "what few photographs gain by"


class TestTrials:
    """Eight photographs, of which growth cannot reach 4,000 Gaussians: only leaving out is open."""

    @pytest.fixture
    def trained(self, monkeypatch: pytest.MonkeyPatch) -> list[tuple[tuple[str, ...], TrainConfig, FitOptions]]:
        """Names of the photographs, settings and options of every training in turn."""
        calls: list[tuple[tuple[str, ...], TrainConfig, FitOptions]] = []

        def fit(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions) -> TrainResult:
            calls.append((views.cameras.names, config, options))
            return fit_splats(initial, views, config, options)

        monkeypatch.setattr(device, "fit_splats", fit)
        return calls

    def test_a_model_is_trained_as_its_photographs_say_and_is_the_one_of_those_settings(self, trained) -> None:
        task, views = task_above(EIGHT)
        watching = Watching(stage="devices/a-1")
        model = train_device(replace(task, train=ASKING), views, watching, Machine(checkpoints=lambda key: Unused()))
        (decision,) = (own for own in watching.decisions if own.topic == CHOICE)
        assert decision.stage == "devices/a-1" and decision.reason.startswith("4 trainings without them")
        assert watching.shares == sorted(watching.shares) and watching.shares[-1] == 1
        assert watching.notes[0].startswith("trial 1 of 4 at most") and watching.notes[-1].startswith("the model itself")
        names = sorted(views.cameras.names)
        without = [set(names) - set(shown) for shown, _, _ in trained]
        assert without == [{names[0]}, {names[4]}, {names[0]}, {names[4]}, set()]
        assert [config.drop_gaussians for _, config, _ in trained[:4]] == ["always", "always", "none", "none"]
        assert {config.light for _, config, _ in trained[:4]} == {"none"} and trained[4][1].light == "auto"
        assert all(isinstance(options.checkpoints, NoCheckpoints) for _, _, options in trained[:4])
        assert not isinstance(trained[4][2].checkpoints, NoCheckpoints)
        drops = "always" if "left out at each step" in decision.choice else "none"
        settings = {"cross_validate": "none", "drop_gaussians": drops, "density.pixels_per_splat": PIXELS_OF_FEW}
        plain = train_device(replace(task, train=with_settings(ASKING, settings)), views, Recorder())
        for name, array in model.splats.arrays().items():
            np.testing.assert_array_equal(array, plain.splats.arrays()[name], err_msg=name)

    def test_kept_scores_are_not_taken_again_unless_a_photograph_changed(self, trained) -> None:
        task, views = task_above(EIGHT)
        asked, kept = replace(task, train=ASKING), InMemory()
        keys = {prepare_training(asked, views, Recorder(), Machine(kept_scores=kept)).key for _ in range(2)}
        assert len(trained) == len(kept.scores) == 4 and len(keys) == 1
        darker = TrainingViews(cameras=views.cameras, images=(views.images[0] // 2, *views.images[1:]))
        prepare_training(asked, darker, Recorder(), Machine(kept_scores=kept))
        assert len(trained) == 8, "each trial trained on it or was scored on it"
        first = next(iter(kept.scores))
        kept.scores[first] = np.array([20.0, 20.0])
        prepare_training(asked, views, Recorder(), Machine(kept_scores=kept))
        assert len(trained) == 9 and len(kept.scores[first]) == 1, "a score of other photographs is none"

    def test_a_limit_of_memory_holds_in_trials(self, trained) -> None:
        task, views = task_above(EIGHT)
        limited = replace(task, train=ASKING, memory_bytes=LIMIT_BYTES)
        prepared = prepare_training(limited, views, Recorder())
        assert {options.statistics_bytes for _, _, options in trained} == {prepared.options.statistics_bytes}
        assert max(config.max_num_splats for _, config, _ in trained) <= prepared.config.max_num_splats

    def test_a_trial_that_diverges_ends_nothing(self, monkeypatch: pytest.MonkeyPatch) -> None:
        task, views = task_above(EIGHT)

        def fit(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions) -> TrainResult:
            if config.drop_gaussians == "none":
                raise StageFailed("training: 20 steps in a row could not be taken.")
            return fit_splats(initial, views, config, options)

        monkeypatch.setattr(device, "fit_splats", fit)
        recorder = Recorder()
        assert len(train_device(replace(task, train=ASKING), views, recorder).splats)
        (decision,) = (own for own in recorder.decisions if own.topic == CHOICE)
        assert "failed (training: 20 steps" in decision.reason and decision.choice.endswith("as their number says")

    def test_what_a_trial_warns_of_is_heard_with_its_name(self, monkeypatch: pytest.MonkeyPatch) -> None:
        task, views = task_above(EIGHT)
        rolled_back = lambda *given: replace(fit_splats(*given), num_rolled_back=3)  # noqa: E731
        monkeypatch.setattr(device, "fit_splats", rolled_back)
        recorder = Recorder()
        prepare_training(replace(task, train=ASKING), views, recorder)
        assert len(recorder.warnings) == 4 and recorder.warnings[2].startswith("trial 3 of 4 at most: 3 of 30 steps")

    def test_a_photograph_that_is_noise_is_asked_and_the_training_goes_on(self) -> None:
        task, views = task_above(EIGHT)
        noise = np.random.default_rng(0).integers(0, 256, views.images[0].shape).astype(np.uint8)
        spoilt = TrainingViews(cameras=views.cameras, images=(noise, *views.images[1:]))
        recorder = Recorder()
        assert np.isfinite(train_device(replace(task, train=ASKING), spoilt, recorder).splats.means).all()
        (decision,) = (own for own in recorder.decisions if own.topic == CHOICE)
        assert decision.figure is not None and np.isfinite(decision.figure)
