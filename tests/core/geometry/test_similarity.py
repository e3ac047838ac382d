"""A moved model is the same model seen from moved cameras: in colours, in shape, in pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats, sh_basis, sh_rotation
from radiant_core.numerics import rotmats_from_quats
from radiant_core.render.harmonics import basis_values
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_BASES, Splats
from tests.core.scenes import cameras_above, ground_splats


def some_sim3(seed: int, *, scale: float = 1.7, far_m: float = 30.0) -> Sim3:
    rng = np.random.default_rng(seed)
    return Sim3(scale=scale, rotation=Rotation.from_quat(rng.normal(size=4)).as_matrix(), translation=rng.normal(scale=far_m, size=3))


def some_splats(degree: int, count: int = 200, seed: int = 0) -> Splats:
    """Oblong Gaussians on bumpy ground, of view-dependent colour, quaternions of any length."""
    rng = np.random.default_rng(seed)
    ground = ground_splats(count, seed=seed)
    return Splats(
        means=ground.means,
        quats=rng.normal(size=(count, 4)) * np.exp(rng.normal(size=(count, 1))),
        log_scales=ground.log_scales + rng.normal(scale=0.4, size=(count, 3)),
        logit_opacities=rng.normal(loc=1.0, size=count),
        sh0=ground.sh0,
        shN=rng.normal(scale=0.15, size=(count, SH_BASES[degree] - 1, 3)),
    )


def colors(splats: Splats, directions: np.ndarray) -> np.ndarray:
    """Σ Y_k f_k (D,N,3) along directions (D,3), in float64, not clamped."""
    values = basis_values(torch.from_numpy(directions), splats.sh_degree).numpy()
    return np.einsum("dk,nkc->dnc", values, np.concatenate([splats.sh0, splats.shN], axis=1).astype(np.float64))


def covariances(splats: Splats) -> np.ndarray:
    axes = rotmats_from_quats(splats.quats) * np.exp(splats.log_scales.astype(np.float64))[:, None]
    return axes @ axes.transpose(0, 2, 1)


def unit_vectors(count: int, seed: int = 5) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_the_basis_is_the_rasterizers() -> None:
    directions = unit_vectors(50)
    bands = [sh_basis(directions, degree) for degree in range(4)]
    np.testing.assert_allclose(np.concatenate(bands, axis=1), basis_values(torch.from_numpy(directions), 3).numpy(), atol=1e-15)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rotations_of_harmonics_are_orthogonal_and_compose(degree: int) -> None:
    a, b = some_sim3(1).rotation, some_sim3(2).rotation
    turned = sh_rotation(a, degree)
    # 1e-13: a least-squares solution of 64 equations in float64.
    np.testing.assert_allclose(turned @ turned.T, np.eye(2 * degree + 1), atol=1e-13)
    np.testing.assert_allclose(sh_rotation(a @ b, degree), turned @ sh_rotation(b, degree), atol=1e-13)
    np.testing.assert_allclose(sh_rotation(np.eye(3), degree), np.eye(2 * degree + 1), atol=1e-13)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colours_turn_with_the_model(degree: int) -> None:
    splats, move = some_splats(degree), some_sim3(3)
    directions = unit_vectors(40)
    moved = move_splats(splats, move)
    # 1e-6: coefficients of about 1 rounded to float32 once (6e-8), 16 of them summed.
    assert np.abs(colors(moved, directions @ move.rotation.T) - colors(splats, directions)).max() < 1e-6


def test_shapes_and_places_turn_grow_and_shift() -> None:
    splats, move = some_splats(2), some_sim3(4)
    moved = move_splats(splats, move)
    expected = move.scale**2 * move.rotation @ covariances(splats) @ move.rotation.T
    # 2e-6 of the largest entry: quaternions and log scales rounded to float32.
    assert np.abs(covariances(moved) - expected).max() < 2e-6 * np.abs(expected).max()
    np.testing.assert_allclose(moved.means, move.apply(splats.means), rtol=1e-6)
    np.testing.assert_array_equal(moved.logit_opacities, splats.logit_opacities)
    np.testing.assert_allclose(np.linalg.norm(moved.quats, axis=1), np.linalg.norm(splats.quats, axis=1), rtol=1e-6)


def test_two_moves_are_their_product_and_the_inverse_undoes() -> None:
    splats, first, second = some_splats(3), some_sim3(5), some_sim3(6, scale=0.3)
    product = Sim3(
        scale=second.scale * first.scale, rotation=second.rotation @ first.rotation, translation=second.apply(first.translation[None])[0]
    )
    for got, expected in [
        (move_splats(move_splats(splats, first), second), move_splats(splats, product)),
        (move_splats(move_splats(splats, first), first.inverse()), splats),
    ]:
        # 100 m in float32 between the two moves.
        np.testing.assert_allclose(got.means, expected.means, atol=2e-5)
        np.testing.assert_allclose(covariances(got), covariances(expected), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(got.shN, expected.shN, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 3])
def test_pictures_of_the_moved_model_by_moved_cameras_are_the_same(degree: int) -> None:
    # Opacity 0.6 throughout, so that no pixel stops at the transmittance cut, where a last bit
    # decides whether a Gaussian is drawn.
    splats = Splats(**{**some_splats(degree, 120).arrays(), "logit_opacities": np.full(120, 0.4)})
    cameras, move = cameras_above([(-1, 0), (2, 1)]), some_sim3(7)
    move_cameras = Cameras(
        names=cameras.names, Ks=cameras.Ks, cam_from_world=move.apply_to_poses(cameras.cam_from_world), sizes_wh=cameras.sizes_wh
    )
    # The rasterizer dilates in pixels and cuts at fixed α, so a similarity changes nothing but
    # rounding, and α_min steps of 1/255 · w.
    moved = move_splats(splats, move)
    for before, after in zip(render_views(splats, cameras), render_views(moved, move_cameras), strict=True):
        difference = np.abs(before.image - after.image).max(axis=2)
        # A Gaussian whose α crosses 1/255 between the two roundings jumps by that; such pixels are
        # few.
        jumps = difference > 1e-4
        assert jumps.mean() < 2e-3 and difference.max() < 2 / 255
        seen = before.alpha > 0.05
        np.testing.assert_allclose(after.depth[seen], move.scale * before.depth[seen], rtol=5e-3)


def test_a_model_far_away_moves_in_float64() -> None:
    # 5e6 m: float32 alone would round s R x and t apart to 0.5 m each before they cancel.
    near = some_splats(0, 20)
    far = Sim3(scale=1.0, rotation=np.eye(3), translation=np.array([5e6, -4e6, 0.0]))
    there = Splats(**{**near.arrays(), "means": far.apply(near.means)})
    turn = some_sim3(8)
    back = Sim3(scale=turn.scale, rotation=turn.rotation, translation=-turn.scale * turn.rotation @ far.translation)
    exact = turn.scale * (there.means.astype(np.float64) - far.translation) @ turn.rotation.T
    np.testing.assert_allclose(move_splats(there, back).means, exact, atol=1e-6)


def test_zero_tiny_and_huge_quaternions_stay_drawable() -> None:
    splats = some_splats(0, 4)
    quats = np.array([[0, 0, 0, 0], [3e-41, 1e-41, 0, 0], [3e38, 3e38, 3e38, 3e38], [1, 0, 0, 0]], np.float32)
    splats = Splats(**{**splats.arrays(), "quats": quats})
    move = some_sim3(9)
    turned = rotmats_from_quats(move_splats(splats, move).quats)
    # 1e-6: even the shortest keeps the direction that its few bits give.
    np.testing.assert_allclose(turned, move.rotation @ rotmats_from_quats(quats), atol=1e-6)


def test_what_leaves_float32_is_refused_and_nothing_is_no_problem() -> None:
    splats = some_splats(1, 3)
    with pytest.raises(BadInput, match="beyond float32"):
        move_splats(splats, Sim3(scale=1.0, rotation=np.eye(3), translation=np.array([0, 1e39, 0])))
    with pytest.raises(BadInput, match="beyond float32"):
        move_splats(splats, Sim3(scale=1e300, rotation=np.eye(3), translation=np.zeros(3)))
    assert len(move_splats(splats.select(np.zeros(3, bool)), some_sim3(10))) == 0


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_any_scale_shifts_the_log_scales_alone(scale: float) -> None:
    splats = some_splats(3, 10)
    moved = move_splats(splats, Sim3(scale=scale, rotation=np.eye(3), translation=np.zeros(3)))
    np.testing.assert_allclose(moved.log_scales, splats.log_scales + np.log(scale), rtol=1e-6)
    np.testing.assert_allclose(moved.shN, splats.shN, atol=1e-7)
