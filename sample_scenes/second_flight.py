"""The photographs that a second flight takes where `radiant plan --next` proposed it.

    python sample_scenes/second_flight.py TOWN NEXT --out BOTH

TOWN: images/ and known/ of the generator; NEXT: a proposal for a run of them. BOTH gets new/, a
photograph per proposed view, images/, TOWN's and these, and known/ of all.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.frames import enu_from_geodetic
from radiant_core.io.colmap.model import read_model
from radiant_core.sfm.world_frame.world import cameras_of
from scenegen.config import SceneConfig
from scenegen.flight import Shot, look_pose
from scenegen.known_model import write_known_model
from scenegen.photo_file import jpeg_bytes
from scenegen.raycast import Photographer
from truth import config_of


def main() -> None:
    """Photograph the proposed views of one town."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("town", type=Path)
    parser.add_argument("next", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    config = config_of(chosen.town / "known")
    shots = proposed_shots(config, json.loads((chosen.next / "next.geojson").read_text()), chosen.town / "known")
    shutil.copytree(chosen.town / "images", chosen.out / "images")
    (chosen.out / "new").mkdir()
    (chosen.out / "known").mkdir()
    photographer = Photographer(config)
    for number, shot in enumerate(shots):
        (chosen.out / "new" / shot.name).write_bytes(jpeg_bytes(config, photographer.photograph(shot, number), shot))
        shutil.copyfile(chosen.out / "new" / shot.name, chosen.out / "images" / shot.name)
    write_known_model(chosen.out / "known", photographer, [*flown_shots(chosen.town / "known"), *shots])


def flown_shots(known: Path) -> list[Shot]:
    """The photographs that a known model is of."""
    cameras = cameras_of(read_model(known))
    return [_shot(name, pose) for name, pose in zip(cameras.names, cameras.cam_from_world, strict=True)]


def proposed_shots(config: SceneConfig, proposal: dict, known: Path) -> list[Shot]:
    """The views of a proposal's GeoJSON, after all photographs of the flight."""
    record = json.loads((known / "frame.json").read_text())
    origin = np.array([record["origin_lat_deg"], record["origin_lon_deg"], record["origin_alt_m"]])
    points = [feature for feature in proposal["features"] if feature["geometry"]["type"] == "Point"]
    shots = []
    for number, point in enumerate(points, config.num_cameras):
        lon, lat, height = point["geometry"]["coordinates"]
        turn, dip = np.radians([point["properties"]["heading"], point["properties"]["pitch"]])
        level = np.array([np.sin(turn), np.cos(turn), 0.0])
        rises = np.array([0.0, 0.0, 1.0])
        ahead, up = level * np.cos(dip) + rises * np.sin(dip), rises * np.cos(dip) - level * np.sin(dip)
        center = enu_from_geodetic(np.array([[lat, lon, height]]), origin)[0]
        shots.append(_shot(f"drone_{number:04d}.jpg", look_pose(center, ahead, up)))
    return shots


def _shot(name: str, pose: NDArray[np.float64]) -> Shot:
    center = -pose[:3, :3].T @ pose[:3, 3]
    return Shot(name=name, cam_from_world=pose, gps_position_m=center, time_s=0.0, exposure_ev=0.0)


if __name__ == "__main__":
    main()
