"""The line from a print to the process that plans its turns: bounded, and the print never waits for it.

Its messages are checked, stored and offered in a thread; if it dies or sends invalid messages, only the update is lost.
"""

from __future__ import annotations

import logging
import secrets
import subprocess
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.frames.versions import FrameVersions
from vamgpu.hosts.player.player import StatusPoll
from vamgpu.hosts.process.live_camera import LiveCamera
from vamgpu.hosts.process.messages import answered, receive, send, spawned
from vamgpu.hosts.process.proposals import checks, frames_of, maps, parameters, proposal, relative_light
from vamgpu.hosts.process.versions import boundary, replaced, sources_of
from vamgpu.hosts.records.plans import keep, last_kept
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.timing import SECOND

log: logging.Logger = logging.getLogger(__name__)
WAITING = 256  # most messages queued for the other process; older images are dropped
CHECKS = 1024  # most checks of images on the page
LEAVE = 1.0  # longest time for that process to end [s]
COLUMNS = ("slot", "frame", "version", "position", "on_time", "engine", "dark")


@dataclass(frozen=True)
class LiveOrder:
    """An order to plan coming turns, with a function that is called with a `PlannerClient`. Raises `BadInput`."""

    function: str  # ``package.module:function``
    allowance: float = 0.0  # light that it may add, as a share of the job's
    patience: float = 2.0  # turns without an answer after which it counts as silent
    settings: Mapping[str, Any] = field(default_factory=dict)  # settings of its task, as plain values
    stop: int | None = None  # the turn before which the light ends unless a version changes it
    wait: float = 0.0  # time for which a simulated clock stops while it plans [s]
    resin: Mapping[str, Any] | None = None  # emulated resin of a dry run, see `vamgpu.hosts.rigs.rehearsal.curing`

    def __post_init__(self) -> None:
        positive("allowance of light", self.allowance, zero=True)
        positive("patience [turns]", self.patience)
        positive("wait [s]", self.wait, zero=True)
        if not all(self.function.partition(":")):
            raise BadInput(f"live planning by {self.function!r}; expected package.module:function")


def task_of(planned: PrintPlan, folder: Path) -> dict[str, Any]:
    """The task that the planning process receives first."""
    table, first, count = planned.schedule, planned.jobs[0], boundary(planned)
    vial = planned.kind == "vial"
    poses, period = (table.frames, 360 / float(table.speed)) if vial else (first.segment, count / table.rate)
    return {
        "print": secrets.token_hex(8), "jobs": [each.path for each in planned.jobs], "kind": planned.kind,
        "frames": count, "turns": -(-len(table) // count), "shape": [poses, *first.shape], "bits": planned.bits,
        "projectors": len(planned.jobs), "period": period, "folder": str(folder.absolute()),
    }  # fmt: skip


class LiveLink:
    """A planning process and its messages, both ways; a context manager. `saw` and `notices` never wait or raise."""

    def __init__(
        self, order: LiveOrder, task: dict[str, Any], planned: PrintPlan, versions: FrameVersions, clock: Clock,
        board: Board, camera: LiveCamera | None = None,
    ) -> None:  # fmt: skip
        self._order, self._task, self._planned, self._versions = order, task, planned, versions
        self._clock, self._board, self._camera = clock, board, camera
        self._folder = Path(task["folder"])
        self._patience = round(order.patience * task["period"] * SECOND)
        self._waiting: deque[dict[str, Any]] = deque()
        self._notices: deque[tuple[str, dict[str, Any]]] = deque()
        self._ready, self._over = threading.Condition(), threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._line: Any = None
        self._owing: int | None = clock.now()  # since when it has not answered
        self._silent = self._gone = False
        self._told = self._asked = 0  # messages to it, and number of its requests
        self.answers: int = 0  # answered proposals

    def saw(self, seen: StatusPoll) -> None:
        """Pass on the shown frames, and the images since."""
        if self._camera is not None:
            for image in self._camera.taken(seen.position):
                self._put(image)
        if seen.frames:
            rows = [asdict(each) for each in seen.frames]
            self._put({"shown": {name: np.array([row[name] for row in rows], np.int64) for name in COLUMNS}})
        if self._order.wait and not self._clock.real:
            with self._ready:  # so that a dry run, which is faster, repeats exactly
                self._ready.wait_for(lambda: self._asked > self._told or self._gone, self._order.wait)
        owing = self._owing
        if not (self._gone or self._silent or owing is None) and self._clock.now() - owing > self._patience:
            self._silent = True
            self._tell(
                "live silent",
                f"the planning process does not answer; {self._versions.unit}s continue as planned ({self._version()})",
            )

    def _put(self, message: dict[str, Any]) -> None:
        """Queue a message; a full queue drops its oldest image, or else its oldest message."""
        with self._ready:
            if len(self._waiting) >= WAITING:
                del self._waiting[next((k for k, each in enumerate(self._waiting) if "image" in each), 0)]
                self._told -= 1
            self._waiting.append(message)
            self._told += 1
            self._ready.notify_all()

    def notices(self) -> list[tuple[str, dict[str, Any]]]:
        """Events since this was asked."""
        found = [] if self._camera is None else self._camera.notices()
        for _, facts in found:
            self._board.show(live=facts["why"])
        while self._notices:
            found.append(self._notices.popleft())
        return found

    def _version(self) -> str:
        number = self._versions.at(self._versions.end)
        return f"version {number}" if number else "the job's frames"

    def _tell(self, kind: str, why: str, **facts: Any) -> None:
        log.warning("%s", why)
        self._board.show(live=why)
        self._notices.append((kind, {"why": why} | facts))

    def __enter__(self) -> LiveLink:
        try:
            self._process = spawned("vamgpu.hosts.live", {"function": self._order.function})
        except OSError as error:
            self._lost(f"it did not start: {error}")
        else:
            threading.Thread(target=self._serve, args=(self._process,), name="live", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        with self._ready:
            self._ready.notify_all()
        if self._line is not None:
            with suppress(OSError):
                self._line.close()
        if self._process is not None:
            try:
                self._process.wait(LEAVE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _ended(self, event: str, text: str) -> None:
        """Wake the threads that wait for a proposal, because none will come, and report the reason."""
        self._gone = True
        with self._ready:
            self._ready.notify_all()
        self._tell(event, text)

    def _lost(self, why: str) -> None:
        if not self._gone and not self._over.is_set():
            self._ended(
                "live lost",
                f"the planning process is lost: {why}; {self._versions.unit}s continue as planned ({self._version()})",
            )

    def _serve(self, process: subprocess.Popen[bytes]) -> None:
        try:
            if (live := answered(process)) is None:
                self._lost(f"it exited with code {process.wait()} before it was ready")
                return
            self._line = Client(live["address"], authkey=bytes.fromhex(live["key"]))
            if self._over.is_set():
                self._line.close()
                return
            self._say({"task": self._task | {"settings": dict(self._order.settings)}})
            threading.Thread(target=self._sending, name="live send", daemon=True).start()
            while not self._over.is_set():
                told = self._received()
                self._owing = None
                if self._silent:
                    self._silent = False
                    self._tell("live speaks", "the planning process answers again")
                if told is not None:
                    self._take(told)
                    self._owing = None  # its messages from meanwhile come now
                if told is not None and "ready" in told:
                    with self._ready:
                        self._asked += 1
                        self._ready.notify_all()
        except (OSError, EOFError, AuthenticationError) as error:
            self._lost(repr(error))

    def _received(self) -> dict[str, Any] | None:
        """The next message; None for an invalid one."""
        try:
            return receive(self._line)
        except (ValueError, KeyError, TypeError, StopIteration, RuntimeError) as error:
            self._refused(f"it sent an invalid message: {error!r}")
            return None

    def _sending(self) -> None:
        try:
            while not self._over.is_set():
                with self._ready:
                    self._ready.wait_for(lambda: self._over.is_set() or self._waiting)
                    message = self._waiting.popleft() if self._waiting else None
                if message is not None:
                    self._say(message)
        except (OSError, ValueError):
            log.info("nothing more can be sent to the planning process")  # the receiving thread gets the reason

    def _say(self, message: dict[str, Any]) -> None:
        self._owing = self._clock.now() if self._owing is None else self._owing
        send(self._line, message)

    def _take(self, told: dict[str, Any]) -> None:
        """Handle a message, if possible."""
        try:
            if "failed" in told:
                self._lost(str(told["failed"]))
            if "done" in told and not self._gone:
                now = self._version()
                self._ended("live ended", f"the planning process has finished; the {self._versions.unit}s are {now}")
            if "parameters" in told:
                self._board.show(parameters=parameters(told["parameters"]))
            if "checks" in told:
                self._board.show(checks=(*self._board.now.checks, *checks(told["checks"]))[-CHECKS:])
            if told.get("doubt"):
                self._tell("live doubted", f"the images are not used: {told['doubt']}; the planned light continues")
            if "maps" in told:
                self._board.show(maps=maps(told["maps"]))
            if "version" in told:
                number = self._offer(told["version"])
                self._answer(number=number)
        except (VamError, OSError, ValueError, KeyError, TypeError, AttributeError, MemoryError) as error:
            self._refused(str(error))

    def _offer(self, told: Any) -> int:
        """Check a version, store it, and offer it. Raises `BadInput`, `StorageError`."""
        if not isinstance(told, dict) or told.get("print") != self._task["print"]:
            raise BadInput("the version is for another print; expected the number of this one")
        wanted = proposal(told)
        jobs, until = replaced(self._planned, wanted.turn, len(wanted.levels[0]) if wanted.levels else 0)
        frames = frames_of(wanted.levels, jobs)
        options = {"light": relative_light(frames, jobs), "stop": wanted.stop, "until": until}
        self._versions.check(wanted.turn, **options)
        number = max(self._versions.last, last_kept(self._folder)) + 1
        keep(self._folder, number, frames, {"turn": wanted.turn} | options)
        sources = sources_of(frames, self._planned.mirrors, self._planned.jobs, wanted.turn)
        return self._versions.swap(sources, wanted.turn, number=number, **options)

    def _refused(self, why: str) -> None:
        self._tell("live refused", f"a version of the frames was rejected: {why}")
        self._answer(why=why)

    def _answer(self, **facts: Any) -> None:
        self._put({"answer": facts})
        self.answers += 1
