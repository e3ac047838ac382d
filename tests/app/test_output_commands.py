"""`radiant export`, `render` and `inspect --screenshot` on a made-up run: what is written, what is said, and what is refused."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.export import levels as export_levels
from radiant_core.errors import BadInput
from radiant_core.geometry import fusion
from radiant_core.geometry.fusion import _save_view
from radiant_core.geometry.open3d_ops import DepthView
from radiant_core.io.ply import load_ply
from radiant_core.io.records import save_cameras, save_scene
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import concatenate_splats
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.made_up_run import made_up_town, save_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("output") / "run"
    save_run(folder, made_up_town(step_levels=40))
    return folder


def radiant(*arguments: object) -> str:
    """Standard output of one command; its exception where it failed."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_every_format_is_written_by_its_ending_and_says_what_it_rounds(run: Path, tmp_path: Path) -> None:
    said = {}
    for name in ("a.ply", "a.spz", "a.sog", "a.geojson", "colmap"):
        said[name] = json.loads(radiant("export", run, tmp_path / name, "--json"))
        assert (tmp_path / name).exists()
    assert [said[name]["format"] for name in said] == ["ply", "spz", "sog", "geojson", "colmap"]
    assert len(load_ply(tmp_path / "a.ply")) == said["a.sog"]["gaussians"] == 9000
    assert 0 < said["a.sog"]["position_max_m"] < 0.01
    assert said["a.geojson"]["cameras"] == said["colmap"]["cameras"] == 24
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    held_out = [f["properties"] for f in features if f["properties"].get("held_out")]
    assert sorted(row["psnr_db"] for row in held_out) == [20.0, 21.0, 22.0]


def test_what_too_few_photographs_constrain_is_taken_out_and_can_be_put_back(tmp_path: Path) -> None:
    town = made_up_town()
    run = tmp_path / "run"
    # A speck above all cameras, which look down: no photograph shows it.
    hidden = replace(town.splats.select(np.array([0])), means=np.array([[0.0, 0.0, 75.0]], np.float32))
    save_run(run, replace(town, splats=concatenate_splats([town.splats, hidden])))
    said = json.loads(radiant("export", run, tmp_path / "a.ply", "--clean", "--long-side-px", "96", "--json"))
    kept, rest = load_ply(tmp_path / "a.ply"), load_ply(Path(said["left_out_file"]))
    assert said["left_out"] == len(rest) > 0 and said["gaussians"] == len(kept) and 0 <= said["left_out_share_of_pixels"] < 0.1
    assert 75 in rest.means[:, 2] and 75 not in kept.means[:, 2]
    whole, again = load_ply(run / "scene.ply"), concatenate_splats([kept, rest])
    for name, array in whole.arrays().items():
        both = (np.sort(each.reshape(len(whole), -1), axis=0) for each in (array, again.arrays()[name]))
        np.testing.assert_array_equal(*both)
    with pytest.raises(BadInput, match=r"a_unconstrained.ply exists"):
        radiant("export", run, tmp_path / "a.spz", "--clean")
    with pytest.raises(BadInput, match="has none"):
        radiant("export", run, tmp_path / "a.geojson", "--clean")
    with pytest.raises(BadInput, match="needs the cameras of a run"):
        radiant("export", run / "scene.ply", tmp_path / "b.ply", "--clean")


def test_the_views_of_a_surface_lie_beside_it_and_go_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    town = made_up_town()
    run = tmp_path / "run"
    save_run(run, replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    # /tmp may be memory, and too small for the views of many photographs.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    seen = set[str]()

    def look(path: Path, view: DepthView) -> None:
        _save_view(path, view)
        seen.add(path.parent.parent.name)
        assert path.parent.name.startswith(".")

    monkeypatch.setattr(fusion, "_save_view", look)
    for ends in ("well", "not"):
        (folder := tmp_path / ends).mkdir()
        command = ("export", run, folder / "a.ply", "--format", "mesh", "--resolution", 2, "--long-side-px", 64)
        if ends == "well":
            radiant(*command)
        else:
            monkeypatch.setattr(fusion, "worker_command", lambda place: [sys.executable, "-c", "raise SystemExit('broken')"])
            with pytest.raises(BadInput, match="broken"):
                radiant(*command)
        assert [path.name for path in folder.iterdir()] == ["a.ply"] * (ends == "well")
    assert seen == {"well", "not"}


def test_a_surface_model_lies_on_the_ground_of_the_town(tmp_path: Path) -> None:
    town = made_up_town()
    # Larger Gaussians close the ground.
    save_run(tmp_path / "run", replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    run = tmp_path / "run"
    said = json.loads(radiant("export", run, tmp_path / "a.tif", "--format", "dsm", "--resolution", 2, "--long-side-px", 96, "--json"))
    assert said["crs"] == "EPSG:32631"
    assert said["known"] > 0.5
    values = np.asarray(tifffile.imread(tmp_path / "a.tif"))
    # Gaussians of 1.5 m at heights of 0 to 1 m.
    assert 0 < np.median(values[values > -9000]) < 3
    with pytest.raises(BadInput, match="exists"):
        radiant("export", run, tmp_path / "a.tif", "--format", "dsm")


def test_a_surface_model_without_altitudes_says_where_its_heights_count_from(tmp_path: Path) -> None:
    town = made_up_town()
    save_run(tmp_path / "run", replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    frame = replace(town.scene.frame, altitude_known=False)
    save_scene(tmp_path / "run" / "sfm" / "scene.safetensors", replace(town.scene, frame=frame))
    arguments = [
        "export",
        str(tmp_path / "run"),
        str(tmp_path / "a.tif"),
        "--format",
        "dsm",
        "--resolution",
        "2",
        "--long-side-px",
        "96",
        "--json",
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "heights count from the middle of the scene's points, not from the sea" in " ".join(result.stderr.split())
    radiant("export", tmp_path / "run", tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert {len(f["geometry"]["coordinates"]) for f in features if f["geometry"]["type"] == "Point"} == {2}


def test_a_mesh_of_which_little_is_known_is_a_warning_with_the_figure(run: Path, tmp_path: Path) -> None:
    # Gaussians 2 m apart in cells of 0.5 m: what two views agree on are specks.
    arguments = ["export", run, tmp_path / "a.ply", "--format", "mesh", "--resolution", "0.5", "--long-side-px", "96", "--json"]
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    said = " ".join(result.stderr.split())
    assert "warning surface: " in said and "of the ground at most" in said and "--resolution" in said


@pytest.mark.parametrize(
    ("name", "kind"), [("a.tif", "dsm"), ("a.tif", "dtm"), ("a.geojson", "contours"), ("a.laz", "laz"), ("a.glb", "glb")]
)
def test_heights_of_which_most_are_unknown_are_not_written(run: Path, tmp_path: Path, name: str, kind: str) -> None:
    told = r"in only .* % of the cells .* nothing is written: they are 0.5 m wide, choose a coarser --resolution such as 1, or train"
    with pytest.raises(BadInput, match=told):
        radiant("export", run, tmp_path / name, "--format", kind, "--resolution", 0.5, "--long-side-px", 96)
    assert not list(tmp_path.iterdir())


def test_a_film_follows_keyframes_and_a_border(run: Path, tmp_path: Path) -> None:
    keys = [{"time_s": 0, "position": [-80, -80, 60], "target": [0, 0, 0]}, {"time_s": 0.5, "position": [80, -80, 60], "target": [0, 0, 0]}]
    (tmp_path / "keys.json").write_text(json.dumps({"keyframes": keys}))
    size = ("--size", "96x64", "--json")
    said = json.loads(radiant("render", run, "--out", tmp_path / "a.mp4", "--keyframes", tmp_path / "keys.json", "--fps", 10, *size))
    assert said["frames"] == 6
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1].astype(int))
    assert len(frames) == 6
    assert frames[0].shape == (64, 96, 3)
    assert np.abs(frames[0] - frames[-1]).mean() > 5, "the camera moved"
    radiant("render", run, "--out", tmp_path / "frames", "--border", "harbour,north", "--frames", 3, *size)
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [f"frame_{index:05d}.png" for index in range(3)]
    radiant("render", run, "--out", tmp_path / "orbit.gif", "--trajectory", "orbit", "--frames", 3, *size)
    assert (tmp_path / "orbit.gif").read_bytes()[:4] == b"GIF8"


def test_names_in_a_file_of_cameras_write_nothing_outside_of_the_folder(run: Path, tmp_path: Path) -> None:
    evil = tmp_path / "a" / "b" / "cameras.safetensors"
    evil.parent.mkdir(parents=True)
    lens = Lens(size_wh=(32, 32))
    two = cameras_looking_at(np.array([[0.0, -80, 60], [0.0, 80, 60]]), np.zeros((2, 3)), lens)
    for name in ("../../out/relative", str(tmp_path / "out" / "absolute")):
        save_cameras(evil, replace(two, names=("good", name)))
        with pytest.raises(BadInput, match="expected relative paths inside a folder"):
            radiant("render", run / "scene.ply", "--cameras", evil, "--out", tmp_path / "a" / "b" / "frames")
        assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "b", "cameras.safetensors"]
    save_cameras(evil, replace(two, names=("good", "inner/folder")))
    radiant("render", run / "scene.ply", "--cameras", evil, "--out", tmp_path / "frames")
    assert sorted(str(path.relative_to(tmp_path / "frames")) for path in (tmp_path / "frames").rglob("*.png")) == [
        "good.png",
        "inner/folder.png",
    ]


def test_a_picture_that_does_not_fit_into_memory_is_one_sentence(run: Path, tmp_path: Path) -> None:
    large = tmp_path / "cameras.safetensors"
    one = cameras_looking_at(np.array([[0.0, -80, 60]]), np.zeros((1, 3)), Lens(size_wh=(32, 32)))
    save_cameras(large, replace(one, sizes_wh=np.array([[1 << 14, 1 << 14]])))
    # A process of its own, which may hold 4 GB: one picture of 268 million pixels takes 3.2 GB and
    # more at once.
    arguments = ["-m", "radiant_app", "render", run / "scene.ply", "--cameras", large, "--out", tmp_path / "frames"]
    command = ["prlimit", f"--as={4 << 30}", sys.executable, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "a picture of 16384 × 16384 px does not fit into the free memory: add --long-side-px" in done.stderr
    assert not (tmp_path / "frames").exists()


def test_a_film_that_browsers_refuse_says_so_before_it_is_rendered(run: Path, tmp_path: Path) -> None:
    arguments = ["render", str(run), "--trajectory", "orbit", "--frames", "2", "--size", "64x48", "--out"]
    said = {ending: CliRunner().invoke(app, [*arguments, str(tmp_path / f"film{ending}")]) for ending in (".mp4", ".webm", ".gif")}
    assert {result.exit_code for result in said.values()} == {0}
    warned = " ".join(said[".mp4"].stderr.split())
    assert "warning render: film.mp4 will hold MPEG-4 Part 2" in warned and "end in .webm" in warned
    assert "warning" not in said[".webm"].stderr + said[".gif"].stderr
    film = cv2.VideoCapture(str(tmp_path / "film.webm"))
    # VP8 is what every browser shows in a WebM.
    assert int(film.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"VP80"
    assert (tmp_path / "film.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"
    # A path that cannot be is refused before anything is said about the film.
    refused = CliRunner().invoke(app, [*arguments[:2], "--out", str(tmp_path / "other.mp4")])
    assert isinstance(refused.exception, BadInput) and "warning" not in refused.stderr


def test_pictures_take_a_size_and_a_camera(run: Path, tmp_path: Path) -> None:
    radiant("inspect", run, "--screenshot", tmp_path / "a.png", "--view", "splats", "--size", "700x450", "--camera", "DJI_0008.JPG")
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None
    assert image.shape == (450, 700, 3)
    radiant("inspect", run, "--screenshot", tmp_path / "b.png", "--view", "compare", "--camera", "DJI_0008.JPG")
    one = cv2.imread(str(tmp_path / "b.png"))
    assert one is not None
    assert one.shape[0] < 450, "one row"


def test_a_screenshot_replaces_no_file(run: Path, tmp_path: Path) -> None:
    (tmp_path / "plan.png").write_bytes(b"a picture that somebody made")
    (tmp_path / "plan.json").write_bytes((run / "plan.json").read_bytes())
    for source in (run, tmp_path / "plan.json"):
        with pytest.raises(BadInput, match=r"plan\.png exists: choose another name"):
            radiant("inspect", source, "--screenshot", tmp_path / "plan.png")
    assert (tmp_path / "plan.png").read_bytes() == b"a picture that somebody made"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("export", "RUN", "OUT/a.xyz"), "--format"),
        (("export", "RUN", "OUT/a.ply", "--resolution", 1), "--resolution"),
        (("export", "RUN", "OUT/a.png", "--format", "dsm"), r"\.tif"),
        (("export", "RUN", "OUT/a.tif"), "--format ortho .* or --format dsm"),
        (("export", "RUN", "OUT/a.tif", "--format", "ortho", "--tile-px", 100), "multiple of 16"),
        (("export", "RUN", "OUT/a.tif", "--format", "ortho", "--resolution", 1e-5), "coarser"),
        (("export", "RUN", "RUN/scene.ply/none/a.ply"), "expected a folder to write"),
        (("export", "RUN/scene.ply", "OUT/a.geojson"), "needs the cameras"),
        (("render", "RUN", "--out", "OUT/a.mp4"), "needs a path"),
        (("render", "RUN", "--out", "OUT/f", "--border", "harbour,moon"), "harbour,north"),
        (("render", "RUN", "--out", "OUT/f", "--trajectory", "orbit", "--keyframes", "OUT/k.json"), "keep one"),
        (("render", "RUN", "--out", "OUT/f", "--keyframes", "RUN/metrics.json"), "no list of keyframes"),
        (("render", "RUN", "--out", "OUT/f", "--trajectory", "orbit", "--size", "big"), "width x height"),
        (("inspect", "RUN", "--screenshot", "OUT/a.png", "--size", "10x10"), "at least"),
        (("inspect", "RUN", "--screenshot", "OUT/a.png", "--view", "splats", "--camera", "DJI_9.JPG"), "did you mean"),
        (("inspect", "RUN", "--screenshot", "OUT/a.png", "--camera", "DJI_0008.JPG"), "splats and compare"),
        (("inspect", "RUN", "--screenshot", "OUT/a.png", "--view", "compare", "--camera", "DJI_0001.JPG"), "trained on"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence_and_nothing_is_left(
    run: Path, tmp_path: Path, arguments: tuple[object, ...], sentence: str
) -> None:
    filled = [str(argument).replace("RUN", str(run)).replace("OUT", str(tmp_path)) for argument in arguments]
    with pytest.raises(BadInput, match=sentence) as caught:
        radiant(*filled)
    assert len(str(caught.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_levels_of_detail_belong_to_the_regions_of_the_run_and_say_nothing_but_gaussians(run: Path, tmp_path: Path) -> None:
    said = json.loads(radiant("export", run, tmp_path / "lod", "--lod", "--levels", "3", "--no-fit-levels", "--json"))
    assert said["format"] == "lod" and said["gaussians"] == 9000 and len(said["levels"].split(", ")) == 3
    chunks = sorted(path.name for path in (tmp_path / "lod").glob("0_*"))
    assert len(chunks) == said["chunks"] == 3, "one for each of the town's regions"
    merged = ("--lod", "--levels", "3", "--no-fit-levels")
    again = json.loads(radiant("export", run / "scene.ply", tmp_path / "again", *merged, "--regions", run, "--json"))
    assert again["chunks"] == 3
    placed = tmp_path / "lod" / "lod-meta.georef.json"
    assert set(json.loads(placed.read_text())) & {"cameras", "names", "poses"} == set()
    # A file alone has no place on the globe.
    placed.unlink()
    for path in (tmp_path / "lod").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "lod")).read_bytes()
        assert not any(name.encode() in path.read_bytes() for name in load_run_view(run).scene.cameras.names)
    back = json.loads(radiant("export", tmp_path / "lod" / "lod-meta.json", tmp_path / "back.ply", "--json"))
    assert back["gaussians"] == 9000 == len(load_ply(tmp_path / "back.ply"))


def test_levels_of_what_has_none_are_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="9,000 Gaussians get one level"):
        radiant("export", run, tmp_path / "one", "--lod", "--fit-levels")
    for options in (("--levels", "3"), ("--fit-levels",), ("--no-fit-levels",)):
        with pytest.raises(BadInput, match="--levels, --fit-levels and --regions"):
            radiant("export", run, tmp_path / "a.ply", *options)
    with pytest.raises(BadInput, match="--lod and --format ask for colmap and lod"):
        radiant("export", run, tmp_path / "a", "--lod", "--format", "colmap")
    for options, told in ((("--lod", "--tiles", "spz"), "--lod and --tiles"), (("--lod", "--spz-version", "2"), "--spz-version is of SPZ")):
        with pytest.raises(BadInput, match=told):
            radiant("export", run, tmp_path / "a", *options)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("x")
    with pytest.raises(BadInput, match="exists"):
        radiant("export", run, tmp_path / "full", "--lod")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["x"]


def test_levels_are_fitted_where_that_is_soon_done_and_what_it_would_take_is_said(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(name: str, *options: str) -> str:
        asked = ["export", str(run), str(tmp_path / name), "--lod", "--levels", "2", *options]
        return " ".join(CliRunner().invoke(app, asked).stderr.split())

    assert "merged, not fitted" not in said("fitted") + said("merged", "--no-fit-levels")
    monkeypatch.setattr(export_levels, "MAX_FITTING_S", 1.0)
    assert re.search(r"9,000 Gaussians are merged, not fitted: .* --fit-levels does it", said("large"))
    means = [path.read_bytes() for path in sorted(tmp_path.glob("*/1_0/means_l.webp"))]
    assert len(means) == 3 and means[1] == means[2] != means[0]


def test_ctrl_c_leaves_no_half_of_an_export(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("radiant_core.lod.fitting.fit_splats", stopped)
    result = CliRunner().invoke(app, ["export", str(run), str(tmp_path / "half"), "--lod", "--levels", "2", "--fit-levels"])
    assert result.exit_code != 0 and not list(tmp_path.iterdir())


def test_tiles_and_pages_are_written_and_photographs_only_where_asked_for(run: Path, tmp_path: Path) -> None:
    said = json.loads(radiant("export", run, tmp_path / "tiles", "--tiles", "spz", "--levels", "2", "--json"))
    tileset = json.loads((tmp_path / "tiles" / "tileset.json").read_text())
    assert said["gaussians"] == 9000 and len(tileset["root"]["transform"]) == 16, "the town has GPS"
    page = json.loads(radiant("export", run, tmp_path / "page", "--format", "viewer", "--json"))
    assert page["photographs"] == 0 and (tmp_path / "page" / "index.html").is_file()
    assert page["places"] == 2 + 3 + 3 + 3, "the whole from two sides, regions, borders, the weakest views"
    one = json.loads(radiant("export", run / "scene.ply", tmp_path / "one.html", "--json"))
    assert one["format"] == "viewer" and one["bytes"] == (tmp_path / "one.html").stat().st_size
    with pytest.raises(BadInput, match="--photographs is of a page"):
        radiant("export", run, tmp_path / "a.ply", "--photographs")
    with pytest.raises(BadInput, match="one file has no levels"):
        radiant("export", run, tmp_path / "two.html", "--levels", "2")
