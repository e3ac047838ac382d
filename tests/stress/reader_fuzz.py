"""Mutated files for the strict readers: seeded, so that a finding can be found again by its format
and number.

    report = fuzz("ply", count, seed, folder)     every mutated file is read once
    report.surprises                              [] where each was read or refused with BadInput

Measured besides: the longest reading in CPU seconds of this process, and by how much its peak
memory grew. By hand: `python -m tests.stress.reader_fuzz ply 1000000`.
"""

from __future__ import annotations

import gc
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from radiant_app.files.constraints_file import load_constraints
from radiant_app.files.profile_file import load_profile
from radiant_app.files.system_file import load_system
from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_core.errors import BadInput
from radiant_core.export.glb import glb_bytes
from radiant_core.export.lod import META_NAME, save_lod
from radiant_core.export.sog import save_sog, save_sog_folder
from radiant_core.frames import Frame
from radiant_core.io.colmap.model import read_model
from radiant_core.io.lod_reader import load_lod_level
from radiant_core.io.open3d_formats import splats_from_spz, spz_bytes
from radiant_core.io.photos.jpeg import read_jpeg_facts
from radiant_core.io.photos.listing import decode_image, list_photographs, load_photograph, photograph_positions, read_size_wh
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.poses.recognise import alignment_files, read_alignment
from radiant_core.io.records import load_cameras, load_plan, load_scene, save_cameras, save_scene, save_splats
from radiant_core.io.sog_reader import load_sog
from radiant_core.io.transport.upload import load_upload, save_upload
from radiant_core.lod.cells import whole_region
from radiant_core.lod.levels import LodLimits
from radiant_core.scene import SfmScene
from radiant_core.waypoints.reader import read_waypoints
from tests.core.io.glb_reader import load_glb
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import Truth
from tests.core.io.poses.writers import F
from tests.core.scenes import cameras_above, ground_splats

SEED = 9
PER_LOOK = 1000
SHOWN = 5
"""Surprises kept; the rest are counted."""
ROOT = Path(__file__).parents[2]
NUMBERS = (b"0", b"-1", b"1e999", b"nan", b"4294967296", b"9223372036854775807", b"1" * 5000, b"-0.0", b"1e-320", b"999999999")
WORDS = (b"\0", b"\n", b"\xff\xfe", b"[" * 3000, b"{" * 3000, b'"', b"=", b".", b"#", b"'''", b"\xed\xa0\x80", b"\\u0000", b" " * 2000)
EXTREMES = tuple(struct.pack("<q", value) for value in (0, 1, -1, 2**31, 2**32 - 1, 2**62, -(2**63), 1000))

Reading = Callable[[Path], object]


@dataclass(frozen=True, kw_only=True)
class Target:
    """One format: whole files to start from, where the mutated one is put, and what reads it."""

    seeds: list[bytes]
    place: Callable[[int], str]
    """Name of the file that is replaced, by the number of the seed."""
    read: Callable[[Path, int], object]
    """Read the folder with the mutated file in it."""
    pixel_bytes: Callable[[bytes], int] = lambda data: 0
    """What the decoded pixels of a file take that is decoded, three bytes each."""


@dataclass(frozen=True, kw_only=True)
class FuzzReport:
    """What came of so many mutated files."""

    count: int
    num_refused: int
    surprises: list[str]
    """Format, number and error of those that were neither read nor refused."""
    longest_s: float
    longest_number: int
    """CPU seconds of one reading, the quicker of two, and which it was."""
    grown_bytes: int
    """Peak resident memory within some `PER_LOOK` of them over that before, without the decoded
    pixels of the largest picture. Not over all: every listing of a folder starts threads, which
    leave 1 kB each time in OpenCV, whatever the files."""
    seconds: float


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to four edits of `data`, most of them near its head, where counts and types stand."""
    edited = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        head = min(len(edited), rng.choice((16, 128, 2048, len(edited))))
        at = rng.randrange(head) if head else 0
        kind = rng.randrange(8)
        if kind == 0 and edited:
            edited[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and edited:
            edited[at] = rng.randrange(256)
        elif kind == 2:
            del edited[at : at + rng.choice((1, 2, 7, 64))]
        elif kind == 3:
            edited[at:at] = edited[at : at + rng.choice((1, 8, 40, 200))]
        elif kind == 4:
            del edited[rng.randrange(len(edited) + 1) :]
        elif kind == 5:
            edited[at : at + rng.choice((0, 1, 3))] = rng.choice(NUMBERS)
        elif kind == 6:
            edited[at : at + rng.choice((0, 1))] = rng.choice(WORDS)
        else:
            size = rng.choice((1, 2, 4, 8))
            edited[at : at + size] = rng.choice(EXTREMES)[:size]
    return bytes(edited)


def fuzz(name: str, count: int, seed: int, folder: Path, first: int = 0) -> FuzzReport:
    """Read `count` mutated files of a format, one after the other; `first` skips to a number that was reported."""
    target = TARGETS[name](folder)
    for number, data in enumerate(target.seeds):
        (folder / target.place(number)).write_bytes(data)
        target.read(folder, number)
    # What was there before is not the reader's: walking through all of it took 0.16 s of some
    # reading.
    gc.collect()
    gc.freeze()
    surprises: list[str] = []
    num_surprises = num_refused = longest_number = 0
    pixel_bytes = grown_bytes = 0
    longest_s, before, begun_s = 0.0, _fresh_peak_bytes(), time.monotonic()
    for number in range(first, first + count):
        if (number - first) % PER_LOOK == 0:
            grown_bytes, pixel_bytes = max(grown_bytes, peak_bytes() - before - pixel_bytes), 0
            before = _fresh_peak_bytes()
        rng = random.Random(seed * 1_000_003 + number)
        chosen = rng.randrange(len(target.seeds))
        path = folder / target.place(chosen)
        data = mutated(target.seeds[chosen], rng)
        path.write_bytes(data)
        pixel_bytes = max(pixel_bytes, target.pixel_bytes(data))
        begun = time.process_time()
        try:
            target.read(folder, chosen)
        except BadInput as error:
            num_refused += 1
            if not str(error):
                num_surprises, surprises = num_surprises + 1, [*surprises, f"{name} {number}: refused without a word"][:SHOWN]
        except Exception as error:  # noqa: BLE001 whatever else comes is what is looked for
            num_surprises, surprises = num_surprises + 1, [*surprises, f"{name} {number}: {type(error).__name__}: {error}"[:300]][:SHOWN]
        seconds = time.process_time() - begun
        if seconds > longest_s:
            seconds = min(seconds, _seconds_to_read(target, folder, chosen))
        if seconds > longest_s:
            longest_s, longest_number = seconds, number
        # The other files of a format of several are whole again.
        path.write_bytes(target.seeds[chosen])
    if num_surprises > SHOWN:
        surprises.append(f"… {num_surprises} in all")
    return FuzzReport(
        count=count,
        num_refused=num_refused,
        surprises=surprises,
        longest_s=longest_s,
        longest_number=longest_number,
        grown_bytes=max(grown_bytes, peak_bytes() - before - pixel_bytes),
        seconds=time.monotonic() - begun_s,
    )


def _seconds_to_read(target: Target, folder: Path, chosen: int) -> float:
    """CPU seconds of a second reading: what a busy machine or a first call adds is not the file's."""
    begun = time.process_time()
    with suppress(Exception):
        target.read(folder, chosen)
    return time.process_time() - begun


def _fresh_peak_bytes() -> int:
    """What the process holds, from which its peak counts anew where that can be (Linux)."""
    return reset_peak_bytes() if sys.platform == "linux" else peak_bytes()


def _made(folder: Path, name: str, save: Callable[[Path], object]) -> bytes:
    save(folder / name)
    return (folder / name).read_bytes()


def _ply(folder: Path) -> Target:
    def seed(count: int, degree: int) -> bytes:
        splats = ground_splats(count)
        more = np.zeros((count, (degree + 1) ** 2 - 1, 3), np.float32)
        return _made(folder, "m.ply", lambda path: save_ply(path, type(splats)(**{**splats.arrays(), "shN": more}, antialiased=degree > 0)))

    return Target(seeds=[seed(1, 0), seed(3, 1), seed(2, 3)], place=lambda _: "m.ply", read=lambda inside, _: load_ply(inside / "m.ply"))


def _safetensors(folder: Path) -> Target:
    splats, cameras = ground_splats(3), cameras_above([(0.0, 0.0), (1.0, 0.5)])
    frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3), residual_m=None)
    colors, seen = np.zeros((3, 3), np.uint8), np.array([[0, 0], [1, 1], [2, 0]])
    scene = SfmScene(cameras=cameras, points=np.zeros((3, 3)), colors=colors, observations=seen, frame=frame)
    seeds = [
        _made(folder, "a", lambda path: save_splats(path, splats)),
        _made(folder, "a", lambda path: save_upload(path, splats, "float16")),
        _made(folder, "a", lambda path: save_cameras(path, cameras)),
        _made(folder, "a", lambda path: save_scene(path, scene)),
    ]
    readers: list[Reading] = [load_upload, load_upload, load_cameras, load_scene]
    return Target(seeds=seeds, place=lambda _: "a", read=lambda inside, number: readers[number](inside / "a"))


def _colmap(folder: Path) -> Target:
    text = {
        "cameras.txt": b"# cameras\n1 PINHOLE 64 48 50 50 32 24\n2 OPENCV 64 48 50 50 32 24 0.1 0 0 0\n",
        "images.txt": b"1 1 0 0 0 0 0 0 1 a.jpg\n10 11 7 12 13 -1\n2 1 0 0 0 0.5 0 0 2 sub/b.jpg\n20 21 7\n",
        "points3D.txt": b"7 0.1 0.2 0.3 10 20 30 0.5 1 0 2 0\n8 1 2 3 0 0 255 0.1\n",
    }
    image = struct.pack("<I7dI", 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.jpg\0" + struct.pack("<Qddqddq", 2, 10, 11, 7, 12, 13, -1)
    binary = {
        "cameras.bin": struct.pack("<QIiQQ4d", 1, 1, 1, 64, 48, 50, 50, 32, 24),
        "images.bin": struct.pack("<Q", 1) + image,
        "points3D.bin": struct.pack("<QQ3d3BdQII", 1, 7, 0.1, 0.2, 0.3, 1, 2, 3, 0.5, 1, 1, 0),
    }
    files = [(f"{kind}/{name}", data) for kind, model in (("text", text), ("binary", binary)) for name, data in model.items()]
    for name, data in files:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)

    def read(inside: Path, number: int) -> object:
        return read_model((inside / files[number][0]).parent).observations()

    return Target(seeds=[data for _, data in files], place=lambda number: files[number][0], read=read)


def _toml(folder: Path) -> Target:
    paths = [ROOT / "sample_scenes/town/system.toml", ROOT / "sample_scenes/hamlet/unequal.toml", ROOT / "radiant_app/profiles/a100.toml"]
    constraints = b'locked = ["north"]\n\n[fixed_weights_m2]\nsouth = 120.0\n\n[pinned]\nwest = ["a.jpg"]\n'
    readers: list[Reading] = [load_system, load_system, load_profile, lambda path: load_constraints(path, ["a.jpg"])]
    seeds = [*(path.read_bytes() for path in paths), constraints]
    return Target(seeds=seeds, place=lambda _: "s.toml", read=lambda inside, number: readers[number](inside / "s.toml"))


def _spz(folder: Path) -> Target:
    """SPZ itself, without the container whose hash would refuse every mutation."""
    counts = (3, 40)
    seeds = [spz_bytes(ground_splats(count)) for count in counts]
    return Target(
        seeds=seeds,
        place=lambda _: "m.spz",
        read=lambda inside, number: splats_from_spz((inside / "m.spz").read_bytes(), counts[number], 0),
    )


def _sog(folder: Path) -> Target:
    """The zip, and of an unbundled one the description, a texture with an alpha channel, and one without."""
    splats = ground_splats(40)
    splats = type(splats)(**{**splats.arrays(), "shN": np.zeros((40, 3, 3), np.float32)})
    bundle = _made(folder, "m.sog", lambda path: save_sog(path, splats))
    (folder / "m.sog").unlink()
    if not (folder / "loose").exists():
        save_sog_folder(folder / "loose", splats)
    loose = [f"loose/{name}" for name in ("meta.json", "quats.webp", "shN_centroids.webp")]
    names = ["m.sog", *loose]
    reads = ["m.sog", *["loose/meta.json"] * 3]
    return Target(
        seeds=[bundle, *((folder / name).read_bytes() for name in loose)],
        place=lambda number: names[number],
        read=lambda inside, number: load_sog(inside / reads[number]),
        # WebP's pixels four bytes each, as bytes and as numbers.
        pixel_bytes=lambda data: 1 << 20,
    )


def _lod(folder: Path) -> Target:
    """Whole files of a few leaves, read with all chunks that they name."""
    splats = ground_splats(60)
    limits = LodLimits(num_levels=2, chunk_count=30, leaf_side_m=1.0, leaf_count=5)
    if not (folder / META_NAME).exists():
        save_lod(folder, splats, [whole_region(splats.means)], limits)
    return Target(
        seeds=[(folder / META_NAME).read_bytes()],
        place=lambda _: META_NAME,
        read=lambda inside, _: load_lod_level(inside / META_NAME),
    )


def _glb(folder: Path) -> Target:
    splats = ground_splats(5)
    more = type(splats)(**{**splats.arrays(), "shN": np.zeros((5, 3, 3), np.float32)})
    seeds = [glb_bytes(splats), glb_bytes(more), glb_bytes(more, form="spz")]
    return Target(seeds=seeds, place=lambda _: "m.glb", read=lambda inside, _: load_glb(inside / "m.glb"))


def _json(folder: Path) -> Target:
    plan = (ROOT / "sample_scenes/runs/tiny/plan.json").read_bytes()
    collection = b'{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"name": "a"}, "geometry": '
    geojson = collection + b'{"type": "LineString", "coordinates": [[8.5, 47.4, 30.0], [8.6, 47.5]]}}]}'
    kml = b'<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>a</name><Point><coordinates>8.5,47.4,3'
    kml += b"</coordinates></Point></Placemark></kml>"
    table = b"name,lat,lon,alt,heading,pitch\na,47.4,8.5,30,10,-90\nb,47.5,8.6,31,,\n"
    names = ["plan.json", "w.geojson", "w.kml", "w.csv"]
    readers: list[Reading] = [load_plan, read_waypoints, read_waypoints, read_waypoints]
    return Target(
        seeds=[plan, geojson, kml, table],
        place=lambda number: names[number],
        read=lambda inside, number: readers[number](inside / names[number]),
    )


def _exif(folder: Path) -> Target:
    """A photograph with camera, focal length and GPS, in both byte orders; one without EXIF, and a PNG."""
    picture = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (24, 32, 3), np.uint8), (5, 5), 0)
    jpeg, png = (cv2.imencode(suffix, picture)[1].tobytes() for suffix in (".jpg", ".png"))
    marked = [jpeg[:2] + _exif_segment(order) + jpeg[2:] for order in "<>"]
    (folder / "photos").mkdir(exist_ok=True)
    (folder / "heads").mkdir(exist_ok=True)
    names = ["photos/a.jpg", "photos/a.jpg", "photos/a.jpg", "photos/b.png"]
    (folder / "photos" / "a.jpg").write_bytes(jpeg)
    (folder / "photos" / "b.png").write_bytes(png)

    def read(inside: Path, number: int) -> object:
        path = inside / names[number]
        read_jpeg_facts(path.read_bytes())
        photograph_positions(inside / "photos")
        list_photographs(inside / "photos")
        return load_photograph(path, (32, 24))

    def pixel_bytes(data: bytes) -> int:
        width, height = read_size_wh(data) or (0, 0)
        return 0 if decode_image(data, cv2.IMREAD_COLOR) is None else 3 * width * height

    return Target(seeds=[*marked, jpeg, png], place=lambda number: names[number], read=read, pixel_bytes=pixel_bytes)


def _exif_segment(order: str) -> bytes:
    """APP1 with make, focal length and a GPS position."""

    def directory(offset: int, entries: list[tuple[int, int, int, bytes]]) -> bytes:
        """Entries (tag, kind, count, value) at `offset`, values of over 4 bytes behind them."""
        head, tail = struct.pack(order + "H", len(entries)), b""
        behind = offset + 2 + 12 * len(entries) + 4
        for tag, kind, count, value in entries:
            if len(value) > 4:
                place, tail = struct.pack(order + "I", behind + len(tail)), tail + value
            else:
                place = value.ljust(4, b"\0")
            head += struct.pack(order + "HHI", tag, kind, count) + place
        return head + struct.pack(order + "I", 0) + tail

    def ratios(*values: int) -> bytes:
        return b"".join(struct.pack(order + "II", value, 1) for value in values)

    def pointer(value: int) -> bytes:
        return struct.pack(order + "I", value)

    main = directory(8, [(0x010F, 2, 6, b"Maker\0"), (0x8769, 4, 1, pointer(200)), (0x8825, 4, 1, pointer(300))])
    details = directory(200, [(0x920A, 5, 1, ratios(24))])
    gps = [(1, 2, 2, b"N\0"), (2, 5, 3, ratios(47, 20, 5)), (3, 2, 2, b"E\0"), (4, 5, 3, ratios(8, 30, 1)), (6, 5, 1, ratios(400))]
    header = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    tiff = (header + main).ljust(200, b"\0") + details.ljust(100, b"\0") + directory(300, gps)
    content = b"Exif\0\0" + tiff
    return b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content


def _alignment(write: Callable[..., Path]) -> Callable[[Path], Target]:
    """The main file of an alignment of two photographs and three points, and those that are read beside it."""

    def target(folder: Path) -> Target:
        names, dist = ["a.jpg", "b.jpg"], (0.1, 0.01, 0.001, 0.002, 0.003)
        R, t = np.tile(F, (2, 1, 1)), np.array([[0.0, 0, 9], [0.5, 0, 9]])
        seen = [(np.array([[20.0, 30], [40, 50], [60, 70]]), np.arange(3))] * 2
        truth = Truth(names=names, R=R, t=t, points=np.eye(3), colors=np.full((3, 3), 9, np.uint8), dist=dist, seen=seen)
        path = write(folder, truth)
        places = [each.relative_to(folder).as_posix() for each in alignment_files(path)]

        def read(inside: Path, number: int) -> object:
            del number
            return read_alignment(inside / path.relative_to(folder), lambda name: (320, 240) if name in names else None).model()

        seeds = [(folder / place).read_bytes() for place in places]
        return Target(seeds=seeds, place=lambda number: places[number], read=read)

    return target


ALIGNMENTS: dict[str, Callable[..., Path]] = {
    "transforms": partial(writers.transforms, ply=True),
    "opensfm": partial(writers.opensfm, tracks=True),
    "metashape": writers.metashape,
    "realityscan": writers.realityscan,
    "pix4d": partial(writers.pix4d, prj="EPSG:25832"),
    "openmvg": writers.openmvg,
    "bundler": writers.bundler,
    "opf": writers.opf,
    "polycam": writers.polycam,
}
TARGETS: dict[str, Callable[[Path], Target]] = {
    "ply": _ply,
    "safetensors": _safetensors,
    "spz": _spz,
    "sog": _sog,
    "lod": _lod,
    "glb": _glb,
    "colmap": _colmap,
    "toml": _toml,
    "json": _json,
    "exif": _exif,
    **{name: _alignment(write) for name, write in ALIGNMENTS.items()},
}


def main(names: list[str], count: int, first: int) -> None:
    """One line a format, as each is done."""
    for name in names:
        with tempfile.TemporaryDirectory(dir="/dev/shm") as made:
            begun = time.process_time()
            report = fuzz(name, count, SEED, Path(made), first)
            print(f"{name}: {time.process_time() - begun:.0f} CPU s", report, flush=True)


if __name__ == "__main__":
    chosen = {"alignments": list(ALIGNMENTS), "all": list(TARGETS)}.get(sys.argv[1], sys.argv[1].split(","))
    main(chosen, int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0)
