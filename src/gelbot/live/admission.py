"""Who may see the page: a request's head is read, and let in, redirected or refused. Text in, answer out."""

from __future__ import annotations

import hmac
import re
from dataclasses import dataclass
from html import escape
from http import HTTPStatus
from urllib.parse import SplitResult, parse_qsl, urlencode, urlsplit

from gelbot.errors import BadInput

LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
"""Names under which a browser reaches this machine itself. Any other name that leads here was made to mislead it."""
SHORTEST_TOKEN = 12
"""Letters of a token."""
_LINE = re.compile(r"([!#$%&'*+.^_`|~0-9A-Za-z-]+):[ \t]*([\x21-\x7e](?:[ \t\x21-\x7e]*[\x21-\x7e])?)?[ \t]*")
_FIRST = re.compile(r"(GET|HEAD) (/[\x21-\x7e]*) HTTP/1\.1")
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'"
_ONCE = ("host", "origin", "upgrade", "cookie", "sec-fetch-dest")


def check_token(token: str | None) -> None:
    """None, or a token that is long enough. Raises `BadInput`."""
    if token is not None and len(token) < SHORTEST_TOKEN:
        raise BadInput("token", "*" * len(token), f"at least {SHORTEST_TOKEN} letters", "leave it out: one is made")


@dataclass(frozen=True)
class Head:
    """The head of a request: `path` with its query, `headers` by names in small letters."""

    method: str
    path: str
    headers: dict[str, str]


@dataclass(frozen=True)
class Answer:
    """What is answered instead of letting a request in."""

    status: HTTPStatus
    text: str
    headers: tuple[tuple[str, str], ...] = ()

    def wire(self) -> bytes:
        """As it goes over the wire; the connection ends with it."""
        body = self.text.encode()
        lines = [
            f"HTTP/1.1 {self.status.value} {self.status.phrase}",
            "Content-Type: text/html; charset=utf-8",
            f"Content-Length: {len(body)}",
            "Cache-Control: no-store",
            f"Content-Security-Policy: {_POLICY}",
            "Referrer-Policy: no-referrer",
            "Connection: close",
            *(f"{name}: {value}" for name, value in self.headers),
        ]
        return "\r\n".join([*lines, "", ""]).encode() + body


def read_head(raw: bytes) -> Head | Answer:
    """The head in `raw`, up to its empty line; strictly: what two servers could read differently is refused."""
    try:
        first, *lines = raw.decode("ascii").removesuffix("\r\n\r\n").split("\r\n")
    except UnicodeDecodeError:
        return _bad("It holds letters that do not belong there.")
    asked = _FIRST.fullmatch(first)
    if asked is None:
        return _bad("Only GET and HEAD of HTTP/1.1 are served.")
    headers: dict[str, str] = {}
    for line in lines:
        found = _LINE.fullmatch(line)
        if found is None:
            return _bad("A line of its head cannot be read.")
        name, value = found[1].lower(), found[2] or ""
        if name in headers and name in _ONCE:
            return _bad(f"It has two {name}.")
        headers[name] = value
    if "transfer-encoding" in headers or headers.get("content-length", "0") != "0":
        return _bad("It has a body.")
    return Head(asked[1], asked[2], headers)


@dataclass(frozen=True)
class Admission:
    """The rules of one address: the `token` that is needed, None for none; `local`: only this machine can reach it."""

    port: int
    token: str | None
    local: bool

    @property
    def cookie(self) -> str:
        """The cookie's name. Cookies know no ports: two gelbots on one machine must not overwrite each other's."""
        return f"gelbot-{self.port}"

    def judge(self, head: Head) -> Answer | None:
        """What is answered to a request, None: it may come in."""
        try:
            url = urlsplit(head.path)
        except ValueError:  # "//[x"
            return _bad("Its address cannot be read.")
        host = head.headers.get("host", "")
        if self.local and host not in {f"{name}:{self.port}" for name in LOOPBACK} | self._bare():
            return _page(HTTPStatus.FORBIDDEN, f"Open this page as http://localhost:{self.port}/.")
        if not host:
            return _bad("It does not say for whom it is.")
        origin = head.headers.get("origin")
        is_socket = "upgrade" in head.headers or "sec-websocket-key" in head.headers
        if (origin is not None or is_socket) and origin not in (f"http://{host}", f"https://{host}"):
            return _page(HTTPStatus.FORBIDDEN, "A page of another site may not open this one.")
        if head.headers.get("sec-fetch-dest", "document") in ("iframe", "frame", "embed", "object"):
            return _page(HTTPStatus.FORBIDDEN, "This page may not be shown inside another one.")
        if self.token is None:
            return None
        return self._check_token(head, url)

    def _bare(self) -> set[str]:
        return set(LOOPBACK) if self.port == 80 else set()

    def _check_token(self, head: Head, url: SplitResult) -> Answer | None:
        query = parse_qsl(url.query, keep_blank_values=True)
        given = [value for key, value in query if key == "token"]
        if given and self._is_right(given[-1]):
            rest = urlencode([(key, value) for key, value in query if key != "token"])
            place = "/" + url.path.lstrip("/") + (f"?{rest}" if rest else "")
            cookie = f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return Answer(HTTPStatus.SEE_OTHER, "", (("Location", place), ("Set-Cookie", cookie)))
        if not given and self._is_right(_cookie(head.headers.get("cookie", ""), self.cookie)):
            return None
        return _page(HTTPStatus.FORBIDDEN, "That was not the token." if given else "", with_form=True)

    def _is_right(self, given: str) -> bool:
        return self.token is not None and hmac.compare_digest(given.encode(), self.token.encode())


def _cookie(text: str, name: str) -> str:
    pairs = (part.strip().partition("=") for part in text.split(";"))
    return next((value for key, _, value in pairs if key == name), "")


def _bad(why: str) -> Answer:
    return _page(HTTPStatus.BAD_REQUEST, f"This request is not understood. {why}")


def _page(status: HTTPStatus, text: str, with_form: bool = False) -> Answer:
    """A small page that shows nothing of what is behind it."""
    form = (
        "<p>This page needs a token. It is in the address that was printed where the program was started: "
        "open that address, or enter the token here.</p>"
        '<form action="/" method="get"><input name="token" type="password" autocomplete="off" autofocus> '
        "<button>open</button></form>"
    )
    style = "font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 32em; margin: 20vh auto; padding: 0 1em"
    inside = (f"<p>{escape(text)}</p>" if text else "") + (form if with_form else "")
    return Answer(status, f'<!doctype html><title>Not open</title><body style="{style}">{inside}</body>\n')
