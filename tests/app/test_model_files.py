"""Model files of other programs, bad ones too, through the commands: the right result or one sentence."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.inspect import view as view_command
from radiant_app.commands.inspect.window import Picture, plan_file_of, save_picture
from radiant_app.commands.model import extend as extend_command
from radiant_app.commands.model.clean import CleanRequest, clean
from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.model.render import RenderRequest, render
from radiant_app.commands.survey.measure import export_measures
from radiant_app.report.progress import ProgressDisplay
from radiant_core.aggregate.config import Join
from radiant_core.aggregate.extend import NewRegion, extend_scene
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.errors import BadInput
from radiant_core.export.scene import save_spz
from radiant_core.export.sog import save_sog
from radiant_core.frames import Frame
from radiant_core.hierarchy.codec import TASK_NAME, message_record
from radiant_core.hierarchy.messages import CloudTask
from radiant_core.io.measures_file import load_measures
from radiant_core.io.model_reader import read_model
from radiant_core.io.ply import save_ply
from radiant_core.io.run_store import write_json
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import Splats
from radiant_core.survey.map_grid import map_frame_of
from radiant_core.train.config import TrainConfig
from radiant_core.train.trainer import FitOptions
from radiant_viewer.pictures.images import load_image
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.window.subject import load_subject
from tests.app.test_evaluate import ground, site
from tests.core.io.test_model_reader import every_kind, rows_of, write_rows

__all__ = ["site"]
KINDS = (
    *("a.ply", "b.spz", "c.spz", "d.sog", "e/meta.json", "f/lod-meta.json", "g.safetensors", "h.splat"),
    *("i.spz", "j.spz", "k.compressed.ply", "l.ply", "m.ply", "n.ply"),
)
"""As `every_kind` writes them."""


def heard() -> tuple[ProgressDisplay, io.StringIO]:
    """A display, and what it said in lines of any length."""
    said = io.StringIO()
    return ProgressDisplay(Console(file=said, width=1000)), said


@pytest.mark.parametrize("version", [2, 3, 4])
def test_our_own_spz_scores_as_the_model_that_it_was_written_from(site: Path, tmp_path: Path, version: int) -> None:
    display, _ = heard()
    save_spz(tmp_path / "a.spz", ground(), version)
    save_sog(tmp_path / "a.sog", ground())
    scores = [evaluate(EvaluateRequest(model=path, scene=site / "sfm"), display) for path in (tmp_path / "a.spz", tmp_path / "a.sog")]
    # The photographs are renders of this very model; a file in other axes would be at some 10 dB.
    assert min(score["psnr_db"] for score in scores) > 38 and {score["num_gaussians"] for score in scores} == {300}


def viewed(path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the page of `radiant inspect --page` says of a model."""
    shown: list[str] = []

    def read_page(address: str) -> None:
        if address.startswith("open "):
            with urlopen(f"{address.removeprefix('open ').rstrip('/')}/scene.json") as answer:
                shown.append(json.loads(answer.read())["about"])

    monkeypatch.setattr(view_command, "_wait", lambda: None)
    view_command.view(path, 0, heard()[0], read_page)
    return shown[0]


def extended_by_command(path: Path, new: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """How many Gaussians the standing scene of `radiant join` has; what follows is tested elsewhere (test_pipeline_commands)."""
    read: list[int] = []

    def stop(request: extend_command.ExtendRequest) -> None:
        raise BadInput(f"{request.old.name} was read.")

    def given(*arguments: Any, **options: Any) -> Any:
        model = given_model(*arguments, **options)
        read.append(len(model.splats))
        return model

    monkeypatch.setattr(extend_command, "given_model", given)
    monkeypatch.setattr(extend_command, "_common_frame", stop)
    with pytest.raises(BadInput, match=f"^{re.escape(path.name)} was read"):
        extend_command.extend(extend_command.ExtendRequest(old=path, new=new, out=new / "extended.ply"), heard()[0])
    return read[0]


def new_run(folder: Path) -> Path:
    """As much of a finished run as `radiant join` looks at before it reads the old scene."""
    shutil.copytree(Path(__file__).parents[2] / "sample_scenes" / "runs" / "tiny", folder)
    (folder / "manifest.json").unlink()
    rest = {"train": TrainConfig(), "join": Join(epochs=5), "backend": "native"}
    task = CloudTask(edges=("east",), num_dealt=(2,), sites=((0.0, 0.0),), weights=(0.0,), **rest)
    (folder / "cloud").mkdir()
    write_json(folder / "cloud" / TASK_NAME, message_record(task))
    return folder


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_is_exported_rendered_cleaned_scored_shown_viewed_and_extended(
    name: str, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, path, number = new_run(tmp_path / "run"), tmp_path / name, 0
    assert path in every_kind(tmp_path)
    display, said = heard()
    assert export(ExportRequest(model=path, out=tmp_path / f"{number}.ply"), display)["gaussians"] == 5
    request = RenderRequest(model=path, out=tmp_path / f"{number}", trajectory="orbit", num_frames=1, size_wh=(32, 24))
    assert render(request, display)["pictures"] == 1
    assert clean(CleanRequest(model=path, max_size=1e6), display)["gaussians"] == 5
    assert evaluate(EvaluateRequest(model=path, scene=site / "sfm"), display)["num_gaussians"] == 5
    assert load_subject(path).summary.startswith("5 Gaussians") and plan_file_of(path) is None
    assert "5 Gaussians" in viewed(path, monkeypatch)
    assert extended_by_command(path, run, monkeypatch) == 5
    assert ("taken as they stand" in said.getvalue()) == (path.suffix == ".spz")
    save_picture(path, None, tmp_path / f"{number}_shown.png", Picture(size_wh=(640, 420)))
    # Five Gaussians on white, below the title of the page.
    assert (load_image(tmp_path / f"{number}_shown.png")[60:].min(axis=2) < 230).sum() > 20
    with pytest.raises(BadInput, match="a model alone, of which there are no seams: use --view splats"):
        save_picture(path, "seams", tmp_path / "x.png")
    one = {**vars(request), "out": tmp_path / f"{number}_one.png", "trajectory": None, "num_frames": 120}
    assert render(RenderRequest(**one), display) == {"picture": str(tmp_path / f"{number}_one.png")}
    assert load_image(tmp_path / f"{number}_one.png").shape == (24, 32, 3)
    with pytest.raises(BadInput, match=r"is a file, and the folder of a run is needed here: a model alone is opened by"):
        load_run_view(path)


def poisoned(change: Callable[[np.ndarray], None], count: int = 30) -> np.ndarray:
    rows = rows_of(count)
    rows[:, 6:15] *= 0.1
    rows[:, 16:19] = -2
    change(rows)
    return rows


def put(columns: slice | int, value: float, rows: slice = slice(0, 5)) -> Callable[[np.ndarray], None]:
    def change(table: np.ndarray) -> None:
        table[rows, columns] = value

    return change


ALL = slice(None)
POISON: dict[str, tuple[Callable[[np.ndarray], None], str]] = {
    "NaN": (put(0, np.nan), "5 of its 30 Gaussians have a number that is not finite"),
    "infinite harmonics": (put(8, np.inf), "5 of its 30 Gaussians"),
    "infinite opacities": (put(15, np.inf), "5 Gaussians have an opacity of exactly 0 or 1"),
    "flat": (put(16, -np.inf), "5 Gaussians have no thickness"),
    "beyond float32": (put(17, 100.0), "5 of its 30 Gaussians"),
    "huge": (put(slice(16, 19), 80.0), ""),
    "no rotation": (put(slice(19, 23), 0.0), "5 Gaussians have a rotation of length 0"),
    "one place": (put(slice(0, 3), 0.0, ALL), ""),
    "transparent": (put(15, -30.0, ALL), ""),
    "far": (put(slice(0, 3), 1e7, ALL), ""),
    "loud": (put(slice(3, 15), 1e30, ALL), ""),
}


@pytest.mark.parametrize("name", list(POISON))
def test_a_poisoned_model_gives_a_result_or_one_sentence_and_says_what_it_lost(site: Path, tmp_path: Path, name: str) -> None:
    change, sentence = POISON[name]
    write_rows(tmp_path / "a.ply", poisoned(change))
    display, said = heard()

    def attempt(work: Callable[[], object]) -> None:
        with suppress(BadInput):
            work()

    count = export(ExportRequest(model=tmp_path / "a.ply", out=tmp_path / "b.ply"), display)["gaussians"]
    assert count == (25 if "of its 30" in sentence else 30) and sentence in said.getvalue()
    # What was exported is whole.
    assert read_model(tmp_path / "b.ply").notes == () or name == "no rotation"
    for out in ("b.spz", "b.sog", "b.html"):
        attempt(lambda out=out: export(ExportRequest(model=tmp_path / "a.ply", out=tmp_path / out), display))
    attempt(lambda: export(ExportRequest(model=tmp_path / "a.ply", out=tmp_path / "lod", format="lod", num_levels=2), display))
    attempt(lambda: export(ExportRequest(model=tmp_path / "a.ply", out=tmp_path / "tiles", format="tiles", num_levels=1), display))
    attempt(lambda: render(RenderRequest(model=tmp_path / "a.ply", out=tmp_path / "r", trajectory="orbit", num_frames=1), display))
    assert evaluate(EvaluateRequest(model=tmp_path / "a.ply", scene=site / "sfm"), display)["num_gaussians"] == count
    poison, good = read_model(tmp_path / "a.ply").splats, ground()
    for old, new in ((poison, good), (good, poison)):
        attempt(lambda old=old, new=new: extended(old, new))


def extended(old: Splats, new: Splats) -> None:
    cameras = cameras_looking_at(np.array([[0.0, -8, 6], [0.0, 8, 6]]), np.zeros((2, 3)), Lens(size_wh=(32, 24)))
    region = NewRegion(polygon=np.array([(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)]), margin_m=0.3)
    addition = Teacher(splats=new, cameras=cameras)
    scene = extend_scene(old, addition, region, TrainConfig(), Join(epochs=1), FitOptions(backend="native")).splats
    assert all(np.isfinite(array).all() for array in scene.arrays().values())


def test_a_model_without_gaussians_is_one_sentence_everywhere(site: Path, tmp_path: Path) -> None:
    write_rows(tmp_path / "a.ply", rows_of()[:0])
    display, _ = heard()
    works: list[Callable[[], object]] = [
        lambda: export(ExportRequest(model=tmp_path / "a.ply", out=tmp_path / "b.ply"), display),
        lambda: render(RenderRequest(model=tmp_path / "a.ply", out=tmp_path / "r", trajectory="orbit"), display),
        lambda: clean(CleanRequest(model=tmp_path / "a.ply", max_size=1), display),
        lambda: evaluate(EvaluateRequest(model=tmp_path / "a.ply", scene=site / "sfm"), display),
        lambda: load_subject(tmp_path / "a.ply"),
    ]
    for work in works:
        with pytest.raises(BadInput, match=r"a\.ply holds no Gaussian"):
            work()


def test_an_export_says_what_it_loses_and_whom_plain_tiles_stop(tmp_path: Path) -> None:
    wide = replace(ground(), means=ground().means * np.float32(1000))
    save_ply(tmp_path / "a.ply", wide)
    for out, form, sentence in (
        ("a.spz", None, "SPZ does not hold all of this model: centres are in steps of 0.000488 units, not 0.00024, to reach 4,094 units."),
        ("tiles", "plain", "CesiumJS (1.139 to 1.145) does not draw plain tiles"),
        ("far.sog", None, "SOG has 16 bits for a coordinate: "),
        ("far.html", None, "SOG has 16 bits for a coordinate: "),
    ):
        if out.startswith("far"):
            save_ply(tmp_path / "a.ply", replace(wide, means=np.concatenate([wide.means[:1] * 1e4, wide.means[1:] * 1e2])))
        display, said = heard()
        kind = "tiles" if form else None
        export(
            ExportRequest(model=tmp_path / "a.ply", out=tmp_path / out, format=kind, tile_form=form, num_levels=1 if form else None),
            display,
        )
        assert sentence in said.getvalue(), out
    display, said = heard()
    save_ply(tmp_path / "b.ply", ground())
    for out in ("b.spz", "b.sog", "b.html"):
        export(ExportRequest(model=tmp_path / "b.ply", out=tmp_path / out), display)
    assert "SPZ" not in said.getvalue() and "SOG" not in said.getvalue(), "nothing is lost, nothing is said"


MEASURE = {
    "kind": "area",
    "crs": "EPSG:32632",
    "places": [[0, 0, 1], [1, 0, 1], [1, 1, 1]],
    "figures": {"area": {"value": 1, "sigma": 0.1, "unit": "m²"}},
}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"filled": "a"}, "a.filled is 'a'"),
        ({"crs": None}, "a.crs is None"),
        ({"kind": "=1+1"}, r"a.kind is '=1\+1'"),
        ({"places": [[1, 2]]}, r"a.places\[0\]\[2\] is missing"),
        ({"places": []}, "'a' has 0 places for its area"),
        ({"figures": {"x": {"value": True, "sigma": 1, "unit": "m"}}}, "a.figures.x.value is True"),
        ({"figures": {"x": {"value": 1, "sigma": -1, "unit": "m"}}}, "a.figures.x.sigma is -1"),
        ({"figures": {"x": {"value": 1, "sigma": 1, "unit": "\x1b[2J"}}}, "characters that cannot be printed"),
        ({"profile": [[0, 1]]}, r"a.profile\[0\]\[2\] is missing"),
        ({"more": 1}, "a.more is not a key of a measure"),
        ({"crs": 5}, "a.crs is 5"),
    ],
)
def test_measures_of_a_stranger_are_typed_whole(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    (tmp_path / "survey").mkdir()
    (tmp_path / "survey/measures.json").write_text(json.dumps({"a": {**MEASURE, **change}}))
    with pytest.raises(BadInput, match=f"measures.json does not hold measures .*{sentence}"):
        load_measures(tmp_path)


def test_no_text_of_a_table_of_measures_is_a_formula(tmp_path: Path) -> None:
    (tmp_path / "survey").mkdir()
    row = {**MEASURE, "crs": "@x", "scale": "-s", "figures": {"=1+1": {"value": -1.5, "sigma": 0.1, "unit": "+m"}}}
    (tmp_path / "survey/measures.json").write_text(json.dumps({"=1+2": row}))
    frame = map_frame_of(Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3), residual_m=None))
    export_measures(tmp_path / "a.csv", load_measures(tmp_path), frame)
    _, cells = csv.reader((tmp_path / "a.csv").read_text().splitlines())
    assert cells == ["'=1+2", "area", "'=1+1", "-1.5", "0.1", "'+m", "'@x", "'-s"]
    # A file of an early version does not say its system.
    del row["crs"], row["scale"]
    (tmp_path / "survey/measures.json").write_text(json.dumps({"a": row}))
    export_measures(tmp_path / "b.csv", load_measures(tmp_path), frame)
    assert (tmp_path / "b.csv").read_text().splitlines()[1].endswith(",'+m,,")


def test_a_picture_is_one_file_of_a_kind_that_is_written_and_a_missing_file_is_no_missing_folder(tmp_path: Path) -> None:
    path = next(iter(every_kind(tmp_path)))
    display, _ = heard()
    for out, more, said in (
        ("a.png", {"trajectory": "orbit"}, "a.png is one picture, and 120 were asked for: add --frames 1"),
        ("a.jpg", {"num_frames": 1}, "a.jpg is a picture of a kind that is not written here"),
    ):
        with pytest.raises(BadInput, match=said):
            render(RenderRequest(model=path, out=tmp_path / out, size_wh=(32, 24), **more), display)
        assert not (tmp_path / out).exists()
    with pytest.raises(BadInput, match=r"there is neither a folder nor a file .*none\.spz"):
        load_subject(tmp_path / "none.spz")
