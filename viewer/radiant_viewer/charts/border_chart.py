"""A border from straight above, and how far colour, height, density and opacity step there and at its parallels. Once per border."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from radiant_core.evaluate.step_detector import PARALLELS_M, QUANTITIES, THRESHOLDS, BorderSteps
from radiant_viewer.layers.palette import BLUE, VERMILLION
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, new_figure

WIDTH_PX, STRIP_PX, CHART_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 250, 150, 84, 64, 52
LABELS = {
    "colour": ("colour", 255.0, "/255"),
    "height": ("height", 100.0, "cm"),
    "density": ("log density", 1.0, ""),
    "gap": ("gap in opacity", 100.0, "%"),
}
"""Name, factor and unit under which a step is told."""


def border_picture(steps: BorderSteps, title: str) -> Image:
    """The strip with its border drawn in, under it the response at every parallel and the threshold; red where a seam is found."""
    height_px = TOP_PX + STRIP_PX + 66 + CHART_PX + FOOT_PX
    figure = new_figure((WIDTH_PX, height_px))
    found = ", ".join(LABELS[quantity][0] for quantity in steps.found)
    detail = f"step found: {found}" if found else "no step stands out from those beside it; smaller ones are not seen here"
    figure.text(16 / WIDTH_PX, 1 - 14 / height_px, title, size=14, weight="bold", color=INK_COLOR, va="top")
    figure.text(16 / WIDTH_PX, 1 - 40 / height_px, detail, size=10, color=SOFT_COLOR, va="top")
    _draw_strip(figure, steps)
    panel_px = (WIDTH_PX - LEFT_PX - 16) // len(QUANTITIES)
    for index, quantity in enumerate(QUANTITIES):
        axes = axes_at(figure, (LEFT_PX + index * panel_px, FOOT_PX, panel_px - 40, CHART_PX))
        responses, threshold = np.abs(steps.responses[quantity]), THRESHOLDS[quantity]
        name, factor, unit = LABELS[quantity]
        step, limit = steps.steps[quantity], steps.limits[quantity]
        text = f"{name}: too little to say" if np.isnan(step) else f"{name}: {factor * step:+.2g} {unit}, found from {factor * limit:.2g}"
        axes.set_title(text.strip(), size=9, color=INK_COLOR, loc="left")
        axes.bar(PARALLELS_M, np.nan_to_num(responses[1:]), width=0.35, color="#c8ccd0")
        axes.bar([0.0], np.nan_to_num(responses[:1]), width=0.5, color=np.array(VERMILLION if quantity in steps.found else BLUE) / 255)
        axes.axhline(threshold, color=SOFT_COLOR, linewidth=1, linestyle="--")
        axes.set_xlim(-8, 8)
        axes.set_ylim(0, max(1.2 * threshold, float(np.nan_to_num(responses).max()) * 1.08))
        axes.set_xlabel("metres left of the border", size=8, color=SOFT_COLOR)
        axes.invert_xaxis()
        axes.tick_params(colors=SOFT_COLOR, labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        if index == 0:
            axes.set_ylabel("response", size=8, color=SOFT_COLOR)
    return figure_image(figure)


def _draw_strip(figure: Figure, steps: BorderSteps) -> None:
    strip = steps.strip
    half_m, length_m = len(strip.image) * strip.px_m / 2, strip.image.shape[1] * strip.px_m
    axes = axes_at(figure, (LEFT_PX, FOOT_PX + CHART_PX + 66, WIDTH_PX - LEFT_PX - 16, STRIP_PX))
    axes.imshow(np.clip(strip.image, 0, 1), extent=(0, length_m, -half_m, half_m), interpolation="antialiased", aspect="equal")
    axes.set_anchor("W")
    # Marks outside the picture: a line over the border would hide or feign the seam.
    for x_m, text, shift, side in ((0.0, "border ▸", -4, "right"), (length_m, "◂", 4, "left")):
        axes.annotate(text, (x_m, 0), xytext=(shift, 0), textcoords="offset points", ha=side, va="center", size=8, color=INK_COLOR)
    axes.set_xlabel("metres along the border", size=8, color=SOFT_COLOR)
    axes.set_yticks([])
    axes.tick_params(colors=SOFT_COLOR, labelsize=8)
    axes.spines[:].set_visible(False)
