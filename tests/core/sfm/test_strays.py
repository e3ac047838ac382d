"""Images whose place is not to be believed are found, and placed again among the others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from radiant_core.decisions import Decision
from radiant_core.geometry.align import compare_centers
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.listing import Photograph, list_photographs
from radiant_core.sfm import attempts
from radiant_core.sfm.colmap import mapping
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.epipolar import epipolar_errors
from radiant_core.sfm.colmap.mapping import MappingJob, map_photographs
from radiant_core.sfm.colmap.pairs import Pairs
from radiant_core.sfm.colmap.strays import agreeing_matches, contradicted, remove, without_strays
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress
from radiant_core.sfm.reconstruct import reconstruct
from radiant_core.sfm.world_frame.world import cameras_of

QUICK = SfmConfig(max_image_size_px=640, max_num_features=1500, num_threads=1)


def quiet(_: SfmProgress) -> None:
    pass


@pytest.fixture(scope="module")
def placed(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The work folder of the hamlet's structure from motion."""
    work = tmp_path_factory.mktemp("work")
    reconstruct(hamlet / "images", work, QUICK, quiet)
    return work


def names_of(model: pycolmap.Reconstruction) -> set[str]:
    return {model.image(image_id).name for image_id in model.reg_image_ids()}


def left(photos: tuple[Photograph, ...], work: Path, model: pycolmap.Reconstruction) -> set[str]:
    remove(model, contradicted(model, work / "database.db"))
    kept = without_strays(model, photos, 0)
    assert kept is not None
    return names_of(kept)


def displace(model: pycolmap.Reconstruction, image_id: int) -> None:
    """Move an image 30 m aside and turn it by 40°; its points stay where they are."""
    frame = model.frame(model.image(image_id).frame_id)
    pose = frame.rig_from_world
    assert pose is not None
    turned = Rotation.from_euler("z", 40, degrees=True).as_matrix() @ pose.rotation.matrix()
    frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(turned), np.add(pose.translation, [30.0, 0.0, 0.0]))


def test_an_image_that_sees_almost_nothing_is_a_stray(hamlet: Path, placed: Path) -> None:
    model = pycolmap.Reconstruction(placed / "sparse")
    stray = model.image(sorted(model.reg_image_ids())[3])
    for index, point in enumerate(stray.points2D):
        if point.has_point3D():
            model.delete_observation(stray.image_id, index)
    photos = list_photographs(hamlet / "images").photographs
    assert left(photos, placed, model) == names_of(pycolmap.Reconstruction(placed / "sparse")) - {stray.name}


def test_images_that_hang_on_to_no_other_are_strays(hamlet: Path, placed: Path) -> None:
    model = pycolmap.Reconstruction(placed / "sparse")
    photos = list_photographs(hamlet / "images").photographs
    apart = set(sorted(model.reg_image_ids())[:3])
    tracks = [[(element.image_id, element.point2D_idx) for element in point.track.elements] for point in model.points3D.values()]
    shared = [track for track in tracks if 0 < sum(image_id in apart for image_id, _ in track) < len(track)]
    # The three keep what only they see, and 14 points in common with the others: one too few.
    for track in shared[14:]:
        theirs = [observation for observation in track if observation[0] in apart]
        others = [observation for observation in track if observation[0] not in apart]
        for image_id, index in others if len(theirs) > 1 else theirs:
            if model.image(image_id).points2D[index].has_point3D():
                model.delete_observation(image_id, index)
    assert all(model.image(image_id).num_points3D > 60 for image_id in apart)
    names = {model.image(image_id).name for image_id in apart}
    assert left(photos, placed, model) == names_of(pycolmap.Reconstruction(placed / "sparse")) - names


def job_of(hamlet: Path, placed: Path, folder: Path) -> MappingJob:
    """Mapping of the hamlet's matches again, all pairs of which are known."""
    photos = list_photographs(hamlet / "images").photographs
    shutil.copy(placed / "database.db", folder / "database.db")
    return MappingJob(
        photo_folder=hamlet / "images",
        photographs=photos,
        database=folder / "database.db",
        pairs=[(a.name, b.name) for index, a in enumerate(photos) for b in photos[index + 1 :]],
        work_folder=folder / "models",
        config=QUICK,
        report=quiet,
    )


def test_all_images_of_a_right_model_agree_with_their_matches(hamlet: Path, placed: Path) -> None:
    model = pycolmap.Reconstruction(placed / "sparse")
    pairs, num_matches, num_agreeing = agreeing_matches(model, placed / "database.db")
    assert len(pairs) > 20 and num_agreeing.sum() > 0.95 * num_matches.sum()
    assert left(list_photographs(hamlet / "images").photographs, placed, model) == names_of(pycolmap.Reconstruction(placed / "sparse"))


def test_a_misplaced_image_with_many_points_is_found_and_placed_anew(
    hamlet: Path, placed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = list_photographs(hamlet / "images").photographs
    model = pycolmap.Reconstruction(placed / "sparse")
    image_id = sorted(model.reg_image_ids())[4]
    name = model.image(image_id).name
    displace(model, image_id)
    assert model.image(image_id).num_points3D > 100
    assert left(photos, placed, pycolmap.Reconstruction(model)) == names_of(model) - {name}

    # Mapping starts from the wrong model, as if a few wrong matches had placed the image first.
    incremental = mapping.incremental_model
    monkeypatch.setattr(mapping, "incremental_model", lambda job, folder, begun=None: incremental(job, folder, begun) if begun else model)
    job = job_of(hamlet, placed, tmp_path)
    mapped = map_photographs(job)
    assert mapped is not None and name in names_of(mapped.model)
    assert "without 1 that had been misplaced: taken" in mapped.decisions[0].choice
    known = cameras_of(read_model(hamlet / "known"))
    names = sorted(names_of(mapped.model))
    centers = [image.projection_center() for image in sorted(mapped.model.images.values(), key=lambda image: image.name) if image.has_pose]
    assert compare_centers(np.array(centers), known.named(names).centers).max_percent < 2.0


def test_mapping_decodes_no_photograph(hamlet: Path, placed: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    model = mapping.incremental_model(replace(job_of(hamlet, placed, tmp_path), photo_folder=tmp_path / "empty"), "incremental")
    assert model is not None and model.num_reg_images() == pycolmap.Reconstruction(placed / "sparse").num_reg_images()
    # Triangulating reads them, once the poses are final.
    assert not any(point.color.any() for point in model.points3D.values())
    assert any(point.color.any() for point in pycolmap.Reconstruction(placed / "sparse").points3D.values())


def test_where_many_are_contradicted_none_is_taken_out_and_all_are_named(
    hamlet: Path, placed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = pycolmap.Reconstruction(placed / "sparse")
    moved = sorted(model.reg_image_ids())[:3]
    for image_id in moved:
        displace(model, image_id)
    monkeypatch.setattr(mapping, "incremental_model", lambda job, folder, begun=None: model)
    mapped = map_photographs(job_of(hamlet, placed, tmp_path))
    assert mapped is not None and mapped.model.num_reg_images() == len(names_of(pycolmap.Reconstruction(placed / "sparse")))
    assert set(mapped.doubted) >= {model.image(image_id).name for image_id in moved}


def test_an_epipolar_error_is_the_least_shift_of_both_points_that_makes_them_meet() -> None:
    rng = np.random.default_rng(0)
    turn = Rotation.from_euler("xyz", [3, -12, 20], degrees=True).as_matrix()
    relative = np.eye(4)
    relative[:3, :3], relative[:3, 3] = turn, [2.0, 0.3, -0.2]
    points = rng.uniform([-4, -4, 8], [4, 4, 20], (20, 3))
    first = points / points[:, 2:]
    moved = points @ turn.T + relative[:3, 3]
    second = moved / moved[:, 2:]
    np.testing.assert_allclose(epipolar_errors(relative, first, second), 0, atol=1e-12)
    x, y, z = relative[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    noisy = second + np.column_stack([rng.normal(0, 0.004, (20, 2)), np.zeros(20)])
    errors = epipolar_errors(relative, first, noisy)
    for row in range(20):

        def meet(shift: np.ndarray, row: int = row) -> float:
            a, b = first[row] + [*shift[:2], 0], noisy[row] + [*shift[2:], 0]
            return float(b @ essential @ a)

        least = minimize(lambda shift: shift @ shift * 1e4, np.zeros(4), constraints={"type": "eq", "fun": meet}, tol=1e-14)
        assert errors[row] == pytest.approx(np.linalg.norm(least.x), rel=0.02, abs=1e-6)
    with np.errstate(all="raise"):
        assert np.isnan(epipolar_errors(np.eye(4), first, noisy)).all()


def test_where_the_short_way_loses_photographs_all_is_done_again_thoroughly(
    hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_promising = attempts.keep_promising

    def keep_few(database: Path, pairs: Pairs, config: SfmConfig, report: Report) -> tuple[Pairs, tuple[Decision, ...]]:
        kept, decisions = keep_promising(database, pairs, config, report)
        names = {pair[0] for pair in kept[:8]}
        return [pair for pair in kept if names.issuperset(pair)] if config.effort == "auto" else kept, decisions

    monkeypatch.setattr(attempts, "keep_promising", keep_few)
    keep_related = mapping.keep_related
    monkeypatch.setattr(mapping, "keep_related", lambda *given: [] if given[2].effort == "auto" else keep_related(*given))
    result = reconstruct(hamlet / "images", tmp_path, replace(QUICK, mapper="incremental"), quiet)
    efforts = [decision.choice for decision in result.decisions if decision.topic == "effort"]
    assert efforts == ["done again thoroughly, and taken"]
    assert len(result.scene.cameras) >= len(list((hamlet / "images").iterdir())) - 1


@pytest.mark.parametrize("least", [0.0, 0.5, 0.6, 0.99])
def test_what_is_left_agrees_with_at_least_the_share_that_was_asked_for(least: float, placed: Path) -> None:
    model = pycolmap.Reconstruction(placed / "sparse")
    displace(model, sorted(model.reg_image_ids())[2])
    gone = contradicted(model, placed / "database.db", least)
    assert bool(gone) == (least > 0)
    pairs, num_matches, num_agreeing = agreeing_matches(model, placed / "database.db")
    kept = ~np.isin(pairs, gone).any(axis=1)
    for image_id in np.unique(pairs[kept]):
        own = kept & (pairs == image_id).any(axis=1)
        assert num_agreeing[own].sum() >= least * num_matches[own].sum()
