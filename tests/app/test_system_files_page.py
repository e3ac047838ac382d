"""docs/system_files.md: its three files are those of sample_scenes/systems, load, and plan; every key is explained."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel

from radiant_app.files import system_file
from radiant_app.files.system_file import load_system
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/system_files.md").read_text()
FILES = sorted((ROOT / "sample_scenes/systems").glob("*.toml"))
DEVICES = {
    "field": {"laptop": ["drone-1", "drone-2"]},
    "office": {"office": ["gpu-1", "gpu-2", "gpu-3", "laptop"]},
    "two_owners": {"survey-office": ["survey-1", "survey-2"], "city": ["city-1"]},
}


def keys(model: type[BaseModel]) -> Iterator[str]:
    """The keys of a table and of the tables in it."""
    for name, field in model.model_fields.items():
        tables = [kind for kind in _kinds(field.annotation) if isinstance(kind, type) and issubclass(kind, BaseModel)]
        yield name
        for table in tables:
            yield from keys(table)


def _kinds(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in get_args(annotation):
        yield from _kinds(part)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_ready_file_stands_on_the_page_and_is_planned(path: Path) -> None:
    assert f"```toml\n{path.read_text()}```" in PAGE
    system = load_system(path)
    assert {edge.id: [device.id for device in edge.devices] for edge in system.edges} == DEVICES[path.stem]
    positions = np.random.default_rng(0).uniform(0.0, 200.0, (120, 2))
    plan = plan_regions(positions, place_edges(system, positions, [47.37, 8.54, 400.0], 0))
    assert not isinstance(plan, PlanInfeasible)
    assert np.bincount(plan.edge_of_camera, minlength=len(system.edges)).min() > 0
    assert plan.edge_time_s.max() <= 1.0001 * plan.lower_bound_s


def test_every_key_is_explained() -> None:
    explained = set(re.findall(r"`(\w+)`", PAGE)) | {"edge", "device", "cloud", "training", "constant", "linear", "power_coefficient"}
    assert sorted(set(keys(system_file._File)) - explained) == []
