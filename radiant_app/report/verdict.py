"""How good a scene is, in a word beside its figures, the same on the terminal and in the report.

The words are a convention for renders of held-out photographs (docs/glossary.md): PSNR says how far
colours are off, SSIM whether fine texture is there, and the lower word of the two is taken. What
else is known of the scene lowers it further: a model that looks right is not good where its place
is in doubt, a part of it is missing or a seam goes through it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

FEW_PHOTOGRAPHS = 5
"""Fewer held-out photographs than this are a sample too small to judge by."""
_WORDS = (
    ("very good", 28.0, 0.88, "renders are hard to tell from photographs of this size"),
    ("good", 24.0, 0.75, "objects and most textures are as in the photographs, fine ones are soft"),
    ("fair", 20.0, 0.55, "shapes and colours are right, textures are blurred"),
    ("poor", float("-inf"), float("-inf"), "places can be recognised, details are missing or wrong"),
)
"""Word, least PSNR in dB, least SSIM, meaning; best first."""
_ORDER = tuple(row[0] for row in _WORDS)
MANY_UNPLACED, MOST_UNPLACED = 0.1, 0.5
"""Shares of the photographs without a pose from which on the scene is not the site."""
WORSE_THAN_EXPECTED = 3.0
"""Check points off by so many times what was expected."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How good a scene is."""

    word: str
    meaning: str
    """What one sees, as a clause."""
    figures: str
    """Such as "24.41 dB PSNR and SSIM 0.79 on 8 held-out photographs"."""
    doubt: str = ""
    """Why the word may not be trusted; else empty."""

    @property
    def line(self) -> str:
        """The verdict in one line without its meaning."""
        return f"{self.word}: {self.figures}{f' ({self.doubt})' * bool(self.doubt)}"


def verdict_of(metrics: Mapping[str, Any]) -> Verdict:
    """Judge the figures of metrics.json: `psnr_db` (dB), `ssim`, the rows `images`, and what it
    says of devices, seams, photographs and the frame. The weakest part gives the word."""
    psnr_db, ssim, num_images = metrics["psnr_db"], metrics["ssim"], len(metrics["images"])
    word, _, _, meaning = next(row for row in _WORDS if psnr_db >= row[1] and ssim >= row[2])
    figures = f"{psnr_db:.2f} dB PSNR and SSIM {ssim:.2f} on {num_images} held-out photograph{'s' * (num_images != 1)}"
    limits = [(most, why) for most, why in _limits(metrics) if _ORDER.index(most) > _ORDER.index(word)]
    if not limits:
        return Verdict(word=word, meaning=meaning, figures=figures, doubt="" if num_images >= FEW_PHOTOGRAPHS else "too few to be sure")
    lowest = max((most for most, _ in limits), key=_ORDER.index)
    doubt = "; ".join(why for _, why in limits)
    return Verdict(word=lowest, meaning=f"by its renders alone it would be {word}", figures=figures, doubt=doubt)


def _limits(metrics: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The best word that each known weakness allows, and the weakness."""
    rows = metrics["images"]
    if len(rows) < FEW_PHOTOGRAPHS:
        yield "good", "too few to be sure"
    flat = [row["mean_color_psnr_db"] for row in rows if row.get("mean_color_psnr_db") is not None]
    if flat and metrics["psnr_db"] <= sum(flat) / len(flat):
        yield "poor", "no better than one flat colour per photograph"
    unplaced = metrics.get("num_unplaced", 0)
    placed = metrics.get("num_photographs")
    if unplaced and placed is not None:
        share = unplaced / (unplaced + placed)
        if share > MANY_UNPLACED:
            yield "poor" if share > MOST_UNPLACED else "fair", f"{unplaced} of {unplaced + placed} photographs could not be placed"
    if unscored := metrics.get("num_unscored", 0):
        yield "good" if unscored < len(rows) else "fair", f"{unscored} of {unscored + len(rows)} held-out photographs are not scored"
    if missing := metrics.get("missing"):
        yield "fair", f"no model arrived from {', '.join(missing)}"
    if metrics.get("seam_found"):
        yield "fair", "a seam was found"
    if doubts := metrics.get("doubts"):
        yield "fair", f"its position, scale or up direction is in doubt ({len(doubts)} warning{'s' * (len(doubts) != 1)})"
    check = (metrics.get("ground_control") or {}).get("check")
    if check is not None and check["rms_axis_m"] > WORSE_THAN_EXPECTED * check["expected_axis_m"]:
        yield "fair", f"check points are off by {check['rms_axis_m'] / check['expected_axis_m']:.0f} times the expected error"
