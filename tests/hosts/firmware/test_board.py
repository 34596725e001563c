"""The sketch on its board: its clock's turn-over, a host that does not listen, and a real terminal."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from binascii import crc_hqx
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from servers import PtyServer

from vamgpu.errors import DeviceRefused
from vamgpu.hosts.drivers.controller import Controller

MILLI, SECOND = 1_000_000, 1_000_000_000
TURN = 100_000  # some turns of the board's loop, which a line takes [ns]
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
        _tell(board, 20 * MILLI, *(f"row {i} {20_000 * i} - 1000 5000 1" for i in range(9)), "go 5", "light 2")
        board.advance(2 * SECOND)
        seen.append((board.lights, board.triggers))
    assert seen[0] == seen[1]
    assert len(seen[0][1]) == 9 and seen[0][0][-1] == (0, 411_010_000)


def test_a_host_that_does_not_listen_never_keeps_the_light_on(new_board: NewBoard) -> None:
    """The port holds 64 bytes, and a byte takes 87 us: 40 answers of 50 bytes would block for 170 ms."""
    board = new_board()
    _tell(board, 10 * MILLI, "hello", "lease 100", "arm", "row 0 30000 - 0 2000 1", "go 5")
    _tell(board, 20 * MILLI, "light 2", *["stat"] * 99)
    board.advance(SECOND)
    (on, lit), (two, pulsed), (back, after), (off, dark) = board.lights
    assert (on, two, back, off) == (2, 3, 2, 0)
    assert lit == 20 * MILLI + 10_000
    assert abs(pulsed - 44 * MILLI) <= 20_000 and abs(after - 46 * MILLI) <= 20_000
    assert abs(dark - 111 * MILLI) <= 20_000


class _Now:
    """A board whose time began when it was made, and is the computer's since. heard: when it last took bytes."""

    def __init__(self, board: Any) -> None:
        self._board, self.start, self.heard = board, time.monotonic_ns(), 0

    def __getattr__(self, name: str) -> Any:
        act = getattr(self._board, name)
        return lambda data, now=None: act(data - self.start) if now is None else act(data, now - self.start)

    def receive(self, data: bytes, now: int) -> None:
        self.heard = now - self.start
        self._board.receive(data, self.heard)

    def due(self) -> int:
        return self._board.due() + self.start

    def ready(self) -> int | None:
        at = self._board.ready()
        return None if at is None else at + self.start


@pytest.mark.parametrize("lease_ms", [50, 200])
def test_the_sketch_speaks_over_a_real_terminal(new_board: NewBoard, lease_ms: int) -> None:
    board = new_board()
    machine: Any = _Now(board)
    with PtyServer(machine) as server, Controller.open(server.url) as driver:
        while not board.lights:  # on a busy machine a lease may be over before there is light
            with suppress(DeviceRefused):
                driver.lease(lease_ms)
                driver.arm()
                driver.light(1)
        while driver.status().light:
            time.sleep(0.01)
        assert driver.status().fault == "lease"
        assert ("light", "off", "lease") in driver.poll()
    (_, lit), (dark, ended) = board.lights
    assert dark == 0 and ended - lit <= lease_ms * MILLI


LEASE = 400
HOST = f"""
import sys, time
from vamgpu.hosts.drivers.controller import Controller
with Controller.open(sys.argv[1]) as controller:
    controller.lease({LEASE})
    controller.arm()
    controller.light(1)
    print("on", flush=True)
    while True:
        controller.lease({LEASE})
        time.sleep(0.005)
"""


def test_the_sketch_closes_the_light_of_hosts_that_are_killed(new_board: NewBoard) -> None:
    """One lease after the board last heard of its host, by the board's own time; some of them died in the light."""
    board = new_board()
    machine: Any = _Now(board)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    lit: list[int] = []
    with PtyServer(machine) as server:
        for hold in (0.0, 0.03, 0.15, 0.21):
            command = [sys.executable, "-c", HOST, server.url]
            with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as host:
                assert host.stdout is not None and host.stdout.readline() == "on\n"
                time.sleep(hold)
                host.kill()
            while board.lights[-1][0]:
                time.sleep(0.01)
            lit.append(board.lights[-1][1] - machine.heard)
    assert max(lit) <= LEASE * MILLI + TURN, lit
    assert max(lit) >= LEASE * MILLI - TURN, lit
