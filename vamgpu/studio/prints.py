"""Rigs and runs, and the print page for one run: the live one, or the record of one that has ended."""

from __future__ import annotations

from contextlib import suppress
from threading import Lock
from typing import Any

from vamgpu.errors import StorageError, VamError
from vamgpu.hosts.panel.history import past, report
from vamgpu.hosts.panel.routes import served
from vamgpu.hosts.process.messages import running
from vamgpu.hosts.process.watch import Watch, attached
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.guarantees import driver_of, guarantees, refused
from vamgpu.storage.reading import parse_json, read_bytes, read_text
from vamgpu.studio.workspace import JOB, Refused, Workspace

ROLES = ("motion", "clock", "display", "light", "lens", "feedback")
# The print page may stand in a frame of this page.
FRAMED = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'self'"
)


class Prints:
    """The runs of a workspace; an ASGI application that serves the print page of one of them."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace, self._lock = workspace, Lock()
        self._watch: Watch | None = None
        self._board = Board()
        self.run: str | None = None
        self._followed: str | None = None
        self._app: Any = served(self._board, True, workspace.folder, None)

    def rig(self, name: str, speed: float | None) -> dict[str, Any]:
        """Parts of a rig, and what it guarantees."""
        place = name if name == "emulated" else str(self._workspace.existing(name, JOB))
        setup = read_rig(place).setup
        unit = "deg" if setup.rig.machine in ("vial", "any") else "mm"
        found = guarantees(setup, speed or (40.0 if unit == "deg" else 1.0), unit)
        parts = {role: [driver_of(each) for each in (part if isinstance(part, tuple) else (part,)) if each]
                 for role in ROLES for part in (getattr(setup, role),)}  # fmt: skip
        drift = f"[safety] accepts drift = {setup.safety.drift:g}" if refused(found, setup) else ""
        return {"id": name, "machine": setup.rig.machine, "parts": parts, "emulated": setup.emulated,
                "guarantees": [each.record() for each in found], "refused": drift}  # fmt: skip

    def runs(self) -> list[dict[str, Any]]:
        return past(self._workspace.folder)

    def report(self, run: str, name: str) -> bytes:
        """The report of a run. Raises `Refused`."""
        page = report(self._workspace.folder, run, name)
        if page is None:
            raise Refused(404, "there is no such report")
        return read_bytes(page)

    def now(self) -> dict[str, Any]:
        """The run of the print page."""
        return {"run": self.run, "state": self._board.now.state.value if self.run else None, "page": "/print/"}

    def attach(self, run: str) -> dict[str, Any]:
        """Show a run: live, if a process prints it, else as it ended. Raises `Refused`."""
        place = self._workspace.existing(run)
        if not (place / "run.json").is_file():
            raise Refused(404, f"{run} is no run; expected one of the history")
        with self._lock:
            board, watch = Board(job=run), None
            if running(place):
                with suppress(StorageError):
                    watch = attached(place, board)
            if watch is None:
                with suppress(OSError, ValueError, KeyError):
                    told = parse_json(read_text(place / "state.json"))
                    board.show(state=PrintState(told["state"]), message=str(told["message"]))
            else:
                with suppress(VamError):
                    watch.viewed(watch.order.planned())
            before, self._watch, self._board, self.run = self._watch, watch, board, run
            self._app = served(board, True, self._workspace.folder, run)
            if before is not None:
                before.__exit__(None)
        return self.now()

    def follow(self, run: str | None) -> bool:
        """Attach once to a run as soon as its process prints it; returns whether the page changed."""
        if run is None or run == self._followed or not running(self._workspace.folder / run):
            return False
        self.attach(run)
        self._followed = None if self._watch is None else run
        return True

    def close(self) -> None:
        """Leave the run, which continues."""
        if self._watch is not None:
            self._watch.__exit__(None)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve the print page, which this page may frame."""

        async def framed(message: Any) -> None:
            if message["type"] == "http.response.start":
                given = [(name.lower(), value) for name, value in message.get("headers", [])]
                own = {b"content-security-policy": FRAMED.encode(), b"x-frame-options": b"SAMEORIGIN"}
                more = [pair for pair in own.items() if pair[0] not in dict(given)]
                message = {**message, "headers": [*given, *more]}
            await send(message)

        await self._app(scope, receive, framed)
