"""The web server of a page, in a thread of the process that prints."""

from __future__ import annotations

import logging
import secrets
import socket
import threading
import time
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.panel.auth import TokenAuth
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.schedules.timing import whole

STARTING = 10.0  # longest wait for the web server [s]; the page cannot stop a print before it is up
PORTS = 65535


class PageServer:
    """A web server in a separate thread, behind `TokenAuth`; a context manager."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> None:
        if not isinstance(host, str):
            raise BadInput(f"the panel's host is {host!r}; expected a name or address, such as '127.0.0.1'")
        if whole("the panel's port", port, 0) > PORTS:
            raise BadInput(f"the panel's port is {port!r}; expected at most {PORTS}: choose another host or port")
        if token is not None and (not isinstance(token, str) or len(token) < 16):
            raise BadInput("the panel's token is not text of 16 characters or more; leave it out to generate one")
        self.host = host
        self.token: str = secrets.token_urlsafe(24) if token is None else token
        self._chosen = token is not None
        self._server, self._thread = None, None
        self._auth: TokenAuth | None = None
        self._failed: BaseException | None = None
        self._socket = _listening(host, int(port))
        self.port: int = int(self._socket.getsockname()[1])

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return self._address(self.token)

    def url_once(self) -> str:
        """Address of the page for one browser, with a token that admits it once."""
        assert self._auth is not None
        return self._address(self._auth.once())

    def _address(self, token: str) -> str:
        name = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{name}:{self.port}/?token={quote(token)}"

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

    def app(self) -> Any:
        """The application to serve."""
        raise NotImplementedError

    def _made(self) -> Any:
        """The web server with its routes."""
        try:
            import uvicorn

            from vamgpu.hosts.panel.half_open import protocol

            app, http = self.app(), protocol()  # they also need the extra
        except ImportError as error:
            raise DeviceError('the panel needs a web server: pip install "vamgpu[panel]"') from error
        self._auth = TokenAuth(app, self.token, self.host, self.port, self._chosen)
        return uvicorn.Server(uvicorn.Config(self._auth, log_level="warning", access_log=False, lifespan="off",
                                             server_header=False, http=http))  # fmt: skip

    def _serve(self, server: Any) -> None:
        try:
            server.run(sockets=[self._socket])
        except BaseException as error:  # a server that cannot start raises SystemExit, which ends only its thread
            self._failed = error
            logging.getLogger(__name__).error("the panel's web server ended: %s", error)

    def _wait(self, server: Any, thread: threading.Thread) -> None:
        """Return when the server is up. Raises `DeviceError`."""
        end = time.monotonic() + STARTING
        while not server.started:
            if not thread.is_alive():
                why = "" if self._failed is None else f": {self._failed!r}"
                raise DeviceError(f"the panel's web server stopped early{why}; see the log, or do without it")
            if time.monotonic() > end:
                raise DeviceError(f"the panel's web server is not up after {STARTING:g} s; try again, or do without it")
            thread.join(0.01)

    def __exit__(self, *_: object) -> None:
        if self._server is not None and self._thread is not None:
            logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # it reports closed connections
            self._server.should_exit = True
            self._server.force_exit = True  # browsers keep their connections open
            self._thread.join(timeout=5.0)
        self._socket.close()


class Panel(PageServer):
    """A server of the page in a separate thread; a context manager, which may stay open after the print.

    Args:
        board: The board of the print to show and stop.
        host: The address to serve at.
        port: Port of the server; 0 selects a free one.
        token: Token for browsers and programs, 16 characters or more; None generates one. Other accounts of this
            machine need it too.
        page: False serves only programs.
        runs: The folder whose run folders are the history; None shows none.
        run: The name of this print's run folder.

    Raises:
        BadInput: An argument is invalid.
        DeviceError: The extra is missing, the port is taken, or the server does not start.
    """

    def __init__(
        self, board: Board, host: str = "127.0.0.1", port: int = 0, token: str | None = None, page: bool = True, *,
        runs: str | Path | None = None, run: str | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(board, Board):
            raise BadInput(f"the panel's board is {board!r}; expected the Board of a print")
        self.board = board
        self.page = page
        self.runs: Path | None = None if runs is None else Path(runs)
        self.run = run
        super().__init__(host, port, token)

    def app(self) -> Any:
        """The routes of the page."""
        from vamgpu.hosts.panel.routes import served

        return served(self.board, self.page, self.runs, self.run)


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    server = socket.socket(family, socket.SOCK_STREAM)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        server.bind((host, port))
    except (OSError, ValueError, TypeError) as error:  # in use, not an address of this machine, or not a name
        server.close()
        told = f"the panel cannot be served at {host}:{port}: {error}; choose another host or port"
        raise DeviceError(told) from error
    server.listen(32)
    return server
