"""The last word on poses and lenses: one bundle adjustment with a robust loss, per scene.

The mappers minimise squared errors of reprojection and drop points off by more than 4 px, so that
what is off by 1 to 4 px, often a wrong match, bends poses and lenses. A Cauchy loss of half a pixel
weighs it down: on the town's device of 11 photographs the error against true poses fell from 39.5
to 28.9 mm, that of the focal length from 0.13 to 0.10 % (docs/experiments/frames.md).

Few photographs straight down on flat ground fix no focal length: it can be traded for height, and
only an early end of the mapper keeps it near (one device of brighton: 763 px, then 530 to 680 px
after more iterations, where all photographs give 798). A lens that this adjustment would move is
not fixed by its photographs, and is kept.
"""

from __future__ import annotations

import numpy as np

from radiant_core.panoramas import has_faces
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress

LOSS_SCALE_PX = 0.5
LEAST_GAIN = 1e-5
"""It ends where an iteration lowers the cost by a smaller share: to the same poses in half of the
time (docs/experiments/sfm.md)."""
MAX_ITERATIONS = 50
"""As many as the mappers take for theirs."""
MAX_IMAGES_DIRECT = 4_000
"""Up to so many images the equations of the cameras are factorised, beyond it solved by iterations,
as COLMAP does from 1,000 on: 1,600 from the air take 159 CPU s in place of some 690
(docs/experiments/sfm.md). Where all see the same, 4,000 take 5 GB."""
MAX_FOCAL_CHANGE = 0.005
"""A larger change of a focal length, as a share, shows that the photographs do not fix it."""


def refine(model: pycolmap.Reconstruction, config: SfmConfig, report: Report) -> pycolmap.Reconstruction:
    """`model` with all poses and points adjusted, and the lenses where its photographs fix them;
    not those of panoramas' faces, nor their rig, which are exact."""
    total = int(model.num_reg_images())
    report(SfmProgress(phase="refining", done=0, total=total))
    has_rig = has_faces(model.image(image_id).name for image_id in model.reg_image_ids())
    refined = adjust(model, config, refine_lenses=not has_rig)
    if not has_rig and not _same_lenses(model, refined):
        refined = adjust(model, config, refine_lenses=False)
    refined.update_point_3d_errors()
    report(SfmProgress(phase="refining", done=total, total=total))
    return refined


def adjust(model: pycolmap.Reconstruction, config: SfmConfig, *, refine_lenses: bool) -> pycolmap.Reconstruction:
    """A copy of `model` with poses and points adjusted, and its lenses where asked for."""
    adjusted = pycolmap.Reconstruction(model)
    options = robust_options(config, refine_lenses=refine_lenses)
    call_colmap("refining", pycolmap.bundle_adjustment, adjusted, options, cancellation_token=pycolmap.CancellationToken())
    return adjusted


def robust_options(config: SfmConfig, *, refine_lenses: bool) -> pycolmap.BundleAdjustmentOptions:
    """COLMAP's settings of an adjustment with the robust loss."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_sensor_from_rig = False
    options.refine_focal_length = options.refine_extra_params = refine_lenses
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_SCALE_PX
    options.ceres.use_gpu = False
    options.ceres.max_num_images_direct_sparse_cpu_solver = MAX_IMAGES_DIRECT
    options.ceres.solver_options.num_threads = config.threads
    options.ceres.solver_options.max_num_iterations = MAX_ITERATIONS
    options.ceres.solver_options.function_tolerance = LEAST_GAIN
    return options


def _same_lenses(before: pycolmap.Reconstruction, after: pycolmap.Reconstruction) -> bool:
    camera_ids = {before.image(image_id).camera_id for image_id in before.reg_image_ids()}
    changes = [abs(np.log(after.camera(number).mean_focal_length() / before.camera(number).mean_focal_length())) for number in camera_ids]
    # A focal length below zero gives no number, which is no small change either.
    return all(change <= MAX_FOCAL_CHANGE for change in changes)
