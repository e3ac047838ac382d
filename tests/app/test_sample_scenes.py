"""The scene generator's laws: same command same pixels, depth and poses agree, EXIF within its
error, poison refused.

The scene is a 6-photograph corner of the town at 96 x 72 px; the shipped hamlet and town are
checked as files.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

import generate
from radiant_core.errors import BadInput
from scenegen.config import SceneConfig
from scenegen.flight import plan_flight
from scenegen.known_model import write_known_model
from scenegen.layout import Layout
from scenegen.noise import detail_noise, gaussian_noise, value_noise
from scenegen.off_path import KINDS, count_views, plan_off_path
from scenegen.photo_file import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, geodetic_from_enu, jpeg_bytes
from scenegen.raycast import Photographer, project, town_mesh, undistort, world_rays
from scenegen.turntable import CAMERA_DISTANCE_M, LAMP_ABOVE, LAMP_ASIDE, TARGET_M, lamp_direction

SAMPLES = Path(__file__).resolve().parents[2] / "sample_scenes"
SMALL = SceneConfig(num_cameras=6, extent_m=(24.0, 16.0), width_px=96, height_px=72, altitude_m=35.0, num_known_points=200)


@pytest.fixture(scope="module")
def photographer() -> Photographer:
    """The small scene's photographer."""
    return Photographer(SMALL)


def pixel_centers() -> np.ndarray:
    """All pixel centres (H·W,2) of the small scene."""
    x, y = np.meshgrid(np.arange(SMALL.width_px) + 0.5, np.arange(SMALL.height_px) + 0.5)
    return np.column_stack([x.ravel(), y.ravel()])


def test_same_config_gives_same_pixels_and_bytes_and_another_seed_others(photographer: Photographer) -> None:
    noisy = replace(SMALL, noise_sigma=3.0, exposure_drift_ev=0.5)
    first = Photographer(noisy)
    town_mesh.cache_clear()
    second = Photographer(noisy)
    shot = plan_flight(noisy)[3]
    assert np.array_equal(first.photograph(shot, 3), second.photograph(shot, 3))
    assert jpeg_bytes(noisy, first.photograph(shot, 3), shot) == jpeg_bytes(noisy, second.photograph(shot, 3), shot)
    other = replace(SMALL, seed=1)
    other_pixels = Photographer(other).photograph(plan_flight(other)[3], 3)
    assert not np.array_equal(other_pixels, photographer.photograph(plan_flight(SMALL)[3], 3))


def test_noise_does_not_depend_on_how_the_samples_are_cut_into_strips() -> None:
    x, y = np.random.default_rng(0).uniform(-1e4, 1e4, (2, 1000)).astype(np.float32)
    whole = value_noise(x, y, 0.3, 5)
    assert np.array_equal(whole, np.concatenate([value_noise(x[k : k + 37], y[k : k + 37], 0.3, 5) for k in range(0, 1000, 37)]))
    assert whole.min() >= 0.0
    assert whole.max() <= 1.0
    # A uniform mean over 1,000 nearly independent values of deviation < 0.29: 5 standard errors are
    # 0.046.
    assert abs(whole.mean() - 0.5) < 0.046


def test_noise_fades_out_under_coarse_pixels() -> None:
    x = np.linspace(0.0, 50.0, 200, dtype=np.float32)
    assert np.all(detail_noise(x, x, 0.3, 5, np.full(200, 1.0, np.float32)) == 0.0)
    assert np.ptp(detail_noise(x, x, 0.3, 5, np.full(200, 0.05, np.float32))) > 0.3


def test_gaussian_noise_has_unit_deviation() -> None:
    values = gaussian_noise(100_000, 3)
    # Standard errors at 1e5 samples: mean 0.0032, deviation 0.0022; five of each.
    assert abs(values.mean()) < 0.016
    assert abs(values.std() - 1.0) < 0.011


def test_town_coordinates_invert() -> None:
    layout = Layout(extent_m=(120.0, 80.0), seed=0)
    towns = np.random.default_rng(1).uniform(-300.0, 300.0, (50, 2))
    worlds = np.array([layout.world_from_town(u, v) for u, v in towns])
    # Angles and sizes pass through float32 constants: 300 m · 1e-7 leaves 0.1 mm.
    assert np.allclose(np.column_stack(layout.town_from_world(worlds[:, 0], worlds[:, 1])), towns, atol=1e-4)


@pytest.mark.parametrize("k1", [-0.12, -0.03, 0.0, 0.05, 0.4])
def test_undistort_inverts_the_lens(k1: float) -> None:
    plane = np.random.default_rng(2).uniform(-0.75, 0.75, (500, 2))
    bent = plane * (1.0 + k1 * np.sum(plane**2, axis=1, keepdims=True))
    # Newton converges quadratically; the limit is rounding of numbers near 1.
    assert np.allclose(undistort(bent, k1), plane, atol=1e-12)


@pytest.mark.parametrize("k1", [0.0, -0.1, 0.2])
def test_rays_and_projection_are_inverse(k1: float) -> None:
    config = replace(SMALL, distortion_k1=k1)
    shot, pixels = plan_flight(config)[0], pixel_centers()
    origins, directions = world_rays(config, shot, pixels)
    back, depth = project(config, shot, origins.astype(np.float64) + 30.0 * directions)
    # Rays are float32 for Embree: 1e-7 · 64 px of focal length, twice over, and 1e-6 m of origin.
    assert np.allclose(back, pixels, atol=2e-4)
    assert np.allclose(depth, 30.0, atol=1e-4)


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_depth_and_colour_of_one_photograph_agree_with_its_neighbour(k1: float) -> None:
    config = replace(SMALL, distortion_k1=k1)
    photographer, pixels = Photographer(config), pixel_centers()
    shots = plan_flight(config)
    origins, directions = world_rays(config, shots[0], pixels)
    points = origins + directions * photographer.depth(shots[0]).ravel()[:, None]
    there, depth = project(config, shots[1], points)
    inside = np.all((there > 1.0) & (there < np.array([config.width_px, config.height_px]) - 1.0), axis=1)
    assert inside.sum() > 1500
    surface = photographer.depth_at(shots[1], there[inside])
    # Each point lies on the neighbour's ray, so what the neighbour sees there is that point or
    # nearer. 2 cm of 35 m allow for float32 rays, a few pixels for edges that such a ray just
    # misses.
    assert np.mean(surface > depth[inside] + 0.02) < 0.003
    same = np.abs(depth[inside] - surface) < 0.02
    assert same.mean() > 0.8
    mine, theirs = photographer.color_at(shots[0], pixels[inside][same]), photographer.color_at(shots[1], there[inside][same])
    # Matte surfaces: only the fading of detail with the pixel's footprint may differ between two
    # views.
    assert np.median(np.abs(mine.astype(float) - theirs)) <= 4.0


def test_sky_is_infinitely_far_and_ground_is_not(photographer: Photographer) -> None:
    config = replace(SMALL, num_cameras=10, oblique_fraction=0.4)
    shots = plan_flight(config)
    assert any(np.isinf(photographer.depth(shot)).any() for shot in shots[6:])
    nadir = photographer.depth(shots[0])
    assert np.all(np.isfinite(nadir))
    assert 15.0 < nadir.min() < nadir.max() < 90.0


def test_known_model_reprojects_and_every_track_has_two_views(photographer: Photographer, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    shots = plan_flight(SMALL)
    write_known_model(tmp_path, photographer, shots)
    model = pycolmap.Reconstruction(str(tmp_path))
    assert model.num_reg_images() == SMALL.num_cameras
    assert model.num_points3D() > 100
    model.update_point_3d_errors()
    # Pixels are written to 0.01 px and points to 0.1 mm, which is 0.0002 px at 35 m.
    assert model.compute_mean_reprojection_error() < 0.01
    assert min(point.track.length() for point in model.points3D.values()) >= 2
    centers = {image.name: image.projection_center() for image in model.images.values()}
    for shot in shots:
        assert np.allclose(centers[shot.name], shot.center_m, atol=1e-6)


def test_positions_survive_the_round_trip_through_latitude_and_longitude() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    positions = np.random.default_rng(3).uniform(-1000.0, 1000.0, (40, 3))
    geodetic = np.array([geodetic_from_enu(position) for position in positions])
    back = pycolmap.GPSTransform().ellipsoid_to_enu(geodetic, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M)
    # ECEF metres are 6e6: 1e-9 m of rounding there, amplified by degrees; a micrometre is ample.
    assert np.allclose(back, positions, atol=1e-5)


def exif_position(path: Path) -> tuple[float, float, float] | None:
    """Latitude, longitude and height written in a JPEG, None without GPS."""
    with Image.open(path) as image:
        gps = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
    if not gps:
        return None
    degrees = [
        sum(float(part) / 60.0**k for k, part in enumerate(gps[tag])) for tag in (ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLongitude)
    ]
    return degrees[0], degrees[1], float(gps[ExifTags.GPS.GPSAltitude])


def known_centers(folder: Path) -> dict[str, np.ndarray]:
    """Camera centres by name of a COLMAP text model, read without any of the generator's code."""
    from scipy.spatial.transform import Rotation

    centers = {}
    for line in (folder / "images.txt").read_text().splitlines()[::2]:
        words = line.split()
        w, x, y, z, *translation = map(float, words[1:8])
        centers[words[9]] = -Rotation.from_quat([x, y, z, w]).inv().apply(translation)
    return centers


@pytest.mark.parametrize(
    ("scene", "photographs", "image_bytes", "known_bytes"), [("town", 60, 4_000_000, 1_000_000), ("hamlet", 12, 300_000, 300_000)]
)
def test_shipped_scene_is_small_and_its_gps_lies_within_the_stated_error(
    scene: str, photographs: int, image_bytes: int, known_bytes: int
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    images = sorted((SAMPLES / scene / "images").glob("*.jpg"))
    assert len(images) == photographs
    assert sum(path.stat().st_size for path in images) <= image_bytes
    assert sum(path.stat().st_size for path in (SAMPLES / scene / "known").iterdir()) <= known_bytes
    centers = known_centers(SAMPLES / scene / "known")
    assert set(centers) == {path.name for path in images}
    geodetic = np.array([exif_position(path) for path in images])
    enu = pycolmap.GPSTransform().ellipsoid_to_enu(geodetic, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M)
    error_m = np.linalg.norm(enu - np.array([centers[path.name] for path in images]), axis=1)
    # The stated error plus the millimetre to which heights are written; and it is an error, not a
    # copy of the truth.
    assert error_m.max() <= SceneConfig().gps_error_m + 0.002
    assert error_m.max() > 0.3 * SceneConfig().gps_error_m


def test_hamlet_is_what_the_generator_renders_today() -> None:
    stored = json.loads((SAMPLES / "hamlet" / "known" / "frame.json").read_text())["config"]
    config = SceneConfig(**{**stored, "extent_m": tuple(stored["extent_m"])})
    rendered = Photographer(config).photograph(plan_flight(config)[4], 4).astype(float)
    with Image.open(SAMPLES / "hamlet" / "images" / "drone_0004.jpg") as image:
        error = np.asarray(image).astype(float) - rendered
    # JPEG of quality 72 with halved colour loses some 6 grey levels RMS on this texture; a moved
    # camera or a new tint loses 20.
    assert np.sqrt(np.mean(error**2)) < 10.0


def test_generate_writes_all_or_nothing_and_never_overwrites(tmp_path: Path) -> None:
    config = replace(SMALL, num_cameras=2, samples_per_axis=1, depth=True, gps=False)
    out = tmp_path / "scene"
    generate.generate(config, out)
    assert sorted(path.name for path in out.iterdir()) == ["depth", "images", "known"]
    first = sorted((out / "images").iterdir())[0]
    assert exif_position(first) is None
    assert np.load(out / "depth" / "drone_0000.npz")["depth_m"].shape == (SMALL.height_px, SMALL.width_px)
    with pytest.raises(BadInput, match="exists already"):
        generate.generate(config, out)

    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot write"):
        generate.generate(config, tmp_path / "file" / "scene")

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate.generate(config, tmp_path / "stopped", stop)
    assert list((tmp_path / "stopped").iterdir()) == []


def test_command_line_switches_reach_the_config() -> None:
    switches = ["--out", "X", "--extent-m", "500x250", "--num-cameras", "1600", "--no-gps", "--distortion-k1", "-0.02"]
    config, out = generate.parse_config(switches)
    assert config == SceneConfig(extent_m=(500.0, 250.0), num_cameras=1600, gps=False, distortion_k1=-0.02)
    assert out == Path("X")


@pytest.mark.parametrize(
    "poison",
    [
        {"num_cameras": 1},
        {"num_cameras": 10**9},
        {"extent_m": (float("nan"), 80.0)},
        {"extent_m": (120.0,)},
        {"extent_m": (0.0, 80.0)},
        {"flight": "zigzag"},
        {"width_px": 0},
        {"altitude_m": float("inf")},
        {"oblique_fraction": -0.1},
        {"oblique_fraction": 1.0},
        {"distortion_k1": float("nan")},
        {"distortion_k1": -0.4},
        {"noise_sigma": -1.0},
        {"gps_error_m": float("nan")},
        {"samples_per_axis": 0},
        {"jpeg_quality": 100},
        {"seed": -1},
        {"off_path": -1},
        {"off_path": 10**9},
        {"flight": "orbit", "off_path": 4},
    ],
)
def test_poison_config_is_refused_by_name(poison: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match=list(poison)[-1]):
        replace(SMALL, **poison)


def test_flight_has_the_number_of_photographs_asked_for_and_covers_the_area() -> None:
    for count in (2, 7, 60, 1600):
        config = SceneConfig(num_cameras=count, extent_m=(500.0, 250.0))
        centers = np.array([shot.center_m for shot in plan_flight(config)])
        assert len(centers) == count
    # Rows and columns end half a spacing (under 10 m) inside the border, and obliques stand up to
    # 1.1 half extents out.
    assert np.ptp(centers[:, 0]) > 480.0
    assert np.ptp(centers[:, 1]) > 230.0


def test_an_orbit_looks_at_one_place_from_all_sides_and_a_walk_goes_along_a_street() -> None:
    orbit = plan_flight(replace(SMALL, flight="orbit", num_cameras=40))
    centers = np.array([shot.center_m for shot in orbit])
    forward = np.array([shot.cam_from_world[2, :3] for shot in orbit])
    middle = centers.mean(axis=0)
    angles = np.sort(np.arctan2(*(centers - middle)[:, 1::-1].T))
    assert np.diff(angles).max() < np.deg2rad(30)
    nearest = centers + forward * ((middle - [0, 0, 11.0] - centers) * forward).sum(axis=1, keepdims=True)
    assert np.linalg.norm(nearest - nearest.mean(axis=0), axis=1).max() < 4.0
    walk = plan_flight(replace(SMALL, flight="street", num_cameras=40, extent_m=(120.0, 80.0)))
    places = np.array([shot.center_m for shot in walk])
    layout = Layout(extent_m=(120.0, 80.0), seed=SMALL.seed)
    u, v = layout.town_from_world(places[:, 0], places[:, 1])
    assert np.ptp(u) > 110 and np.abs(v).max() < 1.01
    height_m = places[:, 2] - layout.height_m(places[:, 0], places[:, 1])
    assert (np.abs(height_m - 1.8) < 0.2).all()


def test_before_a_turntable_the_wall_stands_still_and_the_lamp_goes_with_the_camera() -> None:
    config = replace(SMALL, flight="turntable", num_cameras=9, noise_sigma=0.0)
    table, shots = Photographer(config), plan_flight(replace(SMALL, flight="turntable", num_cameras=9))
    pictures = [table.photograph(shot, 0).astype(int) for shot in shots]
    behind = [~np.isfinite(table.depth(shot)) for shot in shots]
    # Three photographs from each height: the same wall, another side of the house.
    first, second = pictures[0], pictures[1]
    wall = behind[0] & behind[1]
    assert 0.05 < wall.mean() < 0.95
    assert np.abs(first - second)[~behind[0] & ~behind[1]].mean() > 5
    # A pixel at the edge of the house has rays of both.
    assert np.median(np.abs(first - second)[wall]) == 0
    assert {round(float(np.linalg.norm(shot.center_m - TARGET_M)), 6) for shot in shots} == {CAMERA_DISTANCE_M}
    for shot in shots:
        toward = (shot.center_m - TARGET_M) / CAMERA_DISTANCE_M
        assert lamp_direction(shot.cam_from_world) @ toward == pytest.approx(1 / np.sqrt(1 + LAMP_ASIDE**2 + LAMP_ABOVE**2), abs=1e-6)


def test_views_off_the_path_are_lower_across_and_on_the_street_and_free(photographer: Photographer) -> None:
    config = replace(SMALL, off_path=8, extent_m=(120.0, 80.0))
    town = Photographer(config)
    shots = plan_off_path(config, town)
    assert [shot.name.split("_")[0] for shot in shots] == list(KINDS) * 2
    for shot in shots:
        x, y, z = shot.center_m
        above_m = z - float(town.layout.height_m(np.array([x]), np.array([y]))[0])
        down_deg = -np.rad2deg(np.arcsin(shot.cam_from_world[2, 2]))
        assert town.clearance_m(shot.center_m) >= 1.0
        kind = shot.name.split("_")[0]
        if kind == "lower":
            assert down_deg == pytest.approx(60, abs=0.01)
        elif kind == "half":
            assert above_m == pytest.approx((config.altitude_m - (z - above_m)) / 2) and down_deg > 78
        elif kind == "across":
            assert down_deg == pytest.approx(45, abs=0.01) and abs(shot.cam_from_world[2, 0]) < 1e-9 and z == config.altitude_m
        else:
            assert above_m == pytest.approx(1.8, abs=0.01) and abs(down_deg) < 0.01
    again = plan_off_path(config, town)
    assert all(np.array_equal(a.cam_from_world, b.cam_from_world) for a, b in zip(shots, again, strict=True))


def test_how_many_photographs_see_a_pixel_is_counted_as_their_depth_says(photographer: Photographer) -> None:
    flown = plan_flight(SMALL)
    depth = photographer.depth(flown[2])
    alone = count_views(photographer, flown[2], depth, [flown[2]])
    # A photograph sees what it sees itself, but for pixels of leaves and wires.
    assert alone.shape == depth.shape and alone.max() == 1 and alone.mean() > 0.98
    every = count_views(photographer, flown[2], depth, flown)
    assert every.max() <= len(flown) and (every >= alone).all() and every.mean() > 1.5
    away = count_views(photographer, flown[2], np.full_like(depth, np.inf), flown)
    assert not away.any()


def test_views_off_the_path_are_added_to_a_scene_of_the_same_settings_alone(tmp_path: Path) -> None:
    config = replace(SMALL, num_cameras=3, samples_per_axis=1, width_px=48, height_px=36, extent_m=(60.0, 40.0))
    out = tmp_path / "scene"
    generate.generate(config, out)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    generate.generate(replace(config, off_path=4), out)
    assert sorted(path.name for path in out.iterdir()) == ["images", "known", "off_path"]
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items() if path != out)
    views = sorted((out / "off_path" / "images").iterdir())
    assert len(views) == 4 and set(known_centers(out / "off_path")) == {path.name for path in views}
    assert set(known_centers(out / "off_path" / "known")) == {path.name for path in (out / "images").iterdir()}
    with np.load(out / "off_path" / "depth" / f"{views[0].stem}.npz") as arrays:
        assert arrays["depth_m"].shape == arrays["num_views"].shape == (36, 48)
    with pytest.raises(BadInput, match="exists already"):
        generate.generate(replace(config, off_path=4), out)
    with pytest.raises(BadInput, match="was made with seed 0, not 1"):
        generate.generate(replace(config, off_path=4, seed=1), out)
    (out / "known" / "frame.json").write_text("{}")
    with pytest.raises(BadInput, match="does not say how the scene was made"):
        generate.generate(replace(config, off_path=4), out)
