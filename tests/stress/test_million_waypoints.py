"""A million waypoints: read from each format, planned and exported within a time and a memory that grow with their number alone."""

from __future__ import annotations

import io
import resource
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan_waypoints
from radiant_core.waypoints.reader import read_waypoints

pytestmark = pytest.mark.stress
COUNT = 1_000_000


def positions() -> np.ndarray:
    return np.array([47.37, 8.54, 500.0]) + np.random.default_rng(0).uniform(-1, 1, (COUNT, 3)) * [0.05, 0.05, 20]


def csv_text() -> str:
    lines = [f"wp-{i},{lat:.9f},{lon:.9f},{alt:.3f}" for i, (lat, lon, alt) in enumerate(positions())]
    return "\n".join(["name,latitude,longitude,altitude", *lines])


def geojson_text() -> str:
    start, middle = '{"type": "Feature", "properties": {"name": "wp-', '"}, "geometry": {"type": "Point", "coordinates": '
    features = [f"{start}{i}{middle}[{lon:.9f}, {lat:.9f}, {alt:.3f}]}}}}" for i, (lat, lon, alt) in enumerate(positions())]
    return f'{{"type": "FeatureCollection", "features": [{",".join(features)}]}}'


def kml_text() -> str:
    placemarks = [
        f"<Placemark><name>wp-{i}</name><Point><coordinates>{lon:.9f},{lat:.9f},{alt:.3f}</coordinates></Point></Placemark>"
        for i, (lat, lon, alt) in enumerate(positions())
    ]
    return f"<kml>{''.join(placemarks)}</kml>"


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".kml"])
def test_a_million_waypoints_are_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text({".csv": csv_text, ".geojson": geojson_text, ".kml": kml_text}[suffix]())
    before_s = time.process_time()
    found = read_waypoints(path)
    # 5 to 10 s on one core of a busy machine.
    assert time.process_time() - before_s < 30
    assert len(found.waypoints) == COUNT
    np.testing.assert_allclose(found.waypoints.lat_lon_alt, positions(), atol=5.1e-4)


def test_a_million_waypoints_are_planned_or_refused_with_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(csv_text())
    display = ProgressDisplay(Console(file=io.StringIO()))
    before_s = time.process_time()
    result = plan(PlanRequest(source=path, out=tmp_path / "plan.json", system=None, method="exact", seed=0), display)
    assert time.process_time() - before_s < 120  # 31 s where it was measured
    assert result["planned"] == COUNT
    assert "500000 pairs" in result["method"]
    assert result["makespan_s"] < 1.05 * result["lower_bound_s"]
    waypoints = load_plan_waypoints(tmp_path / "plan.json")
    assert waypoints is not None and len(waypoints) == COUNT
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 6e6, "kB"
    edges = [f'[[edge]]\nid = "e{e}"\n' + "".join(f'[[edge.device]]\nid = "d{e}-{d}"\n' for d in range(8)) for e in range(8)]
    (tmp_path / "system.toml").write_text("".join(edges))
    wide = PlanRequest(source=path, out=tmp_path / "wide.json", system=tmp_path / "system.toml", method="exact", seed=0)
    with pytest.raises(BadInput, match="at most 50000000 are supported"):
        plan(wide, display)
    assert not list(tmp_path.glob("*wide*"))
