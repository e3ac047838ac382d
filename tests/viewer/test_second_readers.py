"""What other programs show of the files: Spark draws PLY and SOG, CesiumJS places and loads the tiles.

They are npm packages and no part of radiant: `npm install @sparkjsdev/spark three cesium` in a
folder, and RADIANT_NPM=FOLDER. Spark 2.2.0, three 0.187 and CesiumJS 1.140 were tried. That
Spark reads SPZ up to version 3 ("Invalid gzip header"), and ours is Open3D's, version 4.
"""

from __future__ import annotations

import base64
import functools
import http.server
import json
import os
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_core.frames import geodetic_from_enu
from radiant_core.io.export.sog import save_sog
from radiant_core.io.export.tiles import save_tiles
from radiant_core.io.ply import save_ply
from radiant_core.lod.cells import whole_region
from radiant_core.render.rendered_view import render_views
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.run_view import RunView, load_run_view
from tests.viewer.made_up_run import made_up_town, save_run

NPM = Path(os.environ.get("RADIANT_NPM", "/nowhere")) / "node_modules"
CHROMIUM = shutil.which("chromium")
SIZE_WH = (320, 180)
DEADLINE_MS = 240_000
pytestmark = pytest.mark.skipif(CHROMIUM is None or not NPM.is_dir(), reason="needs chromium, and npm's packages in RADIANT_NPM")

SPARK = """<!doctype html><body style="margin:0"><script type="importmap">{"imports": {
  "three": "./npm/three/build/three.module.js", "three/addons/": "./npm/three/examples/jsm/",
  "spark": "./npm/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { SparkRenderer, SplatMesh } from "spark";
const view = VIEW;
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setPixelRatio(1);
renderer.setSize(view.width, view.height);
document.body.append(renderer.domElement);
const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(view.angle, view.width / view.height, 0.1, 5000);
scene.background = new THREE.Color(0);
camera.up.set(...view.up); camera.position.set(...view.position); camera.lookAt(...view.target);
// As 3DGS was trained: 0.3 px wider, and not fainter for it.
scene.add(new SparkRenderer({ renderer, preBlurAmount: 0.3, blurAmount: 0 }));
const splats = new SplatMesh({ url: view.url });
scene.add(splats);
await splats.initialized;
window.count = splats.numSplats ?? splats.packedSplats?.numSplats;
window.numDrawn = 0;
renderer.setAnimationLoop(() => { renderer.render(scene, camera); window.numDrawn += 1; });
</script>"""
CESIUM = """<!doctype html><body style="margin:0"><div id="globe" style="width:320px;height:180px"></div>
<script>window.CESIUM_BASE_URL = "./npm/cesium/Build/Cesium/";</script><script src="./npm/cesium/Build/Cesium/Cesium.js"></script>
<script type="module">
const viewer = new Cesium.Viewer("globe", { baseLayer: false, baseLayerPicker: false, geocoder: false, animation: false, timeline: false });
window.failures = [];
const tileset = await Cesium.Cesium3DTileset.fromUrl("./tiles/tileset.json", { maximumScreenSpaceError: 1 });
tileset.tileFailed.addEventListener((failure) => window.failures.push(failure.message));
viewer.scene.primitives.add(tileset);
await viewer.zoomTo(tileset);
const place = Cesium.Cartographic.fromCartesian(tileset.boundingSphere.center);
window.place = [place.latitude, place.longitude].map(Cesium.Math.toDegrees).concat([tileset.boundingSphere.radius]);
tileset.allTilesLoaded.addEventListener(() => { window.loaded = true; });
</script>"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    folder = tmp_path_factory.mktemp("readers") / "town"
    save_run(folder, made_up_town(step_levels=40))
    return load_run_view(folder)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "npm").symlink_to(NPM)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.fixture
def tab() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: it comes with the extra 'test'")
    arguments = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
    with playwright.sync_playwright() as tool:
        opened = tool.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = opened.new_page(viewport={"width": SIZE_WH[0], "height": SIZE_WH[1]})
        page.set_default_timeout(DEADLINE_MS)
        yield page
        opened.close()


def overview(run: RunView) -> ViewPose:
    middle = np.append(run.scene.cameras.centers[:, :2].mean(axis=0), 0.0)
    away = 1.3 * float(np.ptp(run.scene.cameras.centers[:, :2], axis=0).max()) * np.array([0.3, -0.7, 0.6])
    return ViewPose(position=middle + away, focal_point=middle, up=np.array([0.0, 0, 1]), angle_deg=40.0)


def shown(tab: Any, name: str) -> np.ndarray:
    """What the page's canvas holds, 0 to 1, kept where RADIANT_SHOTS says so."""
    data = base64.b64decode(tab.evaluate("document.querySelector('canvas').toDataURL().split(',')[1]"))
    if folder := os.environ.get("RADIANT_SHOTS"):
        (Path(folder) / f"{name}.png").write_bytes(data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[..., ::-1].astype(np.float64) / 255


@pytest.mark.parametrize("ending", ["ply", "sog"])
def test_spark_draws_what_our_renderer_draws(run: RunView, tmp_path: Path, served: str, tab: Any, ending: str) -> None:
    assert run.splats is not None
    {"ply": save_ply, "sog": save_sog}[ending](tmp_path / f"town.{ending}", run.splats)
    pose, (width, height) = overview(run), SIZE_WH
    view = {
        "url": f"./town.{ending}", "width": width, "height": height, "angle": pose.angle_deg, "up": [0, 0, 1],
        "position": pose.position.tolist(), "target": pose.focal_point.tolist(),
    }  # fmt: skip
    (tmp_path / "spark.html").write_text(SPARK.replace("VIEW", json.dumps(view)))
    tab.goto(f"{served}/spark.html")
    # It sorts in a thread of its own: some frames later the order is right.
    tab.wait_for_function("window.numDrawn > 8")
    assert tab.evaluate("window.count") == len(run.splats)
    (own,) = render_views(run.splats, pose.camera(SIZE_WH))
    assert np.ptp(own.image) > 0.3, "there is something to see"
    found = shown(tab, f"spark_{ending}")
    # 25 dB, as for our own page: another cut of the splats' rims, and 8 bits.
    assert -10 * np.log10(((found - own.image) ** 2).mean()) > 25


def test_cesium_puts_the_tiles_where_the_scene_is_and_loads_them_all(run: RunView, tmp_path: Path, served: str, tab: Any) -> None:
    # Its 1.140 draws splats only as KHR_gaussian_splatting_compression_spz_2 has them: of ours it
    # reads place, tree and buffers, and its shader of points does not know the attributes' names.
    assert run.splats is not None
    (tmp_path / "tiles").mkdir()
    frame = replace(run.scene.frame, origin_lat_lon_alt=np.array([47.3, 8.5, 420.0]))
    save_tiles(tmp_path / "tiles", run.splats, [whole_region(run.splats.means)], frame)
    (tmp_path / "cesium.html").write_text(CESIUM)
    tab.goto(f"{served}/cesium.html")
    tab.wait_for_function("window.loaded || window.failures?.length")
    assert tab.evaluate("window.failures") == []
    lat, lon, radius_m = tab.evaluate("window.place")
    low, high = run.splats.means.min(axis=0), run.splats.means.max(axis=0)
    truth = geodetic_from_enu((low + high)[None].astype(np.float64) / 2, frame.origin_lat_lon_alt)[0]
    # A tenth of the scene: boxes of ellipsoids are wider than their middles' box.
    assert abs(lat - truth[0]) * 111_000 < 0.1 * radius_m and abs(lon - truth[1]) * 75_000 < 0.1 * radius_m
    assert radius_m > np.linalg.norm(high - low) / 2
