"""The page on an address: the server inside, the door before it."""

from __future__ import annotations

import secrets
import socket
from types import TracebackType

from gelbot.errors import BadInput
from gelbot.live.actions import Actions
from gelbot.live.admission import check_token
from gelbot.live.gate import Gate, is_loopback
from gelbot.live.inner import Inner
from gelbot.live.page import Page


class Served:
    """A page that can be opened at `url`. A context too: it closes at its end."""

    def __init__(self, gate: Gate, page: Page, inner: Inner, url: str) -> None:
        self._gate, self._inner = gate, inner
        self.page, self.url = page, url

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._gate.port

    @property
    def inner_port(self) -> int:
        """Where the server inside listens, on this machine, and answers nobody but the door."""
        return self._inner.port

    def close(self) -> None:
        """Close the page, all its connections and threads. The session is left as it is."""
        self.page.close()
        self._gate.close()
        self._inner.stop()

    def __enter__(self) -> Served:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def serve(actions: Actions, host: str = "127.0.0.1", port: int = 8080, token: str | None = None) -> Served:
    """Show `actions` at `host` and `port`, 0: a free one.

    Whoever opens it from this machine needs no `token`, unless one is given; at any other address one is needed, and
    made if none is given: it is part of `url` then. Raises `BadInput` when the address cannot be listened on, or when
    a token is too short.
    """
    if token is not None and not (token.isascii() and token.replace("-", "").replace("_", "").isalnum()):
        raise BadInput("token", "*" * len(token), "letters, digits, - and _", "leave it out: one is made")
    check_token(token)
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(18)
    inner = Inner("gelbot")
    try:
        gate = Gate(host, port, token, inner.port, inner.secret)
    except BaseException:
        inner.stop()
        raise
    try:
        page = Page(inner.server, actions)
    except BaseException:
        gate.close()
        inner.stop()
        raise
    return Served(gate, page, inner, _url(host, gate.port, token))


def _url(host: str, port: int, token: str | None) -> str:
    name = socket.gethostname() if host in ("0.0.0.0", "::", "") else host
    name = f"[{name}]" if ":" in name else name
    return f"http://{name}:{port}/" + (f"?token={token}" if token else "")
