"""Words and places as a person reads them: one table for hovers and glossary, natural order, coordinates, heights."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from radiant_core.frames import Frame
from radiant_core.scene import SfmScene
from radiant_viewer.layers.layer import LegendEntry
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.pictures.page import _add_entry
from radiant_viewer.runs.places import camera_heights, natural_key, place_text
from radiant_viewer.runs.words import LAYER_TERMS, MEANINGS, counted, tip
from tests.core.scenes import cameras_above

GLOSSARY = Path(__file__).parents[2] / "docs/glossary.md"
METRIC = Frame(kind="metric", origin_lat_lon_alt=np.array([47.37, 8.54, 400.0]))


def test_one_is_no_plural() -> None:
    assert [counted(count, "region") for count in (0, 1, 1200)] == ["0 regions", "1 region", "1,200 regions"]


def glossary() -> dict[str, str]:
    """Term → its entry on the page, without line breaks."""
    text = re.sub(r"\n(?!- \*\*|#|\n)\s*", " ", GLOSSARY.read_text())
    return dict(re.findall(r"^- \*\*([^*]+)\*\*:? (.*)$", text, re.MULTILINE))


@pytest.mark.parametrize("term", MEANINGS)
def test_the_hover_of_a_term_begins_its_entry_in_the_glossary(term: str) -> None:
    entry, meaning = glossary()[term], MEANINGS[term].removesuffix(".")
    assert entry.startswith(meaning), f"docs/glossary.md explains {term} as {entry[:90]!r}"


def test_hovers_name_only_terms_of_the_table() -> None:
    assert all(tip(*terms) for terms in LAYER_TERMS.values())
    assert tip("slack", "bound").splitlines()[1] == f"bound: {MEANINGS['bound']}"


def test_names_are_sorted_as_people_count() -> None:
    names = ["wp-10", "wp-2", "WP-1", "DJI_0100.jpg", "DJI_99.jpg", "a2b10", "a2b9"]
    assert sorted(names, key=natural_key) == ["a2b9", "a2b10", "DJI_99.jpg", "DJI_0100.jpg", "WP-1", "wp-2", "wp-10"]


def test_a_place_is_given_in_the_grid_of_its_zone_and_in_degrees() -> None:
    # Zürich's main station lies at 465,199 E 5,246,376 N in EPSG:32632 to some metres of its origin.
    text = place_text(np.array([0.0, 0.0]), METRIC)
    assert text.endswith("47.370000° 8.540000°") and "(EPSG:32632)" in text
    east, north = (float(number.replace(",", "")) for number in re.findall(r"([\d,.]+) [EN]", text))
    moved = place_text(np.array([100.0, 50.0]), METRIC)
    east_2, north_2 = (float(number.replace(",", "")) for number in re.findall(r"([\d,.]+) [EN]", moved))
    assert (east_2 - east, north_2 - north) == pytest.approx((100.0, 50.0), abs=1.0)


def test_a_place_without_a_globe_is_given_in_the_units_of_its_frame() -> None:
    unscaled = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    assert place_text(np.array([-1.25, 3.0]), unscaled) == "−1.2 east, 3.0 north (units)"
    assert place_text(np.array([1.0, 3.0]), None).endswith("(units)")


def test_heights_of_cameras_are_above_the_ground_where_points_show_it() -> None:
    points = np.array([[x, y, -50.0] for x in range(5) for y in range(5)], np.float64)
    cameras = cameras_above([(0, 0), (1, 1)], height_m=0.64)
    seen = SfmScene(
        cameras=cameras, points=points, colors=np.zeros((25, 3), np.uint8), observations=np.zeros((0, 2), np.int64), frame=METRIC
    )
    heading, heights = camera_heights(seen)
    assert heading == "Above ground (m)" and heights == pytest.approx([50.64, 50.64])
    bare = SfmScene(
        cameras=cameras, points=points[:0], colors=np.zeros((0, 3), np.uint8), observations=np.zeros((0, 2), np.int64), frame=METRIC
    )
    assert camera_heights(bare)[0] == "Height (m)"


def test_a_pale_line_is_seen_in_a_legend() -> None:
    """As that of a border of low risk, which is white."""

    def swatch(color: tuple[int, int, int]) -> int:
        axes = Figure(figsize=(2, 1), dpi=100).add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0, 200), ylim=(100, 0))
        axes.set_axis_off()
        _add_entry(axes, LegendEntry(text="", color=color, marker="line"), 50.0)
        canvas = FigureCanvasAgg(axes.figure)
        canvas.draw()
        return int((np.asarray(canvas.buffer_rgba())[..., :3] < 120).all(axis=2).sum())

    assert swatch((255, 255, 255)) > 20 and swatch(VERMILLION) == 0
