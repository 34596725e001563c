"""The sketch and the emulated controller hold the same conversations, with the driver and without."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vamgpu.errors import DeviceRefused
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import Faults
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.protocols.controller import Row, Status

MILLI, SECOND = 1_000_000, 1_000_000_000
TURN = 30_000
"""The sketch looks at the line, the rows and the light once a turn of 10 us, and acts on them in turns of their own."""
NewBoard = Callable[..., Any]
Times = list[tuple[object, int]]


def _settled(changes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Changes of the light without those that last less than a turn."""
    kept: list[tuple[int, int]] = []
    for channels, at in changes:
        if kept and at - kept[-1][1] < TURN:
            at = kept.pop()[1]
        if channels != (kept[-1][0] if kept else 0):
            kept.append((channels, at))
    return kept


@dataclass
class Bench:
    """A machine, the driver and what was seen of both."""

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


def _bench(machine: Any, latency_ms: float = 8.0) -> Bench:
    clock, faults = VirtualClock(), Faults()
    wire = Wire(plug(machine, clock, latency_ms / 1000, faults=faults), "the controller")
    return Bench(machine, clock, Controller(wire), faults)


def _emulated() -> Bench:
    machine = EmulatedController()
    bench = _bench(machine)
    machine.on_light = lambda channels, at: bench.lights.append((channels, at))
    machine.on_trigger = bench.triggers.append
    machine.on_lens = lambda frame, at: bench.frames.append((at, frame))
    return bench


def _both(new_board: NewBoard, scenario: Callable[[Bench], None]) -> tuple[Bench, Bench]:
    """Play a scenario with both; what was answered, and when light, trigger and lens acted, is the same."""
    emulated, real = _emulated(), _bench(new_board())
    for bench in (emulated, real):
        scenario(bench)
        bench.clock.sleep(20 * MILLI)
    board = real.machine
    real.lights, real.triggers, real.frames = board.lights, board.triggers, board.frames
    assert real.answers == emulated.answers
    assert list(real.driver.events) == list(emulated.driver.events)
    _close(_settled(real.lights), _settled(emulated.lights))
    _close([(0, at) for at in real.triggers], [(0, at) for at in emulated.triggers])
    byte = round(10 * SECOND / 38400)
    _close([(frame, at - byte) for at, frame in real.frames], [(frame, at) for at, frame in emulated.frames])
    return emulated, real


def _close(found: Any, wanted: Any, within: int = TURN) -> None:
    assert [what for what, _ in found] == [what for what, _ in wanted]
    assert all(abs(a - b) <= within for (_, a), (_, b) in zip(found, wanted, strict=True)), (found, wanted)


def _allow(bench: Bench, at_ms: float, lease_ms: int = 1000) -> None:
    bench.ask(at_ms, "lease", lease_ms)
    bench.ask(at_ms + 10, "arm")


def test_who_answers_is_the_same(new_board: NewBoard) -> None:
    emulated, real = _both(new_board, lambda bench: None)
    for name in ("capacity", "longest_lease_ms", "channels"):
        assert getattr(real.driver, name) == getattr(emulated.driver, name)


def test_light_needs_a_lease_and_goes_off_with_it(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        assert bench.ask(100, "light", 1) == "armed"
        assert bench.ask(110, "arm") == "lease"
        assert bench.ask(120, "lease", 0) == bench.ask(130, "lease", 1001) == "range"
        _allow(bench, 140, 200)
        assert bench.ask(160, "light", 4) == "range"
        assert bench.ask(170, "light", 3) == ()
        for at in range(200, 1000, 100):
            bench.ask(at, "lease", 200)
        seen = bench.status(1200)
        assert (seen.state, seen.fault, seen.light, seen.armed, seen.lease_ms) == ("fault", "lease", 0, False, 0)
        assert bench.ask(1210, "light", 1) == "armed"
        _allow(bench, 1220)
        assert bench.status(1240).state == "armed"

    emulated, _ = _both(new_board, scenario)
    assert emulated.lights == [(3, 170 * MILLI), (0, 1100 * MILLI)]


def test_an_open_interlock_darkens_and_refuses(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        bench.ask(120, "light", 1)
        bench.clock.sleep_until(150 * MILLI)
        bench.machine.open_interlock(bench.clock.now())
        bench.ask(160, "lease", 1000)
        assert bench.ask(170, "arm") == "interlock"
        seen = bench.status(180)
        assert (seen.fault, seen.interlock_closed, seen.light) == ("interlock", False, 0)

    _both(new_board, scenario)


def test_rows_act_in_time_with_lens_trigger_and_light(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        for i in range(6):
            bench.ask(
                120 + 10 * i, "row", i, 20_000 * i + 1500, -1200 if i % 2 else "-", 2000, 5000 * (i != 3), 1 + i % 3
            )
        assert bench.ask(190, "row", 7, 1, "-", 0, 0, 1) == "order"
        for wrong in ((6, -1, "-", 0, 0, 1), (6, 1, 32768, 0, 0, 1), (6, 1, "-", 2**31, 0, 1), (6, 1, "-", 0, 0, 4)):
            assert bench.ask(bench.clock.now() // MILLI + 10, "row", *wrong) == "range"
        bench.ask(250, "end", 6)
        bench.ask(260, "go")
        assert bench.ask(270, "go") == bench.ask(280, "mode", "steps") == bench.ask(290, "zero") == "state"
        seen = bench.status(320)
        assert (seen.state, seen.row, seen.shown, seen.free) == ("running", 3, 3, 253)
        assert bench.status(365).state == "running", "while the last picture is lit"
        assert bench.status(400).state == "done"

    emulated, real = _both(new_board, scenario)
    assert len(real.triggers) == 6 and len(_settled(real.lights)) == 10
    assert real.frames[0][1] == bytes.fromhex("50774441fb500000") + real.frames[0][1][-2:]
    assert ("done", "6") in real.driver.events


def test_a_row_that_comes_late_stays_dark(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        bench.ask(120, "go")
        bench.ask(150, "row", 0, 10_000, 1000, 1000, 5000, 1)
        bench.ask(160, "row", 1, 50_000, "-", 1000, 5000, 1)
        seen = bench.status(190)
        assert (seen.late, seen.shown) == (1, 2)

    emulated, real = _both(new_board, scenario)
    assert [channels for channels, _ in real.lights] == [1, 0]
    assert emulated.triggers[0] == 151 * MILLI


def test_a_full_queue_says_so(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        for i in range(256):
            assert bench.ask(100 + 10 * i, "row", i, i, "-", 0, 0, 0) == (str(255 - i), str(i + 1))
        assert bench.ask(2700, "row", 256, 256, "-", 0, 0, 0) == "full"

    _both(new_board, scenario)


@pytest.mark.parametrize(("told", "shown"), [(0, 3), (3, 3), (4, 4), (9, 9)])
@pytest.mark.parametrize("at_ms", [271.25, 274.5, 279.75])
def test_the_end_may_be_told_again_while_rows_run(new_board: NewBoard, told: int, shown: int, at_ms: float) -> None:
    """At 271 ms row 2 waits for its delay, at 274 ms it is lit, at 280 ms it is over; it is never cut short."""

    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        for i in range(9):
            bench.ask(120 + 10 * i, "row", i, 20_000 * i, "-", 2000, 5000, 1)
        bench.ask(220, "end", 6)
        bench.ask(230, "go")
        bench.ask(at_ms, "end", told)
        seen = bench.status(430)
        assert (seen.state, seen.shown, seen.free) == ("done", shown, 256 - (9 - shown))

    _, real = _both(new_board, scenario)
    lit = [b - a for (_, a), (_, b) in zip(real.lights[::2], real.lights[1::2], strict=True)]
    assert len(lit) == shown and all(abs(each - 5 * MILLI) <= TURN for each in lit)


def test_rows_by_steps_follow_the_web(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        bench.ask(120, "mode", "steps")
        assert bench.ask(125, "mode", "miles") == bench.ask(130, "ramp", 0) == "range"
        bench.ask(140, "ramp", 20_000)
        for i in range(8):
            bench.ask(150 + 10 * i, "row", i, 400 * (i + 1), "-", 500, 10_000, 1)
        bench.ask(240, "end", 8)
        bench.ask(250, "go")
        bench.ask(260, "move", 5_000_000)
        bench.ask(560, "lease", 1000)
        bench.ask(800, "move", -2_000_000)

    emulated, real = _emulated(), _bench(new_board())
    for bench in (emulated, real):
        scenario(bench)
    assert real.answers == emulated.answers
    for at in (850, 1100, 2000):
        one, other = real.status(at), emulated.status(at)
        assert abs(one.position - other.position) <= 3 and abs(one.speed - other.speed) <= 20_000
        assert (one.state, one.row, one.shown) == (other.state, other.row, other.shown)
    assert len(real.machine.triggers) == 6
    _close([(0, at) for at in real.machine.triggers], [(0, at) for at in emulated.triggers], 500_000)


def test_steady_light_does_not_outlive_what_closed_it(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        bench.ask(120, "light", 2)
        bench.ask(130, "row", 0, 10_000, "-", 0, 5000, 1)
        bench.ask(140, "disarm")
        _allow(bench, 150)
        bench.ask(170, "go")
        assert bench.status(182).light == 1 and bench.status(190).light == 0

    _both(new_board, scenario)


def test_stop_darkens_and_drops_and_hello_forgets(new_board: NewBoard) -> None:
    def scenario(bench: Bench) -> None:
        _allow(bench, 100)
        bench.ask(120, "move", 1_000_000)
        bench.ask(130, "row", 0, 0, "-", 0, 100_000, 2)
        bench.ask(140, "go")
        bench.ask(160, "stop")
        seen = bench.status(200)
        assert (seen.light, seen.row, seen.free, seen.shown, seen.speed, seen.armed) == (0, 0, 256, 1, 0, False)
        bench.ask(220, "hello")
        assert bench.status(240).shown == 0 and bench.status(250).state == "idle"
        assert bench.ask(260, "dance") == "verb"
        assert (
            bench.ask(270, "power", 2, 0) == bench.ask(280, "power", 0, 65536) == bench.ask(285, "power", 1) == "range"
        )
        bench.ask(290, "power", 1, 4321)

    _, real = _both(new_board, scenario)
    assert real.machine.powers == [65535, 4321]


def test_what_was_shown_survives_the_host(new_board: NewBoard) -> None:
    for machine in (new_board(), EmulatedController()):
        bench = _bench(machine)
        _allow(bench, 100, 150)
        for i in range(9):
            bench.ask(120 + 8 * i, "row", i, 20_000 * i, "-", 0, 5000, 1)
        bench.ask(195, "move", 2_000_000)
        bench.ask(205, "go")
        bench.clock.sleep_until(SECOND)
        again = Controller(Wire(plug(machine, bench.clock, 0.05), "the controller"))
        assert again.before is not None
        assert (again.before.state, again.before.fault, again.before.shown) == ("fault", "lease", 3)
        assert again.before.position >= 1580
        status = again.status()
        assert status.shown == 0 and status.position >= again.before.position, "hello forgets what was shown alone"


def test_damaged_lines_are_asked_for_again_and_act_once(new_board: NewBoard) -> None:
    for way in ("drop_in", "flip_in", "drop_out", "flip_out"):
        for byte in range(0, 24, 5):
            bench = _bench(new_board(), 20)
            count = bench.faults._count["in" if way.endswith("in") else "out"]
            setattr(bench.faults, way, frozenset({count + byte}))
            free = [bench.driver.row(Row(i, 1000 * i, 1000 + i, 0, 100)) for i in range(4)]
            assert free == [255, 254, 253, 252], (way, byte)


def _line(text: str) -> bytes:
    body = text.encode()
    return body + b"*%04X\n" % crc_hqx(body, 0xFFFF)


def _heard(data: bytes) -> tuple[list[str], list[str]]:
    """Answers and complaints, without the milliseconds left of the lease, and events."""
    lines = [line.rpartition("*")[0] for line in data.decode("ascii").split("\n")]
    words = [line.split() for line in lines if line[:1] not in ("", "!")]
    answers = [" ".join([*line[:9], *line[10:]] if len(line) > 12 else line) for line in words]
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
        b"x" * 97 + b"\n" + _line("1 stat"),
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
    st.tuples(st.sampled_from(["arm", "arm", "go", "go", "disarm", "stop", "hello", "zero"])),
    st.tuples(st.just("light"), st.integers(0, 4)),
    st.tuples(st.just("mode"), st.sampled_from(["time", "steps"])),
    st.tuples(st.just("end"), st.integers(0, 12)),
    st.tuples(st.just("row"), HALVES, st.one_of(st.just("-"), st.integers(-9, 9)), HALVES, HALVES, st.integers(0, 4)),
    st.tuples(st.just("row"), HALVES, st.just("-"), HALVES, HALVES, st.integers(0, 3)),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
        _close(_settled(board.lights), _settled(lights))
        _close([(0, at) for at in board.triggers], [(0, at) for at in triggers])
    finally:
        board.unload()
