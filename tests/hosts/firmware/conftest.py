"""The sketch, built for this computer with a board around it, as a machine on a virtual clock."""

from __future__ import annotations

import ctypes
import itertools
import shutil
import subprocess
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest

from vamgpu import hosts

HERE = Path(__file__).parent
MICRO = 1000
POLL_NS, REST_NS = 100 * MICRO, 5000 * MICRO
GATES, DRIVES, TRIGGER, STEP = (2, 3), (4, 5), 6, 7
ANALOG, HOST_BYTE, LENS_BYTE = 1000, 2000, 2001


class _Event(ctypes.Structure):
    _fields_ = [("at_us", ctypes.c_int64), ("kind", ctypes.c_int32), ("value", ctypes.c_int32)]


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

    def open_interlock(self, now: int) -> None:
        """Somebody opens the enclosure."""
        self.advance(now)
        self._library.board_interlock(1)

    def unload(self) -> None:
        """Let go of the sketch, so that the next board begins anew."""
        import _ctypes

        _ctypes.dlclose(self._library._handle)


def compile_sketch(folder: Path) -> Path:
    """The sketch and its board as a library; fails the test that asks for it where there is no compiler."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.fail("the firmware is tested as compiled for this computer: install g++ (apt install g++)")
    library = folder / "board.so"
    sketches = Path(hosts.__file__).parent / "firmware"
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
