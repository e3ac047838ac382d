"""Masks that cancel in a sum: who sums gradients sees the sum, and noise from each device.

    q     round(x / 2^e) of all N rows, int32; e per column, from the totals before, of which every
          replica keeps the magnitudes, so that a device that comes back has the same units
    sent  q_i + Σ_{j > i} r_ij − Σ_{j < i} r_ji   (mod 2³²),   r_ij = ChaCha20(K_ij, step) on both
    Σ     of what all D send = Σ q_i (mod 2³²), exact in any order

Once per step and device, O(D N K). Bonawitz 2017 without its shares: a device that is lost in a
step takes the step with it. The step is left out and the others go on without the device
(`MaskKeys.without`), or, as in a run, wait until it is back and begin anew with new keys. A step is
never repeated with fewer devices, since who had both sums would know a gradient, nor with the same
keys. K_ij is from X25519 of the pair and a run's id; who hands on public keys is trusted to do so.

Whether a Gaussian is shown would say where cameras look, so that all rows travel, and how often it
is seen is one of the columns. What stays open: the loss and the number of views in the head, which
are sums only at the receiver; with D − 1 devices that collude with it, the gradient of the last;
with two devices, each knows the other's from the sum. `Scrutiny` cannot look at one device behind
a mask: of its rules only `check_sum`, on the sum, is left.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import ChaCha20
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.train.config import TrainConfig
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.scrutiny import tensor_lengths, tensor_names, view_limits

_HEAD = struct.Struct("<4sIQQ")
"""Mark, columns, step, Gaussians of the model; then an exponent of 16 bits for each column."""
_MARK = b"RSM1"
HEAD_ROOM_BITS = 6
"""A value may be 2⁶ times the largest of the step before; beyond it is cut."""
FIRST_MAGNITUDE = -2
"""Before the first total nothing says how large gradients are: below 2⁻²."""
LOSS_UNIT = 2.0**-20
_MOST_EXPONENT = 140


@dataclass(kw_only=True)
class MaskKeys:
    """What a device shares with each other device of its sum: 32 bytes by name; its own name is
    not among them."""

    name: str
    pairs: Mapping[str, bytes]
    next_step: int = 0
    """The first step that it has not masked yet."""

    @staticmethod
    def agree(name: str, private: X25519PrivateKey, publics: Mapping[str, bytes], run_id: str) -> MaskKeys:
        """The keys of a run, from the raw public keys of all other devices; BadInput for one that
        is none."""
        pairs = {}
        for peer, public in publics.items():
            if peer == name:
                continue
            try:
                shared = private.exchange(X25519PublicKey.from_public_bytes(public))
            except ValueError as error:
                raise BadInput(f"{peer} sends no X25519 key of 32 bytes: it has to send its public key again.") from error
            first, second = sorted((name, peer))
            info = f"radiant masks {run_id} {first} {second}".encode()
            pairs[peer] = HKDF(algorithm=SHA256(), length=32, salt=None, info=info).derive(shared)
        return MaskKeys(name=name, pairs=pairs)

    def without(self, lost: str) -> MaskKeys:
        """Those of the steps after one in which a device was lost."""
        return MaskKeys(name=self.name, pairs={name: key for name, key in self.pairs.items() if name != lost}, next_step=self.next_step)

    def mask(self, step: int, count: int) -> NDArray[np.uint32]:
        """What this device adds to `count` numbers of a step (from 0); BadInput for one that it
        has masked, or where nobody else is left."""
        if step < self.next_step:
            raise BadInput(f"{self.name} has masked step {step + 1} already: two sums of one step tell a gradient, so leave the step out.")
        if not self.pairs:
            raise BadInput(f"{self.name} has nobody to share masks with: its gradient would travel open.")
        self.next_step = step + 1
        total = np.zeros(count, np.uint32)
        # The counter of ChaCha20 begins at 0 in each step: 256 GB of one stream.
        nonce = struct.pack("<QQ", 0, step)
        for peer, key in self.pairs.items():
            stream = Cipher(ChaCha20(key, nonce), mode=None).encryptor().update(bytes(4 * count))
            pad = np.frombuffer(stream, "<u4")
            (np.add if self.name < peer else np.subtract)(total, pad, out=total)
        return total


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoint:
    """The units 2^e of the columns of a step, exponents (K,) int64: those of a layout; then how
    often a Gaussian is seen, which is whole."""

    exponents: NDArray[np.int64]

    @staticmethod
    def of(magnitudes: NDArray[np.int64], num_senders: int) -> FixedPoint:
        """Those in which `num_senders` values 2^`HEAD_ROOM_BITS` times the largest do not overflow,
        from `next_magnitudes`. All with the same totals get the same."""
        largest_bits = 31 - HEAD_ROOM_BITS - int(np.ceil(np.log2(max(num_senders, 2))))
        return FixedPoint(exponents=np.maximum(magnitudes - largest_bits, -_MOST_EXPONENT))

    def quantise(self, gradients: StepGradients, num_splats: int, num_senders: int) -> NDArray[np.int32]:
        """(N K' + 2,) of all rows, K' columns and `view_counts`, then views and loss; cut where a
        sum of `num_senders` could overflow."""
        columns = len(self.exponents) + 1
        numbers = np.zeros(num_splats * columns + 2, np.int32)
        table = numbers[:-2].reshape(num_splats, columns)
        most = (2**31 - 1) // num_senders
        wanted = np.rint(np.ldexp(gradients.values.astype(np.float64), -self.exponents))
        table[gradients.rows, :-1] = np.clip(wanted, -most, most)
        table[gradients.rows, -1] = gradients.view_counts
        numbers[-2:] = gradients.num_views, np.clip(round(gradients.loss / LOSS_UNIT), -most, most)
        return numbers

    def restore(self, numbers: NDArray[np.int32], num_splats: int) -> StepGradients:
        """What a sum of numbers stands for: the rows that are seen or not 0."""
        table = numbers[:-2].reshape(num_splats, len(self.exponents) + 1)
        rows = np.flatnonzero(table.any(axis=1))
        values = np.ldexp(table[rows, :-1].astype(np.float64), self.exponents).astype(np.float32)
        view_counts = np.clip(table[rows, -1], 0, np.iinfo(np.uint16).max).astype(np.uint16)
        num_views = int(np.clip(numbers[-2], 0, np.iinfo(np.uint16).max))
        return StepGradients(num_views=num_views, loss=float(numbers[-1]) * LOSS_UNIT, rows=rows, values=values, view_counts=view_counts)


def first_magnitudes(layout: Layout) -> NDArray[np.int64]:
    """Before the first total, (K,)."""
    return np.full(layout.num_columns, FIRST_MAGNITUDE)


def next_magnitudes(magnitudes: NDArray[np.int64], total: StepGradients, layout: Layout) -> NDArray[np.int64]:
    """m (K,), 2^(m−1) ≤ the largest |value| of a tensor < 2^m, after a total; of a tensor that is 0
    throughout as before."""
    after = magnitudes.copy()
    for columns in [*layout.columns.values(), slice(layout.growth, layout.growth + 1)]:
        largest = float(np.abs(total.values[:, columns]).max(initial=0))
        if largest > 0:
            after[columns] = np.frexp(largest)[1]
    return after


def encode_masked(gradients: StepGradients, step: int, num_splats: int, unit: FixedPoint, keys: MaskKeys) -> bytes:
    """The masked message of a device for a step (from 0); BadInput for radii on screen, whose
    largest is no sum."""
    if gradients.radii_px is not None:
        raise BadInput("radii on screen do not travel under masks: set prune_radius_px to none, or do not mask.")
    numbers = unit.quantise(gradients, num_splats, len(keys.pairs) + 1).view(np.uint32)
    masked = numbers + keys.mask(step, len(numbers))
    head = _HEAD.pack(_MARK, len(unit.exponents), step, num_splats)
    return head + unit.exponents.astype("<i2").tobytes() + masked.astype("<u4").tobytes()


def peek_masked(message: bytes | memoryview) -> tuple[int, int] | None:
    """Of which step and of how many Gaussians a masked message says it is; None: it is none."""
    if len(message) < _HEAD.size:
        return None
    mark, _, step, count = _HEAD.unpack_from(message)
    return (step, count) if mark == _MARK else None


def sum_masked(messages: Sequence[bytes], step: int, num_splats: int, num_columns: int) -> tuple[NDArray[np.uint32], FixedPoint]:
    """Σ mod 2³² of the numbers of messages of one step and model, and their units; BadInput where
    one is not, or has other units."""
    count = num_splats * (num_columns + 1) + 2
    start = _HEAD.size + 2 * num_columns
    total, units = np.zeros(count, np.uint32), set[bytes]()
    for message in messages:
        if len(message) != start + 4 * count:
            raise BadInput(f"masked gradients are {len(message)} bytes, expected {start + 4 * count}.")
        mark, columns, of_step, of_count = _HEAD.unpack_from(message)
        if (mark, columns, of_step, of_count) != (_MARK, num_columns, step, num_splats):
            raise BadInput(f"masked gradients are of step {of_step} and {of_count} Gaussians, expected step {step} and {num_splats}.")
        units.add(bytes(message[_HEAD.size : start]))
        total += np.frombuffer(message, "<u4", count, start)
    if len(units) != 1:
        raise BadInput(f"masked gradients of step {step + 1} are in {len(units)} units, expected one of all.")
    exponents = np.frombuffer(units.pop(), "<i2").astype(np.int64)
    if np.abs(exponents).max(initial=0) > _MOST_EXPONENT:
        raise BadInput(f"masked gradients have units up to 2^{np.abs(exponents).max()}, expected 2^{_MOST_EXPONENT} at most.")
    return total, FixedPoint(exponents=exponents)


def unmask_sum(messages: Mapping[str, bytes], senders: Sequence[str], step: int, num_splats: int, layout: Layout) -> StepGradients:
    """The sum of a step whose masks cancel. BadInput where a sender is missing: masks stay then,
    and the step is left out."""
    missing = [name for name in senders if name not in messages]
    if missing:
        raise BadInput(f"nothing of {', '.join(missing)} came, and masks cancel only in the sum of all: the step is left out.")
    total, unit = sum_masked([messages[name] for name in senders], step, num_splats, layout.num_columns)
    return unit.restore(total.view(np.int32), num_splats)


def check_sum(total: StepGradients, most_views: int, config: TrainConfig, layout: Layout) -> str | None:
    """Why the sum of a step counts for nothing, in words, or None: all that can be looked at under
    masks, where one device that lies takes the step of all with it."""
    if not 0 < total.num_views <= most_views:
        return f"the sum is of {total.num_views} views, expected 1 to {most_views}"
    if len(total.view_counts) and int(total.view_counts.max()) > total.num_views:
        return f"a Gaussian is seen in {int(total.view_counts.max())} of {total.num_views} views"
    lengths = tensor_lengths(total.values, layout) / total.num_views
    wrong = np.flatnonzero(~(lengths <= view_limits(config, layout)))
    if len(wrong):
        return f"{tensor_names(layout)[wrong[0]]} of the sum are longer than photographs cause"
    return None
