"""`radiant inspect --web`: the page on which a run is chosen, begun and watched, until it opens.

It listens on loopback alone, whatever is asked, and every request needs the secret of the address:
who has it can begin commands of this user. Standard library only, one request per connection.
"""

from __future__ import annotations

import hmac
import json
import secrets
import sys
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2

from radiant_core.errors import BadInput, RadiantError
from radiant_viewer.runs.growing_model import GROWING_S
from radiant_viewer.runs.run_view import RunView, file_stamps, is_planned, load_run_view
from radiant_viewer.start.choices import COLUMNS, FIRST_ROW, KIND, NO_KIND, NOTHING_CHOSEN, QUALITIES, VERBS, forecast_text, list_path
from radiant_viewer.start.session import StartSession

HOST = "127.0.0.1"
FILES = Path(__file__).with_name("start_page")
PICTURE_WH, WEBP_QUALITY = (960, 600), 85
MAX_BODY_BYTES, PATIENCE_S = 1 << 18, 30
WORDS = {
    "qualities": QUALITIES,
    "verbs": VERBS,
    "columns": COLUMNS,
    "kind": KIND,
    "no_kind": NO_KIND,
    "first_row": FIRST_ROW,
    "nothing": NOTHING_CHOSEN,
}


def choose_run(session: StartSession, port: int, secret: str, ready: Callable[[int], None]) -> RunView:
    """Serve the page until a run is opened there; returns that run, and the port is free again.

    `ready` receives the port. Raises BadInput where the port cannot be had.
    """
    page = _StartPage(session)

    class Handler(_Handler):
        pass

    Handler.page, Handler.secret = page, secret
    try:
        server = _Server((HOST, port), Handler)
    except (OSError, OverflowError) as error:
        raise BadInput(f"cannot serve on port {port}: {error}: choose another with --port, or 0 for any.") from error
    worker = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    worker.start()
    try:
        ready(server.server_port)
        while not page.is_opened.wait(1.0):
            pass
        assert page.opened is not None
        return page.opened
    finally:
        server.shutdown()
        server.server_close()
        session.end()


class _StartPage:
    """What the requests of the page do."""

    def __init__(self, session: StartSession) -> None:
        self._session = session
        self.opened: RunView | None = None
        self.is_opened = threading.Event()
        self._drawing = threading.Lock()
        self._picture: tuple[object, bytes] | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what one request asks; raises a RadiantError with why not."""
        session = self._session
        acts: dict[str, Callable[[Any], Any]] = {
            "folder": session.folder,
            "keep": session.keep,
            "begin": session.begin,
            "watch": session.watch,
            "stop": lambda _: session.stop(),
            "resume": lambda _: session.resume(),
            "state": lambda _: session.state(),
            "words": lambda _: WORDS,
            "open": self._open,
        }
        (name,) = request if len(request) == 1 else ("",)
        if name in acts:
            return acts[name](request[name]) or {}
        answer = session.ask(request)
        if name == "forecast":
            return {"command": answer["command"], "text": forecast_text(answer)}
        return answer | ({"list": str(list_path(Path(answer["out"] or Path.cwd() / "run")))} if name == "look" else {})

    def picture(self) -> bytes:
        """The model of the run that is watched as WebP, of what there is of it; empty without
        any."""
        run = self._session.watched
        if run is None or not is_planned(run):
            return b""
        with self._drawing:
            stamps = (run, file_stamps(run))
            if self._picture is None or self._picture[0] != stamps:
                self._picture = (stamps, model_webp(run))
            return self._picture[1]

    def _open(self, path: str) -> dict[str, Any]:
        # A run that cannot be read is named now, while the page is there to say so.
        self.opened = load_run_view(Path(path))
        return {"opened": path}


def model_webp(run: Path) -> bytes:
    """The model of a run so far, from obliquely above and without what lies around the scene, transparent beside it; empty
    where there is none yet."""
    from radiant_viewer.pictures.splat_picture import draw_over_nothing, fit_camera
    from radiant_viewer.runs.shown_model import framed_positions, shown_of_run

    try:
        view = load_run_view(run, growing=True)
    except RadiantError:
        # The run may be in the middle of writing.
        return b""
    if view.splats is None or not len(view.splats):
        return b""
    camera = fit_camera(framed_positions(view.scene, view.cloud_plan), PICTURE_WH)
    image = cv2.cvtColor(draw_over_nothing(shown_of_run(view).splats, camera), cv2.COLOR_RGBA2BGRA)
    return cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])[1].tobytes()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a browser that went away or dawdled: that is no fault of ours."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    page: _StartPage
    secret: str
    server_version, sys_version = "radiant", ""
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if not self._is_allowed():
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"")
        elif path == "/":
            nonce = secrets.token_urlsafe(12)
            text = (FILES / "index.html").read_text(encoding="utf-8")
            script = (FILES / "page.js").read_text(encoding="utf-8")
            page = text.replace("{{ nonce }}", nonce).replace("{{ script }}", script).replace("{{ growing_s }}", f"{GROWING_S:g}")
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page.encode(), nonce)
        elif path == "/model.webp":
            picture = self.page.picture()
            self._send(HTTPStatus.OK if picture else HTTPStatus.NOT_FOUND, "image/webp", picture)
        else:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"")

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not self._is_allowed() or not length.isdecimal() or int(length) > MAX_BODY_BYTES:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"")
            return
        try:
            request = json.loads(self.rfile.read(int(length)))
            if not isinstance(request, dict):
                raise BadInput("a request is a JSON object.")
            answer = self.page.answer(request)
        except RadiantError as error:
            answer = {"error": str(error)}
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            answer = {"error": f"the page sent what is no request ({type(error).__name__}): load it again."}
        self._send(HTTPStatus.OK, "application/json", json.dumps(answer).encode())
        if "opened" in answer:
            self.page.is_opened.set()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Say nothing: a page asks every second."""

    def _is_allowed(self) -> bool:
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        sent_secret = parse_qs(urlsplit(self.path).query).get("secret", [""])[0]
        return host in (HOST, "localhost") and hmac.compare_digest(sent_secret.encode(), self.secret.encode())

    def _send(self, status: HTTPStatus, kind: str, data: bytes, nonce: str = "") -> None:
        self.send_response(status)
        policy = f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data:; connect-src 'self'"
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(data)),
            "Content-Security-Policy": f"{policy}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)
