"""The emulated controller of web, trigger, lens and light; also a process of its own on a pseudo terminal.

``python -m vamgpu.hosts.emulators.controller --link PATH --log FILE`` serves until it is ended. PATH becomes a link to
the terminal; each change of the light is written to FILE as a line of JSON with the time [ns] of the monotonic clock,
which all processes of a computer share.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from vamgpu.hosts.emulators.lens import check_sum
from vamgpu.hosts.emulators.line import Outbox, PtyServer
from vamgpu.hosts.emulators.track import Track

MILLI, MICRO = 1_000_000, 1000
LONGEST_LEASE_MS = 1000
CAPACITY = 256


def line_check(data: bytes) -> int:
    """The lines' check sum by a shift register of sixteen single bits."""
    register = [1] * 16
    for byte in data:
        for bit in range(7, -1, -1):
            carry = register[0] ^ (byte >> bit & 1)
            register = [*register[1:], 0]
            for tap in (15, 10, 3):
                register[tap] ^= carry
    return int("".join(map(str, register)), 2)


class EmulatedController:
    """Queue, web, lease and gate.

    What it does to the other machines goes out through functions that are given the time [ns]: ``on_trigger(now)``,
    ``on_lens(bytes, now)`` on its second serial line, ``on_light(channels, now)`` at each change of the light.
    ``intervals`` remembers when which channels were lit, with their drive.
    """

    def __init__(self, capacity: int = CAPACITY, channels: int = 2, latency_us: float = 50.0) -> None:
        self.capacity, self.channels = capacity, channels
        self.on_trigger: Callable[[int], None] | None = None
        self.on_lens: Callable[[bytes, int], None] | None = None
        self.on_light: Callable[[int, int], None] | None = None
        self.web = Track(acceleration=200_000.0)
        self.interlock_closed = True
        self.powers = [65535] * channels
        self.intervals: deque[tuple[int, int, int, tuple[int, ...]]] = deque(maxlen=4096)
        self.light = 0
        self.row_times: deque[tuple[int, int]] = deque(maxlen=4096)
        self._lit_at = 0
        self._buffer = bytearray()
        self._out = Outbox(0, round(latency_us * 1000))
        self._last: tuple[int, bytes] | None = None
        self._reset()

    def _reset(self) -> None:
        self.armed = self.running = self.done = False
        self.fault = "none"
        self.lease_end: int | None = None
        self.steps_mode = False
        self.rows: deque[tuple[int, ...]] = deque()
        self.next_row = self.shown = self.late = 0
        self.total: int | None = None
        self.started = 0
        self._pulse: tuple[int, int, int] | None = None
        self._pulse_end: int | None = None
        self._steady = 0

    # time

    def due(self) -> int | None:
        """When it acts next."""
        times = [self._pulse_end, self._pulse[0] if self._pulse else None, self._row_due()]
        if self.lease_end is not None and (self.light or self.armed):
            times.append(self.lease_end)
        return min((at for at in times if at is not None), default=None)

    def _row_due(self) -> int | None:
        if not self.running or not self.rows or self._pulse is not None:
            return None
        at = self.rows[0][1]
        after = max(self.started, self._floor)
        return self.web.reaches(at, after) if self.steps_mode else max(self.started + at * MICRO, after)

    def advance(self, now: int) -> None:
        """Do all that is due."""
        while (at := self.due()) is not None and at <= now:
            if self.lease_end is not None and at >= self.lease_end and (self.light or self.armed):
                self._close("lease", at)
            elif self._pulse_end is not None and at >= self._pulse_end:
                self._pulse_end = None
                self._set_light(self._steady, at)
                self._finish(at)
            elif self._pulse is not None and at >= self._pulse[0]:
                self._fire(at)
            else:
                self._act_row(at)

    def _act_row(self, at: int) -> None:
        index, _, code, delay_us, on_us, channels = self.rows.popleft()
        self.row_times.append((index, at))
        self._floor = at
        self.next_row = index + 1
        if code is not None and self.on_lens is not None:
            frame = b"PwDA" + (code & 0xFFFF).to_bytes(2, "big") + b"\0\0"
            self.on_lens(frame + check_sum(frame).to_bytes(2, "little"), at)
        self._pulse = (at + delay_us * MICRO, on_us, channels)

    def _fire(self, at: int) -> None:
        assert self._pulse is not None
        _, on_us, channels = self._pulse
        self._pulse = None
        if self._pulse_end is not None:
            self._pulse_end = None
            self._set_light(self._steady, at)
        self.shown += 1
        if self.on_trigger is not None:
            self.on_trigger(at)
        if on_us and self.armed:
            self._set_light(self._steady | channels, at)
            self._pulse_end = at + on_us * MICRO
        else:
            self._finish(at)

    def _finish(self, at: int) -> None:
        if self.running and self.total is not None and self.next_row >= self.total and self._pulse is None:
            self.running, self.done = False, True
            self._say(at, "done", self.shown)

    def _set_light(self, channels: int, at: int) -> None:
        if channels == self.light:
            return
        if self.light:
            self.intervals.append((self._lit_at, at, self.light, tuple(self.powers)))
        self.light, self._lit_at = channels, at
        if self.on_light is not None:
            self.on_light(channels, at)

    def lit(self, now: int) -> int:
        """The channels that were lit at a time [ns]."""
        if self.light and now >= self._lit_at:
            return self.light
        return next((channels for start, end, channels, _ in reversed(self.intervals) if start <= now < end), 0)

    def _close(self, reason: str, at: int) -> None:
        """The light goes off and stays off until the host arms again."""
        self._pulse = self._pulse_end = None
        self._steady = 0
        self._set_light(0, at)
        self.armed = self.running = False
        self.lease_end = None
        if reason in ("lease", "interlock"):
            self.fault = reason
        self._say(at, "light", "off", reason)

    def open_interlock(self, now: int) -> None:
        """Somebody opens the enclosure."""
        self.advance(now)
        self.interlock_closed = False
        self._close("interlock", now)

    # the line

    def _say(self, now: int, *words: object) -> None:
        self._send(" ".join(["!", *map(str, words)]), now)

    def _send(self, text: str, now: int) -> bytes:
        body = text.encode("ascii")
        line = body + b"*%04X\n" % line_check(body)
        self._out.put(line, now)
        return line

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self.advance(now)
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).strip(b"\r")
            del self._buffer[: end + 1]
            if line:
                self._line(line, now)
        if len(self._buffer) > 96:
            self._buffer.clear()

    def take(self, now: int) -> bytes:
        """Give bytes that have left."""
        return self._out.take(now)

    def ready(self) -> int | None:
        """When the next bytes leave."""
        return self._out.ready()

    def _line(self, line: bytes, now: int) -> None:
        body, _, given = line.rpartition(b"*")
        words = body.decode("ascii", "replace").split()
        if given != b"%04X" % line_check(body) or len(words) < 2 or not words[0].isdigit():
            self._send("? line", now)
            return
        number = int(words[0])
        if words[1] != "hello" and self._last is not None and self._last[0] == number:
            self._out.put(self._last[1], now)
            return
        try:
            answer = self._do(words[1], [None if word == "-" else word for word in words[2:]], now)
        except (ValueError, IndexError, TypeError):
            answer = "no range"
        self._last = (number, self._send(f"{number} {answer}", now))

    def _do(self, verb: str, arguments: list[str | None], now: int) -> str:
        action = getattr(self, f"_do_{verb}", None)
        if action is None:
            return "no verb"
        if verb == "mode":
            return self._do_mode(arguments[0])
        return action(now, *(None if word is None else int(word) for word in arguments))

    def _do_hello(self, now: int) -> str:
        self._close("hello", now)
        self._reset()
        return f"ok vam-controller 1 {self.capacity} {LONGEST_LEASE_MS} {self.channels}"

    def _do_lease(self, now: int, milliseconds: int) -> str:
        if not 1 <= milliseconds <= LONGEST_LEASE_MS:
            return "no range"
        self.lease_end = now + milliseconds * MILLI
        return "ok"

    def _do_arm(self, now: int) -> str:
        if not self.interlock_closed:
            return "no interlock"
        if self.lease_end is None or now >= self.lease_end:
            return "no lease"
        self.armed, self.fault = True, "none"
        return "ok"

    def _do_disarm(self, now: int) -> str:
        self._close("disarm", now)
        return "ok"

    def _do_power(self, now: int, channel: int, drive: int) -> str:
        if not 0 <= channel < self.channels or not 0 <= drive <= 65535:
            return "no range"
        light = self.light
        self._set_light(0, now)
        self.powers[channel] = drive
        self._set_light(light, now)
        return "ok"

    def _do_light(self, now: int, on: int) -> str:
        if on and not self.armed:
            return "no armed"
        if not 0 <= on < 2**self.channels:
            return "no range"
        self._steady = on
        if self._pulse_end is None or not on:
            self._pulse_end = None
            self._set_light(on, now)
        return "ok"

    def _do_mode(self, mode: str | None) -> str:
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
        if self.running and self._passed(at, now):
            self.late += 1
            on = 0
        self.rows.append((index, at, code, delay, on, channels))  # type: ignore[arg-type]
        self.advance(now)
        return f"ok {self.capacity - len(self.rows)} {index + 1}"

    def _passed(self, at: int, now: int) -> bool:
        return self.web.position(now) > at if self.steps_mode else now > self.started + at * MICRO

    def _do_end(self, _: int, count: int) -> str:
        self.total = count
        return "ok"

    def _do_go(self, now: int) -> str:
        if self.running:
            return "no state"
        self.running, self.done, self.started, self._floor = True, False, now, now
        return "ok"

    _floor = 0

    def _do_move(self, now: int, speed: int) -> str:
        self.web.run(now, speed / 1000)
        return "ok"

    def _do_ramp(self, _: int, acceleration: int) -> str:
        if acceleration < 1:
            return "no range"
        self.web.acceleration = float(acceleration)
        return "ok"

    def _do_zero(self, now: int) -> str:
        if self.running:
            return "no state"
        self.web.set_position(now, 0.0)
        return "ok"

    def _do_stop(self, now: int) -> str:
        self._close("stop", now)
        self.rows.clear()
        self.next_row, self.total = 0, None
        self.web.run(now, 0.0)
        return "ok"

    def _do_stat(self, now: int) -> str:
        state = "fault" if self.fault != "none" else "running" if self.running else "done" if self.done else "idle"
        if state == "idle" and self.armed:
            state = "armed"
        lease = max((self.lease_end or now) - now, 0) // MILLI
        numbers = (
            self.next_row, self.shown, self.late, self.capacity - len(self.rows), int(self.web.position(now) // 1),
            round(self.web.velocity(now) * 1000), lease, self.light, int(self.armed), int(self.interlock_closed),
        )  # fmt: skip
        return " ".join(["ok", state, *map(str, numbers), self.fault])


def serve(link: Path, record: Path, latency_us: float = 50.0) -> None:
    """Serve a controller on a pseudo terminal until the process ends."""
    machine = EmulatedController(latency_us=latency_us)
    server = PtyServer(machine)
    with record.open("a", buffering=1, encoding="utf-8") as file:

        def note(channels: int, at: int) -> None:
            file.write(json.dumps({"light": channels, "due_ns": at, "done_ns": time.monotonic_ns()}) + "\n")

        machine.on_light = note
        link.unlink(missing_ok=True)
        os.symlink(server.url, link)
        try:
            while True:
                server.step(1.0)
        finally:
            link.unlink(missing_ok=True)


def main() -> None:
    """Read the command line and serve."""
    parser = argparse.ArgumentParser(description="An emulated controller on a pseudo terminal.")
    parser.add_argument("--link", type=Path, required=True, help="becomes a link to the terminal")
    parser.add_argument("--log", type=Path, required=True, help="takes each change of the light")
    parser.add_argument("--latency-us", type=float, default=50.0, help="from a command to its answer")
    given = parser.parse_args()
    serve(given.link, given.log, given.latency_us)


if __name__ == "__main__":
    main()
