"""Ground control for a sample scene, with errors as a surveyor's: a list for `radiant --gcp`.

    python sample_scenes/control_points.py --scene sample_scenes/town --out gcp_list.txt

Points are chosen from the true surface, far from each other; marks are where the true cameras show
them. Both get normal errors. The first points are ground control, the others check points.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.list_lines import FIRST_PIXEL
from radiant_core.io.colmap.model import read_model

MIN_IMAGES = 5
AREA_SHARE = 0.9
"""Points lie within this share of the scene's area."""


@dataclass(frozen=True, kw_only=True)
class ControlConfig:
    """What is drawn; the noise in metres per axis and in px per axis."""

    num_control: int = 5
    num_check: int = 10
    noise_m: float = 0.02
    noise_px: float = 0.3
    crs: str = "EPSG:32632"
    seed: int = 0


def control_list(scene: Path, config: ControlConfig) -> str:
    """The text of the list for a scene with its truth in known/."""
    model = read_model(scene / "known")
    about = json.loads((scene / "known" / "frame.json").read_text())
    origin = np.array([about["origin_lat_deg"], about["origin_lon_deg"], about["origin_alt_m"]])
    rng = np.random.default_rng([config.seed, 7])
    half = AREA_SHARE * np.array(about["config"]["extent_m"]) / 2
    chosen = _spread_points(model.points.xyz, np.bincount(model.points.tracks[:, 0], minlength=len(model.points.xyz)), half, config, rng)
    surveyed = model.points.xyz[chosen] + rng.normal(scale=config.noise_m, size=(len(chosen), 3))
    crs = parse_crs(config.crs)
    places = crs.from_geodetic(geodetic_from_enu(surveyed, origin))
    observations = model.observations()
    lines = [config.crs]
    for number, (point, place) in enumerate(zip(chosen.tolist(), places, strict=True)):
        name = f"gcp-{number + 1}" if number < config.num_control else f"check-{number + 1 - config.num_control} check"
        for row in observations[observations[:, 0] == point, 1].tolist():
            image = model.images[row]
            local = image.cam_from_world[:3] @ np.append(model.points.xyz[point], 1.0)
            pixel = (model.cameras[image.camera_id].K @ local)[:2] / local[2] + rng.normal(scale=config.noise_px, size=2)
            # In the list the middle of the first pixel is at (0, 0), of K at (0.5, 0.5).
            pixel -= FIRST_PIXEL
            lines.append(f"{place[0]:.4f} {place[1]:.4f} {place[2]:.4f} {pixel[0]:.2f} {pixel[1]:.2f} {image.name} {name}")
    return "\n".join(lines) + "\n"


def _spread_points(
    points: NDArray, num_images: NDArray, half: NDArray, config: ControlConfig, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Rows of points that many photographs see, each the farthest from those before."""
    usable = np.flatnonzero((num_images >= MIN_IMAGES) & (np.abs(points[:, :2]) <= half).all(axis=1))
    corner = usable[np.argmax(points[usable, :2] @ rng.choice([-1.0, 1.0], 2))]
    chosen = [int(corner)]
    while len(chosen) < config.num_control + config.num_check:
        away = np.linalg.norm(points[usable, None, :2] - points[None, chosen, :2], axis=2).min(axis=1)
        chosen.append(int(usable[np.argmax(away)]))
    return np.array(chosen, np.int64)


def main() -> None:
    """Write the list that the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    for name in ("num_control", "num_check", "noise_m", "noise_px", "crs", "seed"):
        default = getattr(ControlConfig, name)
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default)
    values = vars(parser.parse_args())
    scene, out = values.pop("scene"), values.pop("out")
    out.write_text(control_list(scene, ControlConfig(**values)))
    print(f"written: {out}")


if __name__ == "__main__":
    main()
