"""The sketch and the emulated controller answer any line alike, and any conversation."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vamgpu.hosts.drivers.controller_protocol import LONGEST_LINE
from vamgpu.hosts.emulators.controller import EmulatedController

MILLI, SECOND = 1_000_000, 1_000_000_000
NewBoard = Callable[..., Any]


def _line(text: str) -> bytes:
    body = text.encode()
    return body + b"*%04X\n" % crc_hqx(body, 0xFFFF)


def _heard(data: bytes) -> tuple[list[str], list[str]]:
    """Answers and complaints, without the milliseconds left of the lease, and events."""
    lines = [line.rpartition("*")[0] for line in data.decode("ascii").split("\n")]
    words = [line.split() for line in lines if line[:1] not in ("", "!")]
    answers = [" ".join([*line[:11], *line[12:]] if len(line) > 12 else line) for line in words]
    return answers, [line for line in lines if line[:1] == "!"]


@pytest.mark.parametrize(
    "data",
    [
        b"\n\r\n",
        b"1 hello\n",
        b"1 hello*\n",
        b"1 hello*00000\n",
        _line("1 hello").lower(),
        _line("1 hello").replace(b"\n", b"\r\n"),
        _line("hello"),
        _line("-1 stat"),
        _line("+1 stat"),
        _line("123456 stat"),
        _line("  7   lease   50  "),
        _line("7 lease +50"),
        _line("7 lease 1e2"),
        _line("7 lease -"),
        _line("7 lease"),
        _line("7 arm now"),
        _line("7 row 0 - - 0 0 0"),
        _line("7 row 0 1000000000000001 - 0 0 0"),
        _line("7 row 0 9999999999999999999 - 0 0 0"),
        _line("7 row 0 1 2 3 4 0 6"),
        _line("7 end -1"),
        _line("7 lease 50") * 2 + _line("7 lease 2000") + _line("7 stat") * 2,
        b"x" * (LONGEST_LINE + 1) + b"\n" + _line("1 stat"),
        b"x" * 300 + _line("1 stat") + _line("2 stat"),
        bytes(range(256)) + _line("1 stat") + _line("2 stat"),
    ],
)
def test_lines_of_all_kinds_get_the_same_answer(new_board: NewBoard, data: bytes) -> None:
    answers = []
    for machine in (new_board(), EmulatedController()):
        machine.advance(MILLI)
        machine.receive(data, MILLI)
        machine.advance(50 * MILLI)
        answers.append(_heard(machine.take(100 * MILLI)))
    assert answers[0] == answers[1]


HALVES = st.integers(0, 40).map(lambda halves: halves * 500)
COMMANDS = st.one_of(
    st.tuples(st.just("lease"), st.integers(0, 120)),
    st.tuples(st.sampled_from(["arm", "arm", "disarm", "stop", "hello"])),
    st.tuples(st.just("go"), st.integers(0, 65_536)),
    st.tuples(st.just("go"), st.just(7)),
    st.tuples(st.just("zero"), st.integers(0, 65_536)),
    st.tuples(st.just("light"), st.integers(0, 4)),
    st.tuples(st.just("encoder"), st.integers(-2, 2), st.integers(0, 8), st.integers(0, 20)),
    st.tuples(st.just("index"), st.integers(-1, 2), st.integers(0, 3200), st.integers(0, 20)),
    st.tuples(st.just("mode"), st.sampled_from(["time", "steps"])),
    st.tuples(st.just("end"), st.integers(0, 12)),
    st.tuples(st.just("row"), HALVES, st.one_of(st.just("-"), st.integers(-9, 9)), HALVES, HALVES, st.integers(0, 4)),
    st.tuples(st.just("row"), HALVES, st.just("-"), HALVES, HALVES, st.integers(0, 3)),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(9, 40), COMMANDS), min_size=1, max_size=40))
def test_any_conversation_is_the_same(new_board: NewBoard, talk: list[tuple[int, tuple[Any, ...]]]) -> None:
    board, machine = new_board(), EmulatedController()
    lights: list[tuple[int, int]] = []
    triggers: list[int] = []
    machine.on_light = lambda channels, at: lights.append((channels, at))
    machine.on_trigger = triggers.append
    now = 0
    try:
        for number, (wait, (verb, *words)) in enumerate([(9, ("lease", 999)), (9, ("arm",)), *talk], 1):
            now += wait * MILLI + 37_000
            index = [machine.next_row + len(machine.rows)] if verb == "row" else []
            for each in (machine, board):
                each.receive(_line(" ".join(map(str, [2 * number, verb, *index, *words]))), now)
                each.advance(now + 100_000)
                each.receive(_line(f"{2 * number + 1} stat"), now + 100_000)
        for each in (machine, board):
            each.advance(now + 2 * SECOND)
        assert _heard(board.take(now + 2 * SECOND)) == _heard(machine.take(now + 2 * SECOND))
        board.did_as(lights, triggers)
    finally:
        board.unload()
