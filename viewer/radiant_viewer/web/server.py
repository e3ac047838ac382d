"""`radiant inspect [RUN] --web`: the run as a page rendered here, for machines reached by ssh;
without one, first the page on which it is begun.

It binds to 127.0.0.1 and requires the secret in its address, 192 fresh random bits. All files come
from this machine. Needs the `web` extra. Up in 3 s, then some 50 ms per frame.
"""

from __future__ import annotations

import asyncio
import logging
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.extras import require_extra
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.start.session import StartSession
from radiant_viewer.start.start_feeds import StartFeeds

PORT = 8765
LOCAL_HOST = "127.0.0.1"


def require_web() -> None:
    """Raise BadInput with an alternative where the `web` extra is missing."""
    require_extra("web", "no page can be served", "make pictures without a browser: radiant inspect RUN --screenshot out.png")


def open_page(run_folder: Path, announce: Callable[[str], None], host: str = LOCAL_HOST, port: int = PORT) -> None:
    """Serve a run until interrupted.

    Args:
        run_folder: as in `load_run_view`.
        announce: receives the address once the page is up.
        host, port: where to listen; port 0 is any free one.

    Raises: BadInput without the extra, for a broken run, or where host and port cannot be bound.
    """
    require_web()
    _require_free(host, port)
    secret = _fresh_secret()
    _serve_run(load_run_view(run_folder), host, port, secret, lambda used: announce(address_text(host, used, secret)))


def open_start_page(feeds: StartFeeds, announce: Callable[[str], None], port: int = PORT) -> None:
    """Serve the page on which a run is begun, and then the run that is opened there, at the same
    port with the same secret, until interrupted. On loopback alone: the page begins commands.

    Raises: BadInput without the extra, or where the port cannot be bound.
    """
    require_web()
    from radiant_viewer.web.start_server import choose_run

    secret, ports = _fresh_secret(), []

    def ready(used: int) -> None:
        ports.append(used)
        announce(address_text(LOCAL_HOST, used, secret))

    run = choose_run(StartSession(feeds), port, secret, ready)
    _serve_run(run, LOCAL_HOST, ports[0], secret, lambda _: announce(f"the page shows {run.folder}"))


def _fresh_secret() -> str:
    return secrets.token_urlsafe(24)


def _serve_run(run: RunView, host: str, port: int, secret: str, ready: Callable[[int], None]) -> None:
    # Without this, wslink writes to stdout and trame reads our command line.
    os.environ["WSLINK_READY_MSG"] = ""
    # Closing the browser in the middle of a frame is no error.
    for name in ("aiohttp", "wslink"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    from radiant_viewer.web.page import WebPage

    def on_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        # Closing the browser in the middle of a frame is no error here either.
        if not isinstance(context.get("exception"), ConnectionResetError):
            loop.default_exception_handler(context)

    async def serve() -> None:
        asyncio.get_running_loop().set_exception_handler(on_error)
        page = WebPage(run)
        await page.serve(host, port, secret, ready)

    asyncio.run(serve())


def address_text(host: str, port: int, secret: str) -> str:
    """Return the address to open, and how to reach it from another machine."""
    name = LOCAL_HOST if host in ("0.0.0.0", "::") else host  # noqa: S104 (compared, not bound)
    address = f"http://{f'[{name}]' if ':' in name else name}:{port}/?secret={secret}"
    lines = [f"open {address}"]
    if host == LOCAL_HOST:
        lines.append(f"from another machine first: ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}")
    else:
        lines.append(f"{host} can be reached from outside and is not encrypted: whoever reads the address sees the run.")
    return "\n".join([*lines, "Ctrl-C ends it."])


def _require_free(host: str, port: int) -> None:
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except OSError as error:
        raise BadInput(
            f"{host} port {port} cannot be bound ({error.strerror}): choose another --port, or a --host of this machine."
        ) from error
