"""What one generated scene is made from: every switch of the generator, checked once per scene.

A sentence stands with every field and is also its `--help` text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Self

from radiant_core.errors import BadInput

MAX_CAMERAS = 5000
MAX_WIDTH_PX = 8192
MAX_EXTENT_M = 2000.0
MAX_KNOWN_POINTS = 200_000


FLIGHTS = ("survey", "orbit", "street", "facade", "room", "turntable")
SCENERIES = ("town", "fields")


def option(default: Any, help_text: str) -> Any:
    """A dataclass field whose sentence is also the help text of its command-line switch."""
    return field(default=default, metadata={"help": help_text})


@dataclass(frozen=True, kw_only=True)
class SceneConfig:
    """The switches of one generated scene; lengths in metres of the scene's own east-north-up
    frame."""

    flight: str = option(
        "survey",
        "survey: a drone over the area; orbit: around its middle block; street: a walk along its middle street; "
        "facade: along the fronts of three houses; room: a furnished room from inside; "
        "turntable: a house on a plate that turns before a still camera, lamp and wall.",
    )
    num_cameras: int = option(60, "Photographs to take, nadir and oblique together.")
    extent_m: tuple[float, float] = option((120.0, 80.0), "Width (east) and height (north) of the area flown over.")
    width_px: int = option(640, "Width of a photograph.")
    height_px: int = option(480, "Height of a photograph.")
    altitude_m: float = option(45.0, "Height of the nadir flight above the local origin.")
    oblique_fraction: float = option(0.15, "Share of the photographs that look at the horizon from a ring around the area.")
    lens_mm: float = option(24.0, "Focal length of the lens as on film 36 mm wide.")
    num_lenses: int = option(
        1, "2: by threes photographs are of another camera: its lens is half as long again, its pictures smaller and brighter."
    )
    distortion_k1: float = option(0.0, "Radial distortion x_d = x (1 + k1 r²) of the lens; 0 is a pinhole.")
    exposure_drift_ev: float = option(0.0, "Largest slow exposure change over the flight, in stops.")
    cloud_shadow: float = option(0.0, "Largest share of the sun that clouds take, which drift over a survey.")
    shaken_share: float = option(0.0, "Share of the photographs that are blurred by a shake of the camera.")
    noise_sigma: float = option(0.0, "Standard deviation of the sensor noise, in grey levels of 255.")
    gps_error_m: float = option(1.0, "Largest distance between the true position and the one written to EXIF.")
    gps: bool = option(True, "Write GPS positions to EXIF.")
    depth: bool = option(False, "Also write one exact float32 depth map per photograph.")
    off_path: int = option(0, "Also write so many views that a survey never flew, with their depth, for benchmarks.")
    samples_per_axis: int = option(2, "Rays per pixel along each axis; 2 means 4 rays per pixel.")
    jpeg_quality: int = option(72, "Quality of the JPEG files, 1 to 95.")
    num_known_points: int = option(2000, "Surface points, with who sees them, in the known model.")
    textured_points: bool = option(False, "Known points lie where photographs have contrast, as those of structure from motion do.")
    seed: int = option(0, "Number from which town, flight and noise follow.")
    scenery: str = option("town", "town: streets and houses; fields: crops on a level plane, faint and without colour, as in infrared.")
    altered_houses: int = option(0, "Houses that are removed, raised, repainted or extended; known/houses.json says which.")
    date: int = option(0, "Number of the flight: another one flies other lines under another exposure over the same town.")

    def __post_init__(self) -> None:
        if self.flight not in FLIGHTS:
            raise BadInput(f"flight is {self.flight!r}, expected one of {', '.join(FLIGHTS)}")
        _check_range("num_cameras", self.num_cameras, 2, MAX_CAMERAS)
        if len(self.extent_m) != 2:
            raise BadInput(f"extent_m has {len(self.extent_m)} numbers; give a width and a height in metres, like 120x80")
        for extent in self.extent_m:
            _check_range("extent_m", extent, 5.0, MAX_EXTENT_M)
        _check_range("width_px", self.width_px, 16, MAX_WIDTH_PX)
        _check_range("height_px", self.height_px, 16, MAX_WIDTH_PX)
        _check_range("altitude_m", self.altitude_m, 25.0, 500.0)
        _check_range("oblique_fraction", self.oblique_fraction, 0.0, 0.9)
        _check_range("lens_mm", self.lens_mm, 8.0, 400.0)
        _check_range("num_lenses", self.num_lenses, 1, 2)
        _check_range("cloud_shadow", self.cloud_shadow, 0.0, 1.0)
        _check_range("shaken_share", self.shaken_share, 0.0, 1.0)
        _check_range("distortion_k1", self.distortion_k1, -0.5, 0.5)
        _check_range("exposure_drift_ev", self.exposure_drift_ev, 0.0, 3.0)
        _check_range("noise_sigma", self.noise_sigma, 0.0, 64.0)
        _check_range("gps_error_m", self.gps_error_m, 0.0, 1000.0)
        _check_range("samples_per_axis", self.samples_per_axis, 1, 8)
        _check_range("jpeg_quality", self.jpeg_quality, 1, 95)
        _check_range("off_path", self.off_path, 0, MAX_CAMERAS)
        if self.cloud_shadow and self.flight in ("room", "turntable"):
            raise BadInput(f"cloud_shadow is {self.cloud_shadow}, but no sun shines on the flight {self.flight}: leave one of the two out")
        if self.off_path and self.num_lenses > 1:
            raise BadInput("off_path is for one camera: leave out --off-path or --num-lenses")
        if self.off_path and self.flight != "survey":
            raise BadInput(f"off_path is for the flight survey, not for {self.flight}: leave one of the two out")
        _check_range("num_known_points", self.num_known_points, 0, MAX_KNOWN_POINTS)
        _check_range("seed", self.seed, 0, 2**31 - 1)
        if self.scenery not in SCENERIES:
            raise BadInput(f"scenery is {self.scenery!r}, expected one of {', '.join(SCENERIES)}")
        _check_range("altered_houses", self.altered_houses, 0, 1000)
        _check_range("date", self.date, 0, 10_000)
        self._check_lens_unfolds()

    @property
    def focal_px(self) -> float:
        """Focal length; 24 mm on film 36 mm wide is a usual drone camera."""
        return self.width_px * self.lens_mm / 36.0

    def of_camera(self, number: int) -> Self:
        """The same scene as camera `number` takes it, 0 or 1."""
        if number == 0:
            return self
        width, height = max(16, round(0.8 * self.width_px)), max(16, round(0.75 * self.height_px))
        return replace(self, width_px=width, height_px=height, lens_mm=1.5 * self.lens_mm)

    def _check_lens_unfolds(self) -> None:
        """r (1 + k1 r²) turns back at r = √(-1/(3 k1)), where it is 2/3 of that r: the corner must
        stay inside."""
        if self.distortion_k1 >= 0.0:
            return
        corner = math.hypot(self.width_px, self.height_px) / 2.0 / self.focal_px
        largest = 2.0 / 3.0 * math.sqrt(-1.0 / (3.0 * self.distortion_k1))
        if corner > 0.98 * largest:
            raise BadInput(
                f"distortion_k1 = {self.distortion_k1} folds the image over at its corners (radius {corner:.3f}, "
                f"limit {largest:.3f}); choose a value nearer to 0"
            )


def _check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise BadInput unless value is a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise BadInput(f"{name} is {value}; give a number from {low} to {high}")
