"""Photographs: which are usable, what EXIF says of them, and what becomes of damaged ones."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos import listing as photos
from radiant_core.io.photos.facts import file_facts, file_outline
from radiant_core.io.photos.folders import folders_warning
from radiant_core.io.photos.jpeg import ExifFacts, read_exif, read_jpeg_facts
from radiant_core.io.photos.listing import list_photographs, load_photograph

HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "images"


def picture(seed: int, size_wh: tuple[int, int] = (96, 64)) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (size_wh[1] // 8, size_wh[0] // 8, 3), np.uint8)
    return cv2.resize(coarse, size_wh, interpolation=cv2.INTER_CUBIC)


def write(path: Path, image: np.ndarray) -> bytes:
    assert cv2.imwrite(str(path), image)
    return path.read_bytes()


def exif_block(order: str, south_west: bool, below_sea: bool) -> bytes:
    """A TIFF with make, model, focal length and GPS, built by hand in either byte order."""
    rationals = struct.pack(order + "14I", 41, 1, 24, 1, 162, 100, 81, 1, 53, 1, 2801, 100, 26528, 100)
    focal = struct.pack(order + "2I", 52, 10)
    data_at = 8 + (2 + 4 * 12 + 4) + (2 + 12 + 4) + (2 + 6 * 12 + 4)
    texts = b"Canon\0S100 II\0"

    def entry(tag: int, kind: int, count: int, value: bytes) -> bytes:
        return struct.pack(order + "HHI", tag, kind, count) + value.ljust(4, b"\0")

    def at(offset: int) -> bytes:
        return struct.pack(order + "I", data_at + offset)

    exif_at, gps_at = 8 + 54, 8 + 54 + 18
    main = [
        entry(0x010F, 2, 6, at(0)),
        entry(0x0110, 2, 8, at(6)),
        entry(0x8769, 4, 1, struct.pack(order + "I", exif_at)),
        entry(0x8825, 4, 1, struct.pack(order + "I", gps_at)),
    ]
    gps = [
        entry(1, 2, 2, b"S\0" if south_west else b"N\0"),
        entry(2, 5, 3, at(len(texts) + 8)),
        entry(3, 2, 2, b"W\0" if south_west else b"E\0"),
        entry(4, 5, 3, at(len(texts) + 8 + 24)),
        entry(5, 1, 1, b"\1" if below_sea else b"\0"),
        entry(6, 5, 1, at(len(texts) + 8 + 48)),
    ]

    def directory(entries: list[bytes]) -> bytes:
        return struct.pack(order + "H", len(entries)) + b"".join(entries) + b"\0\0\0\0"

    header = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    details = directory([entry(0x920A, 5, 1, at(len(texts)))])
    return header + directory(main) + details + directory(gps) + texts + focal + rationals


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("flipped", [False, True])
def test_exif_is_read_in_both_byte_orders_and_all_hemispheres(order: str, flipped: bool) -> None:
    facts = read_exif(exif_block(order, flipped, flipped))
    sign = -1 if flipped else 1
    assert (facts.make, facts.model, facts.focal_mm) == ("Canon", "S100 II", 5.2)
    assert facts.lat_lon_alt == pytest.approx((sign * (41 + 24 / 60 + 1.62 / 3600), sign * (81 + 53 / 60 + 28.01 / 3600), sign * 265.28))


def test_damaged_exif_never_raises_and_never_leaves_the_globe() -> None:
    good = exif_block("<", False, False)
    rng = np.random.default_rng(0)
    for _ in range(3000):
        block = bytearray(good)
        for _ in range(int(rng.integers(1, 6))):
            block[rng.integers(len(block))] = (0, 1, 127, 255, int(rng.integers(256)))[rng.integers(5)]
        facts = read_exif(bytes(block[: rng.integers(len(block) + 1)]))
        if facts.lat_lon_alt is not None:
            lat, lon, alt = facts.lat_lon_alt
            assert abs(lat) <= 90
            assert abs(lon) <= 180
            assert np.isfinite(alt) or np.isnan(alt)
        assert facts.focal_mm is None or (np.isfinite(facts.focal_mm) and facts.focal_mm > 0)


def test_a_damaged_jpeg_header_never_raises() -> None:
    good = sorted(HAMLET.iterdir())[0].read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(2000):
        data = bytearray(good[:2000])
        data[rng.integers(len(data))] = rng.integers(256)
        read_jpeg_facts(bytes(data[: rng.integers(len(data) + 1)]))


def test_size_and_end_are_the_same_without_exif() -> None:
    image = np.random.default_rng(4).integers(0, 255, (24, 36, 3), np.uint8)
    for ending in (".jpg", ".png", ".tif"):
        data = cv2.imencode(ending, image)[1].tobytes()
        for part in (data, data[: len(data) // 2], data[:30], b""):
            assert file_outline(part) == file_facts(part)[:2]
        assert file_outline(data) == ((36, 24), True)


def test_the_sample_photographs_have_position_size_and_one_camera() -> None:
    listing = list_photographs(HAMLET)
    assert [photo.name for photo in listing.photographs] == sorted(path.name for path in HAMLET.iterdir())
    assert listing.skipped == ()
    assert all(photo.lat_lon_alt is not None for photo in listing.photographs)
    assert len({photo.camera for photo in listing.photographs}) == 1
    assert {photo.size_wh for photo in listing.photographs} == {(320, 240)}


def test_damaged_files_are_skipped_and_named_and_the_rest_is_used(tmp_path: Path) -> None:
    jpeg = write(tmp_path / "a.jpg", picture(0))
    png = write(tmp_path / "b.PNG", picture(1))
    for share in (0.3, 0.6, 0.95):
        (tmp_path / f"cut-{share}.jpg").write_bytes(jpeg[: int(len(jpeg) * share)])
        (tmp_path / f"cut-{share}.png").write_bytes(png[: int(len(png) * share)])
    (tmp_path / "text.jpg").write_text("no image")
    (tmp_path / "empty.jpg").touch()
    (tmp_path / "large.png").write_bytes(png[:16] + struct.pack(">II", 1 << 14, (1 << 14) + 1) + png[24:])
    (tmp_path / "notes.txt").write_text("not looked at")
    listing = list_photographs(tmp_path)
    assert [photo.name for photo in listing.photographs] == ["a.jpg", "b.PNG"]
    reasons = {skipped.name: skipped.reason for skipped in listing.skipped}
    assert set(reasons) == {path.name for path in tmp_path.iterdir()} - {"a.jpg", "b.PNG", "notes.txt"}
    assert "truncated" in reasons["cut-0.95.jpg"]
    assert "truncated" in reasons["cut-0.95.png"]
    assert "pixels" in reasons["large.png"]


def test_full_folders_of_a_camera_are_read_below_and_said(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "101MEDIA/c.jpg", "101MEDIA/d.JPG", "flight2/101MEDIA/d.JPG"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        write(tmp_path / name, picture(3))
    (tmp_path / "notes").mkdir()
    (tmp_path / "101MEDIA" / "album.jpg").mkdir()
    (tmp_path / "prints" / "album.jpg").mkdir(parents=True)
    listing = list_photographs(tmp_path)
    assert [photo.name for photo in listing.photographs] == ["101MEDIA/c.jpg", "101MEDIA/d.JPG", "a.jpg", "b.jpg", "flight2/101MEDIA/d.JPG"]
    assert listing.skipped == ()
    assert folders_warning(listing.content) == (
        "5 photographs are read from 3 folders: the folder itself 2, 101MEDIA 2, flight2/101MEDIA 1.",
    )


def test_names_that_colmap_cannot_keep_are_skipped_and_named(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c\\d.jpg", "e\nf.jpg", "g\udcff.jpg"):
        (tmp_path / name).write_bytes(write(tmp_path / "a.jpg", picture(3)))
    listing = list_photographs(tmp_path)
    assert [photo.name for photo in listing.photographs] == ["a.jpg", "b.jpg"]
    assert len(listing.skipped) == 3 and all("name" in skipped.reason and skipped.name.isprintable() for skipped in listing.skipped)


def test_a_photograph_cut_off_after_it_was_listed_is_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.jpg", picture(3))
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadInput, match="not whole"):
        load_photograph(tmp_path / "a.jpg", (48, 32))


def test_an_embedded_thumbnail_does_not_make_a_cut_jpeg_whole() -> None:
    thumbnail = cv2.imencode(".jpg", picture(2, (32, 24)))[1].tobytes()
    jpeg = cv2.imencode(".jpg", picture(3))[1].tobytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    whole = jpeg[:2] + segment + jpeg[2:]
    assert read_jpeg_facts(whole).whole
    assert read_jpeg_facts(whole + b"maker data behind the end").whole
    assert not read_jpeg_facts(whole[:-40]).whole


@pytest.mark.parametrize(("count", "told"), [(None, "does not exist"), (0, "contains no photographs"), (1, "1 usable photograph")])
def test_too_few_photographs_are_one_clear_sentence(count: int | None, told: str, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    if count is not None:
        folder.mkdir()
        for index in range(count):
            write(folder / f"{index}.jpg", picture(index))
    with pytest.raises(BadInput, match=told):
        list_photographs(folder)


def test_progress_is_told_for_every_file(tmp_path: Path) -> None:
    for index in range(4):
        write(tmp_path / f"{index}.jpg", picture(index))
    told: list[tuple[int, int]] = []
    list_photographs(tmp_path, lambda done, total: told.append((done, total)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_photograph_comes_in_rgb_between_0_and_1_and_keeps_its_mean_when_reduced(tmp_path: Path) -> None:
    image = np.zeros((64, 96, 3), np.uint8)
    image[..., 2], image[:32, :, 0] = 255, 100
    write(tmp_path / "red.png", image)
    full, small = load_photograph(tmp_path / "red.png", (96, 64)), load_photograph(tmp_path / "red.png", (24, 16))
    assert (full.shape, full.dtype, small.shape) == ((64, 96, 3), np.float32, (16, 24, 3))
    assert np.array_equal(full * 255, image[:, :, ::-1])
    # 1/255: area averaging of whole blocks rounds each value once.
    assert np.abs(small.mean(axis=(0, 1)) - full.mean(axis=(0, 1))).max() < 1 / 255
    with pytest.raises(BadInput, match="cannot be decoded"):
        load_photograph(tmp_path / "missing.png", (4, 4))


def test_the_exif_orientation_does_not_turn_pixels(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", picture(4))[1].tobytes()
    tiff = b"II*\0\x08\0\0\0" + struct.pack("<HHHIHH", 1, 0x0112, 3, 1, 6, 0) + b"\0\0\0\0"
    content = b"Exif\0\0" + tiff
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content + jpeg[2:])
    write(tmp_path / "other.jpg", picture(5))
    assert {photo.size_wh for photo in list_photographs(tmp_path).photographs} == {(96, 64)}
    assert load_photograph(path, (96, 64)).shape == (64, 96, 3)


@pytest.mark.parametrize(("kind", "altitude_m"), [(5, 4294967295 - 26527), (10, -26528)])
def test_an_altitude_is_read_as_signed_where_it_says_so(kind: int, altitude_m: float) -> None:
    """Some cameras write heights below the sea as signed fractions (kind 10), not by reference."""
    block = exif_block("<", False, False)
    block = block.replace(struct.pack("<HHI", 6, 5, 1), struct.pack("<HHI", 6, kind, 1))
    block = block.replace(struct.pack("<2I", 26528, 100), struct.pack("<2i", -26528, 1))
    position = read_exif(block).lat_lon_alt
    assert position is not None and position[2] == altitude_m


def with_degrees(lat: int, lon: int) -> bytes:
    """The block by hand with whole degrees in place of its position."""
    block = exif_block("<", False, False)
    for old, new in (((41, 1, 24, 1, 162, 100), lat), ((81, 1, 53, 1, 2801, 100), lon)):
        assert block.count(struct.pack("<6I", *old)) == 1
        block = block.replace(struct.pack("<6I", *old), struct.pack("<6I", new, 1, 0, 1, 0, 1))
    return block


@pytest.mark.parametrize(
    ("lat", "lon", "is_on_globe"),
    [(90, 180, True), (91, 8, False), (47, 181, False), (0, 8, True), (47, 0, True), (0, 0, False)],
)
def test_a_position_is_on_the_globe_and_not_where_receivers_without_a_fix_are(lat: int, lon: int, is_on_globe: bool) -> None:
    position = read_exif(with_degrees(lat, lon)).lat_lon_alt
    assert (position is not None) is is_on_globe
    assert position is None or position == pytest.approx((lat, lon, 265.28))


def test_the_shortest_frame_header_says_its_size_and_a_scan_has_to_end() -> None:
    start, frame = b"\xff\xd8", b"\xff\xc0\x00\x07\x08\x00\x10\x00\x20"
    assert read_jpeg_facts(start + frame).size_wh == (32, 16)
    assert read_jpeg_facts(start + b"\xff\xc0\x00\x06\x08\x00\x10\x00").size_wh is None
    assert read_jpeg_facts(start + frame[:5] + b"\x00\x00\x00\x20").size_wh is None, "no picture is 0 px high"
    assert read_jpeg_facts(start + b"\xff" + frame).size_wh == (32, 16), "segments may be padded by FF"
    scan = b"\xff\xda\x00\x02"
    assert read_jpeg_facts(start + frame + scan + b"\x12\xff\xd9").whole
    assert not read_jpeg_facts(start + frame + scan + b"\x12\xff\x00").whole
    assert not read_jpeg_facts(start + frame + b"\xff\xd9").whole, "no scan, no picture"


def short_jpeg(width: int, height: int) -> bytes:
    """A head, the start of a scan and the end: whole, and not to be decoded."""
    return b"\xff\xd8\xff\xc0\x00\x07\x08" + struct.pack(">HH", height, width) + b"\xff\xda\x00\x02\xff\xd9"


def short_png(width: int, height: int, bits: int = 8, kind: int = 2) -> bytes:
    head = b"\0\0\0\rIHDR" + struct.pack(">IIBB", width, height, bits, kind) + bytes(7)
    return b"\x89PNG\r\n\x1a\n" + head + b"\0\0\0\0IEND" + bytes(4)


def reason_of(folder: Path, data: bytes) -> str:
    for name in ("a.png", "b.png"):
        write(folder / name, picture(1))
    (folder / "x.jpeg").write_bytes(data)
    (skipped,) = list_photographs(folder).skipped
    return skipped.reason


# What zlib can pack: 1,032 bytes into one; channels of the kinds 0 grey, 2 RGB, 3 palette, 4 grey
# with alpha, 6 RGB with alpha.
@pytest.mark.parametrize(
    ("bits", "kind", "channels"), [(8, 2, 3), (8, 0, 1), (1, 0, 1), (8, 3, 1), (16, 4, 2), (8, 6, 4), (16, 6, 4), (0, 2, 3)]
)
def test_a_png_promises_no_more_than_zlib_can_pack(tmp_path: Path, bits: int, kind: int, channels: int) -> None:
    most = 1032 * 8 // max(1, bits * channels) * len(short_png(1, 1))
    assert reason_of(tmp_path, short_png(most, 1, bits, kind)) == "cannot be decoded"
    assert reason_of(tmp_path, short_png(most + 1, 1, bits, kind)) == "is truncated (its end is missing)"


def test_a_jpeg_promises_no_more_than_a_bit_for_64_pixels(tmp_path: Path) -> None:
    size = len(short_jpeg(1, 1))
    assert reason_of(tmp_path, short_jpeg(512, size)) == "cannot be decoded"
    assert reason_of(tmp_path, short_jpeg(512, size + 1)) == "is truncated (its end is missing)"


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (short_png(0, 5), "is not a JPEG, PNG or TIFF image"),
        (short_png(5, 0), "is not a JPEG, PNG or TIFF image"),
        (short_png(5, 5).replace(b"IHDR", b"JHDR"), "is not a JPEG, PNG or TIFF image"),
        (short_png(1 << 14, (1 << 14) + 1), f"has 16384 × 16385 pixels, more than {1 << 28}"),
        (short_png(1 << 14, 1 << 14), "is truncated (its end is missing)"),
        (short_png(5, 5)[:-1], "is truncated (its end is missing)"),
        (short_png(5, 5)[:-5], "is truncated (its end is missing)"),
        (short_png(5, 5), "cannot be decoded"),
        (b"", "is an empty file (0 bytes)"),
        (b"text", "is not a JPEG, PNG or TIFF image"),
    ],
)
def test_why_a_file_is_skipped(tmp_path: Path, data: bytes, told: str) -> None:
    assert reason_of(tmp_path, data) == told


def test_a_file_larger_than_the_limit_is_skipped_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photos, "MAX_FILE_BYTES", 1 << 20)
    assert reason_of(tmp_path, bytes(1 << 20)) == "is not a JPEG, PNG or TIFF image"
    assert reason_of(tmp_path, bytes((1 << 20) + 1)) == "is larger than 1 MiB"


def test_where_no_photograph_is_it_is_told_and_which_files_were_no_use(tmp_path: Path) -> None:
    (tmp_path / "deep" / "er").mkdir(parents=True)
    (tmp_path / "deep" / "folder.png").mkdir()
    with pytest.raises(BadInput, match=r"contains no photographs .*: give the folder that holds the image files"):
        list_photographs(tmp_path)
    (tmp_path / "deep" / "er" / "x.jpg").write_bytes(b"no image")
    told = r"has 0 usable photograph\(s\) \(1 skipped: deep/er/x.jpg is not a JPEG, PNG or TIFF image\): at least 2"
    with pytest.raises(BadInput, match=told):
        list_photographs(tmp_path)
    listing = list_photographs(
        HAMLET.parent, names=["images/000.jpg", "images/none.jpg", *(f"images/{p.name}" for p in sorted(HAMLET.iterdir())[1:3])]
    )
    assert [photo.name for photo in listing.photographs][-2:] == [f"images/{p.name}" for p in sorted(HAMLET.iterdir())[1:3]]


def with_focal(order: str, kind: int, count: int, value: bytes) -> bytes:
    """The block by hand whose focal length is written as another type."""
    block = exif_block(order, False, False)
    old = struct.pack(order + "HHI", 0x920A, 5, 1)
    assert block.count(old) == 1
    at = block.index(old)
    return block[:at] + struct.pack(order + "HHI", 0x920A, kind, count) + value.ljust(4, b"\0") + block[at + 12 :]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "layout", "number", "focal_mm"),
    [(3, "H", 50, 50), (3, "H", 65535, 65535), (4, "I", 4_000_000_000, 4e9), (9, "i", 50, 50), (9, "i", -50, None), (3, "H", 0, None),
     (1, "B", 50, None), (6, "B", 50, None), (8, "h", 50, None), (2, "B", 50, None), (7, "B", 50, None)],
)  # fmt: skip
def test_numbers_of_every_type_of_tiff_that_is_read(order: str, kind: int, layout: str, number: int, focal_mm: float | None) -> None:
    """Types 1 byte, 2 text, 3 short, 4 long, 5 and 10 fractions, 7 undefined, 9 signed long; bytes
    and texts are no numbers."""
    facts = read_exif(with_focal(order, kind, 1, struct.pack(order + layout, number)))
    assert facts.focal_mm == focal_mm and facts.make == "Canon"


def test_fractions_by_zero_say_nothing_and_more_than_1024_bytes_are_not_read() -> None:
    block = exif_block("<", False, False)
    assert read_exif(block.replace(struct.pack("<2I", 52, 10), struct.pack("<2I", 52, 0))).focal_mm is None
    for length, make in ((1023, "x" * 1023), (1024, "x" * 1024), (1025, "")):
        entry = struct.pack("<HHI", 0x010F, 2, length) + struct.pack("<I", len(block))
        at = block.index(struct.pack("<HHI", 0x010F, 2, 6))
        assert read_exif(block[:at] + entry + block[at + 12 :] + b"x" * 1025).make == make


def test_a_directory_and_a_value_may_end_with_the_block_and_not_behind_it() -> None:
    """One entry of four bytes of text inside itself, then nothing; and a text that is the block's
    last; of every type of bytes."""
    for order, start in (("<", b"II*\0"), (">", b"MM\0*")):
        for kind in (1, 2, 7):
            inside = start + struct.pack(order + "IHHHI", 8, 1, 0x010F, kind, 4) + b"abcd"
            assert read_exif(inside).make == "abcd" and read_exif(inside[:-1]).make == ""
            behind = start + struct.pack(order + "IHHHII", 8, 1, 0x010F, kind, 5, 22) + b"abcde"
            assert read_exif(behind).make == "abcde" and read_exif(behind[:-1]).make == ""
        assert read_exif(start + struct.pack(order + "I", 9) + b"\0" + inside[8:]).make == "abcd", "a directory may stand at any byte"
        assert read_exif(start + struct.pack(order + "I", 7)[:3]).make == ""
        assert read_exif(start + struct.pack(order + "IH", 8, 0)) == read_exif(b"") == ExifFacts()


@pytest.mark.parametrize("marker", range(0xC0, 0xD0))
def test_a_frame_starts_at_every_marker_of_the_standard_but_three(marker: int) -> None:
    """C4: Huffman tables, C8: reserved, CC: conditions of arithmetic coding (T.81, table B.1)."""
    data = b"\xff\xd8\xff" + bytes([marker]) + b"\x00\x07\x08\x00\x10\x00\x20"
    assert read_jpeg_facts(data).size_wh == (None if marker in (0xC4, 0xC8, 0xCC) else (32, 16))


def as_type(tag: int, kind: int, count: int) -> bytes:
    return struct.pack("<HHI", tag, kind, count)


@pytest.mark.parametrize(
    ("old", "new", "degrees"),
    [
        (b"N\0", b"X\0", None),
        (b"N\0", b"\0\0", None),
        (b"N\0", b"NS", 41),
        (as_type(2, 5, 3), as_type(2, 5, 2), 41),
        (as_type(6, 5, 1), as_type(7, 5, 1), 41),
        (as_type(5, 1, 1), as_type(5, 3, 1), 41),
    ],
)
def test_a_position_needs_its_letters_and_up_to_three_numbers_each_and_no_altitude(old: bytes, new: bytes, degrees: int | None) -> None:
    block = exif_block("<", False, False)
    assert block.count(old) == 1
    position = read_exif(block.replace(old, new)).lat_lon_alt
    assert (None if position is None else int(position[0])) == degrees


def test_segments_are_walked_to_their_ends_and_not_beyond() -> None:
    frame, scan = b"\xff\xc0\x00\x07\x08\x00\x10\x00\x20", b"\xff\xda\x00\x02"
    empty = b"\xff\xfe\x00\x02"
    assert read_jpeg_facts(b"\xff\xd8" + empty + frame).size_wh == (32, 16), "a comment of nothing has a length of 2"
    assert read_jpeg_facts(b"\xff\xd8\xff\xfe\x00\x01" + frame).size_wh is None
    assert read_jpeg_facts(b"\xff\xd8" + frame[:-1]).size_wh is None
    assert read_jpeg_facts(b"\xff\xd8" + scan + frame).size_wh is None, "what follows a scan is its picture"
    assert read_jpeg_facts(b"\xff\xd9" + frame).size_wh is None
    exif = [
        b"\xff\xe1" + struct.pack(">H", 8 + len(block)) + b"Exif\0\0" + block
        for block in (exif_block("<", s, False) for s in (False, True))
    ]
    position = read_jpeg_facts(b"\xff\xd8" + b"".join(exif)).exif.lat_lon_alt
    assert position is not None and position[0] > 0, "the first of two counts"


def with_details(order: str, details: dict[int, tuple[int, bytes]]) -> bytes:
    """An EXIF block whose second directory holds tags with type and content."""
    behind = b""
    entries = []
    begin = 8 + 2 + 12 + 4
    after = begin + 2 + 12 * len(details) + 4
    for tag, (kind, content) in details.items():
        length = len(content) // {2: 1, 3: 2, 5: 8}[kind]
        place = content.ljust(4, b"\0") if len(content) <= 4 else struct.pack(order + "I", after + len(behind))
        behind += b"" if len(content) <= 4 else content
        entries.append(struct.pack(order + "HHI", tag, kind, length) + place)
    header = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    main = struct.pack(order + "H", 1) + struct.pack(order + "HHII", 0x8769, 4, 1, begin) + b"\0\0\0\0"
    return header + main + struct.pack(order + "H", len(details)) + b"".join(entries) + b"\0\0\0\0" + behind


@pytest.mark.parametrize("order", ["<", ">"])
def test_time_and_exposure_are_read(order: str) -> None:
    def fraction(numerator: int, denominator: int) -> tuple[int, bytes]:
        return 5, struct.pack(order + "2I", numerator, denominator)

    details = {0x829A: fraction(1, 1000), 0x829D: fraction(28, 10), 0x8827: (3, struct.pack(order + "H", 200))}
    details |= {0x9003: (2, b"2016:06:23 16:31:59\0"), 0x9291: (2, b"25\0")}
    facts = read_exif(with_details(order, details))
    assert facts.log2_exposure == pytest.approx(np.log2(200 / 1000 / 2.8**2), abs=1e-12)
    later = read_exif(with_details(order, details | {0x9003: (2, b"2016:06:24 00:00:00\0"), 0x9291: (2, b"x\0")}))
    assert facts.taken_s is not None and later.taken_s is not None
    assert later.taken_s - facts.taken_s == pytest.approx(7 * 3600 + 28 * 60 + 0.75, abs=1e-6)


@pytest.mark.parametrize("text", [b"", b"0000:00:00 00:00:00", b"2016:06:23", b"2016:13:23 16:31:59", b"\xff\xfe:06:23 16:31:59"])
def test_a_time_that_is_none_and_an_exposure_of_zero_say_nothing(text: bytes) -> None:
    assert read_exif(with_details("<", {0x9003: (2, text + b"\0")})).taken_s is None
    for zero in ((0, 1), (1, 0)):
        details = {0x829A: (5, struct.pack("<2I", *zero)), 0x829D: (5, struct.pack("<2I", 28, 10)), 0x8827: (3, struct.pack("<H", 100))}
        assert read_exif(with_details("<", details)).log2_exposure is None
