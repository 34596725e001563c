"""Steppers on Pololu's Tic, through the package ``ticlib``: at a serial port, or on USB."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.cleanup import extra
from vamgpu.hosts.drivers.stages import PolledStage
from vamgpu.hosts.drivers.wire import open_wire

SPEED = 10_000  # units of speed in a microstep per second
LARGEST = 2**31 - 1
BY_POSITION = 1  # planning mode
COMMANDED = 0  # control mode: serial, I2C or USB
ERRORS = (
    "deenergized on purpose", "motor driver", "low supply voltage", "kill switch", "required input", "serial line",
    "command timeout", "safe start", "error line",
)  # fmt: skip


class TicStage(PolledStage):
    """One motor, with ``microsteps`` per unit; it stops by itself if its position is not queried within its timeout."""

    def __init__(self, tic: Any, line: Any, name: str, microsteps: float, unit: str = "deg", **options: Any) -> None:
        self._tic = tic
        super().__init__(line, name, microsteps, unit, **options)

    def _start(self) -> None:
        if self._call("get_control_mode", of=self._tic.settings) != COMMANDED:
            raise DeviceRefused(
                f"{self._name} is not controlled by commands; set Serial/I2C/USB in Tic Control Center", "mode"
            )
        self._most: int = self._call("get_max_speed")
        for act in ("energize", "exit_safe_start", "reset_command_timeout"):
            self._call(act)
        self._checked()

    @classmethod
    def open(cls, port: str, microsteps: float, unit: str = "deg", baud: int = 9600) -> Self:
        """Open the Tic at a serial port, or ``usb``, or ``usb:`` and its serial number."""
        with extra("tic", "a Tic needs ticlib, and pyusb on USB"):
            import ticlib  # type: ignore[import-untyped]
            import usb.util  # type: ignore[import-untyped]
        if port.partition(":")[0] == "usb":
            try:
                tic = ticlib.TicUSB(serial_number=port.partition(":")[2] or None)
            except Exception as error:  # the package and libusb raise errors of several kinds
                raise DeviceNotFound(f"there is no Tic on USB ({error}); check plug, power and permissions") from error
            line = SimpleNamespace(close=partial(usb.util.dispose_resources, tic.usb))  # type: ignore[attr-defined]
            return cls(tic, line, "the Tic on USB", microsteps, unit)
        wire = open_wire(port, "the Tic", baud)
        return cls(ticlib.TicSerial(wire.port), wire, wire.name, microsteps, unit)

    def _call(self, name: str, *arguments: int, of: Any = None) -> Any:
        try:
            return getattr(self._tic if of is None else of, name)(*arguments)
        except Exception as error:
            raise DeviceLost(f"{self._name} failed in {name} ({error}); check its plug and its power") from error

    def _checked(self) -> None:
        """Raise `DeviceRefused` if it does not drive its motor."""
        status = int.from_bytes(bytes(self._call("get_error_status")), "little")
        if found := [text for bit, text in enumerate(ERRORS) if status >> bit & 1]:
            raise DeviceRefused(f"{self._name} does not drive its motor: {', '.join(found)}", f"{status:#x}")

    def _units(self, speed: float) -> int:
        found = round(speed * self.microsteps * SPEED)
        if abs(found) > self._most:
            most = self._most / SPEED / self.microsteps
            raise BadInput(
                f"a speed of {abs(speed):g} {self.unit}/s; the Tic allows {most:g}: go slower, or raise its max speed "
                "in Tic Control Center"
            )
        return found

    def position(self) -> float:
        """The steps made; the query also shows the Tic that its host is alive."""
        self._call("reset_command_timeout")
        return self._call("get_current_position") / self.microsteps

    def _move(self, position: float, speed: float) -> None:
        goal = round(position * self.microsteps)
        if abs(goal) > LARGEST:
            raise BadInput(f"a position of {position:g} {self.unit} is {goal} microsteps; the Tic counts to {LARGEST}")
        self._call("set_max_speed", self._units(speed))
        self._call("set_target_position", goal)

    def run(self, speed: float) -> None:
        self._call("set_max_speed", self._most)
        self._call("set_target_velocity", self._units(speed))

    def busy(self) -> bool:
        self._call("reset_command_timeout")
        self._checked()
        if self._call("get_current_velocity") != 0:
            return True
        goes = self._call("get_planning_mode") == BY_POSITION
        return goes and self._call("get_current_position") != self._call("get_target_position")

    def release(self) -> None:
        """Take the current off the motor, and release the line."""
        with suppress(DeviceLost):
            self._call("deenergize")
        super().release()
