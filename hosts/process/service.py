"""Serves the state of a print to processes that watch it, and takes their orders; the print never waits for them.

Each line of orders has a thread, so that an emergency stop never waits.
"""

from __future__ import annotations

import gc
import json
import queue
import secrets
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, Listener, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any

from vamgpu.hosts.process.messages import LIVE, address, receive, send
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.records.state import Board, PrintState, Snapshot

PERIOD = 0.1  # between two snapshots [s]
SAYS = {"resume": True, "cancel": False}  # button → whether a held print continues
LEAVE = 2.0  # longest time for the last snapshot [s]


class ServedBoard(Board):
    """The board of a print with previews drawn elsewhere. found: whether ``live`` is in the run's folder."""

    draws_previews = False

    def __init__(self, folder: Path, live: str) -> None:
        super().__init__()
        self._place, self._live = folder, live
        self.found: bool = False

    def show(self, **fields: object) -> None:
        """See `Board.show`; no garbage collection while the light is on."""
        super().show(**fields)
        if "state" in fields:
            (gc.disable if fields["state"] is PrintState.PRINTING else gc.enable)()
        if self._live and (self._place / "run.json").is_file():
            live, self._live, self.found = self._live, "", True
            with suppress(OSError):  # without the file, the print still runs
                (self._place / LIVE).unlink(missing_ok=True)
                (self._place / LIVE).touch(mode=0o600)
                (self._place / LIVE).write_text(live, encoding="utf-8")


class Service:
    """Serves a print's board to any number of processes of the same user."""

    def __init__(self, order: PrintOrder) -> None:
        self._listener, self._key = Listener(), secrets.token_bytes(32)
        self.live: str = address(self._listener, self._key)
        self.order = order
        self.board: ServedBoard = ServedBoard(Path(order.folder), self.live)
        self.facts: dict[str, str] = {}
        self._end: dict[str, Any] | None = None
        self._over = threading.Event()
        self._watching: set[threading.Thread] = set()
        self.seen: threading.Event = threading.Event()  # set once a client watches
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        threading.Thread(target=self._accept, name="service", daemon=True).start()

    def go_on(self, meanwhile: Callable[[], None] = lambda: None) -> bool:
        """Ask the clients whether a held print continues; False without clients. meanwhile: called while waiting."""
        while not self._answers.empty():
            self._answers.get()
        while self._watching:
            try:
                return self._answers.get(timeout=PERIOD)
            except queue.Empty:
                meanwhile()
        return False

    def close(self, end: dict[str, Any]) -> None:
        """Report the end, and close. end: the state, or the error."""
        self._end = end
        self._over.set()
        for thread in tuple(self._watching):
            thread.join(LEAVE)
        if self.board.found:
            with suppress(OSError):
                (Path(self.order.folder) / LIVE).unlink(missing_ok=True)
        self._listener.close()

    def _accept(self) -> None:
        while not self._over.is_set():
            try:
                line: Any = self._listener.accept()
            except OSError:
                continue
            threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: Connection) -> None:
        try:
            deliver_challenge(line, self._key)
            answer_challenge(line, self._key)
            while True:
                asked = receive(line)
                if asked["do"] == "watch":
                    self._watched(line)
                    return
                send(line, self._answer(asked))
        except (EOFError, OSError, AuthenticationError, ValueError, KeyError, TypeError):
            pass  # drop clients with invalid messages or closed lines
        finally:
            line.close()

    def _answer(self, asked: dict[str, Any]) -> dict[str, Any]:
        try:
            match asked["do"]:
                case "stop":
                    self.board.stop(str(asked["why"]))
                case "press":
                    self.board.buttons[asked["name"]]()
                    if asked["name"] in SAYS:
                        self._answers.put(SAYS[asked["name"]])
                case "answer":
                    self._answers.put(bool(asked["go_on"]))
                case "order":
                    return {"order": json.dumps(asdict(self.order))}
        except Exception as error:
            return failed(error)
        return {}

    def _watched(self, line: Connection) -> None:
        """Send changes until the print is over or the client is gone."""
        self._watching.add(threading.current_thread())
        self.seen.set()
        try:
            sent, first = Snapshot(), True
            while True:
                over = self._over.wait(0 if first else PERIOD)
                now, first = self.board.now, False
                new = {name: value for name, value in vars(now).items() if changed(value, getattr(sent, name))}
                sent = now
                send(line, {"fields": new, "buttons": list(self.board.buttons), "facts": dict(self.facts)})
                if over:
                    send(line, {"end": self._end})
                    return
        finally:
            self._watching.discard(threading.current_thread())


def changed(value: Any, before: Any) -> bool:
    """Whether a value is sent again: if it changed, or is a list, which may have grown."""
    return value is not before or isinstance(value, list)


def failed(error: BaseException) -> dict[str, Any]:
    return {"error": type(error).__name__, "why": str(error)}
