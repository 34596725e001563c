"""Access control: who may see the page and press its buttons."""

from __future__ import annotations

import ipaddress
import secrets
import socket
import time
from base64 import b64encode
from collections import deque
from hashlib import sha256
from http.cookies import CookieError, SimpleCookie
from math import inf
from typing import Any
from urllib.parse import parse_qs

WRONG = 10  # wrong tokens of one address in `WINDOW` after which its tokens are ignored, if a person chose the token
WINDOW = 60.0  # [s]
REMEMBERED = 1000  # browsers, and addresses with wrong tokens
HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-frame-options": "DENY",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every answer that does not set its own. The page has no inline scripts or styles."""
# After a link from another site, a redirect does not carry strict cookies; a page that reloads itself does. Its script
# keeps the part of the address behind #, which names a tab.
SCRIPT = b'location.replace("/" + location.hash)'
ENTER = (b'<!doctype html><title>vamgpu</title><script>' + SCRIPT + b'</script><noscript><meta http-equiv="refresh" '
         b'content="0;url=/"></noscript><a href="/">The page</a>')  # fmt: skip
ENTERING = (
    b"default-src 'none'; script-src 'sha256-" + b64encode(sha256(SCRIPT).digest()) + b"'; frame-ancestors 'none'"
)
REFUSED = "open this page with the address printed at its start, which contains the token"
LOCKED = "too many wrong tokens came from this address; wait a minute, then open the printed address"


def _number(name: str) -> bool:
    """Whether a name is a numeric address, which no other site's name can point to."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


class TokenAuth:
    """Admits requests that use this machine's own names, with the token or with a browser's cookie made from it."""

    def __init__(self, app: Any, token: str, host: str = "localhost", port: int = 0, chosen: bool = True) -> None:
        self.app = app
        self.token = token
        self.cookie: str = f"vam-{port}"
        self._most = WRONG if chosen else inf  # nobody guesses a random one, and accounts share this machine's address
        own = socket.gethostname().lower()
        self._names = {host.lower(), "localhost", own, f"{own}.local", socket.getfqdn().lower()}
        self._browsers: deque[str] = deque(maxlen=REMEMBERED)
        self._wrong: dict[str, deque[float]] = {}
        self._once: set[str] = set()

    def once(self) -> str:
        """A token that admits one browser: its command line, which other accounts can see, then holds nothing."""
        self._once.add(made := secrets.token_urlsafe(24))
        return made

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on, or answer it."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await self._request(scope, receive, self._guarded(send))

    async def _request(self, scope: Any, receive: Any, send: Any) -> None:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if not self._addressed(headers):
            return await _answer(send, 403, REFUSED.encode())
        if self._known(headers):
            return await self.app(scope, receive, send)
        entering = scope["method"] == "GET" and scope["path"] == "/"
        query = parse_qs(scope.get("query_string", b"").decode("latin-1")) if entering else {}
        bearer = headers.get(b"authorization", "").removeprefix("Bearer ")
        given = query.get("token", [bearer])[0]
        if not given:
            return await _answer(send, 403, REFUSED.encode())
        wrong = self._recent(scope)
        if len(wrong) >= self._most:
            return await _answer(send, 429, LOCKED.encode(), (b"retry-after", b"%d" % WINDOW))
        first = bool(query) and given in self._once
        if not first and not secrets.compare_digest(given.encode(), self.token.encode()):
            wrong.append(time.monotonic())
            return await _answer(send, 403, REFUSED.encode())
        if not query:
            return await self.app(scope, receive, send)
        self._once.discard(given)
        self._browsers.append(made := secrets.token_urlsafe(32))
        cookie = f"{self.cookie}={made}; HttpOnly; SameSite=Strict; Path=/".encode()
        headers = ((b"set-cookie", cookie), (b"content-security-policy", ENTERING))
        return await _answer(send, 200, ENTER, *headers, kind=b"text/html; charset=utf-8")

    def _addressed(self, headers: dict[bytes, str]) -> bool:
        """Whether a request names this machine, and does not come from a page of another site."""
        host, origin = headers.get(b"host", ""), headers.get(b"origin")
        before, colon, after = host.rpartition(":")
        name = (before if colon and after.isdigit() else host).lower()
        return (name in self._names or _number(name)) and (origin is None or origin.partition("//")[2] == host)

    def _known(self, headers: dict[bytes, str]) -> bool:
        try:
            cookie = SimpleCookie(headers.get(b"cookie", "")).get(self.cookie)
        except CookieError:
            return False
        given = "" if cookie is None else cookie.value
        return any([secrets.compare_digest(given.encode(), each.encode()) for each in self._browsers])

    def _recent(self, scope: Any) -> deque[float]:
        """The last time that the client's address gave wrong tokens."""
        address = (scope.get("client") or ("?", 0))[0]
        if address not in self._wrong and len(self._wrong) >= REMEMBERED:
            del self._wrong[next(iter(self._wrong))]
        wrong = self._wrong.setdefault(address, deque())
        while wrong and time.monotonic() - wrong[0] > WINDOW:
            wrong.popleft()
        return wrong

    @staticmethod
    def _guarded(send: Any) -> Any:
        async def answer(message: Any) -> None:
            if message["type"] == "http.response.start":
                given = list(message.get("headers", []))
                names = {name.lower() for name, _ in given}
                more = [(n.encode(), v.encode()) for n, v in HEADERS.items() if n.encode() not in names]
                message = {**message, "headers": [*given, *more]}
            await send(message)

        return answer


async def _answer(send: Any, status: int, body: bytes, *more: tuple[bytes, bytes], kind: bytes = b"text/plain") -> None:
    headers = [(b"content-type", kind), *more]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
