"""What machines that train together say before the first step comes back from its file as it was, with the keys of masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from radiant_core.errors import RadiantError
from radiant_core.hierarchy.group_codec import load_begin, load_start, save_begin, save_start
from radiant_core.hierarchy.together import Begun, ShareStart
from radiant_core.light.offsets import PointLogs
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.together.replica import Group, Replica
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

KEY = X25519PrivateKey.generate().public_key().public_bytes_raw()
START = ShareStart(
    cameras=cameras_above([(0.0, 0.0), (1.0, 0.0)]),
    points=np.ones((2, 3)),
    colors=np.zeros((2, 3), np.uint8),
    num_filled=1,
    logs=PointLogs(points=np.ones((1, 3)), logs=np.zeros((1, 3), np.float32)),
    models_light=False,
    sky_rgb=np.full(3, np.nan),
    most_splats=None,
)


@pytest.mark.parametrize("key", [b"", KEY], ids=["without", "with"])
def test_a_start_keeps_its_public_key(key: bytes, tmp_path: Path) -> None:
    save_start(tmp_path / "start", replace(START, public_key=key))
    start = load_start(tmp_path / "start")
    assert start.public_key == key
    np.testing.assert_array_equal(start.points, START.points)


def test_a_start_with_half_a_key_is_refused(tmp_path: Path) -> None:
    save_start(tmp_path / "start", replace(START, public_key=KEY[:16]))
    with pytest.raises(RadiantError, match="its public key has 16 bytes, expected 32 or none"):
        load_start(tmp_path / "start")


def test_a_begin_keeps_the_keys_and_the_state(tmp_path: Path) -> None:
    group = Group(config=TrainConfig(density=NoDensification()), num_photographs=2, views_per_step=2, extent=1.0, masked=True)
    state = Replica(ground_splats(20), group, FitOptions(backend="native")).state()
    keys = {"a-1": KEY, "a-2": KEY[::-1]}
    save_begin(tmp_path / "begin", Begun(group=group, state=state, public_keys=keys))
    begin = load_begin(tmp_path / "begin")
    assert begin.public_keys == keys and begin.group == group and begin.step == 0
    for name, array in state.arrays.items():
        np.testing.assert_array_equal(begin.state.arrays[name], array)
