"""`radiant inspect --page`: a page that flies through a model, made beside the run and served on
loopback."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from radiant_app.commands.inspect.lod_regions import lod_regions
from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.run.steps import require_model, stage_bar
from radiant_app.report.progress import ProgressDisplay
from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite, RadiantError
from radiant_core.geometry.cleaning_file import cleaning_path
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.lod.levels import LodLimits
from radiant_core.splats import Splats
from radiant_viewer.share.folder import ScenePage, page_of_model, page_of_run, save_page
from radiant_viewer.share.serving import served
from radiant_viewer.share.vendored import SHA256

FOLDER, MADE_OF = "viewer", "made_of.json"


def scene_page(
    model: Path, splats: Splats | None, *, with_photographs: bool, as_trained: bool = False, surroundings: bool | None = None
) -> ScenePage:
    """The page of a run or training by its cleaning, unless `as_trained`, else of `splats`, without
    what lies around the scene unless `surroundings` (None: as `as_trained`); raises as the
    readers."""
    if model.is_dir():
        from radiant_app.report.known_scale import page_scale
        from radiant_viewer.runs.run_view import load_run_view

        require_model(model)
        run = load_run_view(model, as_trained=as_trained)
        around = as_trained if surroundings is None else surroundings
        return page_of_run(run, with_photographs=with_photographs, with_surroundings=around, scale=page_scale(run))
    if splats is None:
        raise BadInput(f"{model} is no run: give its folder, or a .ply file.")
    if surroundings is False and len(splats):
        from radiant_viewer.runs.shown_model import model_box, shown_model

        splats = shown_model(splats, model_box(splats)).splats
    return page_of_model(splats, model.stem)


def view(model: Path, port: int, display: ProgressDisplay, say: Callable[[str], None]) -> None:
    """Make the page where it is not up to date, and serve it until Ctrl-C."""
    with _folder_of(model, display) as folder, served(folder, port) as address:
        say(f"open {address}")
        say(f"to send it: radiant export {model} FOLDER --format viewer, or NAME.html for one file. Ctrl-C ends it.")
        _wait()


def _wait() -> None:
    from threading import Event

    with suppress(KeyboardInterrupt):
        Event().wait()


@contextmanager
def _folder_of(model: Path, display: ProgressDisplay) -> Iterator[Path]:
    """The folder of the page: kept in a run, of a model alone for as long as it is looked at."""
    if not model.is_dir():
        splats = given_model(model, display).splats
        with tempfile.TemporaryDirectory(prefix="radiant-view-") as temporary:
            _make(Path(temporary), model, splats, display)
            yield Path(temporary)
        return
    require_model(model)
    key = content_key(model / "scene.ply", _record_of(model), __version__, SHA256)
    if not _is_made_of(model / FOLDER, key):
        _replace(model, key, display)
    yield model / FOLDER


def _record_of(run: Path) -> Any:
    """What of a run shows on its page beside the model."""
    names = ("plan.json", "delivered/plan.json", "metrics.json", "views.json")
    return [path for path in (*(run / name for name in names), cleaning_path(run)) if path.is_file()]


def _is_made_of(folder: Path, key: str) -> bool:
    try:
        return read_json(folder / MADE_OF, ("key",))["key"] == key
    except RadiantError:
        return False


def _replace(run: Path, key: str, display: ProgressDisplay) -> None:
    try:
        fresh = Path(tempfile.mkdtemp(prefix=f".{FOLDER}.", dir=run))
    except OSError as error:
        raise CannotWrite(f"cannot write into {run}: {error.strerror or error}: copy its scene.ply elsewhere and view that.") from error
    try:
        _make(fresh, run, None, display)
        write_json(fresh / MADE_OF, {"key": key})
        fresh.chmod(0o755)
        if (run / FOLDER).exists():
            shutil.rmtree(run / FOLDER)
        fresh.rename(run / FOLDER)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _make(folder: Path, model: Path, splats: Splats | None, display: ProgressDisplay) -> None:
    page = scene_page(model, splats, with_photographs=True)
    with stage_bar(display, "page") as report:
        save_page(
            folder, page, lod_regions(model, page.splats, ()), LodLimits(), lambda num_done, total: report(num_done, total, "Gaussians")
        )
