"""The sketch on its board: its clock's turn-over, a host that does not listen, and a real terminal."""

from __future__ import annotations

import time
from binascii import crc_hqx
from collections.abc import Callable
from typing import Any

import pytest

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.emulators.servers import PtyServer

MILLI, SECOND = 1_000_000, 1_000_000_000
NewBoard = Callable[..., Any]


def _tell(board: Any, now: int, *texts: str) -> None:
    """Send numbered lines at a time, one every millisecond."""
    for i, text in enumerate(texts):
        body = f"{now // MILLI + i} {text}".encode()
        board.receive(body + b"*%04X\n" % crc_hqx(body, 0xFFFF), now + i * MILLI)


def test_light_is_off_before_the_first_turn_and_nothing_lights_it(new_board: NewBoard) -> None:
    board = new_board()
    assert board.lights == [] and board.powers == [65535, 65535]
    board.advance(10 * SECOND)
    assert board.lights == [] and board.triggers == []


def test_the_clock_turns_over_in_the_middle_of_a_print(new_board: NewBoard) -> None:
    seen = []
    for micros in (0, 2**32 - 100_000):
        board = new_board(micros)
        _tell(board, 10 * MILLI, "hello", "lease 400", "arm")
        _tell(board, 20 * MILLI, *(f"row {i} {20_000 * i} - 1000 5000 1" for i in range(9)), "go", "light 2")
        board.advance(2 * SECOND)
        seen.append((board.lights, board.triggers))
    assert seen[0] == seen[1]
    assert len(seen[0][1]) == 9 and seen[0][0][-1] == (0, 411_010_000)


def test_a_host_that_does_not_listen_never_keeps_the_light_on(new_board: NewBoard) -> None:
    """The port holds 64 bytes, and a byte takes 87 us: 40 answers of 50 bytes would block for 170 ms."""
    board = new_board()
    _tell(board, 10 * MILLI, "hello", "lease 100", "arm", "row 0 30000 - 0 2000 1", "go")
    _tell(board, 20 * MILLI, "light 2", *["stat"] * 99)
    board.advance(SECOND)
    (on, lit), (two, pulsed), (back, after), (off, dark) = board.lights
    assert (on, two, back, off) == (2, 3, 2, 0)
    assert lit == 20 * MILLI + 10_000
    assert abs(pulsed - 44 * MILLI) <= 20_000 and abs(after - 46 * MILLI) <= 20_000
    assert abs(dark - 111 * MILLI) <= 20_000


@pytest.mark.parametrize("lease_ms", [50, 200])
def test_the_sketch_speaks_over_a_real_terminal(new_board: NewBoard, lease_ms: int) -> None:
    class Now:
        """The board's time begins with the terminal's."""

        def __init__(self, board: Any) -> None:
            self._board, self._start = board, time.monotonic_ns()

        def __getattr__(self, name: str) -> Any:
            act = getattr(self._board, name)
            return lambda data, now=None: act(data - self._start) if now is None else act(data, now - self._start)

        def due(self) -> int:
            return self._board.due() + self._start

        def ready(self) -> int | None:
            at = self._board.ready()
            return None if at is None else at + self._start

    board = new_board()
    machine: Any = Now(board)
    with PtyServer(machine) as server, Controller.open(server.url) as driver:
        driver.lease(lease_ms)
        driver.arm()
        driver.light(True)
        deadline = time.monotonic() + 10
        while driver.status().light and time.monotonic() < deadline:
            time.sleep(0.01)
        assert driver.status().fault == "lease"
        assert ("light", "off", "lease") in driver.poll()
    (_, lit), (dark, ended) = board.lights
    assert dark == 0 and ended - lit <= lease_ms * MILLI
