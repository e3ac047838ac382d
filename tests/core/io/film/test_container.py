"""Positions in a film's own file: one place as phones write it, many as GoPro does; what is broken has none."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import pytest

from radiant_core.io.film.container import read_container
from radiant_core.io.film.frames import take_frames
from radiant_core.io.photos.listing import photograph_positions
from tests.core.io.film.films import panned, photographs, write_film
from tests.stress.reader_fuzz import mutated


def box(kind: bytes, *content: bytes) -> bytes:
    inside = b"".join(content)
    return struct.pack(">I4s", 8 + len(inside), kind) + inside


def with_boxes(film: bytes, *boxes: bytes, behind: bytes = b"") -> bytes:
    """A film whose moov, its last box, has more boxes."""
    at = film.rindex(b"moov") - 4
    (length,) = struct.unpack_from(">I", film, at)
    assert at + length == len(film)
    return film[:at] + struct.pack(">I", length + sum(map(len, boxes))) + film[at + 4 :] + b"".join(boxes) + behind


def phone(text: bytes) -> bytes:
    return box(b"udta", box(b"\xa9xyz", struct.pack(">HH", len(text), 0x15C7), text))


def apple(text: bytes) -> bytes:
    key = b"com.apple.quicktime.location.ISO6709"
    keys = box(b"keys", struct.pack(">II", 0, 1), box(b"mdta", key))
    item = struct.pack(">I", 8 + 16 + len(text)) + struct.pack(">I", 1) + box(b"data", struct.pack(">II", 1, 0), text)
    return box(b"meta", box(b"hdlr", bytes(8), b"mdta", bytes(13)), keys, box(b"ilst", item))


def entry(key: bytes, kind: str, size: int, values: bytes) -> bytes:
    count = len(values) // size
    head = struct.pack(">4scBH", key, kind.encode(), size, count) if kind != "0" else struct.pack(">4scBH", key, b"\0", 1, len(values))
    return head + values + bytes(-len(values) % 4)


def gopro(places: np.ndarray, fix: int = 3) -> bytes:
    """A sample of GoPro's with these positions (N,3)."""
    scale = entry(b"SCAL", "l", 4, struct.pack(">5i", 10_000_000, 10_000_000, 1000, 1000, 100))
    rows = b"".join(struct.pack(">5i", round(lat * 1e7), round(lon * 1e7), round(1000 * alt), 0, 0) for lat, lon, alt in places)
    stream = entry(b"STNM", "c", 1, b"GPS (Lat., Long., Alt.)") + entry(b"GPSF", "L", 4, struct.pack(">I", fix)) + scale
    other = entry(b"STRM", "0", 1, entry(b"SCAL", "s", 2, struct.pack(">h", 418)) + entry(b"ACCL", "s", 6, bytes(12)))
    return entry(b"DEVC", "0", 1, entry(b"DVID", "L", 4, bytes(4)) + other + entry(b"STRM", "0", 1, stream + entry(b"GPS5", "l", 20, rows)))


def gopro_film(film: bytes, samples: list[bytes], ticks: int = 1000) -> bytes:
    """A film with a track of samples, one a second, in chunks of two."""
    trak_size = len(_trak(samples, [0] * ((len(samples) + 1) // 2), ticks))
    start = len(film) + trak_size + 8
    offsets, at = [], start
    for number, sample in enumerate(samples):
        if number % 2 == 0:
            offsets.append(at)
        at += len(sample)
    return with_boxes(film, _trak(samples, offsets, ticks), behind=box(b"mdat", *samples))


def _trak(samples: list[bytes], offsets: list[int], ticks: int) -> bytes:
    odd = len(samples) % 2
    runs = [(1, 2, 1), (len(offsets), 1, 1)][: 1 + odd] if len(offsets) > 1 else [(1, len(samples), 1)]
    tables = box(
        b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), box(b"gpmd", bytes(8))),
        box(b"stts", struct.pack(">IIII", 0, 1, len(samples), ticks)),
        box(b"stsc", struct.pack(">II", 0, len(runs)), *(struct.pack(">III", *run) for run in runs)),
        box(b"stsz", struct.pack(">III", 0, 0, len(samples)), *(struct.pack(">I", len(sample)) for sample in samples)),
        box(b"stco", struct.pack(f">II{len(offsets)}I", 0, len(offsets), *offsets)),
    )
    head = box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 1000, ticks * len(samples), 0, 0))
    return box(b"trak", box(b"mdia", head, box(b"hdlr", bytes(8), b"meta", bytes(13)), box(b"minf", tables)))


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Three seconds that move."""
    path = tmp_path_factory.mktemp("film") / "a.mp4"
    return write_film(path, panned(photographs()[0], 30, 6.0)).read_bytes()


@pytest.mark.parametrize("write", [phone, apple])
@pytest.mark.parametrize(
    ("text", "place"),
    [
        (b"+47.3700+008.5400+430.250/", (47.37, 8.54, 430.25)),
        (b"-33.8688+151.2093/", (-33.8688, 151.2093, np.nan)),
        (b"+4722.2-00832.4/", (47.37, -8.54, np.nan)),
        (b"+472212+0083224+100CRSWGS_84/", (47.37, 8.54, 100.0)),
    ],
)
def test_the_place_where_a_film_began(tmp_path: Path, film: bytes, write, text: bytes, place: tuple[float, float, float]) -> None:
    (tmp_path / "a.mp4").write_bytes(with_boxes(film, write(text)))
    track, begun = read_container(tmp_path / "a.mp4")
    assert len(track.times_s) == 0 and begun == pytest.approx(place, abs=1e-9, nan_ok=True)


def places(second: int) -> np.ndarray:
    """Ten a second along a line."""
    steps = second + np.arange(10) / 10
    return np.column_stack([47.37 + 1e-5 * steps, 8.54 - 2e-5 * steps, 430 + steps])


def test_gopros_positions_lie_where_they_were_written(tmp_path: Path, film: bytes) -> None:
    samples = [gopro(places(0)), gopro(places(1), fix=0), gopro(places(2))]
    (tmp_path / "a.mp4").write_bytes(gopro_film(film, samples))
    track, begun = read_container(tmp_path / "a.mp4")
    assert begun is None and track.times_s == pytest.approx(np.r_[0:1:0.1, 2:3:0.1], abs=1e-9)
    # Degrees in steps of 10⁻⁷, metres of 10⁻³; without a fix there is no position.
    assert track.lat_lon_alt == pytest.approx(np.concatenate([places(0), places(2)]), abs=6e-4)
    assert np.abs(track.lat_lon_alt[:, :2] - np.concatenate([places(0), places(2)])[:, :2]).max() < 6e-8


def test_frames_have_the_positions_of_their_films_file(tmp_path: Path, film: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(gopro_film(film, [gopro(places(second)) for second in range(3)]))
    taken = take_frames([tmp_path / "a.mp4"], tmp_path / "frames", 4, lambda *told: None)
    assert "1 of 1 films have positions" in taken.warnings[0]
    found = photograph_positions(taken.folder)
    assert len(found) >= 3
    for name, position in found.items():
        time_s = int(name[-10:-4]) / 10
        assert position == pytest.approx((47.37 + 1e-5 * time_s, 8.54 - 2e-5 * time_s, 430 + time_s), abs=2e-3)
    (tmp_path / "b.mp4").write_bytes(with_boxes(film, phone(b"+47.3700+008.5400/")))
    taken = take_frames([tmp_path / "b.mp4"], tmp_path / "frames_b", 4, lambda *told: None)
    assert any("b.mp4 say where they began alone" in warning for warning in taken.warnings)
    placed = [name for name, position in photograph_positions(taken.folder).items() if position is not None]
    assert placed and all(int(name[-10:-4]) <= 20 for name in placed)


def test_a_broken_file_has_no_position_and_breaks_nothing(tmp_path: Path, film: bytes) -> None:
    whole = gopro_film(film, [gopro(places(second)) for second in range(3)])
    head = whole[whole.rindex(b"moov") - 4 :]
    # The film's own frames are of no interest here.
    seeds = [box(b"ftyp", b"isom") + head, box(b"moov", phone(b"+47.37+008.54/"), apple(b"+47.37+008.54/"))]
    for number in range(3000):
        rng = random.Random(number)
        (tmp_path / "x.mp4").write_bytes(mutated(seeds[number % 2], rng))
        track, _ = read_container(tmp_path / "x.mp4")
        assert np.isfinite(track.lat_lon_alt[:, :2]).all()
