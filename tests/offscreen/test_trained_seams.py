"""The seam view of models that were trained here, cut at a border and joined across it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_viewer.pictures.images import Image
from radiant_viewer.runs.run_pictures import seams_picture
from radiant_viewer.runs.seam_findings import SeamFinding, seam_findings
from tests.core.evaluate.test_seam_excess import CAMERAS, PLAN, ground, joined

SIZE_WH = (960, 640)
REGIONS = replace(PLAN, borders=tuple(np.array([[x, -4.0], [x + 6, -4.0], [x + 6, 4.0], [x, 4.0]]) for x in (-6.0, 0.0)))
"""The plan of that measure, with its two regions drawn."""


def drawn(cloud: str) -> tuple[float, SeamFinding, Image]:
    """The excess of error at the border in dB, what is found there, and the view of it."""
    splats, scene = joined(cloud), ground().scene(range(len(CAMERAS)))
    excess = ground().excess(splats)
    assert excess.excess_db is not None
    proven = {frozenset(PLAN.edge_ids): excess.excess_db} if excess.has_seam else {}
    (finding,) = seam_findings(scene, REGIONS, splats, proven)
    return excess.excess_db, finding, seams_picture(scene, REGIONS, splats, SIZE_WH, proven)


def test_the_error_at_a_cut_is_named_in_the_view_and_joining_takes_it_away() -> None:
    (cut_db, cut, cut_view), (joined_db, join, joined_view) = drawn("crop_merge"), drawn("fade")
    # 3.3 and 0.6 dB were measured.
    assert joined_db < cut_db - 0.5 and cut.has_seam and cut.excess_db == cut_db and join.excess_db is None
    # The label of the cut has that figure beside its step: its white ground is the larger one.
    white = [int((view[330:400, 140:480] > 200).all(axis=-1).sum()) for view in (cut_view, joined_view)]
    assert white[0] > white[1] + 2000, white
