"""Names of files behind the numbers under which photographs of a run in the field go up, where their device's folder lies in the run's.

A device tells neither names nor the poses of what it held out: `edge-1-1/0003` is its fourth training photograph, and
`edge-1-1/held-out-0000` the first that it scored. Its own records know which files they are; on another machine than the devices' there
are none, and nothing is known. Read once per window.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.records import load_cameras, load_scene


def local_file_names(folder: Path, devices: Iterable[str]) -> dict[str, str]:
    """Number → name of a file below `devices/<id>/photos` of the run in `folder`, for devices whose records are there."""
    files: dict[str, str] = {}
    for device in devices:
        own = folder / "devices" / device
        # Records of a device are no part of what was delivered: one that cannot be read is as good as one that is elsewhere.
        with suppress(BadInput, StoreDamaged):
            if (own / "scene.safetensors").is_file():
                names = load_scene(own / "scene.safetensors").cameras.names
                files |= {f"{device}/{index:04d}": name for index, name in enumerate(names)}
        with suppress(BadInput, StoreDamaged):
            if (own / "held_out.safetensors").is_file():
                names = load_cameras(own / "held_out.safetensors").names
                files |= {f"{device}/held-out-{index:04d}": name for index, name in enumerate(names)}
    return files
