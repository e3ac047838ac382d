"""What other programs show of the files: Spark draws PLY, SOG and SPZ, CesiumJS the tiles.

They are npm packages and no part of radiant: `npm install @sparkjsdev/spark three cesium` in a
folder, and RADIANT_NPM=FOLDER. Spark 2.2.0, three 0.187 and CesiumJS 1.145 were tried.
"""

from __future__ import annotations

import base64
import http.server
import json
import os
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_core.export.scene import save_spz
from radiant_core.export.sog import save_sog
from radiant_core.export.tiles import TileOptions, save_tiles
from radiant_core.frames import ecef_from_local, geodetic_from_enu
from radiant_core.io.ply import save_ply
from radiant_core.lod.cells import whole_region
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_BASES, Splats
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
CESIUM = """<!doctype html><style>.cesium-widget, canvas { width: 100%; height: 100% }</style><body style="margin:0">
<div id="globe" style="width:WIDTHpx;height:HEIGHTpx"></div>
<script>window.CESIUM_BASE_URL = "./npm/cesium/Build/Cesium/";</script><script src="./npm/cesium/Build/Cesium/Cesium.js"></script>
<script type="module">
const view = VIEW, vector = (numbers) => new Cesium.Cartesian3(...numbers);
const widget = new Cesium.CesiumWidget("globe", { useDefaultRenderLoop: false,
  baseLayer: false, skyBox: false, skyAtmosphere: false, globe: false, contextOptions: { webgl: { preserveDrawingBuffer: true } } });
const scene = widget.scene, camera = scene.camera;
scene.backgroundColor = Cesium.Color.BLACK;
scene.msaaSamples = 1;
window.failures = [];
scene.renderError.addEventListener((_, error) => window.failures.push(String(error)));
const tileset = await Cesium.Cesium3DTileset.fromUrl("./tiles/tileset.json", { maximumScreenSpaceError: view.error_px });
tileset.tileFailed.addEventListener((failure) => window.failures.push(failure.message));
scene.primitives.add(tileset);
// Its angle is that of the wider side.
camera.frustum.fov = view.angle; camera.frustum.near = 0.1;
camera.setView({ destination: vector(view.position), orientation: { direction: vector(view.direction), up: vector(view.up) } });
const place = Cesium.Cartographic.fromCartesian(tileset.boundingSphere.center);
window.place = [place.latitude, place.longitude].map(Cesium.Math.toDegrees).concat([tileset.boundingSphere.radius]);
let still = 0;
// A pixel is read after each frame: a queue of frames in software would be minutes long.
const draw = () => {
  widget.resize(); widget.render();
  scene.context._gl.readPixels(0, 0, 1, 1, 6408, 5121, new Uint8Array(4));
  if (!window.drawn) setTimeout(draw, 20);
};
draw();
scene.postRender.addEventListener(() => {
  const shown = tileset.gaussianSplatPrimitive?._numSplats ?? 0;
  still = tileset.tilesLoaded && shown > 0 && shown === window.count ? still + 1 : 0;
  window.count = shown;
  window.drawn = still > 3;
});
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

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
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


WRITERS: dict[str, Callable[[Path, Splats], object]] = {
    "ply": save_ply,
    "sog": save_sog,
    "2.spz": partial(save_spz, version=2),
    "3.spz": partial(save_spz, version=3),
}


@pytest.mark.parametrize("ending", list(WRITERS))
def test_spark_draws_what_our_renderer_draws(run: RunView, tmp_path: Path, served: str, tab: Any, ending: str) -> None:
    assert run.splats is not None
    WRITERS[ending](tmp_path / f"town.{ending}", run.splats)
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


@pytest.mark.parametrize("degree", [0, 3])
def test_cesium_draws_the_tiles_where_the_scene_is(run: RunView, tmp_path: Path, served: str, tab: Any, degree: int) -> None:
    assert run.splats is not None
    splats = replace(run.splats, shN=_harmonics(len(run.splats), degree))
    (tmp_path / "tiles").mkdir()
    frame = replace(run.scene.frame, origin_lat_lon_alt=np.array([47.3, 8.5, 420.0]))
    save_tiles(tmp_path / "tiles", splats, [whole_region(splats.means)], TileOptions(frame=frame))
    pose, (width, height) = overview(run), SIZE_WH
    world, ahead = ecef_from_local(frame.origin_lat_lon_alt), pose.focal_point - pose.position
    view = {
        "angle": 2 * np.arctan(np.tan(np.radians(pose.angle_deg) / 2) * width / height),
        "position": (world[:3, :3] @ pose.position + world[:3, 3]).tolist(),
        "direction": (world[:3, :3] @ ahead / np.linalg.norm(ahead)).tolist(),
        "up": (world[:3, :3] @ pose.up).tolist(),
        "error_px": 0.001,
    }
    page = CESIUM.replace("VIEW", json.dumps(view)).replace("WIDTH", str(width)).replace("HEIGHT", str(height))
    (tmp_path / "cesium.html").write_text(page)
    tab.goto(f"{served}/cesium.html")
    tab.wait_for_function("window.drawn || window.failures?.length")
    assert tab.evaluate("window.failures") == []
    assert tab.evaluate("window.count") == len(splats), "the finest level of all"
    # CesiumJS widens splats by 0.3 px² at four times the size, which is next to nothing: so does this.
    (large,) = render_views(splats, pose.camera((4 * width, 4 * height)))
    own = large.image.reshape(height, 4, width, 4, 3).mean(axis=(1, 3))
    found = shown(tab, f"cesium_{degree}")
    # 25 dB, as for Spark and our own page; 38.7 were seen.
    assert -10 * np.log10(((found - own) ** 2).mean()) > 25
    lat, lon, radius_m = tab.evaluate("window.place")
    low, high = splats.means.min(axis=0), splats.means.max(axis=0)
    truth = geodetic_from_enu((low + high)[None].astype(np.float64) / 2, frame.origin_lat_lon_alt)[0]
    # A tenth of the scene: boxes of ellipsoids are wider than their middles' box.
    assert abs(lat - truth[0]) * 111_000 < 0.1 * radius_m and abs(lon - truth[1]) * 75_000 < 0.1 * radius_m
    assert radius_m > np.linalg.norm(high - low) / 2


def _harmonics(count: int, degree: int) -> np.ndarray:
    """Of every Gaussian the same, so that colours change with the direction by a fifth."""
    rest = np.random.default_rng(0).uniform(-0.2, 0.2, (1, SH_BASES[degree] - 1, 3))
    return np.repeat(rest, count, axis=0)
