"""COLMAP models: both formats read the same, COLMAP reads what we write, and no damaged file does
more than raise BadInput."""

from __future__ import annotations

import struct
import tracemalloc
import zlib  # noqa: F401 before pycolmap, whose static copy of it breaks zipfile otherwise
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.colmap import binary as colmap_binary
from radiant_core.io.colmap import model as colmap
from radiant_core.io.colmap import text as colmap_text
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import PARAM_COUNTS, ColmapCamera, ColmapModel, ColmapPoints, check_model
from radiant_core.io.colmap.text import write_model

STEMS = ("cameras", "images", "points3D")
HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "known"
NUM_MUTATIONS = 1000


@pytest.fixture(scope="module")
def text_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small model: two camera models, a name in a subfolder, an image without points."""
    folder = tmp_path_factory.mktemp("text")
    (folder / "cameras.txt").write_text("# cameras\n1 PINHOLE 640 480 500 501 320 240\n4 SIMPLE_RADIAL 320 240 300 160 120 -0.01\n")
    (folder / "images.txt").write_text(
        "# images\n2 0.6 0 0.8 0 1 2 3 4 b(1).jpg\n10.5 20.25 7 30 40 -1\n"
        "1 1 0 0 0 -1 -2 -3 1 a.jpg\n50 60 7 70 80 9\n"
        "3 1 0 0 0 0 0 0 1 sub/c.png\n\n"
    )
    (folder / "points3D.txt").write_text("7 1 2 3 255 0 10 0.5 2 0 1 0\n9 -1 -2 -3 1 2 3 0.25 1 1\n")
    return folder


@pytest.fixture(scope="module")
def binary_model(text_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("binary")
    pycolmap.Reconstruction(text_model).write_binary(folder)
    return folder


def same(a: ColmapModel, b: ColmapModel) -> bool:
    images = all(
        (x.image_id, x.name, x.camera_id) == (y.image_id, y.name, y.camera_id)
        and np.allclose(x.cam_from_world, y.cam_from_world, atol=1e-15)
        and np.array_equal(x.points2d, y.points2d)
        and np.array_equal(x.point3d_ids, y.point3d_ids)
        for x, y in zip(a.images, b.images, strict=True)
    )
    by_id_a, by_id_b = np.argsort(a.points.ids), np.argsort(b.points.ids)
    points = all(
        np.array_equal(getattr(a.points, field)[by_id_a], getattr(b.points, field)[by_id_b])
        for field in ("ids", "xyz", "colors", "errors_px")
    )
    return images and points and a.cameras == b.cameras and len(a.points.tracks) == len(b.points.tracks)


def test_text_and_binary_as_colmap_writes_it_read_the_same(text_model: Path, binary_model: Path) -> None:
    model = read_model(text_model)
    assert same(model, read_model(binary_model))
    assert [image.name for image in model.images] == ["a.jpg", "b(1).jpg", "sub/c.png"]
    assert model.observations().tolist() == [[0, 0], [0, 1], [1, 0]]
    # A turn by θ about y with cos(θ/2) = 0.6, sin(θ/2) = 0.8: x goes to (cos θ, 0, -sin θ) =
    # (-0.28, 0, -0.96), then t is added.
    assert np.allclose(model.images[1].cam_from_world @ [1, 0, 0, 1], [0.72, 2, 2.04, 1])


def test_what_is_written_comes_back_and_colmap_reads_it(text_model: Path, tmp_path: Path) -> None:
    model = read_model(text_model)
    write_model(tmp_path / "again", model)
    assert same(model, read_model(tmp_path / "again"))
    theirs = pycolmap.Reconstruction(tmp_path / "again")
    for image in model.images:
        pose = theirs.image(image.image_id).cam_from_world().matrix()
        # 1e-12: the quaternion is normalised once on either side.
        assert np.allclose(image.cam_from_world[:3], pose, atol=1e-12)
    assert not list((tmp_path / "again").glob("*.part"))


def test_names_with_spaces_survive_though_colmap_cuts_them(text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "spaces")
    path = folder / "images.txt"
    path.write_text(path.read_text().replace("b(1).jpg", "b  (1) über.jpg"))
    model = read_model(folder)
    assert [image.name for image in model.images] == ["a.jpg", "b  (1) über.jpg", "sub/c.png"]
    write_model(tmp_path / "again", model)
    assert same(model, read_model(tmp_path / "again"))


def test_the_shipped_known_model_agrees_with_colmaps_own_reader() -> None:
    model, theirs = read_model(HAMLET), pycolmap.Reconstruction(HAMLET)
    assert len(model.images) == theirs.num_reg_images()
    assert len(model.points.ids) == theirs.num_points3D()
    assert len(model.points.tracks) == theirs.compute_num_observations()


def copied(source: Path, target: Path) -> Path:
    target.mkdir(exist_ok=True)
    for path in source.iterdir():
        if path.stem in STEMS:
            (target / path.name).write_bytes(path.read_bytes())
    return target


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with some changed, cut, doubled or replaced by an extreme number."""
    octets = bytearray(data)
    kind = rng.integers(5)
    at = int(rng.integers(len(octets)))
    if kind == 0:
        octets[at] = rng.integers(256)
    elif kind == 1:
        del octets[at:]
    elif kind == 2:
        octets[at:at] = octets[: int(rng.integers(1, 64))]
    elif kind == 3:
        extreme = [b"\xff" * 8, b"\0" * 8, struct.pack("<d", np.nan), struct.pack("<d", 1e308), struct.pack("<Q", 1 << 60)]
        octets[at : at + 8] = extreme[int(rng.integers(len(extreme)))]
    else:
        words = [b"nan", b"-1", b"1e999", b"99999999999999999999", b"#", b"\n", b" ", b"../x", b"inf"]
        octets[at : at + 1] = words[int(rng.integers(len(words)))]
    return bytes(octets)


def refusal_of(folder: Path) -> bool:
    """Whether the model is refused, the folder named; where it is read, what comes out is sound."""
    try:
        model = read_model(folder)
    except BadInput as error:
        return str(folder) in str(error) or pytest.fail(f"the file is not named: {error}")
    assert np.isfinite(model.points.xyz).all()
    assert (model.observations() >= 0).all()
    return False


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_a_damaged_file_is_read_or_refused_with_its_name_and_nothing_else(
    suffix: str, text_model: Path, binary_model: Path, tmp_path: Path
) -> None:
    source = binary_model if suffix == ".bin" else text_model
    folder = copied(source, tmp_path / "damaged")
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(NUM_MUTATIONS):
        path = folder / f"{STEMS[rng.integers(3)]}{suffix}"
        good = path.read_bytes()
        path.write_bytes(mutated(good, rng))
        refused += refusal_of(folder)
        path.write_bytes(good)
    # Most damage must be noticed; a changed digit of a coordinate cannot be.
    assert refused > NUM_MUTATIONS / 4


@pytest.mark.parametrize("stem", STEMS)
def test_a_count_beyond_the_file_is_refused_before_memory_is_taken(stem: str, binary_model: Path, tmp_path: Path) -> None:
    folder, count = copied(binary_model, tmp_path / "counted"), 10_000_000
    path = folder / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match=rf"{stem}.bin at byte 8: {count}"):
            read_model(folder)
        # Python's own tables (interned strings) grow by megabytes at a time, whoever is running;
        # the promised records would be hundreds of megabytes.
        assert tracemalloc.get_traced_memory()[1] < 64e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("cameras.txt", "PINHOLE 640", "HOLE 640", r"cameras.txt line 2: .*no camera"),
        ("cameras.txt", "640 480", "0 480", "camera 1 has the size 0 × 480"),
        ("cameras.txt", "500 501", "-500 501", "positive focal length"),
        ("cameras.txt", "500 501", "nan 501", "finite"),
        ("points3D.txt", "7 1 2 3", "7 1e200 2 3", "beyond"),
        ("cameras.txt", "4 SIMPLE", "1 SIMPLE", "camera id 1 comes twice"),
        ("images.txt", "a.jpg", "../a.jpg", "no relative path"),
        ("images.txt", "a.jpg", "/etc/a.jpg", "no relative path"),
        ("images.txt", "a.jpg", "sub/c.png", "image name 'sub/c.png' comes twice"),
        ("images.txt", "0.6 0 0.8 0", "0 0 0 0", "quaternion of length 0"),
        ("images.txt", "0.6 0 0.8 0", "inf 0 0.8 0", "not finite"),
        ("images.txt", "3 4 b", "3 5 b", "names camera 5"),
        ("images.txt", "80 9", "80 8", "names a 3D point that is not in points3D"),
        ("images.txt", "80 9", "80", r"images.txt line 4: the line after it holds 5 numbers"),
        ("points3D.txt", "7 1 2 3", "7 1 nan 3", "not finite"),
        ("points3D.txt", "9 -1", "7 -1", "a point id comes twice"),
        ("points3D.txt", "255 0 10", "256 0 10", r"points3D.txt line 1: the colour"),
        ("points3D.txt", "0.5 2 0 1 0", "0.5 2 0 1", r"points3D.txt line 1: .*no point"),
        ("points3D.txt", "0.5 2 0", "0.5 8 0", "names image 8"),
        ("points3D.txt", "0.5 2 0", "0.5 2 9", "names a 2D point that its image does not have"),
    ],
)
def test_each_fault_is_named(file: str, old: str, new: str, told: str, text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "fault")
    content = (folder / file).read_text()
    assert content.count(old) >= 1
    (folder / file).write_text(content.replace(old, new, 1))
    with pytest.raises(BadInput, match=told):
        read_model(folder)


@pytest.mark.parametrize("model", list(PARAM_COUNTS))
def test_every_camera_model_has_as_many_parameters_as_in_colmap(model: str) -> None:
    camera = pycolmap.Camera.create_from_model_name(1, model, 500.0, 640, 480)
    assert PARAM_COUNTS[model] == len(camera.params) and list(PARAM_COUNTS).index(model) == camera.model.value


def test_a_focal_length_is_positive_and_a_centre_may_lie_anywhere(text_model: Path, tmp_path: Path) -> None:
    """Cropped pictures have their principal point outside; focal parameters depend on the model."""
    folder = copied(text_model, tmp_path / "cropped")
    cameras = folder / "cameras.txt"
    whole = cameras.read_text()
    cameras.write_text(whole.replace("500 501 320", "500 501 -320").replace("300 160 120", "300 -160 0"))
    assert read_model(folder).cameras[4].params == (300, -160, 0, -0.01)
    for old, new in (("500 501", "500 0"), ("300 160", "0 160")):
        cameras.write_text(whole.replace(old, new))
        with pytest.raises(BadInput, match="positive focal length"):
            read_model(folder)


def test_a_model_without_points_comes_back(text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "poses")
    (folder / "points3D.txt").write_text("# none\n")
    (folder / "images.txt").write_text("2 1 0 0 0 1 2 3 4 b.jpg\n\n")
    model = read_model(folder)
    assert model.points.tracks.shape == (0, 3) and model.points.xyz.shape == (0, 3) and len(model.images) == 1
    write_model(tmp_path / "again", model)
    assert same(model, read_model(tmp_path / "again"))
    assert len(pycolmap.Reconstruction(tmp_path / "again").points3D) == 0


def test_sides_end_at_131072_px_and_two_models_have_no_distortion(text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "wide")
    cameras = folder / "cameras.txt"
    whole = cameras.read_text()
    cameras.write_text(whole.replace("640 480", "131072 1"))
    model = read_model(folder)
    assert model.cameras[1].size_wh == (131072, 1) and model.cameras[1].is_pinhole and not model.cameras[4].is_pinhole
    cameras.write_text(whole.replace("640 480", "131073 480"))
    with pytest.raises(BadInput, match="expected 1 to 131072 px"):
        read_model(folder)


def with_one(model: ColmapCamera) -> ColmapModel:
    return check_model([model], [], ColmapPoints(**NO_POINTS), "here")


NO_POINTS = {
    "ids": np.zeros(0, int),
    "xyz": np.zeros((0, 3)),
    "colors": np.zeros((0, 3), np.uint8),
    "errors_px": np.zeros(0),
    "tracks": np.zeros((0, 3), int),
}


@pytest.mark.parametrize("name", list(PARAM_COUNTS))
def test_which_parameters_are_focal_lengths_is_as_in_colmap_and_the_limits_belong_to_it(name: str) -> None:
    """A focal length is above 0, every number within ±1e9, both to the last bit."""
    theirs = pycolmap.Camera.create_from_model_name(1, name, 500.0, 640, 480)
    good = [float(value) for value in theirs.params]
    focal = list(theirs.focal_length_idxs())
    for index in range(len(good)):
        for value, fits in (
            (1e9, True),
            (np.nextafter(1e9, 2e9), False),
            (5e-324, True),
            (0.0, index not in focal),
            (-1e9, index not in focal),
        ):
            camera = ColmapCamera(camera_id=3, model=name, size_wh=(640, 480), params=(*good[:index], float(value), *good[index + 1 :]))
            if fits:
                assert with_one(camera).cameras[3] == camera
            else:
                with pytest.raises(BadInput, match=r"here: camera 3 has the parameters .*, expected finite numbers under 1e9"):
                    with_one(camera)


def test_the_matrix_of_a_camera_without_distortion_projects_as_colmap_does() -> None:
    for name, params in (("PINHOLE", (500.0, 510.0, 320.0, 240.0)), ("SIMPLE_PINHOLE", (500.0, 320.0, 240.0))):
        theirs = pycolmap.Camera(model=name, width=640, height=480, params=params)
        ours = ColmapCamera(camera_id=1, model=name, size_wh=(640, 480), params=params)
        np.testing.assert_array_equal(ours.K, theirs.calibration_matrix())


def test_an_image_left_out_takes_its_tracks_along_and_no_point(text_model: Path) -> None:
    model = read_model(text_model)
    rest = model.without(["a.jpg"])
    assert [image.name for image in rest.images] == ["b(1).jpg", "sub/c.png"]
    assert rest.points.tracks.tolist() == [[0, 2, 0]] and rest.points.ids.tolist() == [7, 9]
    assert same(model.without([]), model)


@pytest.mark.parametrize(("length", "fits"), [(0.9901, True), (1.0099, True), (0.9899, False), (1.0101, False)])
def test_a_quaternion_is_of_length_1_within_a_hundredth(length: float, fits: bool, text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "long")
    path = folder / "images.txt"
    path.write_text(path.read_text().replace("1 1 0 0 0 -1", f"1 0 {length} 0 0 -1"))
    if fits:
        read_model(folder)
    else:
        with pytest.raises(BadInput, match=f"a quaternion of length {length:.3g}, expected 1"):
            read_model(folder)


def test_the_shortest_binary_records_fit_and_what_is_a_byte_short_is_told() -> None:
    """One camera of the fewest parameters, one image with an empty name, one point that nobody
    sees; ids up to 2^63 - 1."""
    count = struct.pack("<Q", 1)
    camera = struct.pack("<IiQQ2d", 7, 17, 640, 320, 640.0, 320.0)
    image = struct.pack("<I7dI", 5, 1, 0, 0, 0, 1, 2, 3, 7) + b"\0" + struct.pack("<Q", 0)
    point = struct.pack("<Q3d3Bd", 2**63 - 1, 1, 2, 3, 10, 20, 30, 0.5) + struct.pack("<Q", 0)
    assert colmap_binary.parse_cameras(count + camera, "f")[0].params == (640.0, 320.0)
    assert (found := colmap_binary.parse_images(count + image, "f")[0]).name == "" and found.translation.tolist() == [1, 2, 3]
    assert colmap_binary.parse_points(count + point, "f").ids.tolist() == [2**63 - 1]
    cut = r"f at byte {}: {} need {} bytes, {} are left: the file is cut or damaged\."
    for parse, record, what in (
        (colmap_binary.parse_cameras, camera, "cameras"),
        (colmap_binary.parse_images, image, "images"),
        (colmap_binary.parse_points, point, "points"),
    ):
        with pytest.raises(BadInput, match=cut.format(8, f"1 {what}", len(record), len(record) - 1)):
            parse(count + record[:-1], "f")
        with pytest.raises(BadInput, match=f"f at byte {8 + len(record)}: 1 bytes follow the last record"):
            parse(count + record + b"x", "f")
        with pytest.raises(BadInput, match=cut.format(0, "a record", 8, 7)):
            parse(count[:-1], "f")
    with pytest.raises(BadInput, match=cut.format(8 + len(point), "1 track entries", 8, 0)):
        colmap_binary.parse_points(count + point[:-8] + count, "f")
    with pytest.raises(BadInput, match=cut.format(8 + len(image), "1 2D points", 24, 0)):
        colmap_binary.parse_images(count + image[:-8] + count, "f")
    with pytest.raises(BadInput, match=r"f: a point id exceeds 2\^63"):
        colmap_binary.parse_points(count + struct.pack("<Q", 2**63) + point[8:], "f")
    for number in (-1, len(PARAM_COUNTS)):
        with pytest.raises(BadInput, match=f"f at byte 12: camera model {number} is unknown, expected 0 to {len(PARAM_COUNTS) - 1}"):
            colmap_binary.parse_cameras(count + struct.pack("<Ii", 7, number) + camera[8:], "f")
    for length, told in ((1023, None), (1024, "f at byte 72: an image name does not end within 1024 bytes")):
        named = count + image[:64] + b"n" * length + image[64:]
        if told is None:
            assert colmap_binary.parse_images(named, "f")[0].name == "n" * length
        else:
            with pytest.raises(BadInput, match=told):
                colmap_binary.parse_images(named, "f")
    with pytest.raises(BadInput, match="f at byte 72: an image name is not UTF-8"):
        colmap_binary.parse_images(count + image[:64] + b"\xff" + image[64:], "f")


@pytest.mark.parametrize(
    ("word", "fits"),
    [
        ("9223372036854775807", True),
        ("9223372036854775808", False),
        ("00000000000000000007", False),
        ("٣", False),
        ("1.0", False),
        ("-1", False),
    ],
)
def test_whole_numbers_of_a_text_end_at_2_to_the_63(word: str, fits: bool) -> None:
    line = f"# c\n\n{word} PINHOLE 640 480 1 1 1 1"
    if fits:
        assert colmap_text.parse_cameras(line.encode(), "f")[0].camera_id == int(word)
    else:
        with pytest.raises(BadInput, match=rf"f line 3: {word!r} is no whole number from 0 to 2\^63 - 1"):
            colmap_text.parse_cameras(line.encode(), "f")


@pytest.mark.parametrize(
    ("parse", "text", "told"),
    [
        (colmap_text.parse_cameras, "5", "f line 1: '5' is no camera"),
        (colmap_text.parse_cameras, "5 PINHOLE 1", "f line 1: '5 PINHOLE 1' is no camera"),
        (colmap_text.parse_cameras, "5 PINHOLE 1 1 1 1 1 x", "f line 1: could not convert string to float: 'x', expected a number"),
        (colmap_text.parse_images, "1 1 0 0 0 0 0 0 1", "f line 1: '1 1 0 0 0 0 0 0 1' is no image"),
        (colmap_text.parse_images, "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 3 4", "f line 1: the line after it holds 4 numbers"),
        (colmap_text.parse_points, "1 0 0 0 9 9 9", "f line 1: '1 0 0 0 9 9 9' is no point"),
        (colmap_text.parse_points, "1 0 0 0 9 9 9 0.5 1", "f line 1: '1 0 0 0 9 9 9 0.5 1' is no point"),
        (colmap_text.parse_points, "1 0 0 0 9 9 256 0.5", r"f line 1: the colour \[9, 9, 256\] is not in 0..255"),
        (colmap_text.parse_points, "\xff", None),
    ],
)
def test_lines_that_are_too_short_are_shown(parse: Callable[[bytes, str], object], text: str, told: str | None) -> None:
    content = text.encode() if told else b"ok\xff"
    with pytest.raises(BadInput, match=told or "f at byte 2 is not UTF-8 text"):
        parse(content, "f")


def test_the_longest_of_what_a_text_line_may_say_is_read() -> None:
    points = colmap_text.parse_points(b"1 0.5 1 2 255 0 255 0.25\n2 0 0 0 1 2 3 0 8 1 9 2", "f")
    assert points.colors.tolist() == [[255, 0, 255], [1, 2, 3]] and points.tracks.tolist() == [[1, 8, 1], [1, 9, 2]]
    assert points.xyz.tolist() == [[0.5, 1, 2], [0, 0, 0]] and points.errors_px.tolist() == [0.25, 0]


def test_a_model_larger_than_the_limit_is_not_read(text_model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = max((text_model / f"{stem}.txt").stat().st_size for stem in STEMS)
    monkeypatch.setattr(colmap, "MAX_FILE_BYTES", size)
    read_model(text_model)
    monkeypatch.setattr(colmap, "MAX_FILE_BYTES", size - 1)
    with pytest.raises(BadInput, match=f"has {size} bytes, more than the {size - 1} that are read"):
        read_model(text_model)


def test_a_track_names_points_that_are_there_up_to_the_last(text_model: Path, tmp_path: Path) -> None:
    folder = copied(text_model, tmp_path / "last")
    points = folder / "points3D.txt"
    whole = points.read_text()
    for index, fits in ((1, True), (2, False)):
        points.write_text(whole.replace("0.5 2 0 1 0", f"0.5 2 0 1 {index}"))
        if fits:
            assert read_model(folder).points.tracks[1].tolist() == [0, 1, 1]
        else:
            with pytest.raises(BadInput, match="names a 2D point that its image does not have"):
                read_model(folder)
