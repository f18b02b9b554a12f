"""The door before the page: a small proxy that looks at the first request of each connection, then passes bytes on.

What is behind it has no access control of its own. It answers a connection once and then either closes it or talks the
websocket protocol, so that no second request passes unseen. A secret header, which only the door knows, keeps everybody
else on this machine from going round it.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import threading
from concurrent.futures import Future
from http import HTTPStatus

from gelbot.errors import BadInput
from gelbot.live.admission import Admission, Answer, read_head

MOST_HEAD = 16 * 1024
"""Bytes of a request's head."""
PATIENCE = 3.0
"""Seconds in which a head must have come."""
MOST_CONNECTIONS = 100
"""That were let in, at the same time."""
MOST_WAITING = 32
"""That were not let in yet. One more sends the one away that waits longest, so that nobody who has something to ask is
kept out by those who only hold the line; the places of those who were let in are not theirs."""
PAUSE = 0.3
"""Seconds before a refusal of a token: who guesses is slow."""
CHUNK = 256 * 1024


class Gate:
    """Listens on `host` and `port` and passes what `Admission` lets in on to `inner_port` of this machine, marked with
    the header `secret` (name, value).

    Raises `BadInput` when the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, token: str | None, inner_port: int, secret: tuple[str, str]) -> None:
        self._listener = _listen(host, port)
        self.port = int(self._listener.getsockname()[1])
        self.admission = Admission(self.port, token, is_loopback(host))
        self._inner_port, self._mark = inner_port, f"{secret[0]}: {secret[1]}\r\n".encode()
        self._loop = asyncio.new_event_loop()
        self._done = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        # In the order in which they came.
        self._waiting: dict[asyncio.Task[None], None] = {}
        self._admitted = 0
        started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(started,), name="gelbot gate", daemon=True)
        self._thread.start()
        started.result()

    def close(self) -> None:
        """Close the door and every connection through it. May be called twice."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._done.set)
            self._thread.join()

    def _run(self, started: Future[None]) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve(started))
        finally:
            self._loop.close()

    async def _serve(self, started: Future[None]) -> None:
        server = await asyncio.start_server(self._on_connection, sock=self._listener, limit=MOST_HEAD)
        started.set_result(None)
        await self._done.wait()
        server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _on_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            raw = await self._admit(task, reader, writer)
            if raw is not None:
                self._admitted += 1
                try:
                    await self._pass_on(raw, reader, writer)
                finally:
                    self._admitted -= 1
        except (OSError, asyncio.CancelledError):
            pass  # it went away, another one needs its place, or the door closes
        finally:
            await _shut(writer)
            self._tasks.discard(task)

    async def _admit(
        self, task: asyncio.Task[None], reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> bytes | None:
        """The head of a request that may come in; others are answered here, and None."""
        if len(self._waiting) >= MOST_WAITING:
            longest = next(iter(self._waiting))
            del self._waiting[longest]
            longest.cancel()
        self._waiting[task] = None
        try:
            return await self._ask(reader, writer)
        finally:
            self._waiting.pop(task, None)

    async def _ask(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes | None:
        raw = await _head(reader)
        answer = raw if isinstance(raw, Answer) else self._judge(raw)
        if answer is None and self._admitted >= MOST_CONNECTIONS:
            answer = Answer(HTTPStatus.SERVICE_UNAVAILABLE, "Too many browsers look at this page.\n")
        if answer is not None:
            if answer.status == HTTPStatus.FORBIDDEN:
                await asyncio.sleep(PAUSE)
            writer.write(answer.wire())
            await asyncio.wait_for(writer.drain(), PATIENCE)
            return None
        assert isinstance(raw, bytes)
        return raw

    async def _pass_on(self, raw: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inside, outside = await asyncio.open_connection("127.0.0.1", self._inner_port)
        try:
            first, rest = raw.split(b"\r\n", 1)
            outside.write(first + b"\r\n" + self._mark + rest)
            ways = [asyncio.create_task(_pipe(*way)) for way in ((reader, outside), (inside, writer))]
            # Either side that goes takes the other with it, at once: a browser that closed must be known to have.
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
        finally:
            await _shut(outside)

    def _judge(self, raw: bytes) -> Answer | None:
        head = read_head(raw)
        return head if isinstance(head, Answer) else self.admission.judge(head)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listen(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise BadInput("port", port, "0 for a free one, or 1 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise BadInput("host", host, "an address of this machine", "127.0.0.1, or 0.0.0.0 for all of them") from error
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(64)
    except OSError as error:
        listener.close()
        if isinstance(error, PermissionError):
            raise BadInput("port", port, "a port that you may use", "one above 1023, or 0 for a free one") from error
        if error.errno == 98 or "in use" in str(error):
            advice = f"{port + 1 if port < 65535 else 8080}, or 0 for a free one; or end the program that listens there"
            raise BadInput("port", port, "a port that is not in use", advice) from error
        raise BadInput("host", host, f"an address of this machine ({error.strerror})", "127.0.0.1") from error
    return listener


async def _head(reader: asyncio.StreamReader) -> bytes | Answer:
    """The head of the first request, or why there is none."""
    try:
        return await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
    except (asyncio.LimitOverrunError, ValueError):
        return Answer(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "This request is too long.\n")
    except TimeoutError:
        return Answer(HTTPStatus.REQUEST_TIMEOUT, "This request took too long.\n")
    except asyncio.IncompleteReadError as error:
        raise ConnectionResetError("went before it had asked") from error


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(CHUNK):
            writer.write(data)
            await writer.drain()


async def _shut(writer: asyncio.StreamWriter) -> None:
    writer.close()
    with contextlib.suppress(OSError, asyncio.TimeoutError, asyncio.CancelledError):
        await asyncio.wait_for(writer.wait_closed(), 1.0)
