"""Where the photograph of a camera is, if on this machine. Looked up when a camera is selected.

Photographs stay with the device that trained on them: only `devices/<id>/photos` of the run's
folder is searched, and for held-out photographs the files of the evaluation. For others the answer
names the device.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from radiant_viewer.layers.camera_roles import NOBODY
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.unplanned import unplanned_photographs


@dataclass(frozen=True, kw_only=True)
class PhotoAnswer:
    """The file of a photograph, or None and the reason in one sentence."""

    path: Path | None
    reason: str = ""


def find_photograph(run: RunView, index: int) -> PhotoAnswer:
    """Find photograph `index` of `RunView.photographs`."""
    if run.in_field:
        return _find_in_field(run, index)
    name, roles = run.scene.cameras.names[index], run.roles
    parts = PurePosixPath(name)
    if parts.is_absolute() or ".." in parts.parts:
        return PhotoAnswer(path=None, reason=f"{name!r} is no name of a photograph inside a device's folder.")
    device = int(roles.device_of_camera[index])
    if roles.held_out[index] and run.kind != "scene":
        return _first_file(
            [run.folder / "evaluation" / "photos" / name, run.folder / "pictures" / "photographs" / f"{name}.png"]
        ) or PhotoAnswer(path=None, reason="This photograph was held out and stays where it was scored: this run keeps no picture of it.")
    if run.kind != "run":
        folder = unplanned_photographs(run.folder)
        return (None if folder is None else _first_file([folder / name])) or PhotoAnswer(
            path=None, reason="This photograph is no longer where structure from motion left it."
        )
    if device == NOBODY:
        return PhotoAnswer(path=None, reason="No device of the plan holds this photograph.")
    owner = roles.device_ids[device]
    return _first_file([run.folder / "devices" / owner / "photos" / name]) or PhotoAnswer(
        path=None, reason=f"The photograph stays with device {owner}: its folder is not on this machine, or not dealt yet."
    )


def _find_in_field(run: RunView, index: int) -> PhotoAnswer:
    """Find a photograph that stayed with its device, in its folder if that is inside the run's."""
    name, owner = run.photographs[index], run.owner(index)
    file = PurePosixPath(run.files.get(name, ""))
    if owner and file.name and not file.is_absolute() and ".." not in file.parts:
        answer = _first_file([run.folder / "devices" / owner / "photos" / file])
        if answer is not None:
            return answer
    return PhotoAnswer(path=None, reason=f"This photograph never left {f'device {owner}' if owner else 'its device'}, which took it.")


def _first_file(paths: list[Path]) -> PhotoAnswer | None:
    return next((PhotoAnswer(path=path) for path in paths if path.is_file()), None)
