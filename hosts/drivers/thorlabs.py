"""Stages on a motion cube by Thorlabs (K-Cube, T-Cube), in APT messages by the package ``thorlabs-apt-protocol``."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any, NamedTuple, Self

from vamgpu.errors import BadInput, DeviceLost, WrongDevice
from vamgpu.hosts.drivers.cleanup import extra
from vamgpu.hosts.drivers.stages import PolledStage
from vamgpu.hosts.drivers.wire import Wire, open_wire

log: logging.Logger = logging.getLogger(__name__)
UNIT, HOST, CHANNEL = 0x50, 0x01, 1
FORWARD, REVERSE, PROFILED = 1, 2, 2
MOST = 50  # most messages before an answer
LARGEST = 2**31 - 1  # greatest position or speed
ENDED = ("mot_move_completed", "mot_move_stopped", "mot_move_homed")
MOVING = ("moving_forward", "moving_reverse", "jogging_forward", "jogging_reverse", "homing")


class Cube(NamedTuple):
    """A family of cubes. speed: units of speed per count per second.  encoder: whether counts are of an encoder."""

    speed: float
    encoder: bool


SERVO, BRUSHLESS, STEPPER = Cube(65536 * 2048 / 6e6, True), Cube(65536 * 102.4e-6, True), Cube(2**29 / 1e7, False)
CUBES = {"KDC": SERVO, "TDC": SERVO, "KBD": BRUSHLESS, "TBD": BRUSHLESS, "KST": STEPPER, "TST": STEPPER}


class ThorlabsStage(PolledStage):
    """One axis. counts: per unit, of its encoder, or microsteps on a stepper's cube."""

    def __init__(self, wire: Wire, counts: float, unit: str = "deg", **options: Any) -> None:
        self._wire, self._ended = wire, True
        super().__init__(wire, "the Thorlabs stage", counts, unit, **options)

    @classmethod
    def open(cls, port: str, counts: float, unit: str = "deg", timeout_s: float = 0.5) -> Self:
        """Open a stage and enable its motor; a PRM1-Z8 has 1919.6418578623391 counts per degree."""
        # cubes hold bytes back by RTS and CTS
        return cls(open_wire(port, "the Thorlabs stage", 115200, timeout_s, rtscts=True), counts, unit)

    def _start(self) -> None:
        with extra("thorlabs", "Thorlabs stages need thorlabs-apt-protocol"):
            import thorlabs_apt_protocol as apt  # type: ignore[import-untyped]
        self._apt: Any = apt
        self._messages = apt.Unpacker(SimpleNamespace(read=self._wire.receive))
        self._wire.drain()
        try:
            said = self._ask("hw_req_info", "hw_get_info")
        except DeviceLost as error:
            raise WrongDevice(f"{self._wire.name} does not answer as a Thorlabs cube: {error}") from error
        self.kind: str = bytes(said.model_number).rstrip(b"\0 ").decode("ascii", "replace")
        cube = CUBES.get(self.kind[:3])
        if cube is None:
            raise WrongDevice(f"{self._wire.name} is a {self.kind}; expected a motion cube: {', '.join(CUBES)}")
        self._cube, self._name = cube, f"the {self.kind}"
        self._send("mod_set_chanenablestate", CHANNEL, 1)

    def _send(self, name: str, *arguments: int) -> None:
        self._wire.send(getattr(self._apt, name)(UNIT, HOST, *arguments))

    def _ask(self, question: str, answer: str, *arguments: int) -> Any:
        """Send a query, and read messages up to the answer: cubes also report the end of a move."""
        with self._wire.lock:
            self._send(question, *arguments)
            for _, message in zip(range(MOST), self._messages, strict=False):
                if message.msg in ENDED:
                    self._ended = True
                elif message.msg == answer:
                    return message
        raise DeviceLost(f"{self._wire.name} does not answer {question}; check its power and its plug")

    def _status(self) -> Any:
        kind = "dcstatusupdate" if self._cube.encoder else "statusupdate"
        return self._ask(f"mot_req_{kind}", f"mot_get_{kind}", CHANNEL)

    def position(self) -> float:
        return self._status().position / self.microsteps

    def _speed(self, speed: float) -> None:
        """Set the greatest speed, and keep the rest of its profile."""
        units = self._whole(abs(speed) * self._cube.speed, "speed", speed)
        if units == 0:
            raise BadInput(f"a speed of {speed:g} {self.unit}/s is below the resolution of the {self.kind}; go faster")
        profile = self._ask("mot_req_velparams", "mot_get_velparams", CHANNEL)
        self._send("mot_set_velparams", CHANNEL, profile.min_velocity, profile.acceleration, units)

    def _whole(self, units: float, what: str, value: float) -> int:
        found = round(units * self.microsteps)
        if abs(found) > LARGEST:
            raise BadInput(f"a {what} of {value:g} {self.unit} is {found} units; the {self.kind} counts to {LARGEST}")
        return found

    def _move(self, position: float, speed: float) -> None:
        goal = self._whole(position, "position", position)
        self._speed(speed)
        self._ended = False
        self._send("mot_move_absolute", CHANNEL, goal)

    def run(self, speed: float) -> None:
        if speed == 0:
            return self.stop()
        self._speed(speed)
        self._ended = True
        self._send("mot_move_velocity", CHANNEL, FORWARD if speed > 0 else REVERSE)

    def busy(self) -> bool:
        said = self._status()
        return not self._ended or any(getattr(said, name) for name in MOVING)

    def stop(self) -> None:
        self._ended = True
        self._send("mot_move_stop", CHANNEL, PROFILED)
