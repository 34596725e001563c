"""The sketch, built for this computer with a board around it, as a machine on a virtual clock."""

from __future__ import annotations

import ctypes
import itertools
import shutil
import subprocess
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import needs
import pytest

from vamgpu import hosts
from vamgpu.errors import DeviceRefused
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import Status
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import Faults, VirtualPort

TURN = 30_000
"""The sketch looks at the line, the rows and the light once a turn of 10 us, and acts on them in turns of their own."""
HERE = Path(__file__).parent
MICRO, MILLI, SECOND = 1000, 1_000_000, 1_000_000_000
POLL_NS, REST_NS = 100 * MICRO, 5000 * MICRO
GATES, DRIVES, TRIGGER, STEP = (2, 3), (4, 5), 6, 7
ANALOG, HOST_BYTE, LENS_BYTE = 1000, 2000, 2001


class _Event(ctypes.Structure):
    _fields_ = [("at_us", ctypes.c_int64), ("kind", ctypes.c_int32), ("value", ctypes.c_int32)]


def settled(changes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Changes of the light without those that last less than a turn."""
    kept: list[tuple[int, int]] = []
    for channels, at in changes:
        if kept and at - kept[-1][1] < TURN:
            at = kept.pop()[1]
        if channels != (kept[-1][0] if kept else 0):
            kept.append((channels, at))
    return kept


def close(found: Any, wanted: Any, within: int = TURN) -> None:
    """The same things, at times no further apart."""
    assert [what for what, _ in found] == [what for what, _ in wanted]
    assert all(abs(a - b) <= within for (_, a), (_, b) in zip(found, wanted, strict=True)), (found, wanted)


class Board:
    """A board that runs the sketch; times in ns.

    ``lights`` are changes of the gates, ``triggers`` rises of the trigger pin, ``frames`` what the lens's port sent.
    """

    def __init__(self, library: Path, micros: int = 0) -> None:
        self._library = ctypes.CDLL(str(library))
        self._buffer = (_Event * 4096)()
        self.lights: list[tuple[int, int]] = []
        self.triggers: list[int] = []
        self.powers = [0, 0]
        self._lens: list[tuple[int, int]] = []
        self._out: deque[tuple[int, int]] = deque()
        self._now, self._asked = 0, False
        self._library.board_start(ctypes.c_uint32(micros))
        self._collect()

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Frames of ten bytes on the lens's line, with the time when the first byte had left."""
        groups = [self._lens[i : i + 10] for i in range(0, len(self._lens), 10)]
        return [(group[0][0], bytes(byte for _, byte in group)) for group in groups]

    def _collect(self) -> None:
        while taken := self._library.board_events(self._buffer, len(self._buffer)):
            for event in self._buffer[:taken]:
                self._note(event.at_us * MICRO, event.kind, event.value)

    def _note(self, at: int, kind: int, value: int) -> None:
        if kind == HOST_BYTE:
            self._out.append((at, value))
        elif kind == LENS_BYTE:
            self._lens.append((at, value))
        elif kind in GATES:
            before = self.lights[-1][0] if self.lights else 0
            bit = 1 << GATES.index(kind)
            self.lights.append((before | bit if value else before & ~bit, at))
        elif kind == TRIGGER and value:
            self.triggers.append(at)
        elif kind - ANALOG in DRIVES:
            self.powers[DRIVES.index(kind - ANALOG)] = value

    def advance(self, now: int) -> None:
        """Turn ``loop()`` until a time."""
        if now > self._now:
            self._library.board_run(ctypes.c_int64(now // MICRO))
            self._now = now
            self._collect()

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self.advance(now)
        self._asked = True
        self._library.board_receive(data, len(data))

    def take(self, now: int) -> bytes:
        """Give bytes that have left."""
        self.advance(now)
        taken = bytearray()
        while self._out and self._out[0][0] <= now:
            taken.append(self._out.popleft()[1])
        self._asked = self._asked and not taken.endswith(b"\n")
        return bytes(taken)

    def ready(self) -> int | None:
        """When the next byte will have left."""
        return self._out[0][0] if self._out else None

    def due(self) -> int | None:
        """Soon, while it has been asked; at times otherwise, for it keeps its own time."""
        return self._now + (POLL_NS if self._asked else REST_NS)

    def did_as(self, lights: list[tuple[int, int]], triggers: list[int], within: int = TURN) -> None:
        """Assert that light and trigger acted as another machine's."""
        close(settled(self.lights), settled(lights), within)
        close([(0, at) for at in self.triggers], [(0, at) for at in triggers], within)

    def open_interlock(self, now: int) -> None:
        """Somebody opens the enclosure."""
        self.advance(now)
        self._library.board_interlock(1)

    def stall(self, now: int) -> None:
        """The motor stands, though it is stepped on."""
        self.advance(now)
        self._library.board_stall()

    def unload(self) -> None:
        """Let go of the sketch, so that the next board begins anew."""
        import _ctypes

        _ctypes.dlclose(self._library._handle)


@dataclass
class Conversation:
    """A driver and its machine, and what was seen of both."""

    machine: Any
    clock: VirtualClock
    driver: Controller
    faults: Faults
    answers: list[object] = field(default_factory=list)
    lights: list[tuple[int, int]] = field(default_factory=list)
    triggers: list[int] = field(default_factory=list)
    frames: list[tuple[int, bytes]] = field(default_factory=list)

    def ask(self, at_ms: float, verb: str, *words: object) -> object:
        """Ask at a time; the words of the answer, or the code of the refusal."""
        self.clock.sleep_until(round(at_ms * MILLI))
        assert self.clock.now() == round(at_ms * MILLI), "the step before took too long"
        try:
            answer: object = self.driver.ask(verb, *words)
        except DeviceRefused as error:
            answer = error.code
        self.answers.append(answer)
        return answer

    def status(self, at_ms: float) -> Status:
        """The status at a time."""
        self.clock.sleep_until(round(at_ms * MILLI))
        return self.driver.status()


def _conversation(machine: Any, latency_ms: float = 8.0) -> Conversation:
    clock, faults = VirtualClock(), Faults()
    wire = Wire(VirtualPort(machine, clock, latency_ms / 1000, faults=faults), "the controller")
    return Conversation(machine, clock, Controller(wire), faults)


def _emulated() -> Conversation:
    machine = EmulatedController()
    emulated = _conversation(machine)
    machine.on_light = lambda channels, at: emulated.lights.append((channels, at))
    machine.on_trigger = emulated.triggers.append
    machine.on_lens = lambda frame, at: emulated.frames.append((at, frame))
    return emulated


def _play_both(
    board: Board, scenario: Callable[[Conversation], None], within: int
) -> tuple[Conversation, Conversation]:
    """Play a scenario with both; what was answered, and when light, trigger and lens acted, is the same."""
    emulated, real = _emulated(), _conversation(board)
    for each in (emulated, real):
        scenario(each)
        each.clock.sleep(20 * MILLI)
    real.lights, real.triggers, real.frames = board.lights, board.triggers, board.frames
    assert real.answers == emulated.answers
    assert list(real.driver.events) == list(emulated.driver.events)
    board.did_as(emulated.lights, emulated.triggers, within)
    byte = round(10 * SECOND / 38400)
    close([(frame, at - byte) for at, frame in real.frames], [(frame, at) for at, frame in emulated.frames])
    return emulated, real


def compile_sketch(folder: Path) -> Path:
    """The sketch and its board as a library."""
    compiler = needs.compiler()
    library = folder / "board.so"
    sketches = Path(hosts.__file__).parent / "firmware" / "controller"
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined", "-fno-sanitize-recover"]
    flags += ["-static-libubsan"] if "g++" in Path(compiler).name and "clang" not in compiler else []
    command = [compiler, *flags, "-shared", "-fPIC", f"-I{HERE}", f"-I{sketches}", str(HERE / "board.cpp")]
    built = subprocess.run([*command, "-o", str(library)], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return library


@pytest.fixture(scope="session")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled library."""
    return compile_sketch(tmp_path_factory.mktemp("sketch"))


@pytest.fixture
def new_board(sketch: Path, tmp_path: Path) -> Callable[..., Board]:
    """Makes boards just switched on; ``micros`` is what their clock says then."""
    numbers = itertools.count()

    def make(micros: int = 0) -> Board:
        copy = tmp_path / f"board{next(numbers)}.so"
        shutil.copy(sketch, copy)
        return Board(copy, micros)

    return make


@pytest.fixture
def conversation_with() -> Callable[..., Conversation]:
    """Begins a conversation with a machine; ``latency_ms`` is how long its driver waits."""
    return _conversation


@pytest.fixture
def both(new_board: Callable[..., Board]) -> Callable[..., tuple[Conversation, Conversation]]:
    """Plays a scenario with the emulated controller and with the sketch, asserts that they did the same."""
    return lambda scenario, within=TURN: _play_both(new_board(), scenario, within)
