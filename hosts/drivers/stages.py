"""Stages of one axis: Zaber's and Standa's (8SMC5), through their makers' packages ``zaber-motion`` and ``libximc``."""

from __future__ import annotations

import sys
import time
import types
from collections.abc import Callable
from functools import partial
from math import copysign
from typing import Any, Protocol, Self, runtime_checkable

from vamgpu.errors import (
    BadInput,
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceRefused,
    ProtocolError,
    WrongDevice,
)  # fmt: skip
from vamgpu.hosts.drivers import zaber_protocol as zaber
from vamgpu.hosts.drivers.cleanup import Closable, ClosedOnce, closed_on_error, extra
from vamgpu.hosts.drivers.wire import Wire


@runtime_checkable
class Stage(Protocol):
    """One axis; positions in its ``unit``, ``mm`` or ``deg``, and speeds in ``unit`` per second."""

    unit: str

    def position(self) -> float: ...  # the reported position
    def move(self, position: float, speed: float) -> None: ...  # start moving to a position
    def run(self, speed: float) -> None: ...  # start moving at a constant speed; 0 stops the axis
    def wait(self) -> None: ...  # return when the axis is at rest
    def stop(self) -> None: ...  # start to stop the axis
    def close(self) -> None: ...  # stop, and release the axis


SAME = 1e-6  # relative tolerance of a file's microsteps against those of the device
POLL = 0.02  # time between two queries whether an axis moves [s]


class PolledStage(ClosedOnce):
    """An axis with ``microsteps`` per unit, whose motion is polled; when closed, it stops and releases its line."""

    called = "a stage"

    def __init__(
        self, line: Closable, name: str, microsteps: float, unit: str = "deg", patience_s: float = 60.0,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:  # fmt: skip
        self.microsteps = microsteps
        self.unit = unit
        self._line, self._name = line, name
        self._patience, self._pause = patience_s, pause
        with closed_on_error(line):
            geared(microsteps, unit)
            self._start()

    def _start(self) -> None:
        """Check that the machine is there, and make it ready."""

    def position(self) -> float:
        """Reported position of the axis."""
        raise NotImplementedError

    def run(self, speed: float) -> None:
        """Start moving at a constant speed; 0 stops the axis."""
        raise NotImplementedError

    def busy(self) -> bool:
        raise NotImplementedError

    def move(self, position: float, speed: float) -> None:
        """Start moving to a position, at most at a speed; motors without such a command arrive before this returns."""
        above_zero(speed)
        self._move(position, speed)

    def _move(self, position: float, speed: float) -> None:
        """Run until the axis has passed a position, then stop it."""
        way, waited = position - self.position(), 0.0
        try:
            if way:
                self.run(copysign(speed, way))
            while (position - self.position()) * way > 0.0:
                if waited > abs(way) / speed + self._patience:
                    raise DeviceError(f"{self._name} does not reach {position:g} {self.unit}; check motor and load")
                self._pause(POLL)
                waited += POLL
        finally:
            self.run(0.0)

    def wait(self) -> None:
        """Return when the axis is at rest; DeviceError if that exceeds the stage's patience."""
        waited = 0.0
        while self.busy():
            if waited > self._patience:
                raise DeviceError(f"{self._name} still moves after {self._patience} s; check its commands")
            self._pause(POLL)
            waited += POLL

    def stop(self) -> None:
        """Begin to stop the axis, without waiting."""
        self.run(0.0)

    def release(self) -> None:
        self._line.close()

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self.stop, self.release


def geared(microsteps: float, unit: str) -> None:
    """Raise `BadInput` for impossible microsteps per unit."""
    if not microsteps > 0 or unit not in ("mm", "deg"):
        raise BadInput(f"{microsteps} microsteps per {unit!r} are impossible; give those of its gear, in mm or deg")


def above_zero(speed: float) -> None:
    """Raise `BadInput` for a move whose speed is not above 0."""
    if not speed > 0:
        raise BadInput(f"a move needs a speed above 0, not {speed}")


class ZaberLines:
    """Zaber's commands as lines on a wire, with the wire's clock: the link of emulated stages."""

    def __init__(self, wire: Wire) -> None:
        self.name: str = wire.name
        self._wire, self._number = wire, 0
        wire.drain()

    def exchange(self, device: int, axis: int, text: str) -> zaber.Message:
        """Send a command and return the reply; ``axis`` 0 means the device."""
        with self._wire.lock:
            self._number = (self._number + 1) % 96
            self._wire.send(zaber.command(device, axis, self._number, text))
            while line := self._wire.line():
                message = zaber.parse(line)
                if message.device == device and message.number == self._number:
                    return message
        raise DeviceLost(f"{self.name} does not answer {text!r}; check its power and its number")

    def close(self) -> None:
        self._wire.close()


class ZaberConnection:
    """Zaber's commands through the maker's package, at a serial port or at ``socket://host:port``."""

    def __init__(self, url: str, name: str, timeout_s: float = 0.5) -> None:
        with extra("zaber", "Zaber stages need zaber-motion"):
            import zaber_motion
            from zaber_motion.ascii import Connection
        self.name: str = f"{name} at {url}"
        self._library, self._timeout = zaber_motion, round(timeout_s * 1000)
        try:
            if url.startswith("socket://"):
                host, _, port = url.removeprefix("socket://").rpartition(":")
                self._connection = Connection.open_tcp(host, int(port))
            else:
                self._connection = Connection.open_serial_port(url)
        except ValueError as error:
            raise BadInput(f"{url!r} is not an address of {name}; give a serial port or socket://host:port") from error
        except zaber_motion.SerialPortBusyException as error:
            raise DeviceBusy(f"{self.name} is used by another program ({error.message}); close that program") from error
        except zaber_motion.MotionLibException as error:
            raise DeviceNotFound(
                f"{name} is not at {url} ({error.message}); check the address, the plug, the power and permissions"
            ) from error

    def exchange(self, device: int, axis: int, text: str) -> zaber.Message:
        try:
            found = self._connection.generic_command(text, device, axis, check_errors=False, timeout=self._timeout)
        except self._library.RequestTimeoutException as error:
            raise DeviceLost(f"{self.name} does not answer {text!r}; check its power and its number") from error
        except (self._library.ConnectionFailedException, self._library.ConnectionClosedException) as error:
            raise DeviceLost(f"{self.name} is lost ({error.message}); check its plug and power") from error
        except self._library.MotionLibException as error:
            raise ProtocolError(f"{self.name} answered {text!r} badly ({error.message}); check the port") from error
        accepted, busy = found.reply_flag == "OK", found.status == "BUSY"
        return zaber.Message(device, None, accepted, busy, found.warning_flag, found.data)

    def close(self) -> None:
        """Release the port; may be called more than once."""
        self._connection.close()


class ZaberStage(PolledStage):
    """One axis. output: triggers the mirrors.  gate: output that is high meanwhile, for a board that joins both."""

    def __init__(
        self, link: Wire | ZaberConnection, microsteps: float, unit: str = "deg", device: int = 1, axis: int = 1,
        encoder: bool = False, output: int = 1, gate: int | None = None, **options: Any,
    ) -> None:  # fmt: skip
        self._device, self._axis, self._output, self._gate = device, axis, output, gate
        self._place = "get encoder.pos" if encoder else "get pos"
        super().__init__(link, f"stage {device}", microsteps, unit, **options)

    @classmethod
    def open(
        cls, url: str, microsteps: float, unit: str = "deg", device: int = 1, axis: int = 1, timeout_s: float = 0.5,
        **options: Any,
    ) -> Self:  # fmt: skip
        """Open a stage at a serial port, or at ``socket://host:port``, through the maker's package."""
        return cls(ZaberConnection(url, f"stage {device}", timeout_s), microsteps, unit, device, axis, **options)

    def _start(self) -> None:
        """Check that its encoder and its microsteps per turn are those of the rig's file."""
        line: Any = self._line
        self._link: ZaberLines | ZaberConnection = ZaberLines(line) if isinstance(line, Wire) else line
        try:
            self.kind: int = self._whole("get deviceid")
        except (ProtocolError, DeviceLost) as error:
            raise WrongDevice(f"{self._link.name} does not answer as a Zaber device: {error}") from error
        try:
            self.position()
        except DeviceRefused as error:
            if "encoder" not in self._place:
                raise
            raise WrongDevice(
                f"{self._link.name} has no encoder ({error}); set encoder = false in its table"
            ) from error
        if (turn := self.turn()) and self.unit == "deg" and abs(turn / 360 / self.microsteps - 1) > SAME:
            raise WrongDevice(
                f"{self._link.name} has {turn} microsteps per turn, {turn / 360:.8g} per degree; expected "
                f"{self.microsteps:.8g}, the file's: every angle would be wrong; set microsteps = {turn / 360!r}"
            )

    def turn(self) -> int:
        """Microsteps per turn, from the device; 0 for a linear one."""
        try:
            return self._whole("get limit.cycle.dist")
        except DeviceRefused:
            return 0

    def travel(self) -> tuple[float, float]:
        """Least and greatest position, from the device."""
        low, high = (self._whole(f"get limit.{end}") / self.microsteps for end in ("min", "max"))
        return low, high

    def ask(self, text: str) -> str:
        """Send a command to the axis and return the data of its reply."""
        return zaber.accept(self._exchange(text), text)

    def _whole(self, text: str) -> int:
        """The whole number in the answer to a query."""
        data = self.ask(text)
        try:
            return int(data)
        except ValueError:
            raise ProtocolError(
                f"{self._link.name} answered {data!r} to {text!r}, expected a number; check the number of its axis"
            ) from None

    def _exchange(self, text: str, axis: int | None = None) -> zaber.Message:
        return self._link.exchange(self._device, self._axis if axis is None else axis, text)

    def position(self) -> float:
        return self._whole(self._place) / self.microsteps

    def _move(self, position: float, speed: float) -> None:
        self.ask(f"set maxspeed {self._speed(speed)}")
        self.ask(f"move abs {round(position * self.microsteps)}")

    def run(self, speed: float) -> None:
        self.ask("stop" if speed == 0 else f"move vel {self._speed(speed)}")

    def _speed(self, speed: float) -> int:
        return round(speed * self.microsteps * zaber.SPEED_UNITS)

    def busy(self) -> bool:
        message = self._exchange("")
        zaber.accept(message, "")
        return message.busy

    def trigger_every(self, distance: float) -> None:
        """Raise the output each time the axis has traveled a distance, first after half of it; 0 ends it."""
        half, output = round(distance * self.microsteps / 2), self._output
        if distance != 0 and half < 1:
            raise BadInput(
                f"a trigger every {distance} {self.unit} is finer than two microsteps; give a longer distance"
            )
        if abs(distance * self.microsteps / 2 - half) > 1e-6:
            raise BadInput(
                f"{distance} {self.unit} are {distance * self.microsteps:g} microsteps, which drifts; expected an even "
                "whole number"
            )
        texts = [f"trigger {output} disable", f"io set do {output} 0"]
        if self._gate is not None:
            texts.append(f"io set do {self._gate} {int(half > 0)}")
        if half:
            texts.append(f"trigger {output} when {self._axis} dist {half}")
            texts.append(f"trigger {output} action a io set do {output} t")
            texts.append(f"trigger {output} enable")
        for text in texts:
            zaber.accept(self._exchange(text, axis=0), text)


def _axis(uri: str) -> Any:
    """The maker's axis at an address such as ``xi-com:///dev/ttyACM0``."""
    stands_in = sys.platform != "win32" and "winreg" not in sys.modules
    if stands_in:  # some releases of the package import this Windows module everywhere, but use it only on Windows
        sys.modules["winreg"] = types.ModuleType("winreg")
    try:
        from libximc import highlevel  # type: ignore[import-not-found]
    except ImportError as error:
        raise DeviceNotFound('Standa stages need libximc: pip install "vamgpu[standa]"') from error
    finally:
        if stands_in:  # for checks by the standard library
            del sys.modules["winreg"]
    return highlevel.Axis(uri)


class StandaStage(ClosedOnce):
    """One axis of libximc's ``highlevel.Axis``, with ``steps`` full steps per unit, each of ``fraction`` microsteps."""

    called = "a stage"

    def __init__(self, axis: Any, steps: float, unit: str = "deg", fraction: int = 256) -> None:
        geared(steps, unit)
        self.steps = steps
        self.unit = unit
        self._axis, self._fraction = axis, fraction
        self._call("open_device")

    @classmethod
    def open(cls, uri: str, steps: float, unit: str = "deg", fraction: int = 256) -> Self:
        return cls(_axis(uri), steps, unit, fraction)

    def _call(self, name: str, *arguments: Any) -> Any:
        try:
            return getattr(self._axis, name)(*arguments)
        except Exception as error:
            kind = DeviceNotFound if name == "open_device" else DeviceError
            raise kind(f"the Standa stage failed in {name} ({error}); check address, plug and power") from error

    def _split(self, value: float) -> tuple[int, int]:
        """Whole steps, and microsteps of the same sign."""
        micro = round(value * self.steps * self._fraction)
        whole = abs(micro) // self._fraction * (1 if micro >= 0 else -1)
        return whole, micro - whole * self._fraction

    def _speed(self, speed: float) -> None:
        settings = self._call("get_move_settings")
        settings.Speed, settings.uSpeed = self._split(abs(speed))
        self._call("set_move_settings", settings)

    def position(self) -> float:
        found = self._call("get_position")
        return (found.Position + found.uPosition / self._fraction) / self.steps

    def move(self, position: float, speed: float) -> None:
        above_zero(speed)
        self._speed(speed)
        self._call("command_move", *self._split(position))

    def run(self, speed: float) -> None:
        if speed == 0:
            self.stop()
            return
        self._speed(speed)
        self._call("command_right" if speed > 0 else "command_left")

    def wait(self) -> None:
        self._call("command_wait_for_stop", 10)

    def stop(self) -> None:
        self._call("command_sstp")

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self.stop, partial(self._call, "close_device")
