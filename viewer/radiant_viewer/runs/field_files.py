"""File names of photographs in the field, named by numbers, where a device's folder is here.

A device sends neither file names nor the poses of held-out photographs: `edge-1-1/0003` is its
fourth training photograph, `edge-1-1/held-out-0000` the first held-out one. The device's own
records map numbers to files; on other machines there are no such records. Read once per window.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.records import load_cameras, load_scene


def local_file_names(folder: Path, devices: Iterable[str]) -> dict[str, str]:
    """Return number → file name from the records in `devices/<id>` of the run in `folder`."""
    files: dict[str, str] = {}
    for device in devices:
        device_folder = folder / "devices" / device
        # A device's records are not part of the run: an unreadable one counts as absent.
        with suppress(BadInput, StoreDamaged):
            if (device_folder / "scene.safetensors").is_file():
                names = load_scene(device_folder / "scene.safetensors").cameras.names
                files |= {f"{device}/{index:04d}": name for index, name in enumerate(names)}
        with suppress(BadInput, StoreDamaged):
            if (device_folder / "held_out.safetensors").is_file():
                names = load_cameras(device_folder / "held_out.safetensors").names
                files |= {f"{device}/held-out-{index:04d}": name for index, name in enumerate(names)}
    return files
