"""Serves the live page of a print, and the same to programs, to those who may see it. Needs the extra ``panel``."""

from __future__ import annotations

import ipaddress
import logging
import secrets
import socket
import threading
import time
from http.cookies import SimpleCookie
from math import isfinite
from typing import Any, Self
from urllib.parse import parse_qs

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.board import Board, Snapshot
from vamgpu.hosts.page import serve_page
from vamgpu.hosts.schedules.timing import whole

COOKIE = "vam-token"
STARTING = 10.0
"""Longest wait for the web server [s]; before it is up, nobody could stop a print at the page."""
PORTS = 65535


def loopback(host: str) -> bool:
    """Whether only this machine can reach a server at ``host``."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Doorkeeper:
    """Lets in requests that carry the token; on loopback, those that were addressed to this machine.

    The latter keeps out pages of other sites whose name was made to point here.
    """

    def __init__(self, app: Any, token: str | None) -> None:
        self.app, self.token = app, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on, or answer it with 403."""
        if scope["type"] not in ("http", "websocket") or self._allowed(scope):
            await self.app(scope, receive, self._with_cookie(scope, send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            headers = [(b"content-type", b"text/plain; charset=utf-8")]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            text = "open this page with the address that was printed when it was started, token included"
            await send({"type": "http.response.body", "body": text.encode()})

    def _allowed(self, scope: Any) -> bool:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if self.token is None:
            host = headers.get(b"host", "")
            named = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
            origin = headers.get(b"origin", "")
            return loopback(named) and (not origin or origin.partition("//")[2] == host)
        cookie = SimpleCookie(headers.get(b"cookie", "")).get(COOKIE)
        given = [cookie.value] if cookie else []
        given += parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        return any(secrets.compare_digest(each.encode(), self.token.encode()) for each in given)

    def _with_cookie(self, scope: Any, send: Any) -> Any:
        """The first answer leaves the token with the browser, so that what the page loads is let in."""
        if self.token is None or scope["type"] != "http":
            return send

        async def answer(message: Any) -> None:
            if message["type"] == "http.response.start":
                value = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/".encode()
                message = {**message, "headers": [*message.get("headers", []), (b"set-cookie", value)]}
            await send(message)

        return answer


class Panel:
    """A server of the page in a thread of its own; a context manager.

    board: what is shown and stopped.  host: the address to serve at; beyond this machine only with a token.  port: 0
    finds a free one.  token: what a browser must bring; made up for hosts beyond this machine.  page: False serves
    programs alone. NiceGUI keeps one application a process, so that a process can serve the page once.  Raises
    `BadInput`, and `DeviceError` where the extra is missing, the port is taken, the page was served before, or the
    server does not start.
    """

    def __init__(
        self, board: Board, host: str = "127.0.0.1", port: int = 0, token: str | None = None, page: bool = True
    ) -> None:
        if not isinstance(board, Board):
            raise BadInput(f"the panel's board is {board!r}; wanted the Board of a print")
        if not isinstance(host, str):
            raise BadInput(f"the panel's host is {host!r}; wanted a name or address, such as '127.0.0.1'")
        if whole("the panel's port", port, 0) > PORTS:
            raise BadInput(f"the panel's port is {port!r}; wanted {PORTS} at most: choose another host or port")
        if token is not None and (not isinstance(token, str) or len(token) < 16):
            raise BadInput("the panel's token is no text of 16 characters or more; leave it out to have one made")
        self.board, self.host, self.page = board, host, page
        self.token = token if token is not None or loopback(host) else secrets.token_urlsafe(24)
        self._server, self._thread = None, None
        self._failed: BaseException | None = None
        self._socket = _listening(host, int(port))
        self.port = int(self._socket.getsockname()[1])

    @property
    def url(self) -> str:
        """Where the page is, with what lets one in."""
        name = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{name}:{self.port}/" + ("" if self.token is None else f"?token={self.token}")

    def __enter__(self) -> Self:
        try:
            self._server = self._made()
            self._thread = threading.Thread(target=self._serve, args=(self._server,), name="panel", daemon=True)
            self._thread.start()
            self._wait(self._server, self._thread)
        except BaseException:
            self.__exit__()
            raise
        return self

    def _made(self) -> Any:
        """The web server with all that it serves."""
        try:
            import uvicorn
            from fastapi import FastAPI

            app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
            _routes(app, self.board)
            if self.page:
                serve_page(app, self.board)
        except ImportError as error:
            raise DeviceError('the panel needs NiceGUI: pip install "vamgpu[panel]"') from error
        config = uvicorn.Config(Doorkeeper(app, self.token), log_level="warning", access_log=False, lifespan="on")
        return uvicorn.Server(config)

    def _serve(self, server: Any) -> None:
        try:
            server.run(sockets=[self._socket])
        except BaseException as error:  # a server that cannot start exits, which a thread keeps to itself
            self._failed = error
            logging.getLogger(__name__).error("the panel's web server ended: %s", error)

    def _wait(self, server: Any, thread: threading.Thread) -> None:
        """Return when the server is up. Raises `DeviceError`."""
        end = time.monotonic() + STARTING
        while not server.started:
            if not thread.is_alive():
                why = "" if self._failed is None else f": {self._failed!r}"
                raise DeviceError(f"the panel's web server ended before it was up{why}; see the log, or do without it")
            if time.monotonic() > end:
                raise DeviceError(f"the panel's web server is not up after {STARTING:g} s; try again, or do without it")
            thread.join(0.01)

    def __exit__(self, *_: object) -> None:
        if self._server is not None and self._thread is not None:
            logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # it reports connections that are cut
            self._server.should_exit = True
            self._server.force_exit = True  # browsers keep their connection as long as they are let
            self._thread.join(timeout=5.0)
        self._socket.close()


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    server = socket.socket(family, socket.SOCK_STREAM)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        server.bind((host, port))
    except (OSError, ValueError, TypeError) as error:  # taken, no address of this machine, or no name at all
        server.close()
        told = f"the panel cannot be served at {host}:{port}: {error}; choose another host or port"
        raise DeviceError(told) from error
    server.listen(32)
    return server


def _routes(app: Any, board: Board) -> None:
    """The same for programs: ``GET /state`` and ``POST /stop``, which works where no page does."""

    @app.get("/state")
    def state() -> dict[str, Any]:
        return described(board.now)

    @app.post("/stop")
    def stop() -> dict[str, Any]:
        board.stop("emergency stop over the network")
        return described(board.now)


def described(now: Snapshot) -> dict[str, Any]:
    """A snapshot as plain values, without its picture; None for what is no finite number, which JSON does not hold."""
    plain = {name: value for name, value in vars(now).items() if name != "picture"}
    return {name: None if isinstance(value, float) and not isfinite(value) else value for name, value in plain.items()}
