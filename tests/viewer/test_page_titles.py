"""The line below a picture's title can be read at any size of the picture, and says all."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_viewer.layers.layer import Label, Layer, LegendEntry
from radiant_viewer.pictures.images import Drawing
from radiant_viewer.pictures.page import (
    GAP_PX,
    MIN_SIZE_WH,
    TITLE_PX,
    PageText,
    compose_page,
    drawing_size_wh,
    in_two_lines,
    titled_figure,
)

VERDICT = (
    "Seam found at 1 of 1 border; observed: all 30.29 m   ·   largest over a border: edge-1 | edge-2, 35.7 levels beside 8.8 of texture; "
    "over a piece: up to 74.8"
)


def text_below_the_title(size_wh: tuple[int, int], subtitle: str) -> tuple[int, int]:
    """How many rows of pixels a subtitle takes, and its rightmost pixel; none lies on the
    drawing."""
    width, height = drawing_size_wh(size_wh, is_map=False)
    drawing = Drawing(image=np.full((height, width, 3), 255, np.uint8), label_px=np.zeros((0, 2)), mark_px=np.zeros((0, 2)), extent=None)
    page = compose_page(drawing, [], size_wh, PageText(subtitle=subtitle))
    rows, columns = np.nonzero(page.min(axis=2) < 200)
    assert rows.max() < TITLE_PX
    return int(np.ptp(rows)) + 1, int(columns.max())


@pytest.mark.parametrize("size_wh", [(900, 700), MIN_SIZE_WH])
def test_a_long_line_becomes_two_of_the_usual_size(size_wh: tuple[int, int]) -> None:
    one, _ = text_below_the_title((1280, 900), VERDICT)
    two, right = text_below_the_title(size_wh, VERDICT)
    # 9.5 points are 13 px.
    assert 12 <= one <= 16
    assert two >= one + 13
    assert right < size_wh[0] - GAP_PX + 1


def test_what_is_too_long_for_two_lines_is_smaller_and_whole() -> None:
    _, right = text_below_the_title(MIN_SIZE_WH, VERDICT + "; " + VERDICT)
    assert 0.7 * MIN_SIZE_WH[0] < right < MIN_SIZE_WH[0] - GAP_PX + 1


def test_a_line_is_broken_where_its_sense_breaks_if_both_halves_fit() -> None:
    assert in_two_lines("a b   ·   c d; e", lambda half: len(half) <= 8) == "a b\nc d; e"
    assert in_two_lines("one two; three", lambda half: len(half) <= 8) == "one two;\nthree"
    assert in_two_lines("word", lambda half: False) == "word"
    for limit in (5, 9, 20, 60):
        assert in_two_lines(VERDICT, lambda half, limit=limit: len(half) <= limit).replace("\n", "").replace(" ", "").replace("·", "") == (
            VERDICT.replace(" ", "").replace("·", "")
        )


def test_a_name_with_dollars_is_drawn_as_it_is() -> None:
    # As a formula the first would be refused, the second narrower than its letters.
    assert text_below_the_title((900, 700), "from $a_{1$.jpg")[1] > 80
    assert text_below_the_title((900, 700), "from $a$.jpg")[1] > text_below_the_title((900, 700), "from a.jpg")[1]
    name = "$\\foo$.jpg"
    layer = Layer(
        name=name,
        labels=(Label(text=name, position=np.zeros(3)),),
        legend=(LegendEntry(text=name, color=(0, 0, 0), marker="dot"),),
    )
    width, height = drawing_size_wh((900, 700), is_map=False)
    drawing = Drawing(
        image=np.full((height, width, 3), 255, np.uint8), label_px=np.full((1, 2), 50.0), mark_px=np.zeros((0, 2)), extent=None
    )
    assert compose_page(drawing, [layer], (900, 700), PageText(title=name)).min() < 100
    titled_figure((400, 300), name, name).canvas.draw()
