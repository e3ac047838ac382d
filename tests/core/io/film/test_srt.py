"""Subtitles of drones: every published form, and bytes that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiant_core.io.film.exif import with_position
from radiant_core.io.film.srt import read_track
from radiant_core.io.photos.jpeg import ExifFacts
from radiant_core.io.photos.listing import photograph_heads
from tests.core.io.film.films import HAMLET, srt

NAN = float("nan")


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("[latitude: 41.42] [longitude: 2.23] [rel_alt: 1.300 abs_alt: 132.860]", (41.42, 2.23, 132.86)),
        ("<font size=28>[latitude : -38.9] [longtitude : -92.2] [altitude: 274.2]</font>", (-38.9, -92.2, 274.2)),
        ("[iso : 100] [latitude: 47.1] [longitude: 8.5] [altitude: 117.000000] ", (47.1, 8.5, 117.0)),
        ("[latitude: 47.1] [longitude: 8.5] [rel_alt: 12.0]", (47.1, 8.5, NAN)),
        ("GPS (-82.6669, 27.7716, 10), D 2.80m, H 0.00m", (27.7716, -82.6669, NAN)),
        ("HOME(149.0251,-20.2532) GPS(149.02,-20.25,16) BAROMETER:1.9", (-20.25, 149.02, NAN)),
        ("GPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M", (36.6146, -6.112, NAN)),
        ("GPS(-20.25,149.02,10)", (-20.25, 149.02, NAN)),
    ],
)
def test_each_form_gives_its_position(text: str, position: tuple[float, float, float], tmp_path: Path) -> None:
    (tmp_path / "a.srt").write_text(srt([(0.0, text)]))
    np.testing.assert_array_equal(read_track(tmp_path / "a.srt").lat_lon_alt, [position])


@pytest.mark.parametrize("text", ["", "GPS(0,0,0)", "[latitude: 0] [longitude: 0]", "[latitude: 95] [longitude: 8]", "hello", "GPS(a, b)"])
def test_what_is_no_fix_gives_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.srt").write_text(srt([(0.0, text)]))
    track = read_track(tmp_path / "a.srt")
    assert track.times_s.shape == (0,) and track.lat_lon_alt.shape == (0, 3) and track.at(0.0) is None


def test_positions_lie_where_they_change_and_between_on_the_line(tmp_path: Path) -> None:
    """30 blocks a second of positions that change ten times a second, 1e-5° at a time."""
    blocks = [(index / 30, f"[latitude: {47 + 1e-5 * (index // 3):.6f}] [longitude: 8.5] [altitude: 100]") for index in range(90)]
    (tmp_path / "a.srt").write_text(srt(blocks))
    track = read_track(tmp_path / "a.srt")
    assert len(track.times_s) == 30
    for time_s in np.linspace(0, 2.9, 59):
        position = track.at(float(time_s))
        # Milliseconds of the subtitles are 1e-7° here, as are six decimals.
        assert position is not None and position[0] == pytest.approx(47 + 1e-4 * time_s, abs=2e-7)
    assert track.at(8.0) is None and track.at(4.0) == (pytest.approx(47.00029), 8.5, 100)


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_bytes_that_are_no_subtitles_give_an_empty_track(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("srt") / "a.srt"
    path.write_bytes(b"1\n00:00:01,000 --> 00:00:02,000\n[latitude: " + data + b"\n2\n00:00:02.5 -->\nGPS(" + data)
    track = read_track(path)
    assert np.isfinite(track.times_s).all() and (np.diff(track.times_s) > 0).all()
    assert (np.abs(track.lat_lon_alt[:, 0]) <= 90).all()


@pytest.mark.parametrize("position", [(47.123456789, 8.987654321, 430.1234), (-33.5, -70.25, -12.5), (0.000001, 179.999999, NAN)])
def test_a_position_in_a_frame_is_read_as_that_of_a_photograph(position: tuple[float, float, float], tmp_path: Path) -> None:
    jpeg = sorted(HAMLET.iterdir())[0].read_bytes()
    # The hamlet's photograph has EXIF of its own, which comes second and does not count.
    (tmp_path / "a.jpg").write_bytes(with_position(jpeg, position))
    head: ExifFacts = photograph_heads(tmp_path)["a.jpg"]
    # 1e-6 seconds of arc and a millimetre.
    assert head.lat_lon_alt is not None
    np.testing.assert_allclose(head.lat_lon_alt[:2], position[:2], atol=1e-9)
    np.testing.assert_allclose(head.lat_lon_alt[2], position[2], atol=0.0006)
