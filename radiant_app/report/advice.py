"""What to try where a scene is poor: choices of its run that could be forced the other way, with
what that gained where it was tried, or the most likely cause by figures at hand. Once per run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from radiant_app.report.verdict import MANY_UNPLACED, verdict_of
from radiant_core.regimes import FEW_PHOTOGRAPHS, HARDLY_SHOWN

MOST_TRIED_LOSS_DB = 0.3
"""A choice that lost no more in short trials may be the better one in the whole training: so much
do trials of a few photographs leave open."""
CORRECTED_GAIN_DB = 1.5
"""A correction of colours that gains more says that light differs."""
LOW_OVERLAP = 3.0
"""Photographs that see a point, in the mean, below which depth hangs on pairs."""
UNSHARP_PERCENT = 80.0
"""Of the others' sharpness; sharp sets have 80 to 120 % (docs/experiments/training.md)."""
MOST_LINES = 3
ASKED = {"num_steps": "{count} steps", "long_side_px": "pictures of {count} px"}
"""Sizes of a training that make it poor where somebody asks for less than the default."""
LOST_SOMEWHERE = ("train.fill_in", "train.drop_gaussians")
"""What cost on some kind of scene, surely or before models were averaged
(docs/experiments/kinds.md, regimes.md)."""


def what_to_try(metrics: Mapping[str, Any], decisions: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """What could make a poor scene better, likeliest first.

    Args:
        metrics: the content of metrics.json.
        decisions: those of the manifest, as mappings.

    Returns:
        At most `MOST_LINES` sentences; none unless the verdict is "poor".
    """
    if verdict_of(metrics).word != "poor":
        return ()
    lines = list(dict.fromkeys([*_reduced(decisions), *_tried(decisions), *_causes(metrics, decisions)]))
    return tuple([*lines, *_untried(decisions), *([] if lines else [NOTHING_SEEN])][:MOST_LINES])


NOTHING_SEEN = "the figures do not show why: compare the worst photographs with their renders (`radiant inspect`)"


def _reduced(decisions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Few steps and small pictures that were asked for, and what the defaults would be."""
    rows = {row["topic"]: row for row in decisions if row["topic"] in ASKED and row["forced"] and row.get("otherwise")}
    asked = {topic: (int(rows[topic]["figure"]), int(rows[topic]["otherwise"].split()[-1])) for topic in ASKED if topic in rows}
    small = {topic: (given, usual) for topic, (given, usual) in asked.items() if given < usual}
    if small:
        given = " and ".join(ASKED[topic].format(count=f"{given:,}") for topic, (given, _) in small.items())
        usual = " and ".join(
            ASKED[topic].format(count=f"{'up to ' * (topic == 'num_steps')}{usual:,}") for topic, (_, usual) in small.items()
        )
        yield f"`{' '.join(rows[topic]['otherwise'] for topic in small)}`: only {given} were asked for; the default here would be {usual}"


def _tried(decisions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The other choice of each trial that lost little, the best first."""
    tried = [row for row in decisions if row.get("otherwise_db") is not None and row["otherwise_db"] > -MOST_TRIED_LOSS_DB]
    for row in sorted(tried, key=lambda row: -row["otherwise_db"]):
        decided = f"short trials decided on {row['topic']} ({row['choice']})"
        yield f"`{row['otherwise']}`: {decided}, where this had {row['otherwise_db']:+.2f} dB"


def _untried(decisions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The other choice where none was tried; first what lost somewhere."""
    for row in sorted(decisions, key=lambda row: not any(name in (row.get("otherwise") or "") for name in LOST_SOMEWHERE)):
        if row.get("otherwise") and row.get("otherwise_db") is None and not row["forced"] and not row.get("changes_nothing"):
            yield f"`{row['otherwise']}` was not tried here; this run's choice for {row['topic']}: {row['choice']}"


def _causes(metrics: Mapping[str, Any], decisions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """What the figures at hand say, the gravest first."""
    placed, unplaced = metrics.get("num_photographs"), metrics.get("num_unplaced", 0)
    if placed and unplaced > MANY_UNPLACED * (placed + unplaced):
        yield f"{unplaced} of {placed + unplaced} photographs could not be placed: overlap between neighbours of two thirds helps"
    overlap = metrics.get("views_per_point")
    if overlap is not None and overlap < LOW_OVERLAP:
        yield f"a point is seen by {overlap:.1f} photographs on average: photographs from places in between would raise that to 5 and more"
    if placed and placed < FEW_PHOTOGRAPHS:
        yield f"{placed} photographs are few: {FEW_PHOTOGRAPHS} or more, also from other places, improve the views between them"
    corrected_db = metrics.get("psnr_cc_db")
    if corrected_db is not None and corrected_db - metrics["psnr_db"] > CORRECTED_GAIN_DB:
        gain = corrected_db - metrics["psnr_db"]
        models = "`--set train.light=always` models it, one fixed exposure avoids it"
        yield f"colour correction alone gains {gain:.1f} dB, so the light differs: {models}"
    for row in decisions:
        if row["topic"] == "blurred photographs" and row["figure"] is not None and row["figure"] < UNSHARP_PERCENT:
            yield f"a photograph has {row['figure']:.0f} % of the others' sharpness: leave blurred ones out, or take them again"
    times_used = _times_shown(metrics)
    if times_used is not None and times_used < HARDLY_SHOWN:
        yield f"a training used each photograph {times_used:.0f} times: give more --steps or more time"


def _times_shown(metrics: Mapping[str, Any]) -> float | None:
    training = metrics.get("training") or {}
    count = training.get("num_photographs")
    return training["num_steps"] / count if count else None
