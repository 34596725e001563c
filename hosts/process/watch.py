"""Processes that watch and stop a print: those that started it, and those that find it later."""

from __future__ import annotations

import logging
import os
import signal
import tempfile
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict
from functools import partial
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, DeviceError, StorageError, VamError
from vamgpu.hosts.player.operator import Viewer
from vamgpu.hosts.process.messages import ANSWER, LIVE, answered, local, receive, send, spawned
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.process.resume import may_go_on
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.storage.reading import MOST_TOML, parse_json, read_text

log: logging.Logger = logging.getLogger(__name__)
PATIENCE = 2.0  # time after which an unresponsive process is ended, and the lease switches the light off [s]


class LightProcessLost(DeviceError):
    """The process that controlled the light has ended; if a controller gates the light, its lease switches it off."""


class Watch(AbstractContextManager["Watch"]):
    """A print in another process, mirrored on a board, whose stop and buttons control it; a context manager."""

    pid: int

    def __init__(self, live: dict[str, Any], board: Board) -> None:
        self.board = board
        self.facts: dict[str, str] = dict[str, str]()
        self.end: dict[str, Any] = dict[str, Any]()
        self._held = ExitStack()
        self._over, self._lock = threading.Event(), threading.Lock()
        try:
            self._address, self._key, self.pid = str(live["address"]), bytes.fromhex(live["key"]), int(live["pid"])
            if not isinstance(live["address"], str) or not local(live["address"]) or self.pid < 2:
                raise ValueError("expected the name of a socket, and a process")
            self._stopping, watching = self._line(), self._line()
        except (OSError, EOFError, AuthenticationError, ValueError, KeyError, TypeError) as error:
            raise StorageError(f"no process answers for this print: {error}; see its folder, or --resume it") from error
        self.order: PrintOrder = PrintOrder.parse(parse_json(self._asked(self._stopping, do="order")["order"]))
        send(watching, {"do": "watch"})
        board.on_stop(self.stop)
        self._thread = threading.Thread(target=self._mirror, args=(watching,), name="mirror", daemon=True)
        self._thread.start()

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is KeyboardInterrupt:
                self.stop("SIGINT")
        finally:
            self._held.close()

    def viewed(self, planned: PrintPlan) -> None:
        """Draw the shown frames on the board, in this process."""
        sources = planned.sources()

        def frame(number: int, engine: int = 0) -> np.ndarray:
            return sources[engine].frame(number)

        self._held.enter_context(Viewer(self.board, frame, len(sources)))

    def stop(self, why: str) -> None:
        """Turn the light off at once: by a line, a signal, or the end of that process. Raises `LightProcessLost`."""
        if self._over.is_set():
            return
        answered, answers = threading.Event(), list[BaseException]()

        def ask() -> None:
            try:
                with self._lock:
                    self._asked(self._stopping, do="stop", why=why)
            except VamError as error:
                answers.append(error)
            except (OSError, EOFError, ValueError):
                return
            answered.set()

        threading.Thread(target=ask, daemon=True).start()
        if not answered.wait(ANSWER):
            self._signal(signal.SIGTERM)
            if not answered.wait(PATIENCE) and not self._over.is_set():
                self._signal(getattr(signal, "SIGKILL", signal.SIGTERM))
                raise LightProcessLost(
                    f"the process that holds the light did not answer ({why}) and was ended; {self._dark()}"
                )
        if answers:
            raise answers[0]

    def press(self, name: str) -> None:
        """Press a button there. Raises its error, or `DeviceError` without an answer."""
        self._ordered(do="press", name=name)

    def answer(self, go_on: bool) -> None:
        """Answer whether a held print continues."""
        self._ordered(do="answer", go_on=go_on)

    def wait(self, seconds: float | None = None) -> bool:
        """Whether it is over, after at most a time."""
        return self._over.wait(seconds)

    def result(self) -> dict[str, Any]:
        """The end of the print. Raises the error that ended it there, `LightProcessLost` if its process has ended."""
        if "error" in self.end:
            raise _error(self.end)
        return self.end

    def _line(self) -> Connection:
        line: Any = Client(self._address, authkey=self._key)
        self._held.callback(line.close)
        return line

    @staticmethod
    def _asked(line: Connection, **order: Any) -> dict[str, Any]:
        send(line, order)
        answer = receive(line)
        if "error" in answer:
            raise _error(answer)
        return answer

    def _ordered(self, **order: Any) -> None:
        try:
            line: Any = Client(self._address, authkey=self._key)
            with line:
                self._asked(line, **order)
        except (OSError, EOFError, AuthenticationError) as error:
            raise DeviceError(f"the process that holds the light does not answer: {error}") from error

    def _mirror(self, line: Connection) -> None:
        try:
            while not self.end:
                told = receive(line)
                self.facts.update(told.get("facts", {}))
                self.board.show(**told.get("fields", {}))
                for name in told.get("buttons", ()):
                    if name not in self.board.buttons:
                        self.board.button(name, partial(self.press, name))
                self.end = told.get("end", {})
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            log.error("the process that held the light has ended: %r", error)
            self._lost()
        finally:
            self._over.set()

    def _lost(self) -> None:
        """Show that the process has ended, and what to do."""
        state, told = PrintState.HELD, f"continue with --resume {self.order.folder}"
        try:
            may_go_on(self.order.planned(), self.order.folder)
        except VamError as error:
            state, told = PrintState.ERROR, str(error)
        told = f"the process that controlled the light has ended; {self._dark()}; {told}"
        self.end = {"error": LightProcessLost.__name__, "why": told, "state": state.value}
        self.board.show(state=state, message=told, light=not self.order.leased and self.board.now.light)

    def _dark(self) -> str:
        """A sentence on the light of a process that has ended."""
        return "the controller's lease switches the light off" if self.order.leased else (
            "no lease switches the light off: do it by hand"
        )  # fmt: skip

    def _signal(self, number: int) -> None:
        try:
            os.kill(self.pid, number)
        except OSError as error:
            log.warning("process %d cannot be signaled: %s", self.pid, error)


def _error(told: dict[str, Any]) -> VamError:
    """An error of the other process, of its own class if it is known here."""
    kinds, found = [VamError], dict[str, type[VamError]]()
    for kind in kinds:
        kinds.extend(kind.__subclasses__())
        found[kind.__name__] = kind
    name, why = str(told["error"]), str(told["why"])
    return found[name](why) if name in found else DeviceError(f"the print ended with {name}: {why}")


def started(order: PrintOrder, board: Board) -> Watch:
    """Print an order in a separate process, which outlives this one. Raises `DeviceError` if it does not start."""
    said = tempfile.TemporaryFile()  # noqa: SIM115 - not this terminal, which may be stopped or closed
    child = spawned("vamgpu.hosts.process", asdict(order), said)
    if (live := answered(child)) is None:
        child.wait()
        said.seek(0)
        told = said.read().decode(errors="replace").strip()
        raise DeviceError(f"the process that holds the light did not start: {told or child.returncode}")
    threading.Thread(target=child.wait, name="reaper", daemon=True).start()
    return Watch(live, board)


def attached(folder: str | Path, board: Board) -> Watch:
    """Watch a print that another process started, by its run folder. Raises `StorageError` if none prints."""
    try:
        live = parse_json(read_text(Path(folder) / LIVE, MOST_TOML))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise StorageError(f"no process prints {str(folder)!r} now ({LIVE}: {why}); check the path") from error
    if not isinstance(live, dict):
        raise StorageError(f"{str(Path(folder) / LIVE)!r} is malformed; see the run's folder, or --resume it")
    return Watch(live, board)


def watched(watch: Watch, told: Callable[[str, str], None], go_on: Callable[[str], bool] | None) -> dict[str, Any]:
    """Wait for a print's end. told: called with facts.  go_on: called with the reason of a hold. Raises its error."""
    reported, asked = set[str](), ""
    while True:
        try:
            over = watch.wait(0.1)
            for name in [name for name in watch.facts if name not in reported]:
                reported.add(name)
                told(name, watch.facts[name])
            if over:
                return watch.result()
            now = watch.board.now
            if go_on is not None and now.state is PrintState.HELD and asked != now.message:
                asked = now.message
                watch.answer(go_on(asked))
            elif now.state is not PrintState.HELD:
                asked = ""
        except KeyboardInterrupt:
            watch.stop("SIGINT")


def may_begin(folder: str | Path) -> None:
    """Raise `BadInput` if a process is printing in a folder."""
    if not (Path(folder) / LIVE).exists():
        return
    try:
        with attached(folder, Board()) as found:
            pid = found.pid
    except StorageError:
        return
    raise BadInput(f"process {pid} prints {str(folder)!r} now; watch it with vam panel --attach {str(folder)}")
