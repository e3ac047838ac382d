"""Whether `radiant measure --since` finds the houses that the generator altered, and none of the
others.

    python sample_scenes/change_error.py EARLIER_RUN change.geojson --known FOLDER --houses FILE

FOLDER is `known` of the earlier photographs, FILE houses.json of the later ones. A patch belongs to
the house whose lot is nearest to its middle, if it reaches within 6 m of the lot's middle. Prints
recall and precision over houses, and patches that belong to none.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from shapely.geometry import Point, Polygon

from radiant_core.map_projection import utm_from_geodetic
from radiant_core.survey.map_grid import map_frame_of
from radiant_viewer.runs.run_view import load_run_view
from truth import load_truth

WITHIN_M = 6.0


def main() -> None:
    """Count houses and patches and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("patches", type=Path)
    parser.add_argument("--known", type=Path, required=True)
    parser.add_argument("--houses", type=Path, required=True)
    chosen = parser.parse_args()
    scene = load_run_view(chosen.run).scene
    truth, map_frame = load_truth(chosen.known, scene), map_frame_of(scene.frame)
    houses = json.loads(chosen.houses.read_text())
    lots = np.array([[house["x"], house["y"]] for house in houses])
    points = np.column_stack([lots, truth.heights(lots)])
    middles = map_frame.from_world(truth.truth_from_run.inverse().apply(points))[:, :2]
    found: dict[int, list[str]] = {}
    elsewhere = []
    for feature in json.loads(chosen.patches.read_text())["features"]:
        ring = np.array(feature["geometry"]["coordinates"][0])
        outline = Polygon(utm_from_geodetic(ring[:, ::-1], map_frame.epsg) if map_frame.epsg else ring)
        middle = np.array([outline.centroid.x, outline.centroid.y])
        nearest = int(np.argmin(np.linalg.norm(middles - middle, axis=1)))
        words = f"{feature['properties']['kind']} {feature['properties']['area']:.0f} m²"
        if outline.buffer(0).distance(Point(middles[nearest])) < WITHIN_M:
            found.setdefault(nearest, []).append(words)
        else:
            elsewhere.append(words)
    altered = {row for row, house in enumerate(houses) if house["alteration"]}
    for row in sorted(altered):
        print(f"{houses[row]['alteration']}: {', '.join(found.get(row, ['not found']))}")
    right, wrong = len(altered & set(found)), len(set(found) - altered)
    counts = f"{len(altered)} houses altered, {len(houses) - len(altered)} not"
    print(f"{counts}: recall {right / len(altered):.2f}, precision {right / max(1, right + wrong):.2f}")
    print(f"{len(elsewhere)} patches away from houses: {', '.join(elsewhere) or 'none'}")


if __name__ == "__main__":
    main()
