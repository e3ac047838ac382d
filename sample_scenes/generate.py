"""Render a sample scene: `python sample_scenes/generate.py --out FOLDER` writes FOLDER/images and
FOLDER/known, with `--off-path N` also FOLDER/off_path, views that were never flown.

One photograph is in memory at a time, some 2 s each at 640 x 480 on one core. Everything is made in
a hidden folder beside its place and moved there at the end, so an interrupted run leaves nothing
behind.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from radiant_core.errors import BadInput, way_to_write
from scenegen.config import SceneConfig
from scenegen.flight import plan_flight
from scenegen.known_model import write_known_model
from scenegen.off_path import write_off_path
from scenegen.photo_file import jpeg_bytes
from scenegen.raycast import Photographer


def generate(config: SceneConfig, out: Path, on_photo: Callable[[], None] = lambda: None) -> None:
    """Write images/, known/ and, if asked for, depth/ and off_path/ into out; calls on_photo after
    each picture. Where images/ and known/ of the same settings are there, off_path/ alone is added.

    Raises BadInput when out already holds one of these folders or cannot be written.
    """
    flown = ["images", "known"] + ["depth"] * config.depth
    if config.off_path and all((out / name).is_dir() for name in flown):
        _require_same(config, out / "known" / "frame.json")
        flown = []
    names = flown + ["off_path"] * (config.off_path > 0)
    for name in names:
        if (out / name).exists():
            raise BadInput(f"{out / name} exists already; remove it or choose another folder with --out")
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file; --out needs a folder")
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".partial-", dir=out) as temporary:
            photographer = Photographer(config)
            if flown:
                _write_scene(config, Path(temporary), photographer, on_photo)
            if config.off_path:
                write_off_path(Path(temporary) / "off_path", photographer, on_photo)
            for name in names:
                shutil.move(str(Path(temporary) / name), str(out / name))
    except OSError as error:
        raise BadInput(f"cannot write the scene to {out}: {error.strerror}; {way_to_write(error)} with --out") from error


def _write_scene(config: SceneConfig, folder: Path, photographer: Photographer, on_photo: Callable[[], None]) -> None:
    for name in ("images", "known", "depth"):
        (folder / name).mkdir()
    shots = plan_flight(config)
    for number, shot in enumerate(shots):
        own = photographer.of_shot(shot)
        (folder / "images" / shot.name).write_bytes(jpeg_bytes(own.config, own.photograph(shot, number), shot))
        if config.depth:
            np.savez_compressed(folder / "depth" / f"{Path(shot.name).stem}.npz", depth_m=own.depth(shot))
        on_photo()
    write_known_model(folder / "known", photographer, shots)


def _require_same(config: SceneConfig, record: Path) -> None:
    """Raise BadInput where the scene of this frame.json was made with other settings."""
    try:
        made = json.loads(record.read_text())["config"]
        before = {each.name: made.get(each.name, each.default) for each in fields(SceneConfig)}
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise BadInput(f"{record} does not say how the scene was made: remove the scene or choose another folder with --out") from error
    now = asdict(replace(config, depth=False, off_path=0))
    other = [name for name, value in now.items() if name not in ("depth", "off_path") and _plain(before[name]) != _plain(value)]
    if other:
        raise BadInput(
            f"the scene in {record.parent.parent} was made with {other[0]} {before[other[0]]}, not {now[other[0]]}; "
            "give the same settings or choose another folder with --out"
        )


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def parse_config(arguments: Sequence[str]) -> tuple[SceneConfig, Path]:
    """The config and the output folder of a command line; every field of SceneConfig is a
    switch."""
    parser = argparse.ArgumentParser(prog="generate.py", description="Render a sample scene with known cameras and depth.")
    parser.add_argument("--out", type=Path, required=True, help="Folder that gets images/ and known/.")
    for each in fields(SceneConfig):
        switch, text = "--" + each.name.replace("_", "-"), f"{each.metadata['help']} Default: {each.default}."
        if isinstance(each.default, bool):
            parser.add_argument(switch, action=argparse.BooleanOptionalAction, default=each.default, help=each.metadata["help"])
        elif isinstance(each.default, tuple):
            parser.add_argument(switch, type=_extent, metavar="WxH", default=each.default, help=text)
        else:
            parser.add_argument(switch, type=type(each.default), default=each.default, help=text)
    values = vars(parser.parse_args(arguments))
    out = values.pop("out")
    return SceneConfig(**values), out


def _extent(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no width and height in metres; give them like 120x80") from None


def main() -> int:
    """Run the command line; returns the exit code."""
    try:
        config, out = parse_config(sys.argv[1:])
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns) as progress:
            task = progress.add_task("photographs", total=config.num_cameras + config.off_path)
            generate(config, out, lambda: progress.advance(task))
    except BadInput as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
