"""Routes of the server: the page, the print's state, and the buttons."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter, to_thread
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from vamgpu.errors import VamError
from vamgpu.hosts.panel.history import past, report
from vamgpu.hosts.panel.view import ImageStore, curve, described, images, refusal, told
from vamgpu.hosts.records.state import Board
from vamgpu.storage.reading import read_bytes

PERIOD = 0.25  # between two polls of a page [s]
POLLS = 40.0  # polls of all pages per second; with more pages, each polls less often, to relieve the processor
LONGEST = 5.0  # longest pause between two polls of a page with any number of pages [s]
FRESH = 5.0  # time for which a history is reused [s]
STOPS = 1000  # number of simultaneous stops; if one hangs on a line, the next can still turn the light off
# Reports run their own script without access to this page: no cookie, no origin, no network.
SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; frame-ancestors 'none'"
)
FILES = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}


class RateLimit:
    """The pause of a page between polls [s], by the number of polls in the last second."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.wait: float = PERIOD
        self._clock, self._since, self._polls = clock, clock(), 0

    def count(self) -> float:
        """Count a poll of a page. Programs are not counted: one that polls without a pause would block the pages."""
        now = self._clock()
        self._polls += 1
        if (passed := now - self._since) >= 1.0:
            self.wait = min(LONGEST, max(PERIOD, self.wait * self._polls / passed / POLLS))
            self._since, self._polls = now, 0
        return self.wait


def served(board: Board, page: bool, runs: Path | None, run: str | None) -> Starlette:
    """The application. Programs use ``GET /state``, ``POST /stop`` and ``POST /press/NAME``, also without a page."""
    answers = _Answers(board, runs, run)
    routes = [
        Route("/state", answers.state),
        Route("/stop", answers.stop, methods=["POST"]),
        Route("/press/{name}", answers.press, methods=["POST"]),
        Route("/image/{name}", answers.image),
        Route("/scatter", answers.scatter),
        Route("/history", answers.history),
        Route("/runs/{run}/{name}", answers.report),
    ]
    shown = [Route(path, _file(name, kind)) for path, (name, kind) in FILES.items()] if page else []
    return Starlette(routes=[*shown, *routes])


def _file(name: str, kind: str) -> Callable[[Request], Awaitable[Response]]:
    content = files("vamgpu.hosts.panel").joinpath("static", name).read_bytes()

    async def answer(_: Request) -> Response:
        return Response(content, media_type=kind)

    return answer


class _Answers:
    """One server's answers. Handlers that use no disks and lines run in its loop, others in threads."""

    def __init__(self, board: Board, runs: Path | None, run: str | None) -> None:
        self._board, self._runs, self._run = board, runs, run
        self._store, self._rate_limit = ImageStore(), RateLimit()
        self._stops: CapacityLimiter | None = None
        self._disk: CapacityLimiter | None = None
        self._past: tuple[float, list[dict[str, Any]]] = (-FRESH, [])

    async def state(self, request: Request) -> Response:
        """The state for the page."""
        wait = self._rate_limit.count() if "page" in request.query_params else self._rate_limit.wait
        return JSONResponse(told(self._board, self._store) | {"wait": wait, "run": self._run})

    async def stop(self, _: Request) -> Response:
        """Emergency stop: the light is off when this answers. It does not wait for other work of the server."""
        self._stops = self._stops or CapacityLimiter(STOPS)
        try:
            await to_thread.run_sync(self._board.stop, "emergency stop at the panel", limiter=self._stops)
        except Exception as error:  # the other machines were still stopped
            return PlainTextResponse(f"not every machine stopped: {error}", 500)
        return JSONResponse(described(self._board.now))

    async def press(self, request: Request) -> Response:
        """A button."""
        name = request.path_params["name"]
        press = self._board.buttons.get(name)
        if press is None:
            return PlainTextResponse(f"there is no button {name!r}", 404)
        if (why := refusal(self._board.now, name)) is not None:
            return PlainTextResponse(why, 409)
        try:
            await to_thread.run_sync(press)
        except VamError as error:
            return PlainTextResponse(str(error), 409)
        return JSONResponse(described(self._board.now))

    async def image(self, request: Request) -> Response:
        """A projector's frame, or the camera's image."""
        name = request.path_params["name"]
        image = images(self._board.now).get(name)
        if image is None:
            return PlainTextResponse(f"there is no image {name!r} now", 404)
        return Response(await to_thread.run_sync(self._store.png, name, image), media_type="image/png")

    async def scatter(self, _: Request) -> Response:
        """The curve of the resin's scatter."""
        return JSONResponse(curve(self._board.now))

    async def history(self, _: Request) -> Response:
        """Past prints, with this one."""
        if self._runs is None:
            return JSONResponse([])
        self._disk = self._disk or CapacityLimiter(1)
        async with self._disk:  # a disk that hangs blocks only one thread
            if time.monotonic() - self._past[0] >= FRESH:
                found = await to_thread.run_sync(past, self._runs, self._run)
                self._past = (time.monotonic(), found)
        return JSONResponse(self._past[1])

    async def report(self, request: Request) -> Response:
        """The report of a print."""
        run, name = request.path_params["run"], request.path_params["name"]
        page = None if self._runs is None else await to_thread.run_sync(report, self._runs, run, name)
        if page is None:
            return PlainTextResponse("there is no such report", 404)
        content = await to_thread.run_sync(read_bytes, page)
        return Response(content, media_type="text/html", headers={"content-security-policy": SANDBOX})
