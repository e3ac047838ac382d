"""Panoramas are known by what they say, and their faces show what a pinhole there would."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask, training_validation_mask, validation_mask
from radiant_core.io.panoramas.cutting import RIG_CONFIG, cut_masks, cut_panoramas, face_name
from radiant_core.io.panoramas.recognise import find_panoramas
from radiant_core.panoramas import RIG, frame_of, has_faces, pixels_of_rays, rays_of_face, rays_of_pixels, ring
from radiant_core.sfm.colmap.pairs import neighbor_pairs
from tests.panorama_scene import street, walk, xmp_segment

SIZE = (512, 256)


def quiet(done: int, total: int) -> None:
    del done, total


def painted(rays: np.ndarray) -> np.ndarray:
    """A smooth colour (…,3) of every direction, of waves of some 40°."""
    waves = [np.sin(8 * rays @ np.array(axis)) for axis in ((1, 0.3, 0), (0, 1, 0.4), (0.5, 0, 1))]
    return (127.5 + 100 * np.stack(waves, axis=-1)).round().astype(np.uint8)


def sphere_picture(size_wh: tuple[int, int] = SIZE) -> np.ndarray:
    """A panorama of `painted`, by headings and elevations."""
    column, row = np.meshgrid(np.arange(size_wh[0]) + 0.5, np.arange(size_wh[1]) + 0.5)
    heading, down = (column / size_wh[0] - 0.5) * 2 * np.pi, (row / size_wh[1] - 0.5) * np.pi
    return painted(np.stack([np.cos(down) * np.sin(heading), np.sin(down), np.cos(down) * np.cos(heading)], axis=-1))


def write(path: Path, picture: np.ndarray, head: bytes = b"", suffix: str = ".jpg") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = cv2.imencode(suffix, picture, [cv2.IMWRITE_JPEG_QUALITY, 98] if suffix == ".jpg" else [])[1].tobytes()
    path.write_bytes(data[:2] + head + data[2:] if suffix == ".jpg" else data)
    return path


@pytest.mark.parametrize("rig", [RIG, ring(6, 90.0), ring(8, 75.0, poles=False)])
def test_each_face_shows_what_a_pinhole_there_would(tmp_path: Path, rig) -> None:
    write(tmp_path / "p" / "a.jpg", sphere_picture())
    cut = cut_panoramas(tmp_path / "p", ["a.jpg"], tmp_path / "faces", quiet, rig)
    for face in rig.faces:
        shown = cv2.imread(str(tmp_path / "faces" / face_name(face.folder, "a.jpg")))
        assert shown is not None and shown.shape == (cut.size_px, cut.size_px, 3)
        # Two JPEGs and interpolation; half a pixel makes a median of 3.
        off = np.abs(shown.astype(int) - painted(unit(rays_of_face(face, cut.K, cut.size_px))))
        assert np.median(off) <= 1 and np.percentile(off, 99.9) < 8, face.folder


def unit(rays: np.ndarray) -> np.ndarray:
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def test_the_projection_is_colmaps(tmp_path: Path) -> None:
    import pycolmap

    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=512, height=256, params=[512, 256])
    pixels = np.random.default_rng(0).uniform((0, 0), SIZE, (200, 2))
    rays = rays_of_pixels(pixels, SIZE)
    assert pixels_of_rays(rays, SIZE) == pytest.approx(pixels, abs=1e-9)
    assert np.array([camera.cam_ray_from_img(pixel) for pixel in pixels]).reshape(-1, 3) == pytest.approx(rays, abs=1e-9)
    cut_panoramas(write(tmp_path / "p" / "a.jpg", sphere_picture()).parent, ["a.jpg"], tmp_path / "faces", quiet)
    (config,) = pycolmap.read_rig_config(tmp_path / "faces" / RIG_CONFIG)
    for face, read in zip(RIG.faces, config.cameras, strict=True):
        assert read.image_prefix == f"{face.folder}/" and read.camera is not None and read.camera.model.name == "PINHOLE"
        if not read.ref_sensor:
            assert read.cam_from_rig is not None and read.cam_from_rig.rotation.matrix() == pytest.approx(face.cam_from_rig, abs=1e-12)


def test_the_faces_of_a_cube_cover_the_sphere_once() -> None:
    rays = unit(np.random.default_rng(1).normal(size=(1000, 3)))
    inside = [np.abs((rays @ face.cam_from_rig.T)[:, :2]).max(axis=1) <= (rays @ face.cam_from_rig.T)[:, 2] for face in RIG.faces]
    assert (np.sum(inside, axis=0) == 1).all()


def test_an_interrupted_cutting_goes_on_and_other_panoramas_are_cut_anew(tmp_path: Path) -> None:
    folder = write(tmp_path / "p" / "a.jpg", sphere_picture()).parent
    write(folder / "sub" / "b.png", sphere_picture(), suffix=".png")
    names = ["a.jpg", "sub/b.png"]
    cut_panoramas(folder, names, tmp_path / "faces", quiet)
    kept, lost = tmp_path / "faces/face_up/a.jpg", tmp_path / "faces/face_left/sub/b.png.jpg"
    before = kept.stat().st_ino
    lost.unlink()
    cut_panoramas(folder, names, tmp_path / "faces", quiet)
    assert lost.is_file() and kept.stat().st_ino == before
    write(folder / "a.jpg", sphere_picture((256, 128)))
    assert cut_panoramas(folder, ["a.jpg"], tmp_path / "faces", quiet).size_px == 81
    assert not lost.exists() and json.loads((tmp_path / "faces" / RIG_CONFIG).read_text())[0]["cameras"][0]["ref_sensor"]
    write(folder / "a.jpg.jpg", sphere_picture())
    write(folder / "a.png", sphere_picture(), suffix=".png")
    with pytest.raises(BadInput, match="faces of one name"):
        cut_panoramas(folder, ["a.PNG", "a.png.jpg"], tmp_path / "x", quiet)
    (folder / "c.jpg").write_bytes((folder / "a.jpg").read_bytes()[:400])
    with pytest.raises(BadInput, match=r"panorama .*c\.jpg (is not whole|cannot be read)"):
        cut_panoramas(folder, ["c.jpg"], tmp_path / "y", quiet)
    wide = sphere_picture().astype(np.uint16) * 257
    write(folder / "d.png", wide, suffix=".png")
    with pytest.raises(BadInput, match=r"d\.png has more than 8 bits a channel"):
        cut_panoramas(folder, ["d.png"], tmp_path / "z", quiet)


def test_a_mask_of_a_panorama_becomes_those_of_its_faces(tmp_path: Path) -> None:
    folder = write(tmp_path / "p" / "a.jpg", sphere_picture()).parent
    used = np.full((256, 512), 255, np.uint8)
    used[192:] = 0
    write(tmp_path / "masks" / "a.png", used, suffix=".png")
    cut = cut_panoramas(folder, ["a.jpg"], tmp_path / "faces", quiet)
    cut_masks({"a.jpg": tmp_path / "masks" / "a.png"}, {"a.jpg": SIZE}, tmp_path / "cut", cut)
    shares = {face.folder: np.mean(np.asarray(cv2.imread(str(tmp_path / "cut" / face.folder / "a.jpg.png"), 0)) > 0) for face in RIG.faces}
    # Left out from 45° below the horizon on: within tan⁻¹(1) of straight down, all but the corners.
    assert shares["face_up"] == 1 and shares["face_down"] == pytest.approx(1 - np.pi / 4, abs=0.01)
    assert all(shares[f"face_{name}"] > 0.99 for name in ("front", "right", "back", "left"))


def test_a_panorama_says_that_it_is_one(tmp_path: Path) -> None:
    folder = tmp_path / "p"
    for name, head in (("a.jpg", xmp_segment(512, 512)), ("b.jpg", xmp_segment(512, 512))):
        write(folder / name, sphere_picture(), head)
    assert find_panoramas(folder, ["a.jpg", "b.jpg"], None).names == ("a.jpg", "b.jpg")
    assert find_panoramas(folder, ["a.jpg", "b.jpg"], "none").names == ()
    write(folder / "c.jpg", sphere_picture())
    with pytest.raises(BadInput, match=r"2 of 3 photographs .* are panoramas \(a.jpg, b.jpg\).*--panoramas none"):
        find_panoramas(folder, ["a.jpg", "b.jpg", "c.jpg"], None)
    assert len(find_panoramas(folder, ["a.jpg", "b.jpg", "c.jpg"], "all").names) == 3
    alone = find_panoramas(folder, ["c.jpg"], None)
    assert alone.names == () and "all 1 photographs are twice as wide as high" in alone.warnings[0]
    write(folder / "d.jpg", sphere_picture(), xmp_segment(1024, 512))
    with pytest.raises(BadInput, match=r"d.jpg in .* show a part of the sphere"):
        find_panoramas(folder, ["d.jpg"], None)
    write(folder / "e.jpg", sphere_picture()[:200], xmp_segment(512, 512))
    with pytest.raises(BadInput, match="not twice as wide as high"):
        find_panoramas(folder, ["e.jpg"], None)
    write(folder / "f.jpg", sphere_picture()[:200])
    assert find_panoramas(folder, ["c.jpg", "f.jpg"], None).warnings == ()


def test_the_faces_of_a_panorama_are_held_out_and_matched_as_one() -> None:
    frames = [f"pano_{number:02d}.jpg" for number in range(20)]
    names = [face_name(face.folder, frame) for frame in frames for face in RIG.faces[: 6 - (frame == frames[3])]]
    held = {frame_of(name) for name, is_held in zip(names, held_out_mask(names), strict=True) if is_held}
    assert held == {"pano_00.jpg", "pano_08.jpg", "pano_16.jpg"} and held_out_mask(names).sum() == 18
    judged = {frame_of(name) for name, is_judged in zip(names, validation_mask(names), strict=True) if is_judged}
    assert judged == {"pano_01.jpg", "pano_10.jpg", "pano_19.jpg"}
    # Seven panoramas are too few to validate on, however many faces they have.
    assert not training_validation_mask([name for name in names if frame_of(name) < "pano_07"]).any()
    assert has_faces(names) and not has_faces(["a.jpg", "front/a.jpg", "face_front"])
    places = np.array([[float(frame[5:7]), 0, 0] for frame in map(frame_of, names)])
    pairs = neighbor_pairs(names, places, 2)
    apart = {abs(int(frame_of(a)[5:7]) - int(frame_of(b)[5:7])) for a, b in pairs}
    assert apart <= {1, 2} and len(pairs) > 36 * 19 and all(frame_of(a) != frame_of(b) for a, b in pairs)


def test_the_writer_of_the_tests_has_no_seams_of_its_own() -> None:
    from scenegen.raycast import Photographer
    from tests.panorama_scene import panorama

    made = walk(2, 256)
    picture = panorama(Photographer(street(256)), made.centers[0], made.axes[0], 256).astype(float)
    steps = np.abs(np.diff(picture, axis=1)).mean(axis=(0, 2))
    # Between the four faces around, columns differ by no more than others do.
    assert steps[[31, 95, 159, 223]].max() < 2 * np.median(steps) + 1
