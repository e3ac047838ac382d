"""How good a scene is, in a word beside its figures, the same on the terminal and in the report.

The words are a convention for renders of held-out photographs (docs/glossary.md): PSNR says how far
colours are off, SSIM whether fine texture is there, and the lower word of the two is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    """Judge the figures of metrics.json: `psnr_db` (dB), `ssim` and the rows `images`."""
    psnr_db, ssim, num_images = metrics["psnr_db"], metrics["ssim"], len(metrics["images"])
    word, _, _, meaning = next(row for row in _WORDS if psnr_db >= row[1] and ssim >= row[2])
    figures = f"{psnr_db:.2f} dB PSNR and SSIM {ssim:.2f} on {num_images} held-out photograph{'s' * (num_images != 1)}"
    doubt = "" if num_images >= FEW_PHOTOGRAPHS else "too few to be sure"
    return Verdict(word=word, meaning=meaning, figures=figures, doubt=doubt)
