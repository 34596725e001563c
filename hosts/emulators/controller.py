"""The emulated controller of web, trigger, lens and light.

Its limits are its own: one that is wrong in the driver's protocol is refused here.
"""

from __future__ import annotations

import re

from vamgpu.hosts.drivers.controller_protocol import line_check
from vamgpu.hosts.emulators.line import LineDevice
from vamgpu.hosts.emulators.rows import MICRO, RAMP, RowPlayer

MILLI = 1_000_000
LONGEST_LEASE_MS = 1000
CAPACITY = 256
LONGEST_LINE = 160
FASTEST = 200_000  # the greatest speed of the web [microsteps/s]
STEEPEST = 10**8  # the greatest change of its speed [microsteps/s2]
GREATEST = 10**15  # the greatest count of microseconds or microsteps, some thirty years
LONGEST_US = 2**31 - 1
LONGEST_RATIO = 10**6
NUMBER = re.compile(r"-?[0-9]{1,18}")
ANY, NUMBERED, SPEED = (-GREATEST * 1000, GREATEST * 1000), (1, 65535), 1000 * FASTEST
RANGES: dict[str, tuple[tuple[int, int], ...]] = {
    "hello": (), "arm": (), "disarm": (), "stop": (), "stat": (), "lease": ((1, LONGEST_LEASE_MS),),
    "power": (ANY, (0, 65535)), "light": (ANY,), "row": (ANY,) * 6, "end": ((0, GREATEST * 1000),),
    "go": (NUMBERED,), "zero": (NUMBERED,), "home": (NUMBERED, (1, SPEED)), "move": ((-SPEED, SPEED),),
    "ramp": ((1, STEEPEST),), "encoder": ((-LONGEST_RATIO, LONGEST_RATIO), (1, LONGEST_RATIO), ANY),
    "index": ((0, LONGEST_RATIO), (1, LONGEST_RATIO), ANY),
}  # fmt: skip
"""Least and greatest of each argument."""
AT_REST = ("go", "zero", "encoder", "index", "home")  # refused while rows are played


class EmulatedController(RowPlayer, LineDevice):
    """The firmware's line: commands in, answers and events out."""

    done: bool
    steps_mode: bool
    fault: str
    armed: bool
    running: bool
    started: int
    late: int
    next_row: int

    def __init__(self, capacity: int = CAPACITY, channels: int = 2, latency_us: float = 50.0) -> None:
        RowPlayer.__init__(self, channels)
        LineDevice.__init__(self, latency_us)
        self.capacity = capacity
        self._last: tuple[bytes, bytes] | None = None

    def say(self, now: int, *words: object) -> None:
        self._send(" ".join(["!", *map(str, words)]), now)

    def _send(self, text: str, now: int) -> bytes:
        body = text.encode("ascii")
        line = body + b"*%04X\n" % line_check(body)
        self._out.put(line, now)
        return line

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self.advance(now)
        for line in self.lines(data):
            self.advance(now)
            self._line(line, now)
        del self._buffer[LONGEST_LINE + 1 :]

    def _line(self, line: bytes, now: int) -> None:
        body, _, given = line.rpartition(b"*")
        words = [word for word in body.decode("ascii", "replace").split(" ") if word]
        whole = len(line) <= LONGEST_LINE and given == b"%04X" % line_check(body)
        if not whole or len(words) < 2 or not re.fullmatch("[0-9]{1,5}", words[0]):
            self._send("? line", now)
            return
        if self._last is not None and self._last[0] == line and words[1] not in ("hello", "stat"):
            self._out.put(self._last[1], now)
            return
        self._last = (line, self._send(f"{words[0]} {self._do(words[1], words[2:], now)}", now))

    def _do(self, verb: str, words: list[str], now: int) -> str:
        if verb == "mode" and len(words) == 1:
            return self._do_mode(words[0])
        if verb not in RANGES:
            return "no range" if verb == "mode" else "no verb"
        if len(words) != len(RANGES[verb]):
            return "no range"
        lens = verb == "row" and words[2] == "-"
        numbers = ["0" if lens and place == 2 else word for place, word in enumerate(words)]
        if not all(NUMBER.fullmatch(word) for word in numbers):
            return "no range"
        if (self.running and verb in AT_REST) or (verb == "home" and not self.senses.index[0]):
            return "no state"
        values = [int(word) for word in numbers]
        if not all(least <= value <= most for value, (least, most) in zip(values, RANGES[verb], strict=True)):
            return "no range"
        return getattr(self, f"_do_{verb}")(now, *values[:2], *((None, *values[3:]) if lens else values[2:])) or "ok"

    def _do_hello(self, now: int) -> str:
        self.close("hello", now)
        self._drop()
        self.done, self.steps_mode, self.fault = False, False, "none"
        self.web.ramp(now, RAMP)
        self.senses.forget()
        return f"ok vam-controller 3 {self.capacity} {LONGEST_LEASE_MS} {self.channels}"

    def _do_lease(self, now: int, milliseconds: int) -> None:
        self.lease_end: int = now + milliseconds * MILLI
        if self.on_lease is not None:
            self.on_lease(self.lease_end, now)

    def _do_arm(self, now: int) -> str | None:
        if not self.interlock_closed:
            return "no interlock"
        if self.lease_end is None or now >= self.lease_end:
            return "no lease"
        if reason := self.senses.wrong(self.microsteps(now)):
            return f"no {reason}"
        self.armed, self.fault = True, "none"

    def _do_disarm(self, now: int) -> None:
        self.close("disarm", now)

    def _do_power(self, now: int, channel: int, drive: int) -> str | None:
        if not 0 <= channel < self.channels:
            return "no range"
        self.set_power(channel, drive, now)

    def _do_light(self, now: int, on: int) -> str | None:
        if on and not self.armed:
            return "no armed"
        if not 0 <= on < 2**self.channels:
            return "no range"
        self._steady = on
        if self._pulse_end is None or not on:
            self._pulse_end, self._judge_at = None, now
            self.set_light(on, now)

    def _do_mode(self, mode: str) -> str:
        if self.running:
            return "no state"
        if mode not in ("time", "steps"):
            return "no range"
        self.steps_mode = mode == "steps"
        return "ok"

    def _do_row(self, now: int, index: int, at: int, code: int | None, delay: int, on: int, channels: int) -> str:
        if index != self.next_row + len(self.rows):
            return "no order"
        if len(self.rows) >= self.capacity:
            return "no full"
        if min(at, delay, on, channels) < 0 or channels >= 2**self.channels or abs(code or 0) > 32767:
            return "no range"
        if at > GREATEST or max(delay, on) > LONGEST_US:
            return "no range"
        if self.running and (self.microsteps(now) > at if self.steps_mode else now > self.started + at * MICRO):
            self.late += 1
            on = 0
        if not self.rows:
            self._floor = max(self._floor, now)
        self.rows.append((index, at, code, delay, on, channels))
        return f"ok {self.capacity - len(self.rows)} {index + 1}"

    def _do_end(self, now: int, count: int) -> None:
        self.total, self._judge_at = count, now

    def _do_go(self, now: int, number: int) -> None:
        self.running, self.done, self.started, self._floor = True, False, now, now
        self.shown = self.late = 0
        self.play = number
        self._judge_at = now

    def _do_move(self, now: int, speed: int) -> None:
        self.senses.home = 0
        self.senses.moved(now, self.microsteps(now))
        self.web.run(now, speed / 1000)

    def _do_ramp(self, now: int, acceleration: int) -> None:
        self.web.ramp(now, float(acceleration))

    def _do_zero(self, now: int, number: int) -> None:
        self.zero = number
        self.call_position(now, 0)

    def _do_encoder(self, now: int, counts: int, steps: int, limit: int) -> str | None:
        if limit * abs(counts) < 2 * steps and counts:
            return "no range"
        return self._do_index(now, counts, steps, limit, "encoder")

    def _do_index(self, now: int, counts: int, steps: int, limit: int, which: str = "index") -> str | None:
        if counts and not 1 <= limit <= LONGEST_RATIO:
            return "no range"
        self.senses.take(which, (counts, steps, limit), now, self.microsteps(now))

    def _do_home(self, now: int, number: int, speed: int) -> None:
        self.senses.home = number
        self.web.run(now, speed / 1000)

    def _do_stop(self, now: int) -> None:
        self.close("stop", now)
        self._drop()
        self.senses.home = 0
        self.web.run(now, 0.0)

    def _drop(self) -> None:
        self.rows.clear()
        self.next_row, self.total = 0, None

    def _do_stat(self, now: int) -> str:
        state = "fault" if self.fault != "none" else "running" if self.running else "done" if self.done else "idle"
        if state == "idle" and self.armed:
            state = "armed"
        lease = max((self.lease_end or now) - now, 0) // MILLI
        numbers = (
            self.next_row, self.shown, self.late, self.capacity - len(self.rows), self.microsteps(now),
            round(self.web.velocity(now) * 1000), self.zero, self.play, lease, self.light,
            int(self.armed), int(self.interlock_closed), *self.senses.status(self.microsteps(now)),
        )  # fmt: skip
        return " ".join(["ok", state, *map(str, numbers), self.fault])
