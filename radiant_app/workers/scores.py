"""`Scores`: the figures that a machine reports of its held-out photographs. Once per machine and
scoring.

    scores.json ── scores_of ──→ Scores ── claim_problem ──→ counted, or left out by name

Parsed once, to the last field and within the range of each figure; what is parsed is what is used.
A device's photographs are numbered: what it says can be held against how many it holds out.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, FiniteFloat, TypeAdapter, model_validator

from radiant_app.strangers import UntrustedRecord, parse_record
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.evaluate.seam_excess import BorderError
from radiant_core.hierarchy.choosing import BEST_DB
from radiant_core.io.run_store import read_json, stays_inside

MAX_SCORES_BYTES = 64 << 20
MOST_DB = 100.0
"""Equal images (`image_error.MIN_SQUARED_ERROR`)."""
WORST_BORDER_DB = 60.001
"""Errors at borders are means of squares within 0 to 1, and 1e-6 (`seam_excess.LEAST_MSE`)."""
Db = Annotated[float, Field(ge=0, le=MOST_DB)]
# Sums of many pixels may end a rounding beyond 1.
Likeness = Annotated[float, Field(ge=-1.001, le=1.001)]
Share = Annotated[float, Field(ge=0, le=1.001)]
_VERSIONS = TypeAdapter(dict[Version, tuple[FiniteFloat, ...]])
BorderDb = Annotated[float, Field(ge=-WORST_BORDER_DB, le=0.001)]


class ImageScore(UntrustedRecord):
    """One photograph: its name, or its number on a device, and the figures of `image_error`."""

    name: str = Field(min_length=1, max_length=4096)
    psnr_db: Db
    ssim: Likeness
    psnr_cc_db: Db
    ssim_cc: Likeness
    flip: Share | None
    lpips: Annotated[float, Field(ge=-0.001, le=10)] | None
    initial_psnr_db: Db | None = None
    mean_color_psnr_db: Db | None = None
    used_share: Share | None = None


class _Border(UntrustedRecord):
    side: str = Field(max_length=64)
    beyond: str = Field(max_length=64)
    before_db: BorderDb
    beyond_db: BorderDb


class Leakage(UntrustedRecord):
    """How much a device's model shows of the photographs that it was trained on."""

    psnr_db: Db
    ssim: Likeness
    num_images: int = Field(ge=1, le=10**8)


class Scores(UntrustedRecord):
    """What stands in scores.json."""

    images: tuple[ImageScore, ...]
    borders: tuple[_Border, ...]
    leakage: Leakage | None
    versions: dict[Version, tuple[Annotated[float, Field(ge=0, le=MOST_DB)], ...]]

    @model_validator(mode="after")
    def _fits_together(self) -> Scores:
        names = [row.name for row in self.images]
        if strange := next((name for name in names if not stays_inside(name)), None):
            raise ValueError(f"a score is of {strange[:80]!r}, expected the name of a photograph inside its folder")
        if len({*names}) != len(names):
            raise ValueError("a photograph is scored twice")
        if any(len(figures) != len(names) for figures in self.versions.values()):
            raise ValueError("versions are compared in other photographs than are scored")
        return self

    @property
    def record(self) -> dict[str, Any]:
        """What scores.json says, as JSON has it."""
        return self.model_dump(mode="json", exclude_unset=True)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows as metrics.json has them."""
        return [row.model_dump(exclude_unset=True) for row in self.images]

    @property
    def border_errors(self) -> list[BorderError]:
        """The errors at borders."""
        return [BorderError(**row.model_dump()) for row in self.borders]

    @property
    def num_beyond(self) -> int:
        """How many photographs have a PSNR over `BEST_DB`, which none of 8 bits shows."""
        return sum(row.psnr_db > BEST_DB for row in self.images)

    def bounded(self) -> Scores:
        """The same, in which no photograph weighs more than one of `BEST_DB`."""
        names = ("psnr_db", "psnr_cc_db")
        rows = [row.model_copy(update={name: min(getattr(row, name), BEST_DB) for name in names}) for row in self.images]
        return self.model_copy(update={"images": tuple(rows)})


@dataclass(frozen=True, kw_only=True)
class Claimable:
    """What a device can score by the plan."""

    num_held_out: int
    num_dealt: int
    """Photographs that it trains on."""
    edges: Collection[str]
    """Those of the plan, whose borders are measured."""


def read_scores(path: Path) -> Scores:
    """The scores in a file; BadInput where these are none."""
    return scores_of(read_json(path, max_bytes=MAX_SCORES_BYTES))


def scores_of(record: Any) -> Scores:
    """The scores in a record of JSON; BadInput where a field is missing, unknown, of another type
    or out of its range, or where the parts do not fit together."""
    return parse_record(Scores, record, "scores")


def versions_of(record: Any) -> dict[Version, tuple[float, ...]] | None:
    """The figures of versions of the scene in a record of scores; None where they are none."""
    try:
        return _VERSIONS.validate_json(json.dumps(record["versions"]), strict=True)
    except (ValueError, TypeError, KeyError, RecursionError):
        return None


def claim_problem(scores: Scores, device: str, claimable: Claimable) -> str | None:
    """Why a device cannot have these figures by the plan, one sentence; None where it can."""
    num_rows = len(scores.images)
    if num_rows > claimable.num_held_out:
        return f"it scores {num_rows:,} photographs and holds out {claimable.num_held_out:,} by the plan."
    if strange := next((row.name for index, row in enumerate(scores.images) if row.name != scored_name(device, index)), None):
        return f"it scores {strange[:80]!r}, expected its photographs by numbers, {scored_name(device, 0)!r} first."
    if scores.leakage is not None and scores.leakage.num_images > claimable.num_dealt:
        return f"it compares {scores.leakage.num_images:,} synthetic views and trains on {claimable.num_dealt:,} photographs by the plan."
    borders = Counter((row.side, row.beyond) for row in scores.borders)
    if wrong := next((pair for pair in borders if pair[0] == pair[1] or not {*pair} <= {*claimable.edges}), None):
        return f"it measures a border of {wrong[0][:40]!r} and {wrong[1][:40]!r}, which the plan does not have."
    beyond = Counter(row.beyond for row in scores.borders)
    if (most := max(beyond.values(), default=0)) > claimable.num_dealt:
        return f"it measures one border in {most:,} photographs and trains on {claimable.num_dealt:,} by the plan."
    return None


def scored_name(device: str, index: int) -> str:
    """The name under which a device's held-out photograph is scored, whose own stays there."""
    return f"{device}/held-out-{index:04d}"


def admit_scores(
    reported: Mapping[str, Path | Scores], claimable: Callable[[str], Claimable], warn: Callable[[str, str], None]
) -> dict[str, Scores]:
    """The scores of devices that can have what they say, each photograph with at most `BEST_DB`.

    Args:
        reported: device → its file, or its scores.
        claimable: what a device can score by the plan.
        warn: hears a device and why its figures are left out, or bounded.
    """
    admitted: dict[str, Scores] = {}
    for device, device_scores in reported.items():
        try:
            scores = read_scores(device_scores) if isinstance(device_scores, Path) else device_scores
        except BadInput as error:
            warn(device, f"the figures of this device are left out: {error}")
            continue
        if problem := claim_problem(scores, device, claimable(device)):
            warn(device, f"the figures of this device are left out: {problem}")
            continue
        if number := scores.num_beyond:
            many = f"{number} of its photographs {'has' if number == 1 else 'have'} more than {BEST_DB:.0f} dB"
            warn(device, f"{many}, which no photograph of 8 bits shows: {BEST_DB:.0f} dB count.")
        admitted[device] = scores.bounded()
    return admitted
