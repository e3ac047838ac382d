"""Seams of methods against each other by the same masks: per border, overall, and paired per image. Once per method and scene.

    headline = (band − interior) of a method − (band − interior) of the reference, dB of the errors pooled over images
The paired bounds are of the mean over images of the same difference, image by image, since a pooled figure has no spread; an image counts
for a border when it has `MIN_IMAGE_PIXELS` in its band and as many in the interior, which the masks alone decide. I images, B borders.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import PairedDifference, paired_bootstrap
from radiant_core.evaluate.image_error import MIN_SQUARED_ERROR
from radiant_core.evaluate.seam_error import MIN_IMAGES, SeamError, SeamMasks, pooled_seam_error, squared_errors
from radiant_core.numerics import FloatArray

MIN_IMAGE_PIXELS = 500
Border = tuple[str, str]


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamScores:
    """Sums of squared errors (I,B+1) and pixels (I,B+1) per image and part: the B borders, then the interior."""

    borders: tuple[Border, ...]
    squared: FloatArray
    pixels: NDArray[np.int64]

    def error(self, border: Border | None = None) -> SeamError:
        """Band and interior pooled over images: of one border, or of all; BadInput for a border that no image sees."""
        sums = []
        for columns in (self._columns(border), [len(self.borders)]):
            pixels = self.pixels[:, columns].sum(axis=1)
            sums.append([self.squared[:, columns].sum(), pixels.sum(), (pixels > 0).sum()])
        return pooled_seam_error([np.array(sums, np.float64)])

    def image_gaps_db(self, border: Border | None = None) -> FloatArray:
        """(band − interior) in dB of every image (I,), NaN where either part has under 500 pixels."""
        columns, interior = self._columns(border), len(self.borders)
        pixels = np.stack([self.pixels[:, columns].sum(axis=1), self.pixels[:, interior]])
        squared = np.stack([self.squared[:, columns].sum(axis=1), self.squared[:, interior]])
        levels_db = -10 * np.log10(np.maximum(squared / np.maximum(pixels, 1), MIN_SQUARED_ERROR))
        return np.where((pixels >= MIN_IMAGE_PIXELS).all(axis=0), levels_db[0] - levels_db[1], np.nan)

    def _columns(self, border: Border | None) -> list[int]:
        if border is None:
            return list(range(len(self.borders)))
        if border not in self.borders:
            raise BadInput(f"no image sees a border between {' and '.join(border)}: choose from {self.borders}.")
        return [self.borders.index(border)]


def seam_scores(renders: Iterable[NDArray[np.floating]], photographs: Iterable[NDArray[np.floating]], masks: SeamMasks) -> SeamScores:
    """Scores of the renders of one model, images (H,W,3) in 0..1 in the masks' order, one at a time.

    Raises BadInput when a render, photograph and mask differ in size or a counted pixel is not finite.
    """
    parts = len(masks.borders) + 1
    squared, pixels = np.zeros((len(masks), parts)), np.zeros((len(masks), parts), np.int64)
    for index, (render, photograph, mask) in enumerate(zip(renders, photographs, masks, strict=True)):
        counted = mask.labels >= -1
        # −1, the interior, becomes the last part.
        labels = mask.labels[counted].astype(np.int64) % parts
        squared[index] = np.bincount(labels, squared_errors(render, photograph, mask)[counted], parts)
        pixels[index] = np.bincount(labels, minlength=parts)
    return SeamScores(borders=masks.borders, squared=squared, pixels=pixels)


@dataclass(frozen=True, kw_only=True)
class SeamExcess:
    """(band − interior) of a method minus that of the reference, dB, negative where the method's seams are worse; None where too few."""

    border: Border | None
    """None for all borders together."""
    pooled_db: float | None
    """The headline: of errors pooled over images, mean over seeds."""
    paired: PairedDifference | None
    """Bounds of the mean over images and seeds."""
    reason: str | None
    """Why there is no figure."""


def seam_excess(methods: Sequence[SeamScores], references: Sequence[SeamScores], border: Border | None = None) -> SeamExcess:
    """The headline of a method against a reference, scores of S seeds each, of one border or of all.

    Raises BadInput when numbers of seeds differ or they were not scored by the same masks.
    """
    if len(methods) != len(references) or not methods:
        raise BadInput(f"{len(methods)} scores of a method come with {len(references)} of the reference: give one each per seed.")
    if any(one.borders != methods[0].borders or not np.array_equal(one.pixels, methods[0].pixels) for one in [*methods, *references]):
        raise BadInput("method and reference were scored by different masks: make them once per scene and plan and score both by them.")
    errors = [[one.error(border) for one in scores] for scores in (methods, references)]
    gaps_db = [[error.band_minus_interior_db for error in row] for row in errors]
    known = [[gap for gap in row if gap is not None] for row in gaps_db]
    if any(len(row) < len(methods) for row in known):
        reason = errors[0][0].reason or "insufficient: too few pixels in the interior"
        return SeamExcess(border=border, pooled_db=None, paired=None, reason=reason)
    images = [np.stack([one.image_gaps_db(border) for one in scores]) for scores in (methods, references)]
    seen = np.isfinite(images[0]).all(axis=0)
    enough = int(seen.sum()) >= MIN_IMAGES
    return SeamExcess(
        border=border,
        pooled_db=float(np.mean(known[0]) - np.mean(known[1])),
        paired=paired_bootstrap(images[0][:, seen], images[1][:, seen]) if enough else None,
        reason=None if enough else f"{int(seen.sum())} images have {MIN_IMAGE_PIXELS} pixels in band and interior, {MIN_IMAGES} are needed",
    )
