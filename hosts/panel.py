"""The live page of a print: what it shows, how it does, and a stop. Needs the extra ``panel``."""

from __future__ import annotations

import base64
import io
import ipaddress
import secrets
import socket
import threading
from http.cookies import SimpleCookie
from typing import Any, Self
from urllib.parse import parse_qs

import numpy as np

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.board import Board, Snapshot

COOKIE = "vam-token"
PERIOD = 0.2
"""Seconds between two looks of a page at the print."""
WIDTH = 480
"""Pixels of the picture's longer side on the page."""


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
    `BadInput`, and `DeviceError` where the extra is missing, the port is taken, or the page was served before.
    """

    def __init__(
        self, board: Board, host: str = "127.0.0.1", port: int = 0, token: str | None = None, page: bool = True
    ) -> None:
        if token is not None and len(token) < 16:
            raise BadInput("the panel's token is shorter than 16 characters; leave it out to have one made")
        self.board, self.host, self.page = board, host, page
        self.token = token if token is not None or loopback(host) else secrets.token_urlsafe(24)
        self._server, self._thread = None, None
        self._socket = _listening(host, port)
        self.port = int(self._socket.getsockname()[1])

    @property
    def url(self) -> str:
        """Where the page is, with what lets one in."""
        name = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{name}:{self.port}/" + ("" if self.token is None else f"?token={self.token}")

    def __enter__(self) -> Self:
        try:
            import uvicorn
            from fastapi import FastAPI

            app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
            _routes(app, self.board)
            if self.page:
                _pages(app, self.board)
        except ImportError as error:
            self._socket.close()
            raise DeviceError('the panel needs NiceGUI: pip install "vamgpu[panel]"') from error
        except DeviceError:
            self._socket.close()
            raise
        config = uvicorn.Config(Doorkeeper(app, self.token), log_level="warning", access_log=False, lifespan="on")
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, name="panel", daemon=True
        )
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._server is not None and self._thread is not None:
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
    except OSError as error:
        server.close()
        raise DeviceError(f"the panel cannot be served at {host}:{port}: {error}; choose another port") from error
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
    """A snapshot as plain values, without its picture."""
    return {name: value for name, value in vars(now).items() if name != "picture"}


def rows(now: Snapshot) -> dict[str, str]:
    """What the page says, by the name it says it under."""
    done = f" of {now.slots}" if now.slots else ""
    return {
        "state": now.state.value + (f": {now.message}" if now.message else ""),
        "light": f"ON at {now.power:.4g}" if now.light else "off",
        "frame": f"{now.frame} (slot {now.slot}{done})",
        "position": f"{now.position:.3f} {now.unit}",
        "focus": "—" if now.focus is None else f"{now.focus:+.3f} dpt",
        "buffer": f"{100 * now.fill:.0f} % full",
        "timing margin": f"{now.margin / 1e6:.2f} ms",
        "shown black": str(now.dark),
        "dose": f"{100 * now.spent:.1f} % of the plan",
    }


def _pages(app: Any, board: Board) -> None:
    from nicegui import app as served
    from nicegui import ui

    if served.middleware_stack is not None:
        raise DeviceError("this process has served the page before; begin the next print in a process of its own")

    @ui.page("/")
    def page() -> None:
        _page(ui, board)

    ui.run_with(app, title="vamgpu", dark=True, show_welcome_message=False, reconnect_timeout=3.0)


def _page(ui: Any, board: Board) -> None:
    """One browser's page."""
    ui.button("EMERGENCY STOP", on_click=lambda: board.stop("emergency stop at the panel"), color="red").classes(
        "w-full text-2xl py-6"
    ).mark("stop").props('data-testid="stop"')
    ui.label(board.now.job).classes("text-lg")
    with ui.row():
        picture = ui.image().style(f"width: {WIDTH}px; background: black; image-rendering: pixelated")
        picture.props('data-testid="picture" no-transition no-spinner')
        with ui.grid(columns="auto 1fr").classes("gap-x-6 text-lg"):
            values = {}
            for name in rows(board.now):
                ui.label(name).classes("opacity-60")
                values[name] = ui.label().props(f'data-testid="{name}"')
    with ui.row():
        buttons = {
            name: ui.button(name, on_click=lambda press=press: _press(ui, press)).props(f'data-testid="{name}"')
            for name, press in board.buttons.items()
        }
    shown: list[Any] = [None]

    def refresh() -> None:
        now = board.now
        for name, text in rows(now).items():
            values[name].set_text(text)
        values["light"].style("color: #fd6" if now.light else "color: inherit")
        for button in buttons.values():
            button.set_enabled(not now.state.ended)
        if now.picture is not None and now.picture is not shown[0]:
            shown[0] = now.picture
            picture.set_source(data_url(now.picture))

    refresh()
    ui.timer(PERIOD, refresh)


def _press(ui: Any, press: Any) -> None:
    from vamgpu.errors import VamError

    try:
        press()
    except VamError as error:
        ui.notify(str(error), type="warning")


def data_url(picture: np.ndarray) -> str:
    """A picture as a page takes it, thinned out to the page's size."""
    from PIL import Image

    step = max(1, -(-max(picture.shape) // WIDTH))
    kept = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture[::step, ::step])).save(kept, "PNG", compress_level=1)
    return "data:image/png;base64," + base64.b64encode(kept.getvalue()).decode()
