"""Layers and figures of an edited plan: against slow twins, empty, poisoned and UTM inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import Point, Polygon
from shapely.geometry import box as shapely_box

from radiant_core.errors import BadInput
from radiant_core.plan.borders.footprints import Footprints, ground_footprints, views_of_cameras
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_viewer.editing.model.plan_report import certificate_text, headline, load_rows
from radiant_viewer.layers.camera_roles import camera_roles
from radiant_viewer.layers.change_layer import changed_layer, constraint_layer, selection_layer
from radiant_viewer.layers.footprint_layer import footprint_layer, overlap_counts, overlap_layer
from radiant_viewer.layers.load_layer import load_layer
from radiant_viewer.layers.region_layer import border_layer, region_layer
from radiant_viewer.pictures.offscreen import render_map
from radiant_viewer.runs.camera_figures import camera_figures, count_overlaps, filter_rows, sort_rows
from tests.viewer.made_up_run import Town, made_up_town
from tests.viewer.test_plan_editor import editor_of

UTM = (5.0e5, 5.2e6)


def footprints_of(town: Town) -> Footprints:
    return ground_footprints(views_of_cameras(town.scene.cameras, 0.0))


@pytest.mark.parametrize("shift", [(0.0, 0.0), UTM])
def test_load_bars_are_as_long_as_the_times_and_stand_under_their_edges(shift: tuple[float, float]) -> None:
    town = made_up_town(shift)
    layer = load_layer(town.cloud_plan)
    whole, filled = layer.polygons[:3], layer.polygons[3:]
    widths = [np.ptp(bar[:, 0]) for bar in (*whole, *filled)]
    times = town.cloud_plan.edge_time_s
    np.testing.assert_allclose(np.array(widths[3:]) / widths[:3], times / times.max(), rtol=1e-6)
    for bar, site in zip(whole, town.cloud_plan.sites, strict=True):
        assert bar[:, 1].max() < site[1]
        assert bar[:, 0].mean() == pytest.approx(site[0])
    assert "4.33 min (harbour)" in layer.legend[0].text
    idle = replace(town.cloud_plan, edge_time_s=np.zeros(3), borders=(np.zeros((0, 2)),) * 3)
    assert load_layer(idle).polygons == ()


def test_a_region_alone_borders_on_no_other() -> None:
    plan = made_up_town().cloud_plan
    alone = replace(plan, borders=(plan.borders[0], *(np.zeros((0, 2)),) * (len(plan.borders) - 1)))
    (several,), (one,) = border_layer(plan).legend, border_layer(alone).legend
    assert (several.text, one.text) == ("Border of a region", "Border of the region")


@pytest.mark.parametrize("shift", [(0.0, 0.0), UTM])
def test_overlap_is_what_shapely_counts(shift: tuple[float, float]) -> None:
    footprints = footprints_of(made_up_town(shift))
    low, size = np.array([-100.0, -80]) + shift, 17.0
    counts = overlap_counts(footprints, low, size, np.array([12, 9]))
    shapes = [Polygon(polygon - low) for polygon in footprints.polygons]
    slow = [[sum(shape.contains(Point((c + 0.5) * size, (r + 0.5) * size)) for shape in shapes) for c in range(12)] for r in range(9)]
    np.testing.assert_array_equal(counts, slow)
    assert counts.max() > 1
    middles = footprints.polygons.mean(axis=1)
    others = [sum(shape.contains(Point(*(middle - low))) for shape in shapes) - 1 for middle in middles]
    np.testing.assert_array_equal(count_overlaps(footprints), others)


def test_footprint_layers_have_outlines_cells_and_say_what_sees_nothing() -> None:
    town = made_up_town()
    footprints = footprints_of(town)
    roles = camera_roles(town.scene.cameras, town.cloud_plan, town.edge_plans, ())
    outlines = footprint_layer(footprints, roles, town.cloud_plan)
    low, high = (getattr(np.concatenate(town.cloud_plan.borders), end)(axis=0) for end in ("min", "max"))
    assert ((outlines.segments[..., :2] >= low - 1e-9) & (outlines.segments[..., :2] <= high + 1e-9)).all()
    box = shapely_box(*low, *high)
    lengths = sum(Polygon(polygon).exterior.intersection(box).length for polygon in footprints.polygons)
    assert np.linalg.norm(np.diff(outlines.segments, axis=1), axis=2).sum() == pytest.approx(lengths)
    layer = overlap_layer(footprints, town.cloud_plan, "units", cells_a_side=20)
    assert layer.heat is not None and layer.heat.high > 1 and 0 < len(layer.polygons) <= 20 * 12
    blind = Footprints(polygons=footprints.polygons, areas_m2=np.zeros(24))
    assert "Without sight of the ground: 24" in footprint_layer(blind, roles, town.cloud_plan).legend[-1].text
    assert overlap_layer(blind, town.cloud_plan, "m").polygons == ()
    assert np.isnan(count_overlaps(blind)).all()
    with pytest.raises(BadInput, match="give one each"):
        footprint_layer(Footprints(polygons=footprints.polygons[:3], areas_m2=footprints.areas_m2[:3]), roles, town.cloud_plan)
    with pytest.raises(BadInput, match="give regions"):
        overlap_layer(footprints, replace(town.cloud_plan, borders=(np.zeros((0, 2)),) * 3), "m")


def test_cameras_are_sorted_and_filtered_by_any_figure() -> None:
    town = made_up_town()
    psnr_db = {"DJI_0000.JPG": 25.0, "DJI_0008.JPG": 19.5, "DJI_0016.JPG": 22.0}
    roles = camera_roles(town.scene.cameras, town.cloud_plan, town.edge_plans, town.held_out)
    figures = camera_figures(town.scene, roles, town.cloud_plan, psnr_db, footprints_of(town))
    assert len(figures) == 24 and set(figures.columns) == set(figures.headings)
    assert sort_rows(figures, "psnr")[:4].tolist() == [8, 16, 0, 1]
    assert sort_rows(figures, "psnr", descending=True)[:4].tolist() == [0, 16, 8, 1]
    assert sort_rows(figures, "name", descending=True)[0] == 23
    assert filter_rows(figures, "psnr < 22.5 and use = held out").tolist() == [8, 16]
    assert filter_rows(figures, "psnr != 22").tolist() == [0, 8]
    north = filter_rows(figures, "region = north")
    np.testing.assert_array_equal(north, np.flatnonzero(town.cloud_plan.edge_of_camera == 0))
    assert set(filter_rows(figures, "region != north").tolist()) == set(range(24)) - set(north.tolist())
    assert filter_rows(figures, "device ~ harbour, footprints >= 1").size > 0
    assert filter_rows(figures, "dji_0009").tolist() == [9]
    assert len(filter_rows(figures, "  ")) == 24
    distances = figures.column("distance")
    assert distances[0] == pytest.approx(np.hypot(-90 + 60, -45 + 10))
    for text, words in (("psnr < high", "is none"), ("psnr ~ 2", "is a number"), ("region < 3", "is a name"), ("psnr <", "condition"),
                        ("altitude > 3", "use one of name, region")):  # fmt: skip
        with pytest.raises(BadInput, match=words):
            filter_rows(figures, text)


def test_changes_and_constraints_are_marked() -> None:
    editor = editor_of(num_edges=4)
    cloud = editor.state.cloud
    locked = PlanConstraints(locked=("edge-1",), fixed_weights_m2={"edge-2": 3.0}, pinned={4: "edge-3", 9: "edge-3"})
    layer = constraint_layer(editor.subject.positions, cloud, locked)
    assert len(layer.points) == 2
    assert len(layer.segments) == len(cloud.borders[0]) + len(cloud.borders[1])
    assert [entry.text.split(":")[0] for entry in layer.legend] == ["Locked region", "Region with a dragged border", "Pinned camera (2)"]
    assert constraint_layer(editor.subject.positions, cloud, PlanConstraints()).legend == ()
    changed = np.zeros(120, bool)
    changed[:7] = True
    assert len(changed_layer(editor.subject.positions, changed).points) == 7
    image = render_map([region_layer(cloud), layer, changed_layer(editor.subject.positions, changed), selection_layer(np.zeros((0, 3)))])
    dark = (image == (40, 44, 52)).all(axis=2).sum()
    assert dark > 500
    rows = load_rows(cloud, editor.state.edges, editor.state.wishes.system, locked)
    assert [row.name for row in rows if row.is_edge] == ["edge-1", "edge-2", "edge-3", "edge-4"]
    assert rows[0].note == "locked" and rows[6].note == "2 pinned"
    assert sum(row.num_cameras for row in rows if not row.is_edge) == 120 == sum(row.num_cameras for row in rows if row.is_edge)
    assert max(row.share for row in rows) == 1.0
    assert all(row.time_s is None for row in load_rows(cloud, (), editor.state.wishes.system, locked) if not row.is_edge)
    assert headline(cloud).endswith(", 1.000 × bound " + headline(cloud).split("bound ")[1])
    assert certificate_text(cloud).startswith("Certified optimal")
    assert "Best around what is fixed" in certificate_text(replace(cloud, status="constrained", num_outside=1))
    assert "1 camera lies outside" in certificate_text(replace(cloud, status="constrained", num_outside=1))
    assert certificate_text(made_up_town().cloud_plan).startswith("Not certified as optimal (voronoi")
