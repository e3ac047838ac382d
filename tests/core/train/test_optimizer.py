"""Adam over visible rows, against torch's, dense or on the steps that saw a row; poison."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from torch import Tensor

from radiant_core import _native
from radiant_core.errors import BadInput, StageFailed
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.optimizer import SelectiveAdam

SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (1, 3), "shN": (15, 3)}
RATES = {"means": 1e-3, "quats": 5e-3, "log_scales": 2e-2, "logit_opacities": 0.1, "sh0": 2e-2, "shN": 1e-3}
N = 203  # no multiple of any vector


def tensors(dtype: torch.dtype = torch.float32, num_rows: int = N) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {name: torch.randn(num_rows, *shape, generator=generator, dtype=torch.float64).to(dtype) for name, shape in SHAPES.items()}


def gradients(step: int, num_rows: int = N) -> dict[str, Tensor]:
    """Gradients over twelve powers of ten, some of them zero: what rendering gives."""
    generator = torch.Generator().manual_seed(100 + step)
    found = {}
    for name, shape in SHAPES.items():
        size = 10 ** (-12 * torch.rand(num_rows, *shape, generator=generator))
        found[name] = size * torch.randn(num_rows, *shape, generator=generator) * (torch.rand(num_rows, *shape, generator=generator) > 0.1)
    return found


def visible_rows(step: int, num_rows: int = N) -> Tensor:
    """Runs of rows and single ones; row 0 always, row 1 never."""
    generator = torch.Generator().manual_seed(step)
    visible = (torch.rand(num_rows // 7 + 1, generator=generator) < 0.4).repeat_interleave(7)[:num_rows]
    visible ^= torch.rand(num_rows, generator=generator) < 0.1
    visible[0], visible[1] = True, False
    return visible


def set_gradients(parameters: dict[str, Tensor], step: int) -> None:
    for name, gradient in gradients(step, len(parameters["means"])).items():
        parameters[name].grad = gradient.to(parameters[name].dtype)


def torch_adam(parameters: dict[str, Tensor]) -> torch.optim.Adam:
    groups = [{"params": [tensor.requires_grad_()], "lr": RATES[name]} for name, tensor in parameters.items()]
    return torch.optim.Adam(groups, eps=1e-15)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dense_is_torchs_adam_over_a_hundred_steps(dtype: torch.dtype) -> None:
    ours, theirs = tensors(dtype), tensors(dtype)
    adam, twin = SelectiveAdam(ours, RATES), torch_adam(theirs)
    for step in range(100):
        set_gradients(ours, step)
        set_gradients(theirs, step)
        rate = RATES["means"] * 0.01 ** (step / 100)
        adam.set_rate("means", rate)
        twin.param_groups[0]["lr"] = rate
        adam.step()
        twin.step()
    for name in SHAPES:
        # A hundred steps of at most the rate, each rounded in float32.
        torch.testing.assert_close(ours[name], theirs[name], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [1e30, -1e30])
def test_gradients_count_as_at_most_1e18_either_way(size: float, dtype: torch.dtype) -> None:
    ours = tensors(dtype, 3)
    adam = SelectiveAdam(ours, RATES)
    for tensor in ours.values():
        tensor.grad = torch.full_like(tensor, size)
    adam.step()
    for name in SHAPES:
        first, second = adam.moments(name)
        torch.testing.assert_close(first, torch.full_like(first, 1e17 if size > 0 else -1e17))
        torch.testing.assert_close(second, torch.full_like(second, 1e33))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_row_moves_as_torchs_adam_on_the_steps_that_saw_it(dtype: torch.dtype) -> None:
    ours = tensors(dtype, 30)
    adam = SelectiveAdam(ours, RATES)
    rows = [{name: tensor[row : row + 1].clone() for name, tensor in tensors(dtype, 30).items()} for row in range(30)]
    twins = [torch_adam(row) for row in rows]
    for step in range(40):
        set_gradients(ours, step)
        visible = visible_rows(step, 30)
        for row in visible.nonzero().flatten().tolist():
            for name, tensor in rows[row].items():
                gradient = ours[name].grad
                assert gradient is not None
                tensor.grad = gradient[row : row + 1].clone()
            twins[row].step()
        adam.step(visible)
    for name in SHAPES:
        torch.testing.assert_close(ours[name], torch.cat([row[name] for row in rows]), rtol=1e-6, atol=1e-6)


def test_rows_not_seen_keep_every_bit() -> None:
    ours = tensors()
    adam = SelectiveAdam(ours, RATES)
    for step in range(5):
        set_gradients(ours, step)
        for tensor in ours.values():
            assert tensor.grad is not None
            tensor.grad[1] = torch.nan  # of a row that is not moved, nothing is read
        before = {name: [t.detach().clone() for t in (tensor, *adam.moments(name))] for name, tensor in ours.items()}
        visible = visible_rows(step)
        adam.step(visible)
        for name, tensor in ours.items():
            for old, new in zip(before[name], (tensor.detach(), *adam.moments(name)), strict=True):
                assert torch.equal(old[~visible], new[~visible])
        assert (ours["means"][0] != before["means"][0][0]).any()


def test_all_rows_visible_is_the_same_as_dense_to_the_last_bit() -> None:
    dense, selective = tensors(), tensors()
    adams = SelectiveAdam(dense, RATES), SelectiveAdam(selective, RATES)
    for step in range(10):
        for parameters, adam, visible in zip((dense, selective), adams, (None, torch.ones(N, dtype=torch.bool)), strict=True):
            set_gradients(parameters, step)
            adam.step(visible)
    for name in SHAPES:
        assert torch.equal(dense[name], selective[name])


def test_threads_and_runs_do_not_change_a_bit() -> None:
    num_rows = 12_000  # enough for four threads to be worth starting
    before = torch.get_num_threads()
    results = []
    try:
        for num_threads in (1, 2, 16):
            torch.set_num_threads(num_threads)
            ours = tensors(num_rows=num_rows)
            adam = SelectiveAdam(ours, RATES)
            for step in range(3):
                set_gradients(ours, step)
                adam.step(visible_rows(step, num_rows))
            results.append(ours)
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        for name in SHAPES:
            assert torch.equal(results[0][name], other[name])


@pytest.mark.parametrize("build", _native.instruction_sets())
def test_every_build_takes_torchs_step(build: str) -> None:
    x, g = tensors()["shN"], gradients(0)["shN"]
    m, v = torch.zeros_like(x), torch.zeros_like(x)
    factors = torch.tensor([10.0]), torch.tensor([1 / np.sqrt(0.001)], dtype=torch.float32)
    twin = x.clone().requires_grad_()
    twin.grad = g
    torch.optim.Adam([twin], lr=1e-2, eps=1e-15).step()
    _native.adam_step(x, g, m, v, None, None, *factors, 1, 1e-2, 0.9, 0.999, 1e-15, 1, build)
    torch.testing.assert_close(x, twin.detach(), rtol=1e-6, atol=1e-7)


class TestPoison:
    @pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @pytest.mark.parametrize("selective", [False, True])
    def test_in_the_last_tensor_changes_nothing_in_any(self, poison: float, dtype: torch.dtype, selective: bool) -> None:
        ours = tensors(dtype)
        adam = SelectiveAdam(ours, RATES)
        visible = torch.arange(N) != 1 if selective else None
        set_gradients(ours, 0)
        adam.step(visible)
        before = {name: [t.detach().clone() for t in (tensor, *adam.moments(name))] for name, tensor in ours.items()}
        set_gradients(ours, 1)
        assert ours["shN"].grad is not None
        ours["shN"].grad[7, 14, 2] = ours["shN"].grad[200, 0, 0] = poison
        with pytest.raises(StageFailed, match=r"gradient of shN has 2 values that are not finite, the first at index \(7, 14, 2\)"):
            adam.step(visible)
        for name, tensor in ours.items():
            for old, new in zip(before[name], (tensor.detach(), *adam.moments(name)), strict=True):
                assert torch.equal(old, new)
        # The step that failed does not count: going on is as if it had not been.
        other = tensors(dtype)
        twin = SelectiveAdam(other, RATES)
        for step in (0, 1):
            set_gradients(other, step)
            twin.step(visible)
        set_gradients(ours, 1)
        adam.step(visible)
        assert all(torch.equal(ours[name], other[name]) for name in SHAPES)

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @pytest.mark.parametrize("size", [1e-45, 1e-40, 1e-25, 1e18, 1e20, -3e38])
    def test_denormal_and_huge_gradients_leave_finite_rows(self, size: float, dtype: torch.dtype) -> None:
        ours = tensors(dtype)
        adam = SelectiveAdam(ours, RATES)
        for _ in range(3):
            for tensor in ours.values():
                tensor.grad = torch.full_like(tensor, size)
            adam.step()
        for name, tensor in ours.items():
            assert all(torch.isfinite(t).all() for t in (tensor, *adam.moments(name)))
            # Three steps of the learning rate, as for any other constant gradient.
            if abs(size) >= 1e18:
                moved = (tensors(dtype)[name] - tensor.detach()).abs()
                assert float(moved.min()) == pytest.approx(3 * RATES[name], rel=1e-3)

    def test_bad_calls_are_named(self) -> None:
        with pytest.raises(BadInput, match="differ in rows: means"):
            SelectiveAdam({"means": torch.zeros(3, 3), "quats": torch.zeros(4, 4)}, RATES)
        with pytest.raises(BadInput, match="learning rate of means is 0"):
            SelectiveAdam({"means": torch.zeros(3, 3)}, {"means": 0.0})
        with pytest.raises(BadInput, match="means is not contiguous"):
            SelectiveAdam({"means": torch.zeros(3, 4).T}, RATES)
        for eps in (0.0, -1e-8, 1e-60, np.nan, np.inf):
            with pytest.raises(BadInput, match="eps is"):
                SelectiveAdam({"means": torch.zeros(3, 3)}, RATES, eps=eps)
        for rate in (0.0, -1e-3, np.nan, np.inf):
            with pytest.raises(BadInput, match="learning rate of means is"):
                SelectiveAdam({"means": torch.zeros(3, 3)}, RATES).set_rate("means", rate)
        with pytest.raises(BadInput, match=r"visible is \(4,\) torch.bool, expected \(3,\)"):
            SelectiveAdam({"means": torch.zeros(3, 3)}, RATES).step(torch.ones(4, dtype=torch.bool))

    @pytest.mark.parametrize("other", [torch.zeros(3, 4).T, torch.zeros(6, 3)])
    def test_a_tensor_that_was_swapped_under_the_optimizer_is_named(self, other: Tensor) -> None:
        means = torch.zeros(4, 3)
        adam = SelectiveAdam({"means": means}, RATES)
        means.data = other
        means.grad = torch.ones_like(other)
        with pytest.raises(BadInput, match="means was changed to"):
            adam.step()

    def test_results_are_never_written_into_a_converted_copy(self) -> None:
        x, factors = torch.zeros(4, 3), torch.ones(1)
        for wrong in (x.double(), torch.zeros(3, 4).T):
            with pytest.raises(TypeError, match="incompatible function arguments"):
                _native.adam_step(wrong, x, x.clone(), x.clone(), None, None, factors, factors, 1, 1e-2, 0.9, 0.999, 1e-15)

    def test_steps_below_one_are_refused(self) -> None:
        x, factors, runs = torch.zeros(4, 3), torch.ones(5), np.array([[0, 4]], np.int32)
        steps = torch.full((4,), -2_000_000_000, dtype=torch.int32)
        with pytest.raises(ValueError, match="steps has -2000000000 at index 0"):
            _native.adam_step(x, x.clone(), x.clone(), x.clone(), runs, steps, factors, factors, 1, 1e-2, 0.9, 0.999, 1e-15)

    def test_runs_of_another_rank_are_refused(self) -> None:
        with pytest.raises(ValueError, match="runs has shape"):
            _native.find_not_finite(torch.zeros(8, 3), np.array(3, np.int32))

    @pytest.mark.parametrize("runs", [[[2, 1]], [[0, 9]], [[-1, 2]], [[2, 4], [3, 5]]])
    def test_runs_beyond_the_rows_are_refused(self, runs: list[list[int]]) -> None:
        with pytest.raises(ValueError, match="expected ascending rows below 8"):
            _native.find_not_finite(torch.zeros(8, 3), np.array(runs, np.int32))


def test_a_graph_whose_tensors_have_moved_is_refused() -> None:
    x = torch.ones(4, 3)
    adam = SelectiveAdam({"means": x}, RATES)
    loss = x.square().sum()
    loss.backward(retain_graph=True)
    adam.step()
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_nothing_visible_and_nothing_at_all_are_no_errors() -> None:
    ours = tensors()
    before = copy.deepcopy(ours)
    adam = SelectiveAdam(ours, RATES)
    set_gradients(ours, 0)
    adam.step(torch.zeros(N, dtype=torch.bool))
    assert all(torch.equal(ours[name].detach(), before[name]) for name in SHAPES)
    SelectiveAdam({}, {}).step()
    empty = {name: torch.zeros(0, *shape) for name, shape in SHAPES.items()}
    adam = SelectiveAdam(empty, RATES)
    for tensor in empty.values():
        tensor.grad = torch.zeros_like(tensor)
    adam.step(torch.zeros(0, dtype=torch.bool))


def test_presets_that_promise_plain_3dgs_are_dense_and_so_is_what_was_best() -> None:
    assert all(train_preset(name).adam == "dense" for name in ("draft", "default", "standard", "paper"))
    with pytest.raises(BadInput, match="adam is 'sparse'"):
        TrainConfig(adam="sparse")  # pyright: ignore[reportArgumentType]


def test_rows_that_are_chosen_keep_moments_and_counts_and_fresh_ones_begin_anew() -> None:
    """After a selection each old row goes on as if always there, each fresh one as in a new run."""
    whole = tensors()
    adam = SelectiveAdam(whole, RATES)
    for step in range(5):
        set_gradients(whole, step)
        adam.step(visible_rows(step))
    rows = torch.tensor([7, 3, 3, 0, N - 1])
    fresh = torch.tensor([False, False, True, False, False])
    chosen = {name: tensor.detach()[rows].clone() for name, tensor in whole.items()}
    before = {name: [moments.clone() for moments in adam.moments(name)] for name in SHAPES}
    adam.select_rows(chosen, rows, fresh)
    for name in SHAPES:
        for now, old in zip(adam.moments(name), before[name], strict=True):
            torch.testing.assert_close(now, torch.where(fresh.view(-1, *(1,) * (old.ndim - 1)), 0, old[rows]), rtol=0, atol=0)
    anew = {name: tensor.detach()[2:3].clone() for name, tensor in chosen.items()}
    twin = SelectiveAdam(anew, RATES)
    for step in range(5, 9):
        found = gradients(step)
        for name in SHAPES:
            whole[name].grad, chosen[name].grad, anew[name].grad = found[name], found[name][rows].clone(), found[name][rows[2:3]].clone()
        adam.step(torch.ones(len(rows), dtype=torch.bool))
        twin.step(torch.ones(1, dtype=torch.bool))
    for name in SHAPES:
        torch.testing.assert_close(chosen[name][2:3], anew[name], rtol=1e-6, atol=1e-7)
        # The same row, one with its history and one without.
        assert not torch.equal(chosen[name][1], chosen[name][2])


def test_a_selection_that_does_not_fit_changes_nothing() -> None:
    whole = tensors(num_rows=4)
    adam = SelectiveAdam(whole, RATES)
    rows, fresh = torch.tensor([0, 1]), torch.tensor([False, False])
    part = {name: tensor.detach()[:3].clone() for name, tensor in whole.items()}
    with pytest.raises(BadInput, match="other than 2 rows"):
        adam.select_rows(part, rows, fresh)
    assert adam.moments("means")[0].shape == (4, 3)
