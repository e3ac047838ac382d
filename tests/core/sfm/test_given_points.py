"""A given model without tracks or without points gets what it lacks, or the true sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.georef.control_points import ControlRequest
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.sfm.given_points import seen_points, with_points
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import cameras_of
from tests.colmap_projects import center_of, hamlet_model, moved, pointless, quiet, unseen, write_project


def test_a_model_with_tracks_stays_as_it_is(tmp_path: Path) -> None:
    model = hamlet_model()
    assert with_points(model, tmp_path, tmp_path, quiet) == (model, ())


def test_who_sees_a_point_without_tracks_is_found_by_projection(tmp_path: Path) -> None:
    truth = hamlet_model()
    model, said = with_points(unseen(truth), tmp_path, tmp_path, quiet)
    made, true = (set(map(tuple, each.observations().tolist())) for each in (model, truth))
    # Of the true observations some lie behind a roof's points in the same cell, and what projection
    # adds is what the photographs show and the mapper missed.
    assert len(made & true) > 0.9 * len(true) and len(made & true) > 0.5 * len(made)
    assert said[0].startswith("12 of 12 images of the model do not say which points they see")
    cameras = cameras_of(model)
    for index, image in enumerate(model.images):
        rows = np.searchsorted(model.points.ids, image.point3d_ids)
        local = model.points.xyz[rows] @ cameras.cam_from_world[index][:3, :3].T + cameras.cam_from_world[index][:3, 3]
        px = local @ cameras.Ks[index].T
        assert np.allclose(px[:, :2] / px[:, 2:], image.points2d, atol=1e-9)


def test_only_the_images_that_do_not_say_are_projected_into(tmp_path: Path) -> None:
    truth = hamlet_model()
    first = truth.images[0]
    tracks = truth.points.tracks[truth.points.tracks[:, 1] != first.image_id]
    blind = replace(first, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64))
    model, said = with_points(
        replace(truth, images=(blind, *truth.images[1:]), points=replace(truth.points, tracks=tracks)), tmp_path, tmp_path, quiet
    )
    assert said[0].startswith("1 of 12 images") and model.images[1:] == truth.images[1:]
    assert len(model.images[0].point3d_ids) > 20
    assert (np.diff(model.points.tracks[:, 0]) >= 0).all()


def test_a_point_behind_a_nearer_one_is_not_seen() -> None:
    """Cells of 10 px: 640 px across in 64 cells; depths of one cell within 5 %."""
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    points = np.array([[0, 0, 10.0], [0, 0, 10.4], [0, 0, 10.6], [1, 0, 30.0], [0, 0, -5.0], [9, 0, 5.0], [-6.4, -4.8, 10.0]])
    seen, px = seen_points(points, K, (640, 480))
    assert seen.tolist() == [0, 1, 3, 6] and np.allclose(px[:2], [320, 240]) and np.allclose(px[3], 0)


@pytest.mark.parametrize("change", [unseen, pointless])
def test_a_project_without_tracks_or_points_becomes_a_scene(change: Callable[[ColmapModel], ColmapModel], tmp_path: Path) -> None:
    project = write_project(tmp_path / "project", change(hamlet_model()))
    result = scene_from_colmap(project / "sparse" / "0", project / "images", tmp_path / "work", quiet)
    assert len(result.scene.cameras) == 12 and len(result.scene.points) > 300 and len(result.scene.observations) > 1000
    told = "the model has no points: " if change is pointless else "12 of 12 images of the model do not say"
    assert any(warning.startswith(told) for warning in result.warnings)
    centers = np.array([center_of(image) for image in hamlet_model().images])
    # 1e-9 m: the given poses are not adjusted.
    assert result.given_frame is not None
    assert np.allclose(result.given_frame.given_from_scene.apply(result.scene.cameras.centers), centers, atol=1e-9)
    known = hamlet_model().points.xyz
    inside = ((result.scene.points >= known.min(axis=0) - 3) & (result.scene.points <= known.max(axis=0) + 3)).all(axis=1)
    # Triangulated from 320 px: a few of small parallax lie metres off.
    assert inside.mean() > 0.9


def test_points_that_are_not_of_the_frame_of_the_poses_are_told(tmp_path: Path) -> None:
    model = unseen(hamlet_model())
    away = replace(model, points=moved(model, np.array([0, 0, 1e6])).points)
    with pytest.raises(BadInput, match=r"none of them projects into a photograph: its poses and its points are not of one frame"):
        with_points(away, tmp_path, tmp_path, quiet)


@pytest.mark.parametrize("change", [unseen, pointless])
def test_ground_control_needs_tracks(change: Callable[[ColmapModel], ColmapModel], tmp_path: Path) -> None:
    project = write_project(tmp_path / "project", change(hamlet_model()))
    places = {"a": "465287.8 5246371.9", "b": "465297.8 5246371.9", "c": "465287.8 5246381.9"}
    marks = [f"{place} 427.6 186 103 drone_{number:04d}.jpg {name}" for name, place in places.items() for number in (3, 4)]
    text = "\n".join(["EPSG:32632", *marks])
    placement = Placement(control=ControlRequest(text=text, source="gcp.txt"))
    with pytest.raises(BadInput, match="does not say which points its images see, which --gcp needs"):
        scene_from_colmap(project / "sparse" / "0", project / "images", tmp_path / "work", quiet, placement=placement)
