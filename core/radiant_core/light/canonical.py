"""Whether light is modelled, where a training and a score do so. Once each.

training: photographs ── lights_from_tracks ─→ photographs in one canonical light ─→ model
score:    model, training photographs ── lights_from_model ── predict_lights ─→ light of those
          held out, of which no pixel is read; a render times that light is what is scored
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.choices import LightMode
from radiant_core.decisions import Decision
from radiant_core.light.captures import Captures, complete_captures, shots_of
from radiant_core.light.lights import Lights, in_canonical_light
from radiant_core.light.predict import Prediction, predict_lights
from radiant_core.light.solve import NUM_PLACES, lights_from_model, lights_from_tracks, lights_if_they_differ
from radiant_core.regimes import LIGHT_EVENNESS
from radiant_core.render.contract import Backend
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews


@dataclass(frozen=True, kw_only=True, eq=False)
class LightOfScore:
    """The light of the training photographs (V) and of those held out (K) beside a model."""

    trained: Lights
    prediction: Prediction

    @property
    def held_out(self) -> Lights:
        """That of the photographs held out."""
        return self.prediction.lights

    def decision(self, stage: str) -> Decision:
        """How the light of those held out was predicted, as the report lists it."""
        return self.prediction.decision(stage, int(self.trained.is_known.sum()))


def canonical_views(scene: SfmScene, views: TrainingViews, mode: LightMode) -> tuple[TrainingViews, Lights | None, tuple[Decision, ...]]:
    """The views in one canonical light, and the light they were taken in; None and the same views
    where it hardly differs. `views.cameras` are the scene's in the same order."""
    if mode == "none":
        return views, None, ()
    lights = lights_from_tracks(scene, views) if mode == "always" else lights_if_they_differ(scene, views)
    decision = light_decision(lights, mode)
    return (in_canonical_light(views, lights), lights, (decision,)) if _is_wanted(lights, mode) else (views, None, (decision,))


def _is_wanted(lights: Lights, mode: LightMode) -> bool:
    return bool(lights.is_known.any()) and (mode == "always" or lights.is_worth_modelling)


def light_decision(lights: Lights, mode: LightMode) -> Decision:
    """Whether photographs in these lights are trained on in one."""
    wanted = _is_wanted(lights, mode)
    return Decision(
        stage="train",
        topic="light",
        choice="photographs are trained in one canonical light" if wanted else "photographs are trained as they were taken",
        figure=100 * lights.spread,
        unit="% spread of brightness at common points",
        reason=_reason(lights),
        row=lights.regime.row,
        otherwise="--set train.light=none" if wanted else "--set train.light=always" if lights.is_known.any() else "",
        forced=mode == "always",
    )


def _reason(lights: Lights) -> str:
    case = lights.regime
    if not case.values["compared"] or not np.isfinite(lights.evenness):
        return case.reason
    compared = f"gains are {lights.evenness:.1f} times what they leave of parts of pictures"
    return f"{case.reason} where gains explain whole pictures: {compared}, and from {LIGHT_EVENNESS:g} on they are exposures"


def canonical_validation(lights: Lights, scene: SfmScene, validation: TrainingViews) -> TrainingViews:
    """Views that only choose among models, in the canonical light of the scene's photographs, by
    its prediction: a model is not chosen for fitting the light of one."""
    names = (*scene.cameras.names, *validation.cameras.names)
    captures = complete_captures({}, names)
    shots, targets = (shots_of(cameras, captures) for cameras in (scene.cameras, validation.cameras))
    places = [scene.points[point_rows[:NUM_PLACES]] for point_rows in scene.points_of_cameras()]
    return in_canonical_light(validation, predict_lights(lights, shots, places, targets).lights)


def light_of_score(
    model: Splats, trained: TrainingViews, held_out: Cameras, captures: Captures, mode: LightMode, backend: Backend = "auto"
) -> LightOfScore | None:
    """The light in which photographs held out were taken, beside that of a model.

    Args:
        model: the Gaussians that are scored, whose light is the canonical one.
        trained: the training photographs (V) as they were taken, at any size from `COMPARED_PX`
            of `solve` on, with cameras in the frame of the model.
        held_out: the cameras (K) of the others, in that frame; their pixels are not needed.
        captures: of all by name, as far as EXIF gives any.
        mode: of the training.
        backend: the renderer.

    Returns:
        The lights; None where none are modelled.
    """
    if mode == "none" or not len(held_out):
        return None
    solved = lights_from_model(model, trained, backend, int(held_out.sizes_wh.max()))
    if not solved.lights.is_known.any() or (mode == "auto" and not solved.lights.is_worth_modelling):
        return None
    captures = complete_captures(captures, (*trained.cameras.names, *held_out.names))
    shots, targets = (shots_of(cameras, captures) for cameras in (trained.cameras, held_out))
    return LightOfScore(trained=solved.lights, prediction=predict_lights(solved.lights, shots, solved.places, targets))


def show_in_light(image: NDArray[np.float32], lights: Lights, index: int, cameras: Cameras) -> NDArray[np.float32]:
    """A canonical render (H,W,3) as photograph `index` would have been, in 0..1."""
    return np.clip(image * lights.factors(index, cameras), 0, 1)
