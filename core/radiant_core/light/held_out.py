"""How good a version of a scene is in the photographs that one machine holds out. Once per machine
and version."""

from __future__ import annotations

from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.photos.masks import used_pixels
from radiant_core.light.canonical import show_in_light
from radiant_core.light.lights import Lights
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews


def held_out_psnr_db(model: Splats, views: TrainingViews, backend: Backend = "auto", lights: Lights | None = None) -> list[float]:
    """PSNR of a model in each of a machine's held-out photographs (V).

    Args:
        model: one version of the scene.
        views: the photographs, their cameras in the frame of the model; a mask leaves some of each.
        backend: the renderer.
        lights: the light (V) of the photographs beside the model's; None: the same.
    """
    figures = []
    weights = views.weights if views.weights is not None else [None] * len(views)
    for index, (view, photograph, weight) in enumerate(
        zip(render_views(model, views.cameras, backend), views.images, weights, strict=True)
    ):
        image = view.image if lights is None else show_in_light(view.image, lights, index, views.cameras)
        figures.append(psnr_db(image, photograph / 255, None if weight is None else used_pixels(weight)))
    return figures
