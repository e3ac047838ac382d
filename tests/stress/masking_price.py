"""What masks cost: python -m tests.stress.masking_price [SCENE --px 96 --views 900].

First bytes and milliseconds of a step of six devices with 20,000 rows of 24 columns, of 60,000 Gaussians: masked,
open, and the checks of `scrutiny.py`. Then, with SCENE, PSNR of a group of six trained open and masked.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.together.codec import decode_gradients, encode_gradients
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.masking import FixedPoint, MaskKeys, encode_masked, first_magnitudes, unmask_sum
from radiant_core.train.together.scrutiny import Scrutiny

NUM_DEVICES, NUM_SPLATS, NUM_ROWS = 6, 60_000, 20_000
LAYOUT = Layout(shapes={"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (1, 3), "shN": (3, 3)})


def least_ms(work: Callable[[], object], tries: int = 15) -> float:
    """The shortest of some tries: others use the machine."""
    took = []
    for _ in range(tries):
        begun_s = time.perf_counter()
        work()
        took.append(time.perf_counter() - begun_s)
    return 1e3 * min(took)


def sent() -> dict[str, StepGradients]:
    """Gradients of six devices."""
    rng = np.random.default_rng(0)
    made = {}
    for number in range(NUM_DEVICES):
        rows = np.sort(rng.choice(NUM_SPLATS, NUM_ROWS, replace=False))
        values = 1e-4 * np.abs(rng.standard_normal((NUM_ROWS, LAYOUT.num_columns))).astype(np.float32)
        made[f"d{number}"] = StepGradients(num_views=1, loss=0.2, rows=rows, values=values, view_counts=np.ones(NUM_ROWS, np.uint16))
    return made


def main() -> None:
    """Print the prices."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--px", type=int, default=96)
    parser.add_argument("--views", type=int, default=900)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    gradients, step = sent(), iter(range(10**6))
    scrutiny = Scrutiny(config=TrainConfig(density=NoDensification()))
    print(f"checks of a step: {least_ms(lambda: scrutiny.refuse(next(step), gradients, NUM_SPLATS, LAYOUT), 60):.2f} ms")
    privates = {name: X25519PrivateKey.generate() for name in gradients}
    publics = {name: each.public_key().public_bytes_raw() for name, each in privates.items()}
    keys = {name: MaskKeys.agree(name, each, publics, "price") for name, each in privates.items()}
    unit = FixedPoint.of(first_magnitudes(LAYOUT), len(gradients))
    mask_ms = least_ms(lambda: encode_masked(gradients["d0"], next(step), NUM_SPLATS, unit, keys["d0"]), 5)
    at = next(step)
    masked = {name: encode_masked(each, at, NUM_SPLATS, unit, keys[name]) for name, each in gradients.items()}
    sum_ms = least_ms(lambda: unmask_sum(masked, list(masked), at, NUM_SPLATS, LAYOUT), 5)
    print(f"masked: {len(masked['d0']) / 1e6:.2f} MB, a device {mask_ms:.1f} ms, the sum {sum_ms:.1f} ms")
    plain = encode_gradients(gradients["d0"], 0, NUM_SPLATS, LAYOUT, "bfloat16")
    encode_ms = least_ms(lambda: encode_gradients(gradients["d0"], 0, NUM_SPLATS, LAYOUT, "bfloat16"))
    decode_ms = least_ms(lambda: decode_gradients(plain, 0, NUM_SPLATS, LAYOUT, 1))
    print(f"bfloat16: {len(plain) / 1e6:.2f} MB, a device {encode_ms:.1f} ms, decoding six {6 * decode_ms:.1f} ms")
    if arguments.scene is not None:
        from tests.stress.poisoned_gradients import HONEST, Watched, case_of, honest_psnr, train

        case = case_of(arguments.scene, arguments.scene, arguments.px, arguments.views)
        for masked_group in (False, True):
            splats, inbox = train(case, HONEST, Watched(), checked=False, masked=masked_group)
            print(
                f"masked {masked_group}: {honest_psnr(case, splats):.3f} dB, {len(splats)} Gaussians, refused {inbox.refused}", flush=True
            )


if __name__ == "__main__":
    main()
