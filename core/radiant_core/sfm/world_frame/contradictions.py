"""Where two sources of place, scale or direction differ by more than they can. Once per scene.

What a user gives (ground control, a length, a direction) is compared with the photographs' GPS.
What GPS may be off by is its noise as its residuals show it, more for errors that drift together,
and a floor: the shift of two datums, a geoid, the dial of a compass. Beyond a first limit the user
is warned; beyond a second, which no receiver reaches, nothing is made unless that is asked for
(`--contradictions warn`): then what the user gives is taken.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from radiant_core.choices import Contradictions
from radiant_core.errors import BadInput
from radiant_core.geometry.align import Alignment

MAX_INDEPENDENT = 4
"""GPS drifts during a flight: more positions than these make nothing surer."""
NOTABLE_SIGMAS, GROSS_SIGMAS = 3.0, 5.0
NOTABLE_SCALE, GROSS_SCALE = 0.03, 0.25
"""A length by tape or by flying height is known to no better; a wrong unit is off by far more."""
NOTABLE_TURN_DEG, GROSS_TURN_DEG = 10.0, 20.0
"""Declination and dial of a compass; what no compass is off by."""
NOTABLE_LEAN_DEG, GROSS_LEAN_DEG = 15.0, 60.0
"""Altitudes that drift, or a photograph that was not held straight, put up so far away; so far that
photographs which look down would look ahead, only where they would be rolled as well."""
FOOT_M = 0.3048
UNIT_SHARE = 0.1
"""Within this share a ratio is that of two units."""


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """One difference beyond what is possible: a sentence without its end, and whether it is so
    large that going on has to be asked for."""

    sentence: str
    is_gross: bool
    outcome: str
    """What is taken where the work goes on, such as "--height is taken"."""
    remedy: str
    """What to do, as an imperative."""


def settle(contradictions: Iterable[Contradiction], policy: Contradictions) -> tuple[str, ...]:
    """Warnings of those that are left to the user; BadInput for gross ones under "stop"."""
    warnings = []
    for contradiction in contradictions:
        if contradiction.is_gross and policy == "stop":
            remedy = contradiction.remedy[0].upper() + contradiction.remedy[1:]
            raise BadInput(f"{contradiction.sentence}. {remedy}; with --contradictions warn {contradiction.outcome}.")
        warnings.append(f"{contradiction.sentence}; {contradiction.outcome}.")
    return tuple(warnings)


def scale_sigma(fit: Alignment) -> float:
    """Relative standard deviation of the scale of a fit to GPS whose errors drift together."""
    return float(fit.scale_error) * drift_factor(fit)


def drift_factor(fit: Alignment) -> float:
    """How many times less sure a fit to GPS is than its residuals say, whose errors drift
    together."""
    return float(np.sqrt(max(1.0, fit.inliers.sum() / MAX_INDEPENDENT)))


def heading_sigma_deg(fit: Alignment) -> float:
    """Standard deviation in degrees of the direction of north by GPS: across the longest axis of
    the positions an error turns by as much as it scales along it."""
    return float(np.degrees(scale_sigma(fit)))


def contradicting_scale(ratio: float, sigma: float, option: str, by_gps: str) -> Contradiction | None:
    """A known length against GPS. `ratio`: the scene by the length over the scene by GPS; `sigma`:
    relative standard deviation of GPS's; `option` as typed; `by_gps`: what it is by GPS, such as
    "the cameras are 45.2 m over the ground"."""
    off = abs(float(np.log(ratio)))
    if off <= max(NOTABLE_SCALE, NOTABLE_SIGMAS * sigma):
        return None
    name = option.partition(" ")[0]
    return Contradiction(
        sentence=f"{option} and the photographs' GPS contradict each other: by GPS, whose scale is known to {100 * sigma:.2g} %, "
        f"{by_gps}{_unit_cause(ratio)}",
        is_gross=off > max(GROSS_SCALE, GROSS_SIGMAS * sigma),
        outcome=f"{name} is taken, which makes the scene {ratio:.3g} times as large",
        remedy=f"correct {name}, or leave it out to go by GPS",
    )


def contradicting_north(turn_deg: float, sigma_deg: float, option: str, heading_deg: float) -> Contradiction | None:
    """North as a user gives it against GPS, which sees the photograph look to `heading_deg`,
    `turn_deg` away."""
    off = abs((turn_deg + 180) % 360 - 180)
    if off <= max(NOTABLE_TURN_DEG, NOTABLE_SIGMAS * sigma_deg):
        return None
    return Contradiction(
        sentence=f"{option} and the photographs' GPS contradict each other: by GPS, which fixes north to {sigma_deg:.1f}°, the photograph "
        f"looks to {heading_deg % 360:.0f}°, {off:.0f}° away",
        is_gross=True,
        outcome="--north is taken, which turns the scene on the map",
        remedy="correct --north, or leave it out, for GPS says where north is",
    )


def contradicting_up(lean_deg: float, sigma_deg: float, option: str) -> Contradiction | None:
    """Up as a user gives it against GPS, whose altitudes are the worst of it: gross only where that
    turns ground into walls."""
    if lean_deg <= max(NOTABLE_LEAN_DEG, NOTABLE_SIGMAS * sigma_deg):
        return None
    return Contradiction(
        sentence=f"{option} puts up {lean_deg:.0f}° away from where the photographs' GPS has it, which is known to {sigma_deg:.1f}°",
        is_gross=lean_deg > GROSS_LEAN_DEG,
        outcome="--up is taken",
        remedy="correct --up, or leave it out to go by GPS",
    )


def _unit_cause(ratio: float) -> str:
    """What a ratio of lengths says of their units."""
    for factor, unit in ((1 / FOOT_M, "feet"), (100.0, "centimetres"), (1000.0, "millimetres")):
        if abs(np.log(ratio / factor)) < UNIT_SHARE:
            return f" (the figure may be in {unit})"
    return ""
