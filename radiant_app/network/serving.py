"""The socket of a node that others join: starlette on uvicorn in a thread. Once per process.

Here is nothing but carrying: a request is read up to its limit and answered by `reception.py`.
"""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.network.certificate import server_context
from radiant_app.network.home import Listening
from radiant_app.network.reception import MAX_BODY_BYTES, Asked, Reply
from radiant_core.errors import BadInput

if TYPE_CHECKING:
    from starlette.requests import Request

START_S = 10.0
IDLE_S = 30
MAX_CONNECTIONS = 512


def require_network() -> None:
    """Raise BadInput where the extra `network` is not installed."""
    if any(find_spec(name) is None for name in ("uvicorn", "starlette", "httpx")):
        raise BadInput("the network's libraries are not installed: pip install 'radiant-splats[network]'.")


@contextmanager
def serve(listening: Listening, identity: Path, answer: Callable[[Asked], Reply]) -> Iterator[int]:
    """Answer requests until the end of the block; the port. BadInput where it cannot be bound."""
    import uvicorn

    try:
        bound = socket.create_server((listening.host, listening.port), backlog=128)
    except OSError as error:
        where = f"{listening.host}:{listening.port}"
        raise BadInput(f"{where} cannot be listened at ({error.strerror}): end what listens there, or choose another --port.") from error
    config = uvicorn.Config(
        _app(answer),
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,
        lifespan="off",
        ws="none",
        http="h11",
        loop="asyncio",
        timeout_keep_alive=IDLE_S,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=2,
        ssl_context_factory=None if listening.plain else lambda *_: server_context(identity),
    )
    # Its log would name what is asked for; what matters is in the store.
    logging.getLogger("uvicorn").setLevel(logging.CRITICAL)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    try:
        yield int(bound.getsockname()[1])
    finally:
        server.should_exit = True
        thread.join(START_S)
        bound.close()


def _app(answer: Callable[[Asked], Reply]) -> Any:
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import Response
    from starlette.routing import Route

    async def handle(request: Request) -> Response:
        body = await _bounded_body(request)
        if body is None:
            return Response("a request is too long, or does not say its length.", 413, {"Connection": "close"})
        query = request.url.query
        target = request.scope["raw_path"].decode("latin-1") + (f"?{query}" if query else "")
        asked = Asked(method=request.method, target=target, headers=dict(request.headers), body=body)
        reply = await run_in_threadpool(answer, asked)
        return Response(reply.body, reply.status, dict(reply.headers))

    return Starlette(routes=[Route("/{path:path}", handle, methods=["GET", "HEAD", "POST", "PATCH"])])


async def _bounded_body(request: Request) -> bytes | None:
    """The body of a request, or None where it is longer than any may be."""
    length = request.headers.get("content-length", "0")
    if "transfer-encoding" in request.headers or not length.isdecimal() or len(length) > 12 or int(length) > MAX_BODY_BYTES:
        return None
    parts, total = [], 0
    async for part in request.stream():
        total += len(part)
        if total > MAX_BODY_BYTES:
            return None
        parts.append(part)
    return b"".join(parts)
