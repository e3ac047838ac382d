"""The seam measure: laws on made-up errors, and models that were trained, cut and joined here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from radiant_core.aggregate.config import Join, JoinMethod
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.seam_excess import MARGIN_DB, BorderError, SeamExcess, border_errors, excess_by_border, pooled_excess
from radiant_core.frames import Frame
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.device import train_device
from radiant_core.hierarchy.messages import CloudTask, DeviceTask, EdgeModel
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.plan.plans import CloudPlan
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, Splats
from radiant_core.train.config import train_preset, with_settings, without_mean
from radiant_core.train.views import TrainingViews
from tests.core.plan.made_plans import plan_of
from tests.core.scenes import cameras_above, ground_splats

SITES = np.array([[-3.0, 0.0], [3.0, 0.0]])
PLAN = plan_of(SITES, np.zeros(2))
CAMERAS = cameras_above([(x, y) for x in (-3.5, -2.0, -0.8, 0.8, 2.0, 3.5) for y in (-2.0, 0.0, 2.0)], height_m=5.0, size_wh=(96, 72))


def flat(cameras: Cameras) -> Iterator[RenderedView]:
    """Black renders of flat ground at height 0."""
    for name, (width, height), center in zip(cameras.names, cameras.sizes_wh, cameras.centers, strict=True):
        whole = np.ones((height, width), np.float32)
        yield RenderedView(
            name=name, image=np.zeros((height, width, 3), np.float32), alpha=whole, depth=center[2].astype(np.float32) * whole
        )


def errors_by_ground(west: float, east: float, plan: CloudPlan = PLAN, own: float = 1.0) -> list[BorderError]:
    """Errors of black renders where photographs show these values west and east of x = 0, those of
    their own side times `own`."""
    photographs = []
    for index, (width, height) in enumerate(CAMERAS.sizes_wh):
        x = CAMERAS.centers[index, 0] + (np.arange(width) + 0.5 - width / 2) / CAMERAS.Ks[index, 0, 0] * CAMERAS.centers[index, 2]
        is_own = (x < 0) == (CAMERAS.centers[index, 0] < 0)
        row = np.where(x < 0, west, east) * np.where(is_own, own, 1.0)
        photographs.append(np.broadcast_to(row[None, :, None], (height, width, 3)))
    return list(border_errors(CAMERAS, flat(CAMERAS), photographs, plan))


def test_ground_that_is_hard_on_one_side_cancels_out_and_what_costs_beyond_the_border_does_not() -> None:
    hard = pooled_excess(errors_by_ground(0.05, 0.5))
    assert hard.excess_db == pytest.approx(0, abs=1e-2) and hard.has_seam is False
    # Half the error on the own side is a quarter of its square; 1e-6 is added to each.
    cut = pooled_excess(errors_by_ground(0.05, 0.5, own=0.5))
    assert cut.excess_db == pytest.approx(10 * np.log10(4), abs=1e-2) and cut.has_seam
    assert cut.at_least_db is not None and cut.at_least_db > MARGIN_DB


def test_every_photograph_names_its_own_side_and_the_one_beyond() -> None:
    errors = errors_by_ground(0.1, 0.2)
    assert {(error.side, error.beyond) for error in errors} == {("edge-0", "edge-1"), ("edge-1", "edge-0")}
    first = next(error for error in errors if error.side == "edge-0")
    assert (first.before_db, first.beyond_db) == (pytest.approx(-20, abs=1e-2), pytest.approx(20 * np.log10(0.2), abs=1e-2))
    # Cameras at 3.5 m do not see the other side.
    assert len(errors) == 12


def test_neither_the_order_nor_the_machines_of_photographs_matter() -> None:
    rng = np.random.default_rng(0)
    errors = [BorderError(side=str(i % 2), beyond=str(1 - i % 2), before_db=rng.normal(-30), beyond_db=rng.normal(-29)) for i in range(20)]
    assert pooled_excess(errors) == pooled_excess(errors[7:] + errors[:7])
    assert excess_by_border(errors) == {("0", "1"): pooled_excess(errors)}


def test_too_few_photographs_of_either_side_or_one_region_have_no_figure() -> None:
    errors = errors_by_ground(0.1, 0.2)
    few = [error for error in errors if error.side == "edge-0"] + [error for error in errors if error.side == "edge-1"][:2]
    told = pooled_excess(few)
    assert told.excess_db is None and told.has_seam is None and "3 training photographs" in str(told.reason)
    assert errors_by_ground(0.1, 0.2, plan_of(SITES[:1], np.zeros(1))) == [] and pooled_excess([]).reason


def test_a_broken_model_or_a_picture_of_another_size_is_an_error_and_masks_leave_pixels_out() -> None:
    (view,) = flat(CAMERAS.select([6]))
    photograph = np.full_like(view.image, 0.1)

    def of(view: RenderedView, used: NDArray[np.bool_] | None = None) -> list[BorderError]:
        return list(border_errors(CAMERAS.select([6]), [view], [photograph], PLAN, [used]))

    (whole,) = of(view)
    with pytest.raises(BadInput, match="not finite near a border"):
        of(replace(view, image=np.full_like(view.image, np.nan)))
    with pytest.raises(BadInput, match="has the shape"):
        of(replace(view, image=view.image[:-1]))
    spoilt, used = view.image.copy(), np.ones(view.depth.shape, bool)
    spoilt[::2], used[::2] = np.nan, False
    assert of(replace(view, image=spoilt), used) == of(replace(view, image=spoilt, alpha=view.alpha * used)) == [whole]
    assert of(view, np.zeros_like(used)) == []


@dataclass(frozen=True)
class Ground:
    """A made-up ground and what this code learns of it."""

    truth: Splats
    photographs: tuple[NDArray[np.uint8], ...]

    def scene(self, rows: Sequence[int]) -> SfmScene:
        """Some of the cameras, and every other centre as a sparse point."""
        return SfmScene(
            cameras=CAMERAS.select(rows),
            points=self.truth.means.astype(np.float64)[::2],
            colors=(255 * (0.5 + SH_C0 * self.truth.sh0[::2, 0])).clip(0, 255).astype(np.uint8),
            observations=np.zeros((0, 2), np.int64),
            frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
        )

    def model(self, rows: Sequence[int], num_steps: int) -> Splats:
        """What a device learns of these photographs."""
        scene = self.scene(rows)
        views = TrainingViews(cameras=scene.cameras, images=tuple(self.photographs[row] for row in rows))
        train = replace(TRAIN, num_steps=num_steps)
        return train_device(DeviceTask(scene=scene, train=train, backend="native"), views, Recorder()).splats

    def excess(self, splats: Splats) -> SeamExcess:
        """The measure, drawn offscreen."""
        renders = render_views(splats, CAMERAS, "native")
        return pooled_excess(border_errors(CAMERAS, renders, [image / 255 for image in self.photographs], PLAN))


# Faint and round first Gaussians: from opaque ones the cut of so small a scene hardly has a seam.
FIRST = {"initial_opacity": 0.1, "initial_thickness": 1.0, "drop_gaussians": "none", "density.min_opacity": 0.005}
# Its last step is the result, so that devices' models differ at the border.
DRAFT = train_preset("draft")
TRAIN = with_settings(replace(DRAFT, long_side_px=96, max_num_splats=1500), {**FIRST, **without_mean(DRAFT)})
WEST, EAST = list(range(9)), list(range(9, 18))
NUM_EPOCHS = 15
"""Three times the cloud's, in which so much is left that the machine decides whether it is a
seam."""


@cache
def ground() -> Ground:
    rng = np.random.default_rng(3)
    truth = ground_splats(1600, half_side_m=7.0)
    truth = replace(truth, sh0=(truth.sh0 + rng.normal(0, 0.5, truth.sh0.shape)).astype(np.float32))
    return Ground(truth=truth, photographs=tuple(view.image_bytes for view in render_views(truth, CAMERAS, "native")))


@cache
def device_models() -> tuple[Splats, Splats]:
    return ground().model(WEST, 300), ground().model(EAST, 300)


def joined(method: JoinMethod) -> Splats:
    """Both devices' models, joined by the cloud or cut at the border."""
    rows = (WEST, EAST)
    task = CloudTask(
        edges=("0", "1"),
        num_dealt=(9, 9),
        sites=((-3.0, 0.0), (3.0, 0.0)),
        weights=(0.0, 0.0),
        train=TRAIN,
        join=Join(method=method, epochs=NUM_EPOCHS),
        backend="native",
    )
    edges = {name: EdgeModel(splats=device_models()[index], cameras=CAMERAS.select(rows[index])) for index, name in enumerate("01")}
    scene = join_cloud(task, edges, Recorder())
    assert scene.splats is not None
    return scene.splats


def test_a_cut_is_found_a_joined_model_is_better_and_an_uncut_one_has_no_seam() -> None:
    cut, join = ground().excess(joined("crop_merge")), ground().excess(joined("fade"))
    uncut = ground().excess(ground().model(WEST + EAST, 600))
    assert cut.has_seam
    assert uncut.has_seam is False
    assert join.has_seam is False
    assert cut.excess_db is not None and join.excess_db is not None and join.excess_db < cut.excess_db - 0.5
