"""The page of a scene: what stands in it, what never does, who is served, and that Chromium draws it."""

from __future__ import annotations

import base64
import http.client
import json
import socket
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.lod_reader import load_lod_meta
from radiant_core.io.sog_reader import load_sog
from radiant_core.lod.cells import whole_region
from radiant_core.lod.levels import LodLimits
from radiant_core.render.rendered_view import render_views
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.share import folder as share_folder
from radiant_viewer.share import vendored
from radiant_viewer.share.folder import ScenePage, page_of_model, page_of_run, save_page, save_single_page
from radiant_viewer.share.scene_page import run_overview
from radiant_viewer.share.serving import served
from tests.viewer.made_up_run import made_up_town, save_run

SIZE_WH = (320, 180)
"""16:9, for which the page turns the angle of the overview into its own."""
DEADLINE_S = 240


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    folder = tmp_path_factory.mktemp("shared") / "town <&>"
    save_run(folder, made_up_town(step_levels=40))
    return load_run_view(folder)


@pytest.fixture(scope="module")
def page(run: RunView) -> ScenePage:
    return page_of_run(run, with_photographs=True)


def written(folder: Path, page: ScenePage) -> Path:
    folder.mkdir()
    save_page(folder, page, [whole_region(page.splats.means)], LodLimits(num_levels=2), lambda done, total: None)
    return folder


@pytest.fixture(scope="module")
def page_folder(tmp_path_factory: pytest.TempPathFactory, page: ScenePage) -> Path:
    return written(tmp_path_factory.mktemp("pages") / "page", page)


def test_the_folder_holds_the_model_the_viewer_its_licences_and_what_is_drawn(run: RunView, page_folder: Path) -> None:
    names = {path.name for path in page_folder.iterdir()}
    assert names >= {"index.html", "page.js", "page.css", "supersplat-viewer.js", "viewer.css", "LICENSES.txt", "scene.json", "model"}
    assert (page_folder / "LICENSES.txt").read_text().count("MIT License") + (page_folder / "LICENSES.txt").read_text().count(
        "Permission"
    ) >= 2
    scene = json.loads((page_folder / "scene.json").read_text())
    assert load_lod_meta(page_folder / scene["content"]).counts[0] == len(run.splats or ())
    layers = {layer["name"].split(":")[0]: layer for layer in scene["layers"]}
    assert set(layers) == {"Regions", "Borders", "Seams", "Cameras"}
    assert len(layers["Cameras"]["lines"]) == len(run.scene.cameras)
    # East, north, up become east, up, south.
    center = run.scene.cameras.centers[0]
    apex = layers["Cameras"]["lines"][0]["points"][5]
    assert apex == pytest.approx([center[0], center[2], -center[1]], abs=1e-3)
    titles = [place["title"] for place in scene["settings"]["annotations"]]
    assert sum(title.startswith("Border") for title in titles) == 3
    worst = min(run.placed_psnr_db, key=lambda name: run.placed_psnr_db[name])
    assert titles[3] == "Weakest view" and worst in scene["settings"]["annotations"][3]["text"], "after the seams the worst photograph"
    assert "town &lt;&amp;&gt;" in (page_folder / "index.html").read_text()


def test_a_run_in_the_field_shows_no_camera_no_name_and_no_photograph(tmp_path: Path, run: RunView) -> None:
    field = replace(run, in_field=True, folder=tmp_path / "secret-name")
    folder = written(tmp_path / "page", page_of_run(field, with_photographs=True))
    text = b"".join(path.read_bytes() for path in folder.rglob("*") if path.suffix in (".json", ".html"))
    scene = json.loads((folder / "scene.json").read_text())
    assert not [layer for layer in scene["layers"] if layer["name"] == "Cameras"] and not scene["comparisons"]
    forbidden = [*run.scene.cameras.names, *run.cloud_plan.edge_ids, *run.roles.device_ids, "secret-name"]
    assert not [name for name in forbidden if name.encode() in text]
    assert not (folder / "pictures").exists()
    numbers = {f"{value:.3f}".rstrip("0") for center in run.scene.cameras.centers for value in center[:2] if abs(value) > 1}
    words = {point for layer in scene["layers"] for line in layer["lines"] for row in line["points"] for point in map(str, row)}
    assert not numbers & words, "nor do the places of cameras stand in the lines"


def test_photographs_go_along_only_where_asked_for_and_without_exif(tmp_path: Path, run: RunView) -> None:
    pictures = [run.folder / "pictures" / kind for kind in ("photographs", "renders", "differences")]
    name = min(run.placed_psnr_db, key=lambda name: run.placed_psnr_db[name])
    kept = [(path / f"{name}.png").read_bytes() if (path / f"{name}.png").is_file() else None for path in pictures]
    for path in pictures:
        path.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path / f"{name}.png"), np.full((30, 2000, 3), 90, np.uint8))
    try:
        asked, plain = page_of_run(run, with_photographs=True), page_of_run(run, with_photographs=False)
    finally:
        for path, data in zip(pictures, kept, strict=True):
            (path / f"{name}.png").unlink() if data is None else (path / f"{name}.png").write_bytes(data)
    assert not plain.pairs and asked.pairs[0][0] == "Weakest view" and name in asked.pairs[0][1]
    folder = written(tmp_path / "page", asked)
    data = (folder / "pictures" / "0_photograph.jpg").read_bytes()
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (19, 1280, 3) and b"Exif" not in data
    assert not (written(tmp_path / "plain", plain) / "pictures").exists()


def test_one_file_holds_everything_and_too_large_a_model_is_one_sentence(
    tmp_path: Path, page: ScenePage, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = save_single_page(tmp_path / "a.html", page)
    text = (tmp_path / "a.html").read_text()
    assert size == (tmp_path / "a.html").stat().st_size
    assert "./" not in text.split("<script")[0] and 'src="./' not in text and text.count("</script>") == 2
    scene = json.loads(text.split('id="scene-data">')[1].split("</script>")[0])
    (tmp_path / "a.sog").write_bytes(base64.b64decode(scene["content"].split(",")[1]))
    assert len(load_sog(tmp_path / "a.sog")) == len(page.splats) and scene["contentName"] == "scene.sog"
    monkeypatch.setattr(share_folder, "MAX_SINGLE_BYTES", 1000)
    with pytest.raises(BadInput, match="write a folder"):
        save_single_page(tmp_path / "b.html", page)
    assert not (tmp_path / "b.html").exists()


def test_a_changed_viewer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vendored, "SHA256", "0" * 64)
    with pytest.raises(StoreDamaged, match="not the viewer"):
        vendored.viewer_files()


def test_a_model_alone_has_a_page_and_nothing_has_none(page: ScenePage) -> None:
    assert not page_of_model(page.splats, "a").layers
    with pytest.raises(BadInput, match="no Gaussians"):
        page_of_model(page.splats.select(np.zeros(0, np.int64)), "a")


def answer(address: str, path: str, host: str | None = None) -> tuple[int, bytes]:
    parts = urlsplit(address)
    line = http.client.HTTPConnection(parts.hostname or "", parts.port or 0, timeout=20)
    line.putrequest("GET", path, skip_host=True)
    line.putheader("Host", host or parts.netloc)
    line.endheaders()
    found = line.getresponse()
    status, data = found.status, found.read()
    line.close()
    return status, data


def test_only_who_knows_the_secret_is_served_and_only_from_the_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("no")
    inside = tmp_path / "page"
    inside.mkdir()
    (inside / "index.html").write_text("hello")
    (inside / "link").symlink_to(tmp_path / "secret.txt")
    (inside / "sub").mkdir()
    with served(inside) as address:
        base = urlsplit(address).path
        assert answer(address, base) == (200, b"hello") == answer(address, f"{base}index.html?webgl")
        for path in (
            "/",
            "/index.html",
            f"{base}../secret.txt",
            f"{base}%2e%2e/secret.txt",
            f"{base}link",
            f"{base}sub",
            f"{base}%00",
            base[:-1],
        ):
            assert answer(address, path) == (404, b""), path
        assert answer(address, base, "evil.example:80") == (404, b"")
        with pytest.raises(BadInput, match="cannot serve"), served(inside, urlsplit(address).port or 0):
            pass
    with pytest.raises(ConnectionError):
        answer(address, base)


ODD_TARGETS = (
    "http://[::1/",
    "//[/",
    "{base}http://[::1/",
    "{base}" + 3000 * "a",
    "{base}" + "a/" * 3000,
    "{base}loop",
    "{base}loop/index.html",
    "{base}a%00b",
    "{base}%ff%fe",
    "{base}index.html/x",
    "{base}%",
    "?",
    "*",
    "{base}\xff",
)


@pytest.mark.parametrize("target", ODD_TARGETS, ids=range(len(ODD_TARGETS)))
def test_an_odd_address_is_not_found_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str], target: str) -> None:
    (tmp_path / "index.html").write_text("hello")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with served(tmp_path) as address:
        parts = urlsplit(address)
        with socket.create_connection((str(parts.hostname), parts.port or 0), timeout=20) as line:
            line.sendall(f"GET {target.format(base=parts.path)} HTTP/1.0\r\nHost: {parts.netloc}\r\n\r\n".encode("latin-1"))
            assert line.recv(100).startswith(b"HTTP/1.0 404")
        assert answer(address, parts.path) == (200, b"hello")
    assert capfd.readouterr() == ("", "")


def test_a_browser_that_goes_away_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "large").write_bytes(bytes(30_000_000))
    with served(tmp_path) as address:
        parts = urlsplit(address)
        for _ in range(3):
            line = socket.create_connection((str(parts.hostname), parts.port or 0), timeout=20)
            # Reset, not closed: bytes that nobody read are lost.
            line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            line.sendall(f"GET {parts.path}large HTTP/1.0\r\nHost: {parts.netloc}\r\n\r\n".encode())
            assert line.recv(100)
            line.close()
        time.sleep(0.3)
    assert capfd.readouterr() == ("", "")


def test_chromium_draws_what_our_renderer_draws_and_asks_nobody_else(drawing_browser: Any, run: RunView, page_folder: Path) -> None:
    width, height = SIZE_WH
    tab = drawing_browser.new_page(viewport={"width": width, "height": height})
    asked, failed = [], []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("pageerror", lambda error: failed.append(str(error)))
    with served(page_folder) as address:
        tab.goto(f"{address}?webgl&fullload")
        begun = time.monotonic()
        while not tab.evaluate("!!window.radiantViewer?.state.loaded"):
            assert time.monotonic() - begun < DEADLINE_S and not failed, failed
            time.sleep(0.2)
        taken = tab.evaluate(f"radiantViewer.captureFrame({{width: {width}, height: {height}, supersample: 1}})")
        boxes = tab.evaluate("[...document.querySelectorAll('#layers input')].map((box) => { box.click(); return box.checked; })")
        drawn = "document.getElementById('lines').getContext('2d').getImageData(0, 0, 50, 50).data.length"
        assert boxes == [True] * 4 and tab.evaluate(drawn) == 10_000
        assert [url for url in asked if not url.startswith((address, "blob:", "data:"))] == [] and failed == []
    pixels = np.frombuffer(base64.b64decode(taken["data"]), np.uint8).reshape(height, width, 4)[..., :3] / 255
    assert run.splats is not None
    (own,) = render_views(run.splats, run_overview(run).view.camera(SIZE_WH))
    assert np.ptp(own.image) > 0.3, "there is something to see"
    # 25 dB: its splats end at another radius, are sorted by distance, and come from 8 bits.
    assert -10 * np.log10(((pixels - own.image) ** 2).mean()) > 25
