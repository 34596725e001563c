"""The controller of web, trigger, lens and light."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers import controller_protocol as protocol
from vamgpu.hosts.drivers.cleanup import Closing, closed_on_error
from vamgpu.hosts.drivers.controller_protocol import ControllerRow, Reply, Status
from vamgpu.hosts.drivers.wire import Wire, open_wire
from vamgpu.hosts.schedules.timing import exact, fraction

log: logging.Logger = logging.getLogger(__name__)
TRIES = 3
CLOSE = Fraction(1, 10**9)  # allowed relative error of a ratio: one microstep in 10^9
LONGEST_BABBLE = 100  # largest number of lines read for one answer, because a machine may never stop sending
REASONS = {
    "lease": "its lease has run out: renew it before arming",
    "interlock": "its interlock is open: close the enclosure",
    "armed": "it is not armed",
    "full": "its queue of rows is full",
    "order": "rows must come in order",
    "range": "a value is outside its range",
    "state": "it cannot do so in its present state",
    "verb": "it does not know the command: check its firmware",
    "stall": "its encoder differs from the motor's steps: check motor and load, then home it or start again",
    "index": "its index mark was off position: check motor and belt, then home it or start again",
}


@dataclass(frozen=True)
class Encoder:
    """An encoder that measures the motion; beyond its tolerance the controller switches the light off."""

    counts: float  # quadrature edges per mm or degree, negative if it counts down
    tolerance: float  # allowed difference from the motor's steps [mm] or [deg]

    def __post_init__(self) -> None:
        exact("counts", abs(fraction("counts", self.counts)))
        exact("tolerance", self.tolerance)


@dataclass(frozen=True)
class Index:
    """A mark that recurs; if it is off position, the controller switches the light off."""

    distance: float  # distance from mark to mark [mm] or [deg]
    tolerance: float  # allowed position error [mm] or [deg]

    def __post_init__(self) -> None:
        exact("distance", self.distance)
        exact("tolerance", self.tolerance)


def _in_range(ratio: Fraction) -> Fraction:
    """The nearest ratio of numbers that the controller accepts."""
    if abs(ratio) <= 1:
        return ratio.limit_denominator(protocol.LONGEST_RATIO)
    return 1 / (1 / ratio).limit_denominator(protocol.LONGEST_RATIO)


class Controller(Closing):
    """The controller: it answers every command; a command is repeated if its answer is lost or malformed."""

    def __init__(self, wire: Wire, microsteps_per_mm: float = 1.0) -> None:
        if not microsteps_per_mm > 0:
            raise BadInput(f"{microsteps_per_mm} microsteps per mm drive no web; give those of motor and roller")
        self._wire = wire
        self._number = 0
        self.microsteps_per_mm = microsteps_per_mm
        self._ramp: float | None = None
        self._measuring: tuple[Encoder | None, Index | None] = (None, None)
        self.events: deque[tuple[str, ...]] = deque(maxlen=1000)
        with closed_on_error(wire):
            self._start()

    @classmethod
    def open(cls, url: str, microsteps_per_mm: float = 1.0, baud: int = 115200, timeout_s: float = 0.1) -> Self:
        return cls(open_wire(url, "the controller", baud, timeout_s), microsteps_per_mm)

    def _start(self) -> None:
        self._wire.drain()
        self._wire.send(b"\n")
        self._wire.drain()
        try:
            words = self.ask("hello")
            name, version, capacity, _, channels = words[0], int(words[1]), *(int(word) for word in words[2:5])
        except (DeviceLost, DeviceRefused, ProtocolError, ValueError, IndexError) as error:
            raise WrongDevice(f"{self._wire.name} does not answer as a controller: {error}") from error
        if name != protocol.NAME or version != protocol.VERSION:
            raise WrongDevice(
                f"{self._wire.name} is {name} version {version}; expected {protocol.NAME} version {protocol.VERSION}, "
                "which measures the position: load the sketch of this library (hosts/firmware)"
            )
        self.capacity: int = capacity
        self.channels: int = channels

    def revive(self) -> None:
        """Open the port again if the controller does not answer, as after it was unplugged."""
        try:
            self.status()
        except DeviceLost:
            self._wire.reopen()
            self._start()
            if self._ramp is not None:
                self.ramp(self._ramp)
            if any(self._measuring):
                self.feedback(*self._measuring)

    def ask(self, verb: str, *arguments: object) -> tuple[str, ...]:
        """Send a command and return the words of its answer; DeviceRefused or DeviceLost without one."""
        with self._wire.lock:
            self._number = (self._number + 1) % protocol.NUMBERS
            line = protocol.encode(self._number, verb, *arguments)
            for attempt in range(TRIES):
                if attempt:
                    log.warning("controller: %s again", verb)
                self._wire.send(line)
                if (reply := self._answer()) is None:
                    continue
                if reply.kind == "ok":
                    return reply.words
                reason = reply.words[0] if reply.words else "?"
                raise DeviceRefused(f"the controller refused {verb!r}: {REASONS.get(reason, reason)}", reason)
        raise DeviceLost(f"{self._wire.name} did not answer {verb!r} in {TRIES} tries; check plug and power")

    def _replies(self, wait: bool = True) -> Iterator[Reply]:
        """Replies, without malformed ones; events are kept. wait: for the next line."""
        for _ in range(LONGEST_BABBLE):
            line = self._wire.line(protocol.LONGEST_LINE) if wait or self._wire.waiting() else b""
            if not line:
                return
            try:
                reply = protocol.parse(line)
            except ProtocolError as error:
                log.warning("controller: %s", error)
                continue
            if reply.kind == "!":
                log.info("controller says %s", " ".join(reply.words))
                self.events.append(reply.words)
            else:
                yield reply

    def _answer(self) -> Reply | None:
        """The reply to the last number; None if it is missing, or the command must be repeated."""
        found = next((each for each in self._replies() if each.kind == "?" or each.number == self._number), None)
        return None if found is None or found.kind == "?" else found

    def poll(self) -> tuple[tuple[str, ...], ...]:
        """Return the controller's events since the last call."""
        with self._wire.lock:
            deque(self._replies(wait=False), maxlen=0)
        taken = tuple(self.events)
        self.events.clear()
        return taken

    def lease(self, milliseconds: int) -> None:
        """Allow the light for a time from now; renew it well before its end."""
        self.ask("lease", int(milliseconds))

    def arm(self) -> None:
        """Allow light."""
        self.ask("arm")

    def disarm(self) -> None:
        """Light off, and not allowed."""
        self.ask("disarm")

    def light(self, channels: int) -> None:
        """Steady light of some channels, a sum of powers of two, while armed; 0 is off."""
        self.ask("light", int(channels))

    def power(self, channel: int, fraction: float) -> None:
        """Set the drive of a channel of light, as a share of full."""
        if not 0 <= fraction <= 1:
            raise BadInput(f"a light cannot be driven at {fraction} of full; give 0..1")
        self.ask("power", channel, round(fraction * 65535))

    def mode(self, mode: str) -> None:
        """Set the unit of rows: ``time`` (microseconds since ``go``) or ``steps`` (microsteps of the web)."""
        self.ask("mode", mode)

    def row(self, row: ControllerRow) -> int:
        """Queue one slot; returns how many more fit."""
        return int(self.ask("row", *row.words())[0])

    def end(self, count: int) -> None:
        """Set the number of rows of the print."""
        self.ask("end", count)

    def go(self, number: int) -> None:
        """Start to play the rows. number: 1 to 65535, by which a later host recognizes this play."""
        self.ask("go", number)

    def stop(self) -> None:
        """Light off first, then rows dropped, then the web at rest."""
        self.ask("stop")

    def move(self, speed_mm_s: float) -> None:
        """Run the web at a speed [mm/s]; 0 stops it."""
        self._within("speed", speed_mm_s, "mm/s", protocol.FASTEST)
        self.ask("move", round(speed_mm_s * self.microsteps_per_mm * 1000))

    def ramp(self, acceleration_mm_s2: float) -> None:
        """Set the acceleration of the web [mm/s2]."""
        if not acceleration_mm_s2 > 0:
            raise BadInput(f"the acceleration is {acceleration_mm_s2:g} mm/s2; expected more than 0")
        self._within("acceleration", acceleration_mm_s2, "mm/s2", protocol.STEEPEST)
        self._ramp = acceleration_mm_s2
        self.ask("ramp", max(round(acceleration_mm_s2 * self.microsteps_per_mm), 1))

    def _within(self, what: str, value: float, unit: str, most: int) -> None:
        if not abs(value) * self.microsteps_per_mm <= most:
            raise BadInput(
                f"a {what} of {value:g} {unit} is {abs(value) * self.microsteps_per_mm:.4g} microsteps; the controller "
                f"steps at most {most:.4g}: go slower, or use fewer microsteps"
            )

    def zero(self, number: int) -> None:
        """Call this position of the web 0. number: 1 to 65535, by which a later host recognizes this zero."""
        self.ask("zero", number)

    def feedback(self, encoder: Encoder | None = None, index: Index | None = None) -> None:
        """Set the sensor of the motion; None for no sensor. The present position counts as correct."""
        per_unit = fraction("microsteps", self.microsteps_per_mm)
        edges = Fraction(0) if encoder is None else fraction("counts", encoder.counts) / per_unit
        marks = Fraction(0) if index is None else 1 / (fraction("distance", index.distance) * per_unit)
        for verb, per_step, found in (("encoder", edges, encoder), ("index", marks, index)):
            ratio = _in_range(per_step)
            limit = 0 if found is None else int(fraction("tolerance", found.tolerance) * per_unit)
            if abs(ratio - per_step) > CLOSE * abs(per_step) or limit > protocol.LONGEST_RATIO:
                raise BadInput(
                    f"{found} has {float(per_step):.6g} per microstep and a tolerance of {limit} microsteps; expected "
                    f"ratios of whole numbers up to {protocol.LONGEST_RATIO}: check counts, distance and microsteps"
                )
            if found is not None and (limit < 1 or (found is encoder and limit * abs(ratio) < 2)):
                raise BadInput(
                    f"the {verb}'s tolerance of {found.tolerance:g} is {limit} microsteps, below its resolution; "
                    "expected at least one microstep, and two counts of an encoder"
                )
            self.ask(verb, ratio.numerator, ratio.denominator, limit)
        self._measuring = (encoder, index)

    @property
    def index(self) -> Index | None:
        return self._measuring[1]

    def home(self, number: int, speed_mm_s: float) -> None:
        """Run up to the next index mark, set 0 there under a number, and stop; `status` has ``homing`` meanwhile."""
        self._within("speed", speed_mm_s, "mm/s", protocol.FASTEST)
        self.ask("home", number, round(speed_mm_s * self.microsteps_per_mm * 1000))

    def status(self) -> Status:
        return protocol.parse_status(self.ask("stat"))

    def position_mm(self) -> float:
        """The web's position [mm]."""
        return self.status().position / self.microsteps_per_mm

    def close(self) -> None:
        """Release the port; the lease then runs out and switches the light off."""
        self._wire.close()
