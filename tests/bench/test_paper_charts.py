"""Pictures of `radiant bench paper`: distinct curves, true lengths of bars, and differences."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.charts.curve_chart import CurvePoint, curve_picture
from benchmarks.charts.curve_style import curve_style
from benchmarks.charts.end_to_end_chart import KEYS_PX, LABEL_PX, PANEL_PX, MethodLatency, SystemLatency, end_to_end_picture
from benchmarks.charts.healing_chart import CAPTION_PX, CELL_PX, FOOT_PX, GAP_PX, TOP_PX, Healed, healing_picture
from benchmarks.charts.latency_chart import DeviceLatency, PlanLatency, latency_picture
from benchmarks.charts.line_chart import Line, Panel, line_picture
from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import BLUE, CURVE_COLORS, GREEN, ORANGE

PHASES = ("devices train and send", "edges join and send", "the cloud joins", "refined and compared")
SIMULATED = "simulated, until the edges are done"


def of_color(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=2) < 12


def test_no_two_curves_look_alike() -> None:
    styles = [curve_style(index) for index in range(308)]
    assert len({(style.color, style.dash, style.marker) for style in styles}) == 308
    assert len({style.marker for style in styles[:11]}) == 11
    # On white, by the relative luminance of WCAG 2: 3:1 for graphics, but for the two pale ones
    # that a marker tells.
    for color in CURVE_COLORS:
        linear = (np.array(color) / 255) ** 2.2 @ [0.2126, 0.7152, 0.0722]
        assert 1.05 / (linear + 0.05) > 1.9
    eight = {f"method {index}": [CurvePoint(cpu_s=1 + index, num_gaussians=1e4, psnr_db=20 + index)] for index in range(8)}
    seven = {name: points for name, points in eight.items() if name != "method 7"}
    blue = [of_color(curve_picture(curves, "Title", ""), BLUE).sum() for curves in (seven, eight)]
    assert blue[1] > blue[0] and curve_style(0).color == curve_style(7).color and curve_style(0).marker != curve_style(7).marker


def test_a_panel_keeps_its_range_and_marks_its_values() -> None:
    line = Line(name="a", x=np.array([2.0, 4.0, 8.0]), y=np.array([20.0, 20.5, 21.0]), marked=True)
    wide = line_picture(
        [Panel(lines=(line,), x_label="x", y_label="y", y_range=(19.9, 21.1), x_ticks=(2, 4, 8))], "Title", panel_wh=(300, 200)
    )
    assert wide.shape[1] == 76 + 300 + 30
    rows = np.flatnonzero(of_color(wide, BLUE).any(axis=1))
    assert np.ptp(rows) > 150
    from_zero = line_picture([Panel(lines=(line,), x_label="x", y_label="y")], "Title", panel_wh=(300, 200))
    rows = np.flatnonzero(of_color(from_zero, BLUE).any(axis=1))
    # The line lies high in the panel, apart from its entry in the legend.
    line_rows = np.split(rows, np.flatnonzero(np.diff(rows) > 10) + 1)[0]
    assert np.ptp(line_rows) < 40


def test_bars_are_as_long_as_their_seconds() -> None:
    def plan(name: str, *seconds: float) -> PlanLatency:
        return PlanLatency(name=name, note="", devices=tuple(DeviceLatency(name=f"d{s}", measured_s=s, predicted_s=0) for s in seconds))

    picture = latency_picture([plan("even", 5.0, 10.0), plan("balanced", 8.0, 8.0)], "Title", "")
    lengths = of_color(picture, ORANGE)[116:-100].sum(axis=1), of_color(picture, BLUE)[116:-100].sum(axis=1)
    longest = [np.unique(length[length > 100]) for length in lengths]
    assert longest[0].max() / longest[0].min() == pytest.approx(2, abs=0.05)
    assert longest[1].max() / longest[0].max() == pytest.approx(0.8, abs=0.02)
    with pytest.raises(BadInput, match="two times of 0 or more"):
        DeviceLatency(name="d", measured_s=float("nan"), predicted_s=1)
    for nothing in ([], [PlanLatency(name="even", note="", devices=())]):
        with pytest.raises(BadInput, match="no latency"):
            latency_picture(nothing, "Title", "")


def test_differences_show_where_a_join_is_wrong() -> None:
    photograph = np.full((60, 90, 3), 100, np.uint8)
    wrong = photograph.copy()
    wrong[:, 45:] += 20
    band = np.zeros((60, 90), bool)
    band[:, 40:50] = True
    shown = [Healed(caption="cut", image=wrong), Healed(caption="ours", image=photograph)]
    picture = healing_picture(photograph, band, shown, "A border")
    cell_h = round(CELL_PX * 60 / 90)
    assert picture.shape == (TOP_PX + 2 * (cell_h + CAPTION_PX) + FOOT_PX, GAP_PX + 3 * (CELL_PX + GAP_PX), 3)
    below = slice(TOP_PX + cell_h + CAPTION_PX + 5, TOP_PX + 2 * cell_h + CAPTION_PX - 5)
    cut, ours = (picture[below, GAP_PX + column * (CELL_PX + GAP_PX) + 5 :][:, : CELL_PX - 10] for column in (1, 2))
    assert not ours.any() and not cut[:, :150].any() and (cut[:, -150:] == 60).all()
    with pytest.raises(BadInput, match="no border to draw"):
        healing_picture(photograph, band, [], "A border")
    with pytest.raises(BadInput, match="ours is of 90 × 30 px, the photograph of 90 × 60"):
        healing_picture(photograph, band, [Healed(caption="ours", image=wrong[:30])], "A border")
    with pytest.raises(BadInput, match="the band is of 89"):
        healing_picture(photograph, band[:, 1:], shown, "A border")


def test_phases_follow_each_other_on_one_axis_of_all_systems() -> None:
    def method(*ends_s: float, simulated_s: float | None = None) -> MethodLatency:
        return MethodLatency(name="exact", ends_s=ends_s, simulated_s=simulated_s, note="20 dB")

    systems = [
        SystemLatency(name="one", methods=(method(4.0, 6.0, 10.0, simulated_s=5.0),)),
        SystemLatency(name="two", methods=(method(5.0, 5.0, 20.0),)),
    ]
    picture = end_to_end_picture(systems, ("a", "b", "c"), "simulated", "Title", "")
    panel = picture[:-KEYS_PX, LABEL_PX : LABEL_PX + PANEL_PX]
    named = end_to_end_picture(systems, PHASES, SIMULATED, "Title", "")
    assert (named[-KEYS_PX:, -8:] == named[-1, -1]).all(), "the key ends within the picture"
    for color, seconds in ((BLUE, (4, 5)), (ORANGE, (2,)), (GREEN, (4, 15))):
        lengths = of_color(panel, color).sum(axis=1)
        drawn = sorted({int(length) for length in lengths[lengths > 10]})
        assert drawn[0] == pytest.approx(min(seconds) / 20 * PANEL_PX, abs=3) and drawn[-1] == pytest.approx(
            max(seconds) / 20 * PANEL_PX, abs=3
        )
    for ends_s in ((3.0, 2.0), (-1.0, 2.0), (1.0, float("inf"))):
        with pytest.raises(BadInput, match="expected rising times"):
            method(*ends_s)
    with pytest.raises(BadInput, match="at least one method"):
        end_to_end_picture([SystemLatency(name="one", methods=())], (), "", "", "")
