"""What a browser shows before the page is there: the model as the report has it, and how much of
the page has come. Once per server.

The first frame follows five to ten seconds after the address, most of them the page's libraries.
Only a browser with the secret of the address is given the picture.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2

from radiant_core.errors import RadiantError
from radiant_viewer.pictures.images import Image, load_image

MAX_PX, JPEG_QUALITY = 1280, 82
ROUTE = "first.jpg"
PART = """
<style>
  #rad-first { position: fixed; inset: 0; z-index: 2000; background: #fff; font: 14px/1.4 system-ui, sans-serif; color: #1c2430; }
  #rad-first img { position: absolute; left: 0; top: 0; width: 100%; height: calc(100% - 56px); object-fit: contain; }
  #rad-first div { position: absolute; left: 16px; right: 16px; bottom: 12px; }
  #rad-first progress { width: 100%; height: 6px; display: block; }
  .rad-first-picture { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain; z-index: 1; background: #fff;
    pointer-events: none; }
  .rad-first-note { position: absolute; left: 8px; bottom: 6px; z-index: 2; padding: 1px 8px; border-radius: 4px; font: 12px/1.6 system-ui,
    sans-serif; background: rgba(28,36,48,.82); color: #fff; pointer-events: none; }
</style>
<div id="rad-first"><img alt="" hidden><div><span>Loading the page …</span><progress max="1"></progress></div></div>
<script>
(() => {
  const total = {{ total }}, first = document.getElementById("rad-first"), picture = first.querySelector("img");
  const said = first.querySelector("span"), bar = first.querySelector("progress"), begun = performance.now();
  const secret = new URLSearchParams(location.search).get("secret");
  picture.onload = () => { picture.hidden = false; };
  picture.src = "./first.jpg?secret=" + encodeURIComponent(secret);
  const tell = () => {
    const come = performance.getEntriesByType("resource").reduce((sum, one) => sum + (one.decodedBodySize || 0), 0);
    const share = Math.min(1, come / total), ran = (performance.now() - begun) / 1000;
    const left = share > 0.1 && share < 1 && ran > 1 ? `, about ${Math.max(1, Math.round(ran * (1 - share) / share))} s left` : "";
    bar.value = share;
    said.textContent = share < 1 ? `Loading the page: ${Math.round(100 * share)} %${left}` : "Starting the page …";
  };
  let note = null;
  const step = () => {
    const pane = document.querySelector("[data-view='3D']");
    if (!pane) { tell(); return; }
    if (!note) {
      // The page stands: the picture goes on where the model will be.
      note = document.createElement("div");
      note.className = "rad-first-note";
      note.textContent = "A first picture; drawing the model …";
      picture.className = "rad-first-picture";
      pane.append(picture, note);
      if (picture.hidden) note.textContent = "Drawing the model …";
      first.remove();
    }
    const frame = [...pane.querySelectorAll("img")].find((one) => one !== picture && one.src.startsWith("blob:") && one.naturalWidth > 1);
    if (frame || pane.querySelector("iframe[data-loaded]")) { picture.remove(); note.remove(); clearInterval(timer); }
  };
  const timer = setInterval(step, 100);
  tell();
})();
</script>
</body>"""


def first_page(index: str, total_bytes: int) -> str:
    """The page's own index.html with what is shown until it has drawn; `total_bytes` of files that
    it loads before."""
    return index.replace("</body>", PART.replace("{{ total }}", str(max(1, total_bytes))))


def first_picture(run: Path, draw: Callable[[], Image]) -> bytes:
    """The report's picture of the model as JPEG, or what `draw` makes (H,W,3) of a run without."""
    try:
        image = load_image(run / "pictures" / "model.png")
    except (OSError, RadiantError):
        image = draw()
    shrink = min(1.0, MAX_PX / max(image.shape[:2]))
    size_wh = (max(1, round(image.shape[1] * shrink)), max(1, round(image.shape[0] * shrink)))
    small = cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA) if shrink < 1 else image
    return cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def add_first_picture(app: Any, content: Path, loaded: Iterable[Path], picture: bytes, secret: str) -> None:
    """Serve index.html of the folder `content` with the first picture, before aiohttp's own routes;
    `loaded`: files that it fetches before it draws."""
    from aiohttp import web

    files = [*content.glob("*.js"), *content.glob("assets/*"), *loaded]
    page = first_page((content / "index.html").read_text(encoding="utf-8"), sum(path.stat().st_size for path in files if path.is_file()))

    async def index(request: Any) -> Any:
        del request
        return web.Response(text=page, content_type="text/html")

    async def first(request: Any) -> Any:
        if not hmac.compare_digest(request.query.get("secret", "").encode(), secret.encode()):
            raise web.HTTPNotFound
        return web.Response(body=picture, content_type="image/jpeg")

    app.router.add_routes([web.get("/index.html", index), web.get(f"/{ROUTE}", first)])
