"""The timing of the controller's firmware: rows, pulses of light, and the lease that closes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from vamgpu.hosts.emulators.lens import check_sum
from vamgpu.hosts.emulators.sensors import Senses
from vamgpu.hosts.emulators.track import Track

MICRO = 1000
TRIGGER_GAP = 50 * MICRO  # from trigger to trigger at least [ns]
RAMP = 200_000.0  # how fast the web changes its speed until a host tells it otherwise [microsteps/s2]


class RowPlayer:
    """Queue, web, lease and gate of the firmware; callbacks get the time [ns] last."""

    # ``intervals`` remembers when which channels were lit with which drive, ``row_times`` when each row acted.

    armed: bool
    running: bool
    done: bool
    next_row: int
    shown: int
    zero: int

    def __init__(self, channels: int) -> None:
        self.channels = channels
        self.on_trigger: Callable[[int], None] | None = None
        self.on_lens: Callable[[bytes, int], None] | None = None
        self.on_light: Callable[[int, int], None] | None = None
        self.on_lease: Callable[[int, int], None] | None = None
        self.on_close: Callable[[str, int], None] | None = None
        self.interlock_closed: bool = True
        self.powers: list[int] = [65535] * channels
        self.intervals: deque[tuple[int, int, int, tuple[int, ...]]] = deque(maxlen=4096)
        self.row_times: deque[tuple[int, int]] = deque(maxlen=4096)
        self.light: int = 0
        self._lit_at = 0
        self._begin()

    def _begin(self) -> None:
        """As a board does when it gets its power."""
        self.web: Track = Track(acceleration=RAMP)
        self.senses: Senses = Senses()
        self.armed = self.running = self.done = False
        self.fault: str = "none"
        self.lease_end: int | None = None
        self.steps_mode = False
        self.rows: deque[tuple[int, int, int | None, int, int, int]] = deque()
        self.next_row = self.shown = self.late = self.zero = self.play = 0
        self.total: int | None = None
        self.started = self._floor = 0
        self._fired = -TRIGGER_GAP
        self._pulse: tuple[int, int, int] | None = None
        self._pulse_end: int | None = None
        self._judge_at: int | None = None
        self._steady = 0

    def say(self, now: int, *words: object) -> None:
        """Tell the host something by itself."""

    def due(self) -> int | None:
        """When it acts next."""
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
        """The whole microsteps the web has gone; a rounding short of one counts."""
        position = self.web.position(now)
        return int(position + (1e-6 if position > 0 else -1e-6))

    def advance(self, now: int) -> None:
        """Do all that is due."""
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
        """Compare encoder and mark; whether that closed the light, or was all that was due."""
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
        """Call where the web is so; encoder and mark are taken to agree."""
        self.senses.call_position(now, self.microsteps(now), there)
        self.web.set_position(now, float(there))

    def _act_row(self, at: int) -> None:
        index, _, code, delay_us, on_us, channels = self.rows.popleft()
        self.row_times.append((index, at))
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
        """Change a drive; light that is on stays on, and is remembered with the drives it had until now."""
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
        """It goes off and on again, and knows nothing any more."""
        self.advance(now)
        self.set_light(0, now)
        self._begin()

    def stall(self, now: int) -> None:
        """The motor stands, though it is stepped on."""
        self.advance(now)
        self.senses.stall(now, self.microsteps(now))

    def slip(self, now: int, steps: int) -> None:
        """The motor loses so many microsteps at once."""
        self.advance(now)
        self.senses.slip(now, self.microsteps(now), steps)
        if self.senses.used:
            self._sense_at(now)

    def open_interlock(self, now: int) -> None:
        """Somebody opens the enclosure."""
        self.advance(now)
        self.interlock_closed = False
        self.close("interlock", now)
