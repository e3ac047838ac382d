"""The socket of a node that others join: starlette on uvicorn in a thread. Once per process.

Here is nothing but carrying: `reception.py` admits a request before its body is read, and answers
it. Who dawdles is cut off: connections are few.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.network.certificate import server_context
from radiant_app.network.home import Listening
from radiant_app.network.reception import HttpRequest, Reception, Reply
from radiant_core.errors import BadInput, StageFailed
from radiant_core.extras import require_extra

if TYPE_CHECKING:
    from starlette.requests import Request

START_S = 10.0
IDLE_S = 30
"""How long a connection may stay without a request, or be at the head of one."""
BODY_S = 120.0
"""How long one body may take: the smallest part at 0.5 kB/s."""
END_S = 2
"""So long what is answered at the server's end may take."""
MAX_CONNECTIONS = 512
SPARED_BYTES = 1 << 16
"""A refused body of no more is read and thrown away, so that the refusal is not lost with it."""


def require_network() -> None:
    """Raise BadInput where the extra `network` is not installed."""
    require_extra("network", "nothing can be sent or received", "use machines of one owner: --executor local or ray")


@contextmanager
def serve(listening: Listening, identity: Path, reception: Reception) -> Iterator[int]:
    """Answer requests until the end of the block; the port.

    Raises:
        BadInput: the port cannot be bound, or the key cannot be used.
        StageFailed: the server did not start.
    """
    import uvicorn

    try:
        bound = socket.create_server((listening.host, listening.port), backlog=128)
    except OSError as error:
        where = f"{listening.host}:{listening.port}"
        raise BadInput(f"{where} cannot be listened at ({error.strerror}): end what listens there, or choose another --port.") from error
    context = None if listening.plain else server_context(identity)
    config = uvicorn.Config(
        _app(reception),
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,
        lifespan="off",
        ws="none",
        http=_impatient_protocol(),
        loop="asyncio",
        timeout_keep_alive=IDLE_S,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=END_S,
        ssl_context_factory=None if context is None else lambda *_: context,
    )
    # Its log names what is asked for, and what matters is in the store; its errors are our lines.
    logging.getLogger("uvicorn").setLevel(logging.ERROR)
    logging.getLogger("uvicorn.error").addFilter(is_fault)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    try:
        _require_started(server, thread)
        yield int(bound.getsockname()[1])
    finally:
        server.should_exit = True
        thread.join(START_S)
        bound.close()


def is_fault(record: logging.LogRecord) -> bool:
    """Whether a line of the server's log tells of a fault: what takes too long at its end is cut on
    purpose, and who asked for it asks again."""
    error = record.exc_info[1] if record.exc_info else None
    return "graceful shutdown" not in str(record.msg) and not isinstance(error, asyncio.CancelledError)


def _require_started(server: Any, thread: threading.Thread) -> None:
    until_s = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > until_s:
            raise StageFailed("the server of this node did not start; its terminal says why.")
        time.sleep(0.01)


def _impatient_protocol() -> Any:
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Impatient(H11Protocol):
        """Cuts a connection off on which no request came for `IDLE_S`, however slowly one drips."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.loop.call_later(IDLE_S, self._check, None)

        def shutdown(self) -> None:
            super().shutdown()
            # Over TLS a connection else stays until the other side has said goodbye as well.
            self.loop.call_later(END_S / 2, self.transport.abort)

        def _check(self, before: Any) -> None:
            if self.transport.is_closing():
                return
            if self.cycle is before and (self.cycle is None or self.cycle.response_complete):
                self.transport.abort()
            else:
                self.loop.call_later(IDLE_S, self._check, self.cycle)

    return Impatient


def _app(reception: Reception) -> Any:
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.requests import ClientDisconnect
    from starlette.responses import Response
    from starlette.routing import Route

    async def handle(request: Request) -> Response:
        query = request.scope["query_string"].decode("latin-1")
        target = request.scope["raw_path"].decode("latin-1") + (f"?{query}" if query else "")
        http_request = HttpRequest(method=request.method, target=target, headers=dict(request.headers))
        reply: Reply | None = await run_in_threadpool(reception.admit, http_request)
        if reply is not None:
            await _throw_away(request)
            return Response(reply.body, reply.status, {**reply.headers, "Connection": "close"})
        try:
            async with asyncio.timeout(BODY_S):
                body = await request.body()
        except (TimeoutError, ClientDisconnect):
            return Response("the body of a request took too long, or was cut.", 408, {"Connection": "close"})
        reply = await run_in_threadpool(reception.answer, replace(http_request, body=body))
        return Response(reply.body, reply.status, dict(reply.headers))

    return Starlette(routes=[Route("/{path:path}", handle, methods=["GET", "HEAD", "POST", "PATCH"])])


async def _throw_away(request: Request) -> None:
    """Read a small refused body: closed before, the connection is reset and the answer lost."""
    from starlette.requests import ClientDisconnect

    length = request.headers.get("content-length", "0")
    if length.isdecimal() and len(length) < 6 and int(length) <= SPARED_BYTES:
        with suppress(TimeoutError, ClientDisconnect):
            async with asyncio.timeout(START_S):
                async for _ in request.stream():
                    pass
