"""Devices that place their own photographs by GPS: how well frames agree in the end, and sets whose GPS is good or bad. Minutes."""

from __future__ import annotations

import io
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from radiant_app.commands.run.demo import DEMO_TRAINING, sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import RunConfig
from radiant_core.cameras import Cameras
from radiant_core.errors import StageFailed
from radiant_core.frames import Sim3, geodetic_from_enu
from radiant_core.geometry.align import fit_sim3
from radiant_core.geometry.similarity import move_cameras
from radiant_core.hierarchy.codec import sim3_of
from radiant_core.io.colmap.model import read_model
from radiant_core.io.records import load_scene
from radiant_core.sfm.world_frame.world import cameras_of

DATA = Path(os.environ.get("RADIANT_DATA", Path(__file__).parents[3] / "shared" / "data"))
TOWN = sample_scenes_folder() / "town"


def with_gps_noise(photos: Path, known: Cameras, sigma_m: float, target: Path) -> Path:
    """Copies of the photographs whose GPS is the true position with Gaussian noise of `sigma_m` per axis; pixels keep their bytes."""
    frame = json.loads((TOWN / "known" / "frame.json").read_text())
    origin = [frame[f"origin_{name}"] for name in ("lat_deg", "lon_deg", "alt_m")]
    noisy = known.centers + np.random.default_rng(0).normal(0, sigma_m, (len(known), 3))
    target.mkdir(parents=True)
    for name, place in zip(known.names, geodetic_from_enu(noisy, origin), strict=True):
        data = (photos / name).read_bytes()
        exif = Image.open(io.BytesIO(data)).getexif()
        gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
        gps[ExifTags.GPS.GPSLatitude], gps[ExifTags.GPS.GPSLongitude] = (_sexagesimal(abs(angle)) for angle in place[:2])
        gps[ExifTags.GPS.GPSAltitude] = round(float(place[2]), 3)
        block = exif.tobytes()
        start = data.index(b"\xff\xe1")
        end = start + 2 + struct.unpack(">H", data[start + 2 : start + 4])[0]
        (target / name).write_bytes(data[:start] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + data[end:])
    return target


def _sexagesimal(angle_deg: float) -> tuple[float, float, float]:
    minutes, seconds = divmod(angle_deg * 3600, 60)
    return minutes // 60, minutes % 60, round(seconds, 5)


def frame_errors(out: Path, known: Cameras) -> dict[str, tuple[float, float, float, float]]:
    """Per device the error of scale, of rotation in degrees, and of place as a share of the extent,
    once the similarity that all devices have in common is taken off: only better GPS could fix that
    one. Last what its own structure from motion leaves open of its scale, σ / √Σ‖x‖² of the
    residuals after the best similarity: no frame can mend that."""
    placed = {
        device: cameras.named([name for name in cameras.names if name in known.names]) for device, cameras in placed_cameras(out).items()
    }
    true = {name: (center, pose[:3, :3]) for name, center, pose in zip(known.names, known.centers, known.cam_from_world, strict=True)}
    mine = np.concatenate([cameras.centers for cameras in placed.values()])
    theirs = np.array([true[name][0] for cameras in placed.values() for name in cameras.names])
    gauge = fit_sim3(mine, theirs)
    extent = float(np.linalg.norm(theirs[:, None] - theirs, axis=2).max())
    errors = {}
    for device, cameras in placed.items():
        moved = move_cameras(cameras, gauge)
        wanted = np.array([true[name][0] for name in moved.names])
        left = fit_sim3(moved.centers, wanted)
        turns = [_angle_deg(true[name][1] @ pose[:3, :3].T) for name, pose in zip(moved.names, moved.cam_from_world, strict=True)]
        offset = float(np.linalg.norm(moved.centers.mean(axis=0) - wanted.mean(axis=0)))
        residuals = np.linalg.norm(left.apply(moved.centers) - wanted, axis=1)
        spread = np.linalg.norm(wanted - wanted.mean(axis=0), axis=1)
        # Per axis σ² = Σ r² / 3 (n − 2): seven numbers were fitted to 3 n.
        own = float(np.sqrt(np.square(residuals).sum() / (3 * (len(wanted) - 2)) / np.square(spread).sum()))
        errors[device] = abs(left.scale - 1), float(np.median(turns)), offset / extent, own
    return errors


def placed_cameras(out: Path) -> dict[str, Cameras]:
    """Training cameras of each device in the scene's frame."""
    placed = {}
    for edge, to_cloud in moves(out / "cloud").items():
        for device, to_edge in moves(out / "edges" / edge).items():
            cameras = load_scene(out / "devices" / device / "scene.safetensors").cameras
            placed[device] = move_cameras(move_cameras(cameras, to_edge), to_cloud)
    return placed


def moves(folder: Path) -> dict[str, Sim3]:
    found = json.loads((folder / "corrections.json").read_text())
    return {name: sim3_of(record) for name, record in found.items() if record is not None}


def _angle_deg(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


@pytest.mark.stress
def test_frames_agree_under_3_m_of_gps_noise(tmp_path: Path) -> None:
    known = cameras_of(read_model(TOWN / "known"))
    photos = with_gps_noise(TOWN / "images", known, 3.0, tmp_path / "photos")
    runs = {}
    for frames in ("gps", "shared"):
        config = RunConfig(source=photos, out=tmp_path / frames, frames=frames, system=TOWN / "system.toml", train=DEMO_TRAINING)
        runs[frames] = run(config).metrics
    assert runs["gps"]["missing"] == {}
    errors = frame_errors(tmp_path / "gps", known)
    print(f"\n{errors}, {runs['gps']['psnr_db']:.2f} dB, shared {runs['shared']['psnr_db']:.2f} dB")
    for device, (scale, turn_deg, offset, own) in errors.items():
        assert scale <= 1e-3 and turn_deg <= 0.1 and offset <= 5e-3, (device, scale, turn_deg, offset, own)
    assert runs["gps"]["psnr_db"] >= runs["shared"]["psnr_db"] - 0.3, (runs["gps"]["psnr_db"], runs["shared"]["psnr_db"])


@pytest.mark.stress
@pytest.mark.parametrize("name", ["brighton", "lewis", "caliterra"])
def test_a_real_set_is_placed_or_refused(name: str, tmp_path: Path) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    system = None
    if name == "brighton":
        system = tmp_path / "system.toml"
        system.write_text("".join(f'[[edge]]\nid = "{edge}"\n[[edge.device]]\nid = "{edge}-1"\n' for edge in ("one", "two")))
    config = RunConfig(source=DATA / name / "images", out=tmp_path / "run", frames="gps", system=system, train=DEMO_TRAINING)
    if name == "caliterra":
        # Its GPS is off by 10 to 30 m across and up to 90 m in height on a site of 100 × 140 m.
        with pytest.raises(StageFailed, match=r"no device delivered a model.* refused"):
            run(config)
        return
    metrics = run(config).metrics
    errors = frame_errors(tmp_path / "run", cameras_of(read_model(DATA / name / "sparse_undistorted" / "0")))
    print(f"\n{name}: {errors}, missing {metrics['missing']}, {metrics['psnr_db']:.2f} dB")
    # A frame may be refused, as the pages say; what ends by a fault of its own is none of these.
    assert not [reason for reason in metrics["missing"].values() if "process ended" in reason]
    # Models of 7 to 12 photographs with focal lengths of their own are bent by per cents; a wrong
    # place is off by tens of per cent.
    for device, (scale, turn_deg, offset, _) in errors.items():
        assert scale <= 0.04 and turn_deg <= 4 and offset <= 0.02, (device, scale, turn_deg, offset)
    # What was merged must agree: a wrongly placed device shows nothing of the photographs it holds
    # out.
    for row in metrics["images"]:
        assert row["psnr_db"] > row["initial_psnr_db"], row
