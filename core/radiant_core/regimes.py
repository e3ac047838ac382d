"""Where a default depends on what is trained on: every measured case, its limits and its evidence.

    look_up(topic, figures) = the first row of a topic within whose limits all figures lie

The one place of thresholds such as "few photographs" or "shown often"; what decides by one names
its row in the `Decision`. Each row stands in docs/experiments/regimes.md with its evidence and the
page that has the sets and the command; a row that no decision names, or that the page lacks, fails
a test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

FEW_PHOTOGRAPHS = 36
"""Photographs of a model. Below, each of their pixels tells more, one place hangs on few of them,
and two devices that share them are no better than one that has them all."""
PHOTOGRAPHS_OF_A_DEVICE = 10
"""With fewer for each device a joined model is worse than that of fewer devices."""
SHORT_SHOWS, SHORT_STEPS = 50, 650
"""A training is short that shows each photograph less often, or takes fewer steps: between the 38
and 62 times, and the 500 and 800 steps, that were measured."""
HARDLY_SHOWN, ENOUGH_SHOWS, OFTEN_SHOWN = 30, 75, 100
"""How often a training shows each photograph: where refining has most to do, and where little."""
FEW_DEVICES = 4
"""Up to so many the cloud has nothing to fit that they would not; with 16 it has."""
LIGHT_SPREAD, LIGHT_EVENNESS = 0.02, 1.5
"""Spread of gains, and how many times what they leave of parts of pictures it is (`light`)."""
SEEN_THROUGH_SHARE = 0.05
"""Of filled-in points that other photographs see through: around an object, along a street."""
CONTRADICTED_SHARE = 0.6
"""Of filled-in points whose colour is not what other photographs show (`train/fill_in.py`)."""
SKY_SHARE = 0.03
"""Less sky than this in every image is a strip that the far ground's Gaussians cover."""
SHARPNESS = 0.7
"""Of a photograph beside the others at common points; below, it is blurred."""


@dataclass(frozen=True, kw_only=True)
class Regime:
    """One measured case."""

    row: str
    """Its name, which decisions carry and the page of evidence lists."""
    reason: str
    """Why its values hold there, as a decision says it."""
    evidence: str
    """What was measured, as docs/experiments/regimes.md has it."""
    page: str = "training"
    """The page of docs/experiments with the sets and the command."""
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    """Figure → (from, below)."""
    values: Mapping[str, int] = field(default_factory=dict[str, int])
    """What holds there."""

    @property
    def where(self) -> str:
        """Its limits in words; "else" for the last of a topic."""
        ends = [(name.replace("_", " "), *pair) for name, pair in self.limits.items()]
        parts = [f"{name} from {low:g}" if high == inf else f"{name} below {high:g}" for name, low, high in ends]
        return ", ".join(parts) or "else"

    def holds(self, figures: Mapping[str, float]) -> bool:
        """Whether all its limits hold."""
        return all(low <= figures[name] and (figures[name] < high or high == inf) for name, (low, high) in self.limits.items())


def _below(limit: float) -> tuple[float, float]:
    return -inf, limit


def _from(limit: float) -> tuple[float, float]:
    return limit, inf


PHOTOGRAPHS, DEVICES, MACHINE = "photographs of a model", "devices of few photographs", "one machine"
JOINING, REFINING = "joining", "refining"
LIGHT, FILL_IN, SKY = "light", "points filled in", "sky"
REPEATS, BLUR, LENGTH, EXTENT, SHAPES, THINNING = "repeats", "blur", "length", "extent", "shapes", "thinning"

_EXPOSURES = f"from {100 * LIGHT_SPREAD:.0f} % on, a gain per photograph and channel and a vignetting per camera are removed"

REGIMES: Mapping[str, tuple[Regime, ...]] = {
    PHOTOGRAPHS: (
        Regime(
            row="few-photographs",
            evidence=(
                "left out at random: +0.04 to +0.51 dB with 15 to 20 photographs, −0.11 to −0.08 with 46, of averaged models "
                "−0.01 to +0.89 with 20; one per 40 pixels: +0.75, +0.28, +0.13, −0.01 dB with 20"
            ),
            limits={"photographs": _below(FEW_PHOTOGRAPHS)},
            values={"leaves_out": 1, "pixels_per_splat": 40},
            reason=f"below {FEW_PHOTOGRAPHS} photographs this gains on photographs left out; above, it costs",
        ),
        Regime(
            row="some-photographs",
            evidence="one per 44 with 40 photographs +0.56, −0.09, +0.07 dB; one per 51 to 72 with all +0.24, −0.06, +0.08",
            limits={"photographs": _below(2 * FEW_PHOTOGRAPHS)},
            values={"leaves_out": 0},
            reason=f"below {FEW_PHOTOGRAPHS} photographs this gains on photographs left out; above, it costs",
        ),
        Regime(
            row="many-photographs",
            evidence="one per 60 has 24.80 dB, one per 80 24.95 (town)",
            values={"leaves_out": 0, "pixels_per_splat": 80},
            reason=f"below {FEW_PHOTOGRAPHS} photographs this gains on photographs left out; above, it costs",
        ),
    ),
    DEVICES: (
        Regime(
            row="few-photographs-one-device",
            page="aggregation",
            evidence=(
                "15 to 17 photographs: one device is 0.2 to 0.8 dB ahead of two; 26 and 28: 0.5 dB ahead to 0.2 "
                "behind; 46 to 65: −0.1 to +0.4 dB in 0.6 to 0.9 of the time"
            ),
            limits={"photographs": _below(FEW_PHOTOGRAPHS)},
            values={"photographs_each": FEW_PHOTOGRAPHS},
            reason=f"below {FEW_PHOTOGRAPHS} photographs one device is better than several",
        ),
        Regime(
            row="few-photographs-each",
            page="aggregation",
            evidence=("4 to 7 on each of four devices: 0.2 to 1.9 dB behind one in six of seven cells; 12 to 16: 0.3 to 0.9 dB ahead"),
            limits={"photographs_each": _below(PHOTOGRAPHS_OF_A_DEVICE)},
            values={"photographs_each": FEW_PHOTOGRAPHS},
            reason=f"with fewer than {PHOTOGRAPHS_OF_A_DEVICE} photographs each, fewer devices are better",
        ),
    ),
    MACHINE: (
        Regime(
            row="one-machine",
            page="aggregation",
            evidence="28.21 dB, as four devices 27.86 (town, 384 px, 1,500 steps)",
            reason="one model of all photographs is 0.2 to 1.6 dB better than four joined ones trained on as many views, and 0.2 to 0.3 "
            "dB with a quarter of the views: photographs are divided only for lack of memory or by --devices N",
        ),
    ),
    JOINING: (
        Regime(
            row="joined-after-long",
            page="aggregation",
            evidence="10 and 5 epochs have 33.13 and 22.86 dB, 2 and 2 have 33.00 and 22.76 (caliterra, lewis)",
            limits={"shows": _from(SHORT_SHOWS), "steps": _from(SHORT_STEPS)},
            reason=f"after {SHORT_STEPS} steps that show each photograph {SHORT_SHOWS} times the long join is 0.0 to 0.4 dB better",
        ),
        Regime(
            row="joined-of-few-devices",
            page="aggregation",
            evidence=(
                "1 and 0 epochs have 25.54 dB after 20 s, 2 and 2 have 25.63 after 25 (town); 21.93 after 18, 21.90 after 23 (lewis)"
            ),
            limits={"devices": _below(FEW_DEVICES + 1)},
            values={"edge_epochs": 1, "cloud_epochs": 0},
            reason=f"after short trainings of up to {FEW_DEVICES} devices, refining gains the same in less time",
        ),
        Regime(
            row="joined-after-short",
            page="aggregation",
            evidence="16 devices: 27.88 dB, without an epoch at the cloud 27.26",
            values={"edge_epochs": 2, "cloud_epochs": 2},
            reason="after short trainings refining gains the same in less time; with many devices, one epoch at the cloud is still needed",
        ),
    ),
    REFINING: (
        Regime(
            row="hardly-shown",
            page="aggregation",
            evidence="400 photographs: 27.60 dB after three rounds, 27.88 after five",
            limits={"shows": _below(HARDLY_SHOWN)},
            values={"rounds": 5, "epochs": 8},
            reason=f"below {HARDLY_SHOWN} views per photograph, a fourth and a fifth round still gained",
        ),
        Regime(
            row="short-of-few-devices",
            page="aggregation",
            evidence="a third round is worth 0.2, 0.15 and 0.05 dB for a third of the time (town, caliterra, lewis)",
            limits={"shows": _below(SHORT_SHOWS), "devices": _below(FEW_DEVICES + 1)},
            values={"rounds": 2, "epochs": 8},
            reason=f"after short trainings of up to {FEW_DEVICES} devices, a third round gained 0 to 0.2 dB for a third of the time",
        ),
        Regime(
            row="few-steps-of-few-devices",
            page="aggregation",
            evidence="between 43 and 117 times nothing was measured; as its neighbours above and below",
            limits={"steps": _below(SHORT_STEPS), "shows": _below(OFTEN_SHOWN), "devices": _below(FEW_DEVICES + 1)},
            values={"rounds": 2, "epochs": 8},
            reason=f"after short trainings of up to {FEW_DEVICES} devices, a third round gained 0 to 0.2 dB for a third of the time",
        ),
        Regime(
            row="few-photographs-of-few-devices",
            page="aggregation",
            evidence="five epochs in place of eight: −0.01 dB in the mean of four sets, in 0.7 to 0.8 of the time",
            limits={"steps": _below(SHORT_STEPS), "devices": _below(FEW_DEVICES + 1)},
            values={"rounds": 2, "epochs": 5},
            reason=f"after short trainings of up to {FEW_DEVICES} devices that show each photograph {OFTEN_SHOWN} times, a third round "
            "and more epochs per round gained nothing",
        ),
        Regime(
            row="half-shown",
            page="aggregation",
            evidence="62 times: 25.63, 25.78, 25.86 dB after one, two and three rounds",
            limits={"shows": _below(ENOUGH_SHOWS)},
            values={"rounds": 3, "epochs": 8},
            reason=f"below {ENOUGH_SHOWS} views per photograph, a second and a third round gained 0.1 to 0.2 dB each",
        ),
        Regime(
            row="shown-enough",
            page="aggregation",
            evidence="92 to 130 times: the second and third round gain −0.03 to +0.13 dB",
            values={"rounds": 1, "epochs": 8},
            reason=f"from {ENOUGH_SHOWS} views per photograph on, a second and a third round gained −0.1 to +0.1 dB",
        ),
    ),
    LIGHT: (
        Regime(
            row="light-alike",
            page="light",
            evidence="spread 0.08 % (town): the same bytes with and without",
            limits={"spread": _below(LIGHT_SPREAD)},
            values={"taken_out": 0, "compared": 0},
            reason=_EXPOSURES,
        ),
        Regime(
            row="light-no-exposure",
            page="light",
            evidence="turntable: spread 5.3 %, evenness 0.5",
            limits={"evenness": _below(LIGHT_EVENNESS)},
            values={"taken_out": 0, "compared": 1},
            reason=_EXPOSURES,
        ),
        Regime(
            row="light-exposures",
            page="light",
            evidence=("spread 6.7 to 14.8 %, evenness 2.6 to 10.9; joined +0.67, +0.99, +0.53 dB (caliterra, lewis, brighton)"),
            values={"taken_out": 1, "compared": 1},
            reason=_EXPOSURES,
        ),
    ),
    FILL_IN: (
        Regime(
            row="filled-where-nothing-is",
            page="regimes",
            evidence="turntable: 68 to 87 % contradicted, −2.73 and −0.82 dB; twelve others: 0 to 51 %, −0.9 to +0.9 dB",
            limits={"contradicted": _from(CONTRADICTED_SHARE)},
            values={"tried": 0, "on": 0},
            reason=f"from {100 * CONTRADICTED_SHARE:.0f} % on, most of these points lie in empty space, as around an object on a table",
        ),
        Regime(
            row="filled-over-ground",
            evidence="0 to 2 % seen through: +0.49, +0.08, +0.23 dB (town, caliterra, lewis), −0.06 corrected (brighton)",
            limits={"seen_through": _below(SEEN_THROUGH_SHARE)},
            values={"tried": 0, "on": 1},
            reason="places without sparse points would start empty",
        ),
        Regime(
            row="filled-around",
            evidence="12 to 18 %: +0.47 (orbit), −0.37 (street), −0.82 dB (turntable); room of 90: −0.94 by height, +0.16 by depth",
            values={"tried": 1, "on": 1},
            reason="around an object or along a street they gain or lose half a decibel",
        ),
    ),
    SKY: (
        Regime(
            row="no-sky",
            page="regimes",
            evidence="0 % in surveys and before façades, where none would be seen; between 0 and 3 % nothing was measured",
            limits={"share": _below(SKY_SHARE)},
            values={"built": 0},
            reason=f"a sky is modelled if it covers {100 * SKY_SHARE:.0f} % or more of an image",
        ),
        Regime(
            row="sky-seen",
            page="regimes",
            evidence="turntable +3.40 dB, room +1.57 (30 photographs, 160 px)",
            values={"built": 1},
            reason=f"a sky is modelled if it covers {100 * SKY_SHARE:.0f} % or more of an image",
        ),
    ),
    REPEATS: (
        Regime(
            row="repeated",
            evidence="14 copies left out: 28.52 dB in 54 s for 28.44 in 62 (town)",
            reason="a copy costs steps and shows nothing new",
        ),
    ),
    BLUR: (
        Regime(
            row="blurred",
            evidence="9 px of motion: 27.62 dB for 27.35, 21.95 for 21.40, 32.29 for 31.41 (town, lewis, caliterra)",
            reason=f"below {100 * SHARPNESS:.0f} % a photograph blurs the model; the only one that shows a place is kept",
        ),
    ),
    LENGTH: (
        Regime(
            row="steps-enough",
            evidence="120 to 240 steps per photograph: caliterra and lewis −0.3 dB",
            reason="more steps gained nothing on photographs left out",
        ),
    ),
    THINNING: (
        Regime(
            row="few-photographs-whole",
            evidence="three quarters of the Gaussians: −0.21 to +0.16 dB, −0.08 in the mean of nine kinds of 30 photographs",
            limits={"photographs": _below(FEW_PHOTOGRAPHS)},
            values={"stays_percent": 100},
            reason="of few photographs every Gaussian is worth keeping",
        ),
        Regime(
            row="thinned",
            evidence=(
                "three quarters of the Gaussians and growth by sums: −0.01, +0.19, +0.16 dB (town, caliterra, lewis; 46 to 65 "
                "photographs); thinning alone −0.02, +0.01 (90 of a room, a turntable)"
            ),
            values={"stays_percent": 75},
            reason="the rest shows the photographs held out as well, in less time and smaller files",
        ),
    ),
    EXTENT: (
        Regime(
            row="long-flight",
            evidence="1,600 photographs of a long flight: 21.68 dB for 20.99",
            reason="a longer flight sees the same detail",
        ),
    ),
    SHAPES: (
        Regime(
            row="shapes-held",
            evidence=(
                "needles held at 10 times: +0.13, +0.26, −0.09 dB (town, lewis, caliterra); thinner ones than a pixel at 10 "
                "pixels: +0.35, +0.26 (90 of a façade, a turntable); sizes cost 0.34 on the turntable"
            ),
            reason="needles and huge Gaussians show in views they were not fitted to",
        ),
    ),
}
"""Topic → its cases, in the order in which they are asked."""


def look_up(topic: str, figures: Mapping[str, float] | None = None) -> Regime | None:
    """The case of a topic that holds for these figures.

    Args:
        topic: one of `REGIMES`.
        figures: all that its limits name.

    Returns:
        The first whose limits hold; None where none was measured, so that nothing changes.
    """
    return next((case for case in REGIMES[topic] if case.holds(figures or {})), None)


def require(topic: str, figures: Mapping[str, float] | None = None) -> Regime:
    """The same of a topic whose last case always holds."""
    case = look_up(topic, figures)
    assert case is not None, f"no case of {topic} holds for {figures}"
    return case
