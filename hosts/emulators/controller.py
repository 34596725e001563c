"""The emulated controller of web, trigger, lens and light, which rejects a wrong limit in the driver's protocol."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable

from vamgpu.hosts.drivers.controller_protocol import line_check
from vamgpu.hosts.emulators.lens import check_sum
from vamgpu.hosts.emulators.line import LineDevice
from vamgpu.hosts.emulators.sensors import Senses
from vamgpu.hosts.emulators.track import Track

MICRO = 1000
TRIGGER_GAP = 50 * MICRO  # least time from trigger to trigger [ns]
RAMP = 200_000.0  # acceleration of the web until a host sets it [microsteps/s2]
MILLI = 1_000_000
LONGEST_LEASE_MS = 1000
CAPACITY = 256
LONGEST_LINE = 160
FASTEST = 200_000  # the greatest speed of the web [microsteps/s]
STEEPEST = 10**8  # the greatest acceleration [microsteps/s2]
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
AT_REST = ("go", "zero", "encoder", "index", "home")  # rejected while rows are played


class EmulatedController(LineDevice):
    """The firmware: its line, and its queue, web, lease and gate; the last argument of callbacks is the time [ns]."""

    # ``intervals`` records times, channels and drives of light.

    def __init__(self, capacity: int = CAPACITY, channels: int = 2) -> None:
        super().__init__(latency_us=50.0)
        self.capacity = capacity
        self.channels = channels
        self._last: tuple[bytes, bytes] | None = None
        self.on_trigger: Callable[[int], None] | None = None
        self.on_lens: Callable[[bytes, int], None] | None = None
        self.on_light: Callable[[int, int], None] | None = None
        self.on_lease: Callable[[int, int], None] | None = None
        self.on_close: Callable[[str, int], None] | None = None
        self.interlock_closed: bool = True
        self.powers: list[int] = [65535] * channels
        self.intervals: deque[tuple[int, int, int, tuple[int, ...]]] = deque(maxlen=4096)
        self.light: int = 0
        self._lit_at = 0
        self._begin()

    def _begin(self) -> None:
        """Start as a board does at power-on."""
        self.web: Track = Track(acceleration=RAMP)
        self.senses: Senses = Senses()
        self.armed: bool = False
        self.running: bool = False
        self.done: bool = False
        self.fault: str = "none"
        self.lease_end: int | None = None
        self.steps_mode: bool = False
        self.rows: deque[tuple[int, int, int | None, int, int, int]] = deque()
        self.next_row: int = 0
        self.shown: int = 0
        self.late: int = 0
        self.zero: int = 0
        self.play: int = 0
        self.total: int | None = None
        self.started: int = 0
        self._floor = 0
        self._fired = -TRIGGER_GAP
        self._pulse: tuple[int, int, int] | None = None
        self._pulse_end: int | None = None
        self._judge_at: int | None = None
        self._steady = 0

    def due(self) -> int | None:
        times = [self._judge_at, self._pulse_end, None if self._pulse is None else self._pulse[0], self._row_due()]
        if self.lease_end is not None and (self.light or self.armed):
            times.append(self.lease_end)
        if self.senses.used:
            times += self.senses.due(self.web)
        return min([at for at in times if at is not None], default=None)

    def _row_due(self) -> int | None:
        if not self.running or not self.rows or self._pulse is not None or self._all_acted():
            return None
        at = self.rows[0][1]
        after = max(self.started, self._floor)
        return self.web.reaches(at, after) if self.steps_mode else max(self.started + at * MICRO, after)

    def _all_acted(self) -> bool:
        return self.total is not None and self.next_row >= self.total

    def microsteps(self, now: int) -> int:
        """Whole microsteps of the web, with a tolerance for rounding."""
        position = self.web.position(now)
        return int(position + (1e-6 if position > 0 else -1e-6))

    def advance(self, now: int) -> None:
        while (at := self.due()) is not None and at <= now:
            if self.senses.used and self._sense_at(at):
                continue
            if self.lease_end is not None and at >= self.lease_end and (self.light or self.armed):
                self.close("lease", at)
            elif self._judge_at is not None and at >= self._judge_at:
                self._judge_at = None
                self._finish(at)
            elif self._pulse_end is not None and at >= self._pulse_end:
                self._pulse_end = None
                self.set_light(self._steady, at)
                self._finish(at)
            elif self._pulse is not None and at >= self._pulse[0]:
                self._fire(at)
            else:
                self._act_row(at)

    def _sense_at(self, at: int) -> bool:
        """Compare encoder and mark; return whether that switched the light off, or was the only event due."""
        only = at not in (self._judge_at, self._pulse_end, self.lease_end, self._row_due())
        only = only and (self._pulse is None or at < self._pulse[0])
        reason, homed = self.senses.compare(self.web, at, self.microsteps(at))
        if homed:
            self.zero = homed
            self.call_position(at, 0)
            self.web.run(at, 0.0)
            self.say(at, "home", homed)
        if reason and (self.light or self.armed or self.running):
            self.close(reason, at)
            return True
        return only

    def call_position(self, now: int, there: int) -> None:
        """Set the position of the web; encoder and mark then count as correct."""
        self.senses.call_position(now, self.microsteps(now), there)
        self.web.set_position(now, float(there))

    def _act_row(self, at: int) -> None:
        index, _, code, delay_us, on_us, channels = self.rows.popleft()
        self._floor = at
        self.next_row = index + 1
        if code is not None and self.on_lens is not None:
            frame = b"PwDA" + (code & 0xFFFF).to_bytes(2, "big") + b"\0\0"
            self.on_lens(frame + check_sum(frame).to_bytes(2, "little"), at)
        self._pulse = (max(at + delay_us * MICRO, self._fired + TRIGGER_GAP), on_us, channels)

    def _fire(self, at: int) -> None:
        assert self._pulse is not None
        _, on_us, channels = self._pulse
        self._pulse, self._floor, self._fired = None, at, at
        if self._pulse_end is not None:
            self._pulse_end = None
            self.set_light(self._steady, at)
        self.shown += 1
        if self.on_trigger is not None:
            self.on_trigger(at)
        if on_us and self.armed:
            self.set_light(self._steady | channels, at)
            self._pulse_end = at + on_us * MICRO
        else:
            self._finish(at)

    def _finish(self, at: int) -> None:
        if self.running and self._all_acted() and self._pulse is None and self._pulse_end is None:
            self.running, self.done = False, True
            self.say(at, "done", self.shown)

    def set_light(self, channels: int, at: int) -> None:
        if channels == self.light:
            return
        if self.light:
            self.intervals.append((self._lit_at, at, self.light, tuple(self.powers)))
        self.light, self._lit_at = channels, at
        if self.on_light is not None:
            self.on_light(channels, at)

    def set_power(self, channel: int, drive: int, at: int) -> None:
        """Change a drive; light that is on stays on, and is recorded with its drives until now."""
        if self.light:
            self.intervals.append((self._lit_at, at, self.light, tuple(self.powers)))
            self._lit_at = at
        self.powers[channel] = drive

    def drive(self, channel: int) -> float:
        """Drive of a channel's light, as a share of full."""
        return self.powers[channel] / 65535

    def lit(self, now: int) -> int:
        """The channels that were lit at a time [ns]."""
        if self.light and now >= self._lit_at:
            return self.light
        return next((channels for start, end, channels, _ in reversed(self.intervals) if start <= now < end), 0)

    def close(self, reason: str, at: int) -> None:
        """The light goes off and stays off until the host arms again."""
        self._pulse = self._pulse_end = self._judge_at = None
        self._steady = 0
        self.set_light(0, at)
        self.armed = self.running = False
        self.lease_end = None
        if reason in ("lease", "interlock", "stall", "index"):
            self.fault = reason
        if self.on_close is not None:
            self.on_close(reason, at)
        self.say(at, "light", "off", reason)

    def lose_power(self, now: int) -> None:
        """Power off and on again; all state is lost."""
        self.advance(now)
        self.set_light(0, now)
        self._begin()

    def stall(self, now: int) -> None:
        """The motor stalls, while steps continue."""
        self.advance(now)
        self.senses.stall(now, self.microsteps(now))

    def slip(self, now: int, steps: int) -> None:
        """The motor loses a number of microsteps at once."""
        self.advance(now)
        self.senses.slip(now, self.microsteps(now), steps)
        if self.senses.used:
            self._sense_at(now)

    def open_interlock(self, now: int) -> None:
        self.advance(now)
        self.interlock_closed = False
        self.close("interlock", now)

    # the line

    def say(self, now: int, *words: object) -> None:
        self._send(" ".join(["!", *map(str, words)]), now)

    def _send(self, text: str, now: int) -> bytes:
        body = text.encode("ascii")
        line = body + b"*%04X\n" % line_check(body)
        self._out.put(line, now)
        return line

    def receive(self, data: bytes, now: int) -> None:
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
        self.lease_end = until = now + milliseconds * MILLI
        if self.on_lease is not None:
            self.on_lease(until, now)

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
