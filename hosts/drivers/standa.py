"""Standa stages on 8SMC5 controllers, through the maker's ``libximc`` package."""

from __future__ import annotations

import logging
import sys
import types
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceError, DeviceNotFound

log = logging.getLogger(__name__)


def _axis(uri: str) -> Any:
    """The maker's axis at an address such as ``xi-com:///dev/ttyACM0``."""
    stands_in = sys.platform != "win32" and "winreg" not in sys.modules
    if stands_in:  # some releases of the package import this Windows module everywhere, and use it on Windows alone
        sys.modules["winreg"] = types.ModuleType("winreg")
    try:
        from libximc import highlevel  # type: ignore[import-not-found]
    except ImportError as error:
        raise DeviceNotFound('Standa stages need libximc: pip install "vamgpu[standa]"') from error
    finally:
        if stands_in:  # the standard library asks whether there is one
            del sys.modules["winreg"]
    return highlevel.Axis(uri)


class StandaStage:
    """One axis; ``steps`` is how many full steps make a ``unit``, ``fraction`` the microsteps of a step.

    ``axis`` has the methods of libximc's ``highlevel.Axis``.
    """

    def __init__(self, axis: Any, steps: float, unit: str = "deg", fraction: int = 256) -> None:
        if not steps > 0 or unit not in ("mm", "deg"):
            raise BadInput(f"{steps} steps a {unit!r} are no stage; give what screw or gear make, in mm or deg")
        self._axis, self.steps, self.unit, self._fraction = axis, steps, unit, fraction
        self._call("open_device")
        self._open = True

    @classmethod
    def open(cls, uri: str, steps: float, unit: str = "deg", fraction: int = 256) -> Self:
        """Open the axis at an address."""
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
        """Where the axis says it is."""
        found = self._call("get_position")
        return (found.Position + found.uPosition / self._fraction) / self.steps

    def home(self) -> None:
        """Find the axis's zero; returns when it has."""
        self._call("command_homezero")

    def move(self, position: float, speed: float) -> None:
        """Begin to move to a position."""
        if not speed > 0:
            raise BadInput(f"a move needs a speed above 0, not {speed}")
        self._speed(speed)
        self._call("command_move", *self._split(position))

    def run(self, speed: float) -> None:
        """Begin to move at a speed, for good."""
        if speed == 0:
            self.stop()
            return
        self._speed(speed)
        self._call("command_right" if speed > 0 else "command_left")

    def wait(self) -> None:
        """Return when the axis rests."""
        self._call("command_wait_for_stop", 10)

    def stop(self) -> None:
        """Begin to come to rest."""
        self._call("command_sstp")

    def close(self) -> None:
        """Stop, and let go of the axis; more than once does no harm."""
        if not self._open:
            return
        self._open = False
        for name in ("command_sstp", "close_device"):
            try:
                self._call(name)
            except DeviceError as error:
                log.warning("closing a stage: %s", error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
