"""COLMAP models: both formats read the same, COLMAP reads what we write, and no damaged file does more than raise BadInput."""

from __future__ import annotations

import struct
import tracemalloc
import zlib  # noqa: F401 before pycolmap, whose static copy of it breaks zipfile otherwise
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.colmap import ColmapModel, find_model, read_model, write_model
from radiant_core.io.colmap_records import PARAM_COUNTS

STEMS = ("cameras", "images", "points3D")
HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "known"
NUM_MUTATIONS = 1000


@pytest.fixture(scope="module")
def text_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small model of every kind of record: two camera models, a name in a subfolder, an image without points."""
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
    # A turn by θ about y with cos(θ/2) = 0.6, sin(θ/2) = 0.8: x goes to (cos θ, 0, -sin θ) = (-0.28, 0, -0.96), then t is added.
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


def test_the_model_is_found_in_a_project(text_model: Path, tmp_path: Path) -> None:
    model = read_model(text_model)
    write_model(tmp_path / "sparse" / "0", model)
    assert find_model(tmp_path) == tmp_path / "sparse" / "0"
    with pytest.raises(BadInput, match="holds no COLMAP model"):
        find_model(tmp_path / "sparse" / "0" / "nowhere")
    # The nearest first: of the folder itself, its first reconstruction, and sparse.
    write_model(tmp_path / "sparse", model)
    assert find_model(tmp_path) == tmp_path / "sparse" / "0"
    for path in (tmp_path / "sparse" / "0").iterdir():
        path.unlink()
    assert find_model(tmp_path) == tmp_path / "sparse"
    write_model(tmp_path, model)
    assert find_model(tmp_path) == tmp_path


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
@pytest.mark.parametrize("count", [1 << 63, 1 << 40, (1 << 64) - 1])
def test_a_count_of_billions_is_refused_before_memory_is_taken(stem: str, count: int, binary_model: Path, tmp_path: Path) -> None:
    folder = copied(binary_model, tmp_path / "huge")
    path = folder / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match=rf"{stem}.bin at byte 8: {count}"):
            read_model(folder)
        # Python's own tables (interned strings) grow by megabytes at a time, whoever is running; the promised records would be terabytes.
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
    """Cropped pictures have their principal point outside; which parameters are focal lengths depends on the model."""
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
