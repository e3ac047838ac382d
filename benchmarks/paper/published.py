"""What the paper's Table II prints for Mill 19: PSNR, SSIM and LPIPS of Rubble and of Building.

Other scenes, sizes and machines than ours, and not one protocol among themselves (VastGaussian
corrects colours, Fed3DGS scores half images): they stand in a table of their own and are compared
with nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

Triple = tuple[float, float | None, float | None]
"""PSNR in dB, SSIM, LPIPS; None: not printed."""
MILL_19: Mapping[str, tuple[Triple, Triple]] = {
    "GP-NeRF": ((24.08, 0.563, 0.497), (20.99, 0.565, 0.490)),
    "3DGS": ((25.51, 0.725, 0.316), (22.53, 0.738, 0.214)),
    "Switch-NeRF": ((24.31, 0.562, 0.496), (21.54, 0.579, 0.474)),
    "Drone-NeRF": ((19.51, 0.528, 0.489), (18.46, 0.490, 0.469)),
    "Mega-NeRF": ((24.06, 0.553, 0.516), (20.93, 0.547, 0.504)),
    "VastGaussian": ((25.20, 0.742, 0.264), (21.80, 0.728, 0.225)),
    "FedNeRF": ((20.12, None, None), (17.51, None, None)),
    "Fed3DGS": ((20.62, 0.588, 0.437), (18.66, 0.602, 0.362)),
    "Even, system 1": ((23.93, 0.719, 0.324), (21.19, 0.682, 0.304)),
    "Even, system 2": ((24.08, 0.729, 0.310), (21.33, 0.698, 0.297)),
    "Radiant, system 1": ((24.44, 0.737, 0.305), (21.57, 0.716, 0.292)),
    "Radiant, system 2": ((24.53, 0.740, 0.284), (21.66, 0.723, 0.236)),
}


def published_table() -> list[str]:
    """Lines of Markdown."""
    lines = ["| the paper, Mill 19 | Rubble: PSNR dB, SSIM, LPIPS | Building: PSNR dB, SSIM, LPIPS |", "|---|---|---|"]
    for name, scenes in MILL_19.items():
        lines.append(f"| {name} | {' | '.join(', '.join(map(_text, scene)) for scene in scenes)} |")
    return lines


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"
