"""A folder served to a browser on this machine: loopback only, behind a secret. Once per `view`.

Every address begins with the secret, so that the page's own addresses have it too; anything else,
another Host (a foreign name that was pointed here), a folder, a link that leads outside: not found.
"""

from __future__ import annotations

import mimetypes
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import unquote

from radiant_core.errors import BadInput

HOST = "127.0.0.1"
_KINDS = {".js": "text/javascript", ".json": "application/json", ".webp": "image/webp", ".html": "text/html; charset=utf-8"}


@contextmanager
def served(folder: Path, port: int = 0) -> Iterator[str]:
    """Serve the files of `folder` while the block runs; yields the address with its secret.

    Raises BadInput where the port cannot be had.
    """
    secret = secrets.token_urlsafe(16)
    root = folder.resolve()

    class Handler(_Handler):
        pass

    Handler.root, Handler.secret = root, secret
    try:
        server = _Server((HOST, port), Handler)
    except (OSError, OverflowError) as error:
        raise BadInput(f"cannot serve on port {port}: {error}: choose another with --port, or 0 for any.") from error
    server.daemon_threads = True
    worker = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    worker.start()
    try:
        yield f"http://{HOST}:{server.server_port}/{secret}/"
    finally:
        server.shutdown()
        server.server_close()
        worker.join()


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a browser that went away or dawdled: that is no fault of ours."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    root: Path
    secret: str
    server_version, sys_version = "radiant", ""
    timeout = 30

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Say nothing: a page asks for hundreds of files."""

    def _answer(self, *, with_body: bool) -> None:
        path = self._file()
        try:
            data = None if path is None else path.read_bytes()
        except OSError:
            data = None
        self.send_response(HTTPStatus.NOT_FOUND if data is None else HTTPStatus.OK)
        if path is not None and data is not None:
            self.send_header("Content-Type", _KINDS.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream")
        for name, value in (("X-Content-Type-Options", "nosniff"), ("Referrer-Policy", "no-referrer"), ("Cache-Control", "no-store")):
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(data or b"")))
        self.end_headers()
        if with_body and data:
            self.wfile.write(data)

    def _file(self) -> Path | None:
        """The file that is asked for, None where it is not to be had."""
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        # Without urlsplit, which refuses what looks like a broken address of a host.
        parts = unquote(self.path.partition("?")[0].partition("#")[0]).split("/")
        has_secret = len(parts) > 2 and not parts[0] and secrets.compare_digest(parts[1].encode(), self.secret.encode())
        if host not in (HOST, "localhost") or not has_secret:
            return None
        path = self.root.joinpath(*(part for part in parts[2:] if part)) if any(parts[2:]) else self.root / "index.html"
        try:
            resolved = path.resolve()
            return resolved if resolved.is_relative_to(self.root) and resolved.is_file() else None
        except (OSError, ValueError, RuntimeError):
            # A name that is too long or has a NUL, a link that leads to itself.
            return None
