"""`radiant measure RUN`: distances, heights, areas, volumes and profiles with their σ, kept with
the run in survey/measures.json, beside the surface they were taken on (survey/heights.safetensors).
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.commands.run.steps import require_file_to_be
from radiant_app.commands.survey.parts import Survey, cell_of, load_survey
from radiant_app.commands.survey.surface import PIXELS_PER_CELL, points_of_survey, surface_of_survey
from radiant_app.files.out_folder import folder_made_for
from radiant_app.report.known_scale import scale_of_run
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning_file import cleaning_path
from radiant_core.io.array_file import load_arrays, stream_arrays
from radiant_core.io.csv_cells import cell_of_text
from radiant_core.io.measures_file import FOLDER, load_measures, places_of, save_measures
from radiant_core.io.run_store import file_sha256, write_atomic, write_json
from radiant_core.numerics import FloatArray
from radiant_core.survey.geojson import line_feature, polygon_feature, to_geojson
from radiant_core.survey.heights import RENDERING, HeightMap
from radiant_core.survey.map_grid import MapFrame, MapGrid
from radiant_core.survey.measures import PLACE_GSD, Accuracy, Measured, MeasureKind, measure, require_measure
from radiant_core.survey.sight import first_hit

HEIGHTS = "heights.safetensors"
_SCHEMA, _DTYPES = "radiant.heights", {"heights": "F64", "sigma": "F32", "source": "U8"}
MAX_NAME = 100
SNAP_GSD = 5.0
"""Three σ of a rendered depth."""


@dataclass(frozen=True, kw_only=True)
class MeasureRequest:
    """One measure of a run, or, with kind None, only what is kept; export: .geojson or .csv."""

    run: Path
    kind: MeasureKind | None = None
    places: str | None = None
    name: str | None = None
    base: float | None = None
    resolution: float | None = None
    remove: str | None = None
    export: Path | None = None


def measure_run(request: MeasureRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Measure, keep and return the figures; without a kind, list what is kept."""
    if (request.kind is None) != (request.places is None):
        raise BadInput("a measure needs its kind and its places: give both --kind and --at, or neither to list what is kept.")
    for option, value in (("--name", request.name), ("--base", request.base), ("--resolution", request.resolution)):
        if value is not None and request.kind is None:
            raise BadInput(f"{option} is of a new measure: give its --kind and --at too, or leave {option} out.")
    if request.export is not None:
        require_export_name(request.export)
    places = None if request.places is None else parse_places(request.places)
    if request.kind is not None and places is not None:
        # Before minutes of matching.
        require_measure(request.kind, places, request.base)
    survey, measures = load_survey(request.run), load_measures(request.run)
    if request.remove is not None:
        take_out(request.run, measures, request.remove)
    name = ""
    if request.kind is not None and places is not None:
        name_for(request.kind, request.name, measures)
        surface = surface_for_measures(survey, request.resolution, display)
        measured = measure(request.kind, places, surface, accuracy_of(survey), request.base)
        name, measures = keep(survey, request.name, measured)
    if request.export is not None:
        export_measures(request.export, measures, survey.map_frame)
    return {"measures": measures} if request.kind is None else {"name": name, **measures[name]}


def take_out(run: Path, measures: dict[str, Any], name: str) -> None:
    """Remove a measure from `measures` and from the file; BadInput for an unknown name."""
    if name not in measures:
        raise BadInput(f"there is no measure named {name!r}: there are {', '.join(measures) or 'none'}.")
    del measures[name]
    save_measures(run, measures)


def keep(survey: Survey, name: str | None, measured: Measured) -> tuple[str, dict[str, Any]]:
    """Add a measure to the file, which may have others since the surface began; its name and all
    that are kept. BadInput as `name_for`."""
    measures = load_measures(survey.run.folder)
    name = name_for(measured.kind, name, measures)
    measures[name] = _record(measured, survey)
    save_measures(survey.run.folder, measures)
    return name, measures


def clicked_places(survey: Survey, surface: HeightMap, points: FloatArray, eyes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (P,3) on the map, and σ (P,) of their heights, of points (P,3) of the world that were
    clicked from `eyes` (P,3); a point of NaN height was clicked on the map, and is the surface's.

    What is meant is where the look meets the surface: the point that was drawn there may be haze.
    It is on the surface, with its σ, unless it is farther than `SNAP_GSD` below it, on a wall.
    Where the surface is not known the point itself counts, with the σ of a rendered depth.
    """
    is_looked_at = np.isfinite(points[:, 2])
    places = survey.map_frame.from_world(np.column_stack([points[:, :2], np.where(is_looked_at, points[:, 2], survey.ground.level)]))
    for row in np.flatnonzero(is_looked_at):
        hit = first_hit(surface, survey.map_frame.from_world(eyes[row : row + 1])[0], places[row])
        places[row] = np.where(np.isfinite(hit), hit, places[row])
    heights, sigmas = surface.at(places[:, :2])
    is_on_surface = ~is_looked_at | (np.abs(places[:, 2] - heights) <= SNAP_GSD * survey.ground.gsd)
    places[:, 2] = np.where(is_on_surface, heights, places[:, 2])
    return places, np.where(is_on_surface, sigmas, RENDERING * survey.ground.gsd)


def parse_places(text: str) -> FloatArray:
    """Places (P,2 or 3) of "east,north[,height] east,north[,height] …"."""
    try:
        rows = [[float(value) for value in place.split(",")] for place in text.split()]
        places = np.array(rows, np.float64)
    except ValueError:
        places = np.zeros((0, 0))
    if not np.isfinite(places).all() or places.ndim != 2 or places.shape[1] not in (2, 3):
        raise BadInput(
            f"'{text}' is no list of places: give them like \"465230.1,5246380.2 465250.7,5246377.9\", all with a height or none."
        )
    return places


def accuracy_of(survey: Survey) -> Accuracy:
    """σ of a place, and of the scale."""
    return Accuracy(place=PLACE_GSD * survey.ground.gsd, scale=scale_of_run(survey.run).sigma)


def surface_for_measures(survey: Survey, resolution: float | None, display: ProgressDisplay) -> HeightMap:
    """The surface kept with the run, made where there is none of this scene and resolution."""
    path = survey.run.folder / FOLDER / HEIGHTS
    cell = cell_of(survey, resolution, PIXELS_PER_CELL)
    cleaning = cleaning_path(survey.run.folder)
    key = {
        "model": file_sha256(survey.run.folder / "scene.ply"),
        "cleaning": file_sha256(cleaning) if cleaning.is_file() else None,
        "cell": cell,
    }
    if path.is_file():
        arrays, about = load_arrays(path, _SCHEMA, _DTYPES)
        if about.get("key") == key:
            grid = MapGrid(**{**about["grid"], "north_west": np.array(about["grid"]["north_west"])})
            if all(array.shape == grid.shape for array in arrays.values()):
                return HeightMap(grid=grid, **arrays)
    surface = surface_of_survey(survey, points_of_survey(survey, display, 576), cell, display)
    grid = surface.grid
    about = {
        "key": key,
        "grid": {"north_west": grid.north_west.tolist(), "cell": grid.cell, "rows": grid.rows, "columns": grid.columns, "epsg": grid.epsg},
    }
    path.parent.mkdir(exist_ok=True)
    stream_arrays(path, _SCHEMA, {"heights": surface.heights, "sigma": surface.sigma, "source": surface.source}, about)
    return surface


def name_for(kind: MeasureKind, name: str | None, measures: dict[str, Any]) -> str:
    """The name of a new measure, by default its kind and a number; BadInput for one that is taken
    or cannot be written."""
    name = name or next(f"{kind} {number}" for number in range(1, len(measures) + 2) if f"{kind} {number}" not in measures)
    if not name.isprintable() or len(name) > MAX_NAME:
        raise BadInput(f"a name of {len(name)} characters came, expected at most {MAX_NAME} printable ones.")
    if name in measures:
        raise BadInput(f"there is a measure named {name!r}: choose another name, or --remove it first.")
    return name


def _record(measured: Measured, survey: Survey) -> dict[str, Any]:
    unit = survey.run.unit
    record: dict[str, Any] = {
        "kind": measured.kind,
        "crs": survey.map_frame.crs,
        "places": np.round(measured.places, 4).tolist(),
        "figures": {
            figure.name: {
                "value": round(figure.value, 4),
                "sigma": round(figure.sigma, 4),
                "unit": f"{unit}{('', '²', '³')[figure.power - 1]}",
            }
            for figure in measured.figures
        },
        "filled": round(measured.filled, 4),
        "scale": scale_of_run(survey.run).text,
    }
    if len(measured.profile):
        record["profile"] = [[None if not np.isfinite(value) else round(float(value), 4) for value in row] for row in measured.profile]
    return record


def require_export_name(path: Path) -> None:
    """Raise BadInput unless measures can be written to `path`, a new .geojson or .csv."""
    if path.suffix.lower() not in (".geojson", ".json", ".csv"):
        raise BadInput(f"{path.name} is no name for measures: let it end in .geojson or .csv.")
    require_file_to_be(path)
    if path.exists():
        raise BadInput(f"{path} exists: choose another name.")


def export_measures(path: Path, measures: dict[str, Any], map_frame: MapFrame) -> None:
    """Write measures as .csv, or as .geojson in longitude and latitude, into a folder made for
    them."""
    with folder_made_for(path):
        _write_measures(path, measures, map_frame)


def _write_measures(path: Path, measures: dict[str, Any], map_frame: MapFrame) -> None:
    if path.suffix.lower() == ".csv":
        lines = io.StringIO()
        writer = csv.writer(lines)
        writer.writerow(["name", "kind", "figure", "value", "sigma", "unit", "crs", "scale"])
        for name, row in measures.items():
            for figure, about in row["figures"].items():
                # Numbers are numbers; any text may be a formula to a spreadsheet.
                texts = [cell_of_text(text) for text in (name, row["kind"], figure, about["unit"], row["crs"], row.get("scale", ""))]
                writer.writerow([*texts[:3], about["value"], about["sigma"], *texts[3:]])
        return write_atomic(path, lines.getvalue().encode())
    features = []
    for name, row in measures.items():
        make = polygon_feature if row["kind"] in ("area", "volume") else line_feature
        scale = {"scale": row["scale"]} if "scale" in row else {}
        features.append(make(map_frame, places_of(row), {"name": name, "kind": row["kind"], **row["figures"], **scale}))
    return write_json(path, to_geojson(map_frame, features))
