"""An emulated Zaber device of one axis, in ASCII messages with check sums, and an emulated stepper driven by pulses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import LineDevice
from vamgpu.hosts.emulators.track import Track
from vamgpu.hosts.schedules.timing import SECOND

SPEED = 1.6384  # units of speed per microstep per second


@dataclass(eq=False)
class EmulatedStage(LineDevice):
    """One axis in microsteps; ``track`` has its position, ``rotary`` means without end."""

    limit: int = 10_000_000
    rotary: bool = False
    acceleration: float = 2_000_000.0
    device: int = 1
    encoder: bool = False
    scale: float = 1.0  # ratio of true to reported position, as with a slipping belt
    wired: int = 1  # number of the output on the mirrors' trigger
    joined: int | None = None  # number of the output that a board joins with it

    def __post_init__(self) -> None:
        super().__init__(latency_us=90.0)
        self.track: Track = Track(self.acceleration)
        limits = {"limit.min": -self.limit if self.rotary else 0, "limit.max": self.limit, "limit.cycle.dist": 0}
        self.settings: dict[str, int] = {"maxspeed": 153600, "resolution": 64} | limits
        self.settings |= {"deviceid": 50081, "system.serial": 42}
        self.fault = ""
        self.on_trigger: Callable[[int], None] | None = None
        self.levels: set[int] = set()  # outputs that are high
        self.edges: int = 0
        self._half, self._number = 0, "1"
        self._next: float | None = None
        self._after = 0

    def true_position(self, now: int) -> float:
        """Position of the axis [microsteps]."""
        return self.track.position(now) * self.scale

    def due(self) -> int | None:
        """Time of the next change of the trigger output."""
        return None if self._next is None else self.track.reaches(self._next, self._after)

    def advance(self, now: int) -> None:
        """Toggle the output if due: at each half distance on the way up."""
        while self._next is not None and (at := self.due()) is not None and at <= now:
            self._next, self._after, number = self._next + self._half, at, int(self._number)
            self.levels ^= {number}
            if number in self.levels and number == self.wired and self.joined in {None, *self.levels}:
                self.edges += 1
                if self.on_trigger is not None:
                    self.on_trigger(at)

    def receive(self, data: bytes, now: int) -> None:
        self.advance(now)
        self._after = now
        for line in self.lines(data):
            if line.startswith(b"/"):
                self._command(line[1:], now)

    def _command(self, body: bytes, now: int) -> None:
        checked = body[-3:-2] == b":"
        if checked:
            if (sum(body[:-3]) + int(body[-2:], 16)) % 256:
                return
            body = body[:-3]
        words = body.decode("ascii").split()
        numbers = []
        while words and words[0].isdigit() and len(numbers) < 3:
            numbers.append(words.pop(0))
        device = int(numbers[0]) if numbers else 0
        if device not in (0, self.device):
            return
        number = numbers[2] if len(numbers) > 2 else None
        good, data = self._act(words, now)
        state = "BUSY" if self.track.moving(now) else "IDLE"
        warning = self.fault or ("--" if self.rotary else "WR")
        fields = [f"{self.device:02d}", "1" if len(numbers) > 1 and numbers[1] != "0" else "0"]
        fields += [number] if number else []
        text = " ".join([*fields, "OK" if good else "RJ", state, warning, data])
        if checked:
            text += f":{256 - sum(text.encode()) % 256 & 255:02X}"
        self._out.put(f"@{text}\r\n".encode("ascii"), now)

    def _act(self, words: list[str], now: int) -> tuple[bool, str]:
        try:
            match words:
                case ["trigger" | "io", *_]:
                    return self._triggers(words, now)
                case ["get", "pos"]:
                    return True, str(round(self.track.position(now)))
                case ["get", "encoder.pos"] if self.encoder:
                    return True, str(round(self.true_position(now)))
                case ["get", name] if name in self.settings:
                    return True, str(self.settings[name])
                case ["set", "pos", value]:
                    self.track.set_position(now, int(value))
                case ["set", name, value] if name in self.settings:
                    self.settings[name] = int(value)
                case ["stop"] | ["estop"]:
                    self.track.run(now, 0.0)
                case ["move", "abs", value]:
                    return self._go(float(int(value)), now)
                case ["move", "rel", value]:
                    return self._go(self.track.position(now) + int(value), now)
                case ["move", "vel", value]:
                    self.track.run(now, int(value) / SPEED)
                case [_, *_]:
                    return False, "BADCOMMAND"
        except ValueError:
            return False, "BADDATA"
        return True, "0"

    def _triggers(self, words: list[str], now: int) -> tuple[bool, str]:
        """One trigger that toggles one output as the axis moves."""
        match words:
            case ["trigger", "1" | "2" | "3" | "4" as number, "when", "1", "dist", distance]:
                self._half, self._number = int(distance), number
            case ["trigger", number, "action", "a", "io", "set", "do", output, "t"] if output == number == self._number:
                pass
            case ["trigger", number, "enable"] if self._half and number == self._number:
                self._next, self._after, self.edges = self.track.position(now) + self._half, now, 0
            case ["trigger", "1" | "2" | "3" | "4", "disable"]:
                self._next, self.edges = None, 0
            case ["io", "set", "do", "1" | "2" | "3" | "4" as output, "0" | "1" as level]:
                self.levels = self.levels - {int(output)} | ({int(output)} if level == "1" else set())
            case _:
                return False, "BADDATA"
        return True, "0"

    def _go(self, target: float, now: int) -> tuple[bool, str]:
        if not self.settings["limit.min"] <= target <= self.settings["limit.max"]:
            return False, "BADDATA"
        self.track.go(now, target, self.settings["maxspeed"] / SPEED)
        return True, "0"


@dataclass(eq=False)
class EmulatedStepper:
    """A pulse output and its motor, which can stall."""

    clock: VirtualClock
    turn: float  # pulses
    off: float = 0.0  # by how much its clock is faster than the host's [ppm]

    def __post_init__(self) -> None:
        self.stalled: bool = False
        self._pieces: list[tuple[int, float, float]] = [(0, 0.0, 0.0)]
        self._asked = 0

    def position(self, now: int) -> float:
        """True position of the motor at a time [pulses]."""
        at, place, speed = next(piece for piece in reversed(self._pieces) if piece[0] <= now)
        return place + speed * (now - at) / SECOND

    def rate(self, hz: float) -> float:
        now = self.clock.now()
        true = 0.0 if self.stalled else hz * (1 + 1e-6 * self.off)
        self._pieces.append((now, self.position(now), true))
        return hz

    def stall(self) -> None:
        """The motor stalls, while pulses continue."""
        self.rate(0.0)
        self.stalled = True

    def edges(self) -> tuple[int, ...]:
        found, now = [], self.clock.now()
        for piece, (at, place, speed) in enumerate(self._pieces):
            end = self._pieces[piece + 1][0] if piece + 1 < len(self._pieces) else now
            last = place + speed * (end - at) / SECOND
            marks = range(ceil(place / self.turn), floor(last / self.turn) + 1) if speed else ()
            found += [at + round((mark * self.turn - place) / speed * SECOND) for mark in marks]
        asked, self._asked = self._asked, now
        return tuple(at for at in dict.fromkeys(found) if asked < at <= now)

    def close(self) -> None:
        self.rate(0.0)
