"""Steppers on boards that speak lines of text: GRBL 1.1, or a firmware of the lab, by the table of its lines."""

from __future__ import annotations

import re
from typing import Any, NamedTuple, Self

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.stages import PolledStage
from vamgpu.hosts.drivers.wire import MOST, Wire, open_wire

TRIES = 16  # queries until a board that restarts at the opening of its port must have answered
SLOW = 0.2  # time in which a moving axis makes at least one step [s]
SAME = 1e-4  # relative tolerance of steps that a board prints with three decimals


class Dialogue(NamedTuple):
    """Texts of a firmware, with fields as in `TextMotion`, and {way} for the distance from the present position."""

    ask: str  # query of the position
    answer: str  # pattern of its answer, with a group ``position`` [unit] or ``steps``, and perhaps a ``state``
    run: str  # move at a speed
    stop: str
    move: str = ""  # move to a position; "" runs to it
    accepted: str = ""  # pattern of the answer to run, stop and move; "": there is none
    refused: str = r"(?i)\b(error|alarm)\b.*"
    resting: str = ""  # pattern of the state of an axis at rest; "" compares positions


class TextStage(PolledStage):
    def __init__(self, wire: Wire, dialogue: Dialogue, microsteps: float, unit: str = "deg", **options: Any) -> None:
        self._wire, self._says = wire, dialogue
        super().__init__(wire, wire.name, microsteps, unit, **options)

    @classmethod
    def open(cls, port: str, dialogue: Dialogue, microsteps: float, unit: str = "deg", baud: int = 115200) -> Self:
        return cls(open_wire(port, "the stepper's board", baud), dialogue, microsteps, unit)

    def _start(self) -> None:
        """Wait for the board, which may restart when its port is opened."""
        for _ in range(TRIES):
            try:
                self._ask()
                return
            except DeviceLost:
                continue
        raise WrongDevice(f"{self._wire.name} does not answer {self._says.ask!r}; check port, baud and firmware")

    def _ask(self) -> re.Match[str]:
        return self._wire.exchange(self._says.ask, self._says.answer, self._says.refused)

    def _tell(self, template: str, speed: float, position: float = 0.0, way: float = 0.0) -> None:
        text = template.format(
            speed=speed, rate=60.0 * speed, position=position, way=way, steps=round(position * self.microsteps),
            steps_per_s=speed * self.microsteps,
        )  # fmt: skip
        if self._says.accepted:
            self._wire.exchange(text, self._says.accepted, self._says.refused)
        else:
            self._wire.send(text.encode("latin-1"))

    def _place(self, found: re.Match[str]) -> float:
        given = found.groupdict()
        return float(given["position"]) if given.get("position") else float(given["steps"]) / self.microsteps

    def position(self) -> float:
        return self._place(self._ask())

    def _move(self, position: float, speed: float) -> None:
        if self._says.move:
            self._tell(self._says.move, speed, position)
        else:
            super()._move(position, speed)

    def run(self, speed: float) -> None:
        if speed == 0:
            self.stop()
        else:
            self._tell(self._says.run, speed)

    def busy(self) -> bool:
        found = self._ask()
        if self._says.resting:
            return not re.fullmatch(self._says.resting, found["state"])
        self._pause(SLOW)
        return self._place(self._ask()) != self._place(found)

    def stop(self) -> None:
        self._tell(self._says.stop, 0.0)


def grbl(axis: str = "X") -> Dialogue:
    """GRBL 1.1's jogging of an axis, whose mm may be degrees; it stops at the realtime character 0x85."""
    place = r"-?[\d.]+,"
    return Dialogue(
        "?", rf"<(?P<state>\w+)[^|>]*\|.*MPos:(?:{place}){{{'XYZ'.index(axis)}}}(?P<position>{place[:-1]})",
        f"$J=G91G21{axis}{{way:.3f}}F{{rate:.4f}}\n", "\x85", f"$J=G53G21{axis}{{position:.3f}}F{{rate:.4f}}\n",
        "^ok$", r"(error|ALARM):\d+", "Idle",
    )  # fmt: skip


WAY = 3600.0  # length of a jog: the board's numbers of 32 bits are fine enough for it


class GrblStage(TextStage):
    """An axis of GRBL; a motion at a speed is a sequence of long jogs, which `position` continues."""

    def _start(self) -> None:
        """Check its settings: they bound the speed, and say how many steps it makes."""
        self._goal, self._speed = 0.0, 0.0
        super()._start()
        axis = "XYZ".index(self._says.move[len("$J=G53G21")])
        if self._ask()["state"] == "Alarm":
            raise DeviceRefused(f"{self._name} is in alarm; check the axis, and send $X to unlock it", "alarm")
        found = self._settings()
        steps, self._most = found.get(100 + axis, 0.0), found.get(110 + axis, 0.0) / 60.0
        if abs(steps / self.microsteps - 1) > SAME:
            raise WrongDevice(
                f"{self._name} makes {steps:g} steps per {self.unit} (${100 + axis}); the rig's file has microsteps = "
                f"{self.microsteps:g}: correct one of them"
            )
        if found.get(13) or found.get(20):
            raise DeviceRefused(f"{self._name} reports inches or has soft limits; set $13=0 and $20=0", "settings")

    def _settings(self) -> dict[int, float]:
        found: dict[int, float] = {}
        with self._wire.lock:
            self._wire.drain()
            self._wire.send(b"$$\n")
            for _ in range(MOST):
                line = self._wire.line().decode("ascii", "replace").strip()
                if one := re.fullmatch(r"\$(\d+)=([\d.]+).*", line):
                    found[int(one[1])] = float(one[2])
                elif line in ("ok", ""):
                    break
        return found

    def _bounded(self, speed: float) -> None:
        """Raise `BadInput` for a speed that it would silently lower."""
        if abs(speed) > self._most:
            raise BadInput(
                f"a speed of {abs(speed):g} {self.unit}/s; the axis makes {self._most:g} at most ($110 to $112 / 60)"
            )

    def position(self) -> float:
        """Reported position of the axis; a motion at a speed is prolonged."""
        here = super().position()
        if self._speed and abs(self._goal - here) < WAY / 2:
            self._jog()
        return here

    def _jog(self) -> None:
        way = WAY if self._speed > 0 else -WAY
        self._goal += way
        self._tell(self._says.run, abs(self._speed), way=way)

    def run(self, speed: float) -> None:
        """Start moving at a constant speed; a moving axis stops first."""
        self._bounded(speed)
        self._rest()
        if speed:
            self._goal, self._speed = self.position(), speed
            self._jog()

    def _rest(self) -> None:
        """Stop a motion at a speed: its queued jogs would come first."""
        if self._speed:
            self.stop()
            self.wait()

    def _move(self, position: float, speed: float) -> None:
        self._bounded(speed)
        self._rest()
        super()._move(position, speed)

    def stop(self) -> None:
        """Begin to stop the axis; its jogs are dropped."""
        self._speed = 0.0
        self._wire.send(self._says.stop.encode("latin-1"))
