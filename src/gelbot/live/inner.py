"""The viser server behind the door: on a free port of this machine, for those who know its secret."""

from __future__ import annotations

import contextlib
import hmac
import io
import logging
import secrets
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from viser import _messages as messages
from viser.infra._infra import WebsockMessageHandler
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

HEADER = "X-Gelbot-Gate"
PING_EVERY, PING_PATIENCE = 1.0, 3.0
"""Seconds between questions whether a browser is still there, and how long the answer may take. Whoever closes a tab
says so at once; a cable that is pulled says nothing."""
POLICY = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page may load nothing from anywhere else, and may not be shown inside another page."""

FORBIDDEN = (
    messages.ShareUrlRequest,
    messages.ShareUrlDisconnect,
    messages.FileTransferStartUpload,
    messages.FileTransferPart,
)

_starting = threading.Lock()


class Inner:
    """A viser server and the `secret` (header, value) without which it answers nobody; `port`: where it listens."""

    def __init__(self, label: str) -> None:
        self.secret = (HEADER, secrets.token_urlsafe(32))
        with _starting, _guarded(self.secret[1]), _quiet():
            self.server = viser.ViserServer("127.0.0.1", 0, label=label, verbose=False)
        self.port = self.server.get_port()
        interface = self.server._websock_server
        _forbid(interface)
        # Each browser has handlers of its own too; they are there when this is called, and nothing has come yet.
        interface.on_client_connect(_forbid)

    def stop(self) -> None:
        """Stop it; its threads have ended then."""
        with _quiet():
            self.server.stop()
        self.server._thread_executor.shutdown(wait=True)


def _forbid(interface: WebsockMessageHandler) -> None:
    """What any browser could ask of viser, a watcher too, and shall not.

    A tunnel to the internet, past the door; files that nobody wants; and any property of any control, such as that it
    is removed or what it does: the emergency stop's for all browsers. A browser has values to send, nothing else.
    """
    handlers = interface._incoming_handlers
    for message in FORBIDDEN:
        handlers.pop(message, None)
    handlers[messages.GuiUpdateMessage] = [_values_only(one) for one in handlers.get(messages.GuiUpdateMessage, [])]


def _values_only(handler: Callable[..., Any]) -> Callable[..., Any]:
    async def handle(client: int, message: messages.GuiUpdateMessage) -> None:
        if isinstance(message.updates, dict) and set(message.updates) == {"value"}:
            await handler(client, message)

    return handle


@contextlib.contextmanager
def _guarded(secret: str) -> Iterator[None]:
    """While it starts, viser's server is made with a look at each request before its own.

    viser has no setting for that. It finds `serve` by its module, so that it can be given another one for this moment.
    """
    module = websockets.asyncio.server
    plain = module.serve

    def serve(handler: Any, host: str, port: int, *, process_request: Callable[..., Any], **settings: Any) -> Any:
        def checked(connection: ServerConnection, request: Request) -> Response | None:
            given = request.headers.get_all(HEADER)
            if len(given) != 1 or not hmac.compare_digest(given[0], secret):
                return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": "0"}), b"")
            answer = process_request(connection, request)
            if isinstance(answer, Response):
                answer.headers["Content-Security-Policy"] = POLICY
                answer.headers["Referrer-Policy"] = "no-referrer"
                answer.headers["Cache-Control"] = "no-store"
            return answer

        settings = {**settings, "ping_interval": PING_EVERY, "ping_timeout": PING_PATIENCE, "logger": _logger()}
        return plain(handler, host, port, process_request=checked, **settings)

    module.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        module.serve = plain


def _logger() -> logging.Logger:
    """One that says nothing of connections that were refused or broke off."""
    logger = logging.getLogger("gelbot.live.inner")
    logger.setLevel(logging.CRITICAL)
    return logger


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """viser prints its inner address, which nobody shall open."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
