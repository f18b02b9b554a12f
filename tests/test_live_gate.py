"""Nobody sees or moves anything who may not: what the door before the page lets through, asked with plain sockets."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import pytest
import viser
from viser import _messages as messages
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from gelbot.errors import BadInput
from gelbot.live import gate
from gelbot.live.admission import Admission, Answer, Head, read_head
from gelbot.live.serve import Served, serve
from toy import Toy

pytestmark = pytest.mark.realtime
TOKEN = "correct-horse-battery"
VISER = Subprotocol(f"viser-v{viser.__version__}")


@pytest.fixture(scope="module")
def open_to_all() -> Iterator[Served]:
    with Toy(camera=False) as toy, serve(toy, port=0) as served:
        yield served


@pytest.fixture(scope="module")
def locked() -> Iterator[Served]:
    with Toy(camera=False) as toy, serve(toy, port=0, token=TOKEN) as served:
        yield served


def ask(port: int, path: str = "/", host: str | None = None, **headers: str) -> tuple[int, dict[str, str], str]:
    """Status, headers and text of what is answered to a GET."""
    lines = [f"GET {path} HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return raw(port, "\r\n".join([*lines, "", ""]).encode())


def raw(port: int, sent: bytes) -> tuple[int, dict[str, str], str]:
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as wire:
        wire.sendall(sent)
        got = b""
        with contextlib.suppress(ConnectionResetError):
            while part := wire.recv(65536):
                got += part
    if not got:
        return 0, {}, ""
    head, _, body = got.decode("latin-1").partition("\r\n\r\n")
    first, *rest = head.split("\r\n")
    return int(first.split()[1]), {k.lower(): v for k, v in (line.split(": ", 1) for line in rest)}, body


def _socket(port: int) -> ClientConnection:
    """A connection that was let in."""
    return connect(
        f"ws://127.0.0.1:{port}/", origin=Origin(f"http://127.0.0.1:{port}"), subprotocols=[VISER], compression=None
    )


def shake(port: int, origin: str | None = "own", cookie: str = "") -> int:
    """The status of a websocket's handshake."""
    headers = {"Cookie": cookie} if cookie else {}
    mine = Origin(f"http://127.0.0.1:{port}" if origin == "own" else origin) if origin else None
    try:
        with connect(
            f"ws://127.0.0.1:{port}/", origin=mine, subprotocols=[VISER], additional_headers=headers, compression=None
        ):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_this_machine_needs_no_token(open_to_all: Served) -> None:
    status, headers, body = ask(open_to_all.port)
    assert status == 200
    assert "<script" in body
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert ask(open_to_all.port, host=f"localhost:{open_to_all.port}")[0] == 200
    assert shake(open_to_all.port) == 101


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1:1", "127.0.0.1", "localhost.evil.example"]
)
def test_a_name_that_was_bent_to_this_machine_is_refused(open_to_all: Served, host: str) -> None:
    status, _, body = ask(open_to_all.port, host=host.format(port=open_to_all.port))
    assert status == 403
    assert "<script" not in body


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://localhost.evil.example"]
)
def test_a_page_of_another_site_opens_no_connection(open_to_all: Served, origin: str) -> None:
    assert shake(open_to_all.port, origin) == 403
    assert ask(open_to_all.port, Origin=origin)[0] == 403


def test_who_does_not_say_where_it_comes_from_opens_no_connection(open_to_all: Served) -> None:
    assert shake(open_to_all.port, None) == 403


def test_it_is_not_shown_inside_another_page(open_to_all: Served) -> None:
    assert ask(open_to_all.port, Sec_Fetch_Dest="iframe")[0] == 403


def test_without_the_token_nothing_is_shown(locked: Served) -> None:
    for path in ("/", "/?token=", "/?token=wrong-token-wrong", "/?token=correct-horse-batter", "/index.html"):
        status, headers, body = ask(locked.port, path)
        assert status == 403
        assert "<script" not in body
        assert "<form" in body
        assert "viser" not in body.lower()
        assert "set-cookie" not in headers
    assert shake(locked.port) == 403
    assert shake(locked.port, cookie="gelbot=x") == 403
    assert shake(locked.port, cookie=f"gelbot-{locked.port}=wrong-token-wrong") == 403


def test_the_token_is_exchanged_for_a_cookie(locked: Served) -> None:
    assert locked.url.endswith(f"?token={TOKEN}")
    status, headers, body = ask(locked.port, f"/?fixedDpr=1&token={TOKEN}")
    assert (status, body) == (303, "")
    assert headers["location"] == "/?fixedDpr=1"
    cookie, *flags = headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(flags)
    assert ask(locked.port, Cookie=f"other=1; {cookie}")[0] == 200
    assert shake(locked.port, cookie=cookie) == 101
    assert shake(locked.port, "http://evil.example", cookie) == 403


def test_a_redirect_stays_here(locked: Served) -> None:
    assert ask(locked.port, f"//evil.example/?token={TOKEN}")[1]["location"] == "/"


def test_the_server_inside_answers_nobody_else(locked: Served, open_to_all: Served) -> None:
    for served in (locked, open_to_all):
        status, _, body = ask(served.inner_port)
        assert (status, body) == (403, "")
        assert ask(served.inner_port, X_Gelbot_Gate="guessed")[0] == 403
        assert shake(served.inner_port) == 403
    # A mark that a browser brings along does not help it, nor does it replace the right one.
    assert ask(open_to_all.port, X_Gelbot_Gate="guessed")[0] == 403


def test_only_the_first_request_of_a_connection_is_answered(open_to_all: Served) -> None:
    port = open_to_all.port
    mine = f"GET /favicon.ico HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
    evil = f"GET / HTTP/1.1\r\nHost: evil.example:{port}\r\n\r\n"
    status, _, body = raw(port, (mine + evil).encode())
    assert status in (404, 0)  # 0: cut off before it was read
    assert "HTTP/1.1" not in body


@pytest.mark.parametrize(
    "sent",
    [
        b"POST / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 3\r\n\r\nabc",
        b"GET / HTTP/1.0\r\nHost: {host}\r\n\r\n",
        b"GET http://{host}/ HTTP/1.1\r\nHost: {host}\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: {host}\r\nHost: evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: {host}\r\n folded: yes\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: {host}\nX: y\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: {host}\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 5\r\n\r\nhello",
        b"GET / HTTP/1.1\r\nHost: {host}\r\nX: \xff\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n",
    ],
)
def test_what_could_be_read_in_two_ways_is_refused(open_to_all: Served, sent: bytes) -> None:
    host = f"127.0.0.1:{open_to_all.port}".encode()
    assert raw(open_to_all.port, sent.replace(b"{host}", host))[0] == 400


def test_a_head_without_end_is_cut_off(open_to_all: Served) -> None:
    start = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{open_to_all.port}\r\nX: ".encode()
    assert raw(open_to_all.port, start + b"x" * 40_000 + b"\r\n\r\n")[0] == 431


def test_who_dawdles_is_sent_away(open_to_all: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "PATIENCE", 0.2)
    began = time.perf_counter()
    assert raw(open_to_all.port, b"GET / HTTP/1.1\r\nHost: ")[0] == 408
    assert time.perf_counter() - began < 2.0


def test_dawdlers_do_not_lock_others_out(open_to_all: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "PATIENCE", 60.0)
    with contextlib.ExitStack() as held:
        inside = held.enter_context(_socket(open_to_all.port))
        address = "127.0.0.1", open_to_all.port
        idle = [held.enter_context(socket.create_connection(address)) for _ in range(gate.MOST_CONNECTIONS + 20)]
        # The first of them had to go.
        idle[0].settimeout(5.0)
        assert idle[0].recv(1) == b""
        assert ask(open_to_all.port)[0] == 200
        assert shake(open_to_all.port) == 101
        assert inside.ping().wait(5.0)


def test_those_who_were_let_in_have_places_of_their_own(open_to_all: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "MOST_CONNECTIONS", 2)
    monkeypatch.setattr(gate, "PATIENCE", 60.0)
    port = open_to_all.port
    with contextlib.ExitStack() as held:
        for _ in range(gate.MOST_WAITING):
            held.enter_context(socket.create_connection(("127.0.0.1", port)))
        with _socket(port), _socket(port):
            assert ask(port)[0] == 503
            assert ask(port, host="evil.example")[0] == 403
        end = time.monotonic() + 5.0
        while ask(port)[0] != 200:
            assert time.monotonic() < end


def test_an_address_that_cannot_be_read_is_answered(locked: Served, open_to_all: Served) -> None:
    for served in (locked, open_to_all):
        for path in ("//[x", "//[x?token=y", "//a]b/"):
            assert ask(served.port, path)[0] == 400


def test_nobody_can_ask_for_a_tunnel_past_the_door(open_to_all: Served) -> None:
    handlers = open_to_all.page._server._websock_server._incoming_handlers
    assert messages.ShareUrlRequest not in handlers
    assert messages.GuiUpdateMessage in handlers


def test_a_port_in_use_is_one_clear_line(open_to_all: Served) -> None:
    before = threading.active_count()
    with Toy(camera=False) as toy:
        with pytest.raises(BadInput, match=r"^port: got \d+; allowed: a port that is not in use. Try: ") as refused:
            serve(toy, port=open_to_all.port)
        assert "\n" not in str(refused.value)
    assert threading.active_count() == before


@pytest.mark.parametrize("token", ["short", "a b c d e f g h i j", "x" * 20 + "\r\nSet-Cookie: a=b", "ü" * 20])
def test_a_token_that_is_none_is_refused(token: str) -> None:
    with Toy(camera=False) as toy, pytest.raises(BadInput, match="token") as refused:
        serve(toy, port=0, token=token)
    assert token not in str(refused.value)


@pytest.mark.parametrize("host", ["192.0.2.1", "no such host", ""])
def test_an_address_that_is_not_ours_is_refused(host: str) -> None:
    if host == "":
        assert not gate.is_loopback(host)
        return
    with Toy(camera=False) as toy, pytest.raises(BadInput, match="host"):
        serve(toy, host=host, port=0)


def test_another_address_makes_a_token() -> None:
    rules = Admission(8080, TOKEN, local=False)
    assert isinstance(rules.judge(Head("GET", "/", {"host": "bench.example:8080"})), Answer)
    assert not gate.is_loopback("0.0.0.0")
    assert not gate.is_loopback("::")
    assert not gate.is_loopback("bench.example")
    assert all(gate.is_loopback(name) for name in ("127.0.0.1", "127.0.0.2", "::1", "localhost"))


def test_a_head_is_read() -> None:
    head = read_head(b"GET /a?b=c HTTP/1.1\r\nHost: x\r\nEmpty:\r\nTwo:  words here \r\n\r\n")
    assert head == Head("GET", "/a?b=c", {"host": "x", "empty": "", "two": "words here"})
