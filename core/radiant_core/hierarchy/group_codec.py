"""What machines that train together say before the first step, as files. Once per training, and
again for a machine that comes back.

    start    a device's cameras and points, for the root
    begin    the state of the training, for devices, with the light of each

Each is received as bytes, written to the receiver's folder and parsed there strictly.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import message_of, message_record
from radiant_core.hierarchy.together import Begun, ShareStart
from radiant_core.io.array_file import load_arrays, name_file_in_errors, save_arrays
from radiant_core.io.records import CAMERAS_DTYPES, cameras_of_arrays
from radiant_core.light.offsets import PointLogs
from radiant_core.train.results import TrainState
from radiant_core.train.together.replica import Group

START_SCHEMA, BEGIN_SCHEMA = "radiant.group_start", "radiant.group_begin"
START_DTYPES = {**CAMERAS_DTYPES, "points": "F64", "colors": "U8", "log_points": "F64", "logs": "F32", "sky_rgb": "F64", "public_key": "U8"}
_STATE, _KEY = "state.", "public_key."


def save_start(path: Path, start: ShareStart) -> None:
    """Write a device's start, atomically."""
    arrays = {name: getattr(start.cameras, name) for name in CAMERAS_DTYPES}
    arrays |= {"points": start.points, "colors": start.colors, "log_points": start.logs.points, "logs": start.logs.logs}
    arrays |= {"sky_rgb": np.asarray(start.sky_rgb, np.float64), "public_key": np.frombuffer(start.public_key, np.uint8)}
    about = {"num_filled": start.num_filled, "models_light": start.models_light, "most_splats": start.most_splats}
    save_arrays(path, START_SCHEMA, arrays, {**about, "names": list(start.cameras.names)})


def load_start(path: Path) -> ShareStart:
    """What `save_start` wrote; StoreDamaged when broken, BadInput when it is something else."""
    arrays, about = load_arrays(path, START_SCHEMA, START_DTYPES)
    with name_file_in_errors(path):
        most = about["most_splats"]
        if not (isinstance(about["models_light"], bool) and _is_count(about["num_filled"]) and (most is None or _is_count(most))):
            raise BadInput("its counts are no counts: write it anew with this version.")
        if arrays["sky_rgb"].shape != (3,) or arrays["logs"].shape != arrays["log_points"].shape:
            raise BadInput("its arrays do not fit each other: write it anew with this version.")
        if arrays["public_key"].shape not in ((0,), (32,)):
            raise BadInput(f"its public key has {arrays['public_key'].size} bytes, expected 32 or none: write it anew with this version.")
        return ShareStart(
            cameras=cameras_of_arrays(about["names"], arrays),
            points=arrays["points"],
            colors=arrays["colors"],
            num_filled=about["num_filled"],
            logs=PointLogs(points=arrays["log_points"], logs=arrays["logs"]),
            models_light=about["models_light"],
            sky_rgb=arrays["sky_rgb"],
            most_splats=most,
            public_key=arrays["public_key"].tobytes(),
        )


def save_begin(path: Path, begin: Begun) -> None:
    """Write where a training stands, atomically."""
    arrays = {_STATE + name: array for name, array in begin.state.arrays.items()}
    arrays |= {f"offset.{device}": np.asarray(offset, np.float64) for device, offset in begin.offsets.items()}
    arrays |= {_KEY + device: np.frombuffer(key, np.uint8) for device, key in begin.public_keys.items()}
    about = {"group": message_record(begin.group), "numbers": begin.state.numbers, "antialiased": begin.antialiased}
    save_arrays(path, BEGIN_SCHEMA, arrays, about)


def load_begin(path: Path) -> Begun:
    """What `save_begin` wrote; StoreDamaged when broken, BadInput when it is something else."""
    arrays, about = load_arrays(path, BEGIN_SCHEMA, None)
    with name_file_in_errors(path):
        numbers: dict[str, Any] = about["numbers"]
        return Begun(
            group=message_of(Group, about["group"], "group"),
            state=TrainState(
                arrays={name.removeprefix(_STATE): array for name, array in arrays.items() if name.startswith(_STATE)}, numbers=numbers
            ),
            offsets={name.removeprefix("offset."): array for name, array in arrays.items() if name.startswith("offset.")},
            antialiased=about["antialiased"] is True,
            public_keys={name.removeprefix(_KEY): array.tobytes() for name, array in arrays.items() if name.startswith(_KEY)},
        )


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
