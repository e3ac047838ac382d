"""The page of a scene, written as a folder for any static host, or as one HTML file. Once per page.

index.html page.js page.css     ours
supersplat-viewer.js viewer.css LICENSES.txt
scene.json                      lines, places, pictures, where the view begins
model/lod-meta.json …           the Gaussians, streamed
pictures/<n>_photograph.jpg     only where asked for: drawn anew, without EXIF
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.export.lod import META_NAME, LodFigures, save_lod
from radiant_core.export.sog import sog_files, zipped
from radiant_core.io.run_store import atomic_writer, read_bounded, write_atomic
from radiant_core.lod.cells import LodRegion
from radiant_core.lod.levels import LodLimits
from radiant_core.splats import Splats, morton_order
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView, comparison_paths
from radiant_viewer.runs.shown_model import shown_of_run
from radiant_viewer.share.scene_page import (
    PagePlace,
    PageScale,
    listed_places,
    overview,
    run_borders,
    run_layers_of_page,
    run_overview,
    run_places,
    settings,
    weak_view,
    worst_photographs,
)
from radiant_viewer.share.vendored import LICENSES, SCRIPT, STYLE, viewer_files

MODEL, PICTURES = "model", "pictures"
JPEG_QUALITY, MAX_PICTURE_PX = 85, 1280
MAX_PICTURE_BYTES = 256 << 20
MAX_SINGLE_BYTES = 30_000_000
"""A model as SOG that goes into one file: a browser holds it twice while it opens."""
_PAGE = Path(__file__).with_name("page")
_IMPORT = "import { createViewer } from './supersplat-viewer.js';\n"
_EXPORT = b"export { createViewer };"


@dataclass(frozen=True, kw_only=True, eq=False)
class ScenePage:
    """What a page shows: the model, its title, and of a run its lines, places and pairs of
    pictures."""

    splats: Splats
    title: str
    start: PagePlace
    about: str = ""
    places: Sequence[PagePlace] = ()
    layers: Sequence[dict[str, Any]] = ()
    scale: PageScale = field(default_factory=PageScale)
    pairs: Sequence[tuple[str, str, bytes, bytes]] = field(default=(), repr=False)
    """Title, text, and JPEGs of photograph and render."""


def page_of_run(run: RunView, *, with_photographs: bool, with_surroundings: bool = False, scale: PageScale | None = None) -> ScenePage:
    """The page of a run's model, without what lies around the scene unless wanted; `scale`: how
    well its lengths are known, None: not said. BadInput where there is no model yet."""
    from radiant_viewer.runs.run_view import require_splats

    splats, borders = require_splats(run), run_borders(run)
    hidden = ""
    if not with_surroundings:
        model = shown_of_run(run)
        splats, hidden = model.splats, f"; {model.sentence}" if model.sentence else ""
    return ScenePage(
        splats=splats,
        title="Scene" if run.in_field else run.folder.resolve().name,
        start=run_overview(run),
        about=f"{len(splats):,} Gaussians{hidden}",
        places=run_places(run, borders),
        layers=run_layers_of_page(run, borders),
        scale=scale or PageScale(unit=run.unit, note="", ground=ground_height(run.scene)),
        pairs=_pairs(run) if with_photographs else (),
    )


def page_of_model(splats: Splats, title: str) -> ScenePage:
    """The page of a model alone."""
    if not len(splats):
        raise BadInput(f"{title} has no Gaussians: there is nothing to show.")
    low, high = np.percentile(splats.means.astype(np.float64), [5, 95], axis=0)
    return ScenePage(splats=splats, title=title, start=overview(low, high), about=f"{len(splats):,} Gaussians")


def save_page(
    folder: Path, page: ScenePage, regions: Sequence[LodRegion], limits: LodLimits, report: Callable[[int, int], None]
) -> LodFigures:
    """Write a page into the existing empty `folder`; raises as `save_lod`."""
    (folder / MODEL).mkdir()
    figures = save_lod(folder / MODEL, page.splats, regions, limits, report)
    comparisons = []
    if page.pairs:
        (folder / PICTURES).mkdir()
    for number, (title, text, photograph, render) in enumerate(page.pairs):
        names = [f"{PICTURES}/{number}_{kind}.jpg" for kind in ("photograph", "render")]
        for name, data in zip(names, (photograph, render), strict=True):
            write_atomic(folder / name, data)
        comparisons.append({"title": title, "text": text, "photograph": names[0], "render": names[1]})
    scene = _scene(page, f"./{MODEL}/{META_NAME}", comparisons)
    for name, data in {**viewer_files(), "page.js": _page_file("page.js"), "page.css": _page_file("page.css")}.items():
        write_atomic(folder / name, data)
    write_atomic(folder / "scene.json", json.dumps(scene, allow_nan=False).encode())
    write_atomic(folder / "index.html", _page_file("index.html").replace(b"{{ title }}", html.escape(page.title).encode()))
    return figures


def save_single_page(path: Path, page: ScenePage) -> int:
    """Write a page as one file that opens without any server; returns its bytes.

    Raises BadInput where the model takes more than `MAX_SINGLE_BYTES`.
    """
    files, _ = sog_files(page.splats.select(morton_order(page.splats.means)))
    model = zipped(files)
    if len(model) > MAX_SINGLE_BYTES:
        limit = f"{MAX_SINGLE_BYTES / 1e6:.0f} MB"
        raise BadInput(f"the model takes {len(model) / 1e6:.0f} MB and one file holds {limit}: write a folder, a name without an ending.")
    comparisons = [
        {"title": title, "text": text, "photograph": _data_uri("image/jpeg", photograph), "render": _data_uri("image/jpeg", render)}
        for title, text, photograph, render in page.pairs
    ]
    scene = {**_scene(page, _data_uri("application/octet-stream", model), comparisons), "contentName": "scene.sog"}
    content = _inlined(page.title, scene)
    with atomic_writer(path) as file:
        file.write(content)
    return len(content)


def _inlined(title: str, scene: dict[str, Any]) -> bytes:
    vendored, text = viewer_files(), _page_file("index.html").decode()
    page_script = _page_file("page.js").decode()
    assert _IMPORT in page_script and vendored[SCRIPT].rstrip().endswith(_EXPORT)
    engine = vendored[SCRIPT].rstrip().removesuffix(_EXPORT).decode()
    styles = f"<style>\n{vendored[STYLE].decode()}\n{_page_file('page.css').decode()}</style>"
    text = text.replace('<link rel="stylesheet" href="./viewer.css">\n', "").replace('<link rel="stylesheet" href="./page.css">', styles)
    text = text.replace('<a href="./LICENSES.txt">SuperSplat Viewer</a>', "SuperSplat Viewer")
    # In a script element only "</" can end it, and JSON has another way of writing it.
    data = json.dumps(scene, allow_nan=False).replace("</", "<\\/")
    text = text.replace(">null</script>", f">{data}</script>").replace("{{ title }}", html.escape(title))
    script = f"/*\n{vendored[LICENSES].decode()}\n*/\n{engine}\n{page_script.replace(_IMPORT, '')}"
    return text.replace('<script type="module" src="./page.js"></script>', f'<script type="module">\n{script}</script>').encode()


def _scene(page: ScenePage, content: str, comparisons: list[dict[str, str]]) -> dict[str, Any]:
    return {
        "about": page.about,
        "content": content,
        "antialiased": page.splats.antialiased,
        "settings": settings(page.start, page.places),
        "places": listed_places(page.places),
        "measure": page.scale.record(),
        "layers": list(page.layers),
        "comparisons": comparisons,
    }


def _pairs(run: RunView) -> list[tuple[str, str, bytes, bytes]]:
    pairs = []
    for number, name in enumerate(worst_photographs(run)):
        try:
            photograph, render, _ = comparison_paths(run, name)
        except StoreDamaged:
            raise
        except BadInput:
            # The pictures of this one stayed elsewhere, or the run keeps none.
            continue
        pairs.append((*weak_view(number, name, run.placed_psnr_db[name]), _jpeg(photograph), _jpeg(render)))
    return pairs


def _jpeg(path: Path) -> bytes:
    """A picture drawn anew: without EXIF, and no larger than a screen."""
    image = cv2.imdecode(np.frombuffer(read_bounded(path, MAX_PICTURE_BYTES), np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise StoreDamaged(f"{path} is no picture: run the evaluation again.")
    shrink = MAX_PICTURE_PX / max(image.shape[:2])
    if shrink < 1:
        image = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def _page_file(name: str) -> bytes:
    return (_PAGE / name).read_bytes()


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
