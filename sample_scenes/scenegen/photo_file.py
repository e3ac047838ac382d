"""JPEG files as a drone writes them: focal length, time and GPS position in EXIF.

    ECEF = ECEF(origin) + R_ecef_from_enu · (east, north, up), then latitude by Bowring's iteration

Once per photograph. Seconds of arc are kept to 1e-5 (0.3 mm), heights to 1 mm.
"""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from scenegen.config import SceneConfig
from scenegen.flight import Shot

ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M = 47.37, 8.54, 430.0
FIRST_PHOTO = datetime(2025, 6, 14, 10, 0, 0, tzinfo=UTC)
_SEMI_MAJOR_M, _FLATTENING = 6378137.0, 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)


def jpeg_bytes(config: SceneConfig, pixels: NDArray[np.uint8], shot: Shot) -> bytes:
    """The photograph (H,W,3) as a JPEG file with EXIF."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=config.jpeg_quality, exif=_exif(config, shot), optimize=True)
    return buffer.getvalue()


def geodetic_from_enu(position_m: NDArray[np.float64]) -> tuple[float, float, float]:
    """WGS 84 latitude and longitude in degrees and height in metres of an east-north-up position
    (3,) at the scene's origin."""
    lat, lon = np.deg2rad(ORIGIN_LAT_DEG), np.deg2rad(ORIGIN_LON_DEG)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    x, y, z = _ecef(lat, lon, ORIGIN_ALT_M) + np.column_stack([east, north, up]) @ position_m
    from_axis = np.hypot(x, y)
    new_lat = np.arctan2(z, from_axis * (1.0 - _ECCENTRICITY2))
    # Contracts by e² ≈ 0.007 per round at these heights: six rounds reach rounding.
    for _ in range(6):
        normal_m = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(new_lat) ** 2)
        new_lat = np.arctan2(z + _ECCENTRICITY2 * normal_m * np.sin(new_lat), from_axis)
    normal_m = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(new_lat) ** 2)
    return float(np.rad2deg(new_lat)), float(np.rad2deg(np.arctan2(y, x))), float(from_axis / np.cos(new_lat) - normal_m)


def _ecef(lat_rad: float, lon_rad: float, alt_m: float) -> NDArray[np.float64]:
    normal_m = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(lat_rad) ** 2)
    across = (normal_m + alt_m) * np.cos(lat_rad)
    up = (normal_m * (1.0 - _ECCENTRICITY2) + alt_m) * np.sin(lat_rad)
    return np.array([across * np.cos(lon_rad), across * np.sin(lon_rad), up])


def _exif(config: SceneConfig, shot: Shot) -> Image.Exif:
    exif = Image.Exif()
    taken = FIRST_PHOTO + timedelta(seconds=shot.time_s)
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Radiant", "SampleDrone"
    exif[ExifTags.Base.DateTime] = taken.strftime("%Y:%m:%d %H:%M:%S")
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.DateTimeOriginal] = taken.strftime("%Y:%m:%d %H:%M:%S")
    # A sensor 13.2 mm wide, so 24 mm on 35 mm film is a lens of 8.8 mm.
    details[ExifTags.Base.FocalLength] = IFDRational(Fraction(config.lens_mm * 88 / 240).limit_denominator(1000))
    details[ExifTags.Base.FocalLengthIn35mmFilm] = round(config.lens_mm)
    details[ExifTags.Base.ExifImageWidth], details[ExifTags.Base.ExifImageHeight] = config.width_px, config.height_px
    if config.gps:
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(_gps_tags(shot, taken))
    return exif


def _gps_tags(shot: Shot, taken: datetime) -> dict[int, object]:
    lat, lon, alt = geodetic_from_enu(shot.gps_position_m)
    return {
        ExifTags.GPS.GPSVersionID: b"\x02\x03\x00\x00",
        ExifTags.GPS.GPSLatitudeRef: "N" if lat >= 0 else "S",
        ExifTags.GPS.GPSLatitude: _degrees_minutes_seconds(abs(lat)),
        ExifTags.GPS.GPSLongitudeRef: "E" if lon >= 0 else "W",
        ExifTags.GPS.GPSLongitude: _degrees_minutes_seconds(abs(lon)),
        ExifTags.GPS.GPSAltitudeRef: b"\x00",
        ExifTags.GPS.GPSAltitude: IFDRational(round(alt * 1000), 1000),
        ExifTags.GPS.GPSTimeStamp: (float(taken.hour), float(taken.minute), float(taken.second)),
        ExifTags.GPS.GPSDateStamp: taken.strftime("%Y:%m:%d"),
    }


def _degrees_minutes_seconds(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    hundred_thousandths = round(angle_deg * 3600 * 100_000)
    minutes, seconds = divmod(hundred_thousandths, 60 * 100_000)
    return IFDRational(minutes // 60, 1), IFDRational(minutes % 60, 1), IFDRational(seconds, 100_000)
