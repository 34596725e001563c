"""Zaber stages over a serial line or a socket, by their ASCII protocol."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Self

from vamgpu.errors import BadInput, DeviceError, DeviceLost, ProtocolError, WrongDevice
from vamgpu.hosts.drivers.wire import Wire, open_wire
from vamgpu.hosts.protocols import zaber

log = logging.getLogger(__name__)


class ZaberStage:
    """One axis of one device; ``microsteps`` is how many make a unit, ``unit`` is ``mm`` or ``deg``.

    ``pause`` waits a number of seconds between questions about motion.
    """

    def __init__(
        self,
        wire: Wire,
        microsteps: float,
        unit: str = "deg",
        device: int = 1,
        axis: int = 1,
        patience_s: float = 60.0,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        if not microsteps > 0 or unit not in ("mm", "deg"):
            wire.close()
            raise BadInput(f"{microsteps} microsteps a {unit!r} are no stage; give what its gear makes, in mm or deg")
        self._wire, self.microsteps, self.unit = wire, microsteps, unit
        self._device, self._axis, self._patience, self._pause = device, axis, patience_s, pause
        self._number = 0
        try:
            self._wire.drain()
            self.kind = self._start()
        except BaseException:
            wire.close()
            raise

    @classmethod
    def open(
        cls, url: str, microsteps: float, unit: str = "deg", device: int = 1, axis: int = 1, timeout_s: float = 0.5
    ) -> Self:
        """Open the stage at an address."""
        return cls(open_wire(url, f"stage {device}", 115200, timeout_s), microsteps, unit, device, axis)

    def _start(self) -> int:
        try:
            return self._whole("get deviceid")
        except (ProtocolError, DeviceLost) as error:
            raise WrongDevice(f"{self._wire.name} does not answer as a Zaber device: {error}") from error

    def ask(self, text: str) -> str:
        """Send a command to the axis and return the data of its reply."""
        return zaber.accept(self._exchange(text), text)

    def _whole(self, text: str) -> int:
        """The whole number a question is answered with."""
        data = self.ask(text)
        try:
            return int(data)
        except ValueError:
            raise ProtocolError(
                f"{self._wire.name} answered {data!r} to {text!r}, a number was wanted; check the number of its axis"
            ) from None

    def _exchange(self, text: str) -> zaber.Message:
        with self._wire.lock:
            self._number = (self._number + 1) % 96
            self._wire.send(zaber.command(self._device, self._axis, self._number, text))
            while line := self._wire.line():
                message = zaber.parse(line)
                if message.kind == "@" and message.device == self._device and message.number == self._number:
                    return message
                log.info("stage says %s", message)
        raise DeviceLost(f"{self._wire.name} does not answer {text!r}; check its power and its number")

    def position(self) -> float:
        """Where the axis says it is."""
        return self._whole("get pos") / self.microsteps

    def home(self) -> None:
        """Find the axis's zero; returns when it has."""
        self.ask("home")
        self.wait()

    def move(self, position: float, speed: float) -> None:
        """Begin to move to a position at most at a speed."""
        if not speed > 0:
            raise BadInput(f"a move needs a speed above 0, not {speed}")
        self.ask(f"set maxspeed {self._speed(speed)}")
        self.ask(f"move abs {round(position * self.microsteps)}")

    def run(self, speed: float) -> None:
        """Begin to move at a speed, for good."""
        self.ask("stop" if speed == 0 else f"move vel {self._speed(speed)}")

    def _speed(self, speed: float) -> int:
        return round(speed * self.microsteps * zaber.SPEED_UNITS)

    def true_speed(self, speed: float) -> float:
        """The speed the device will run at when asked for one: whole numbers of its own unit."""
        return self._speed(speed) / zaber.SPEED_UNITS / self.microsteps

    def busy(self) -> bool:
        """Whether the axis moves."""
        message = self._exchange("")
        zaber.accept(message, "")
        return message.busy

    def wait(self) -> None:
        """Return when the axis rests; DeviceError if it does not within the stage's patience."""
        waited = 0.0
        while self.busy():
            if waited > self._patience:
                raise DeviceError(f"stage {self._device} still moves after {self._patience} s; check what it should do")
            self._pause(0.02)
            waited += 0.02

    def stop(self) -> None:
        """Begin to come to rest."""
        self.ask("stop")

    def close(self) -> None:
        """Stop, and let go of the line."""
        try:
            self.stop()
        except DeviceError as error:
            log.warning("closing a stage: %s", error)
        self._wire.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
