"""Light that a line turns on and off: a laser's or LED driver's TTL input on a serial port's RTS or DTR."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceLost
from vamgpu.hosts.drivers.cleanup import ClosedOnce, closed_on_error
from vamgpu.hosts.drivers.wire import open_wire

LINES = ("rts", "dtr")


class TtlLamp(ClosedOnce):
    """A laser's TTL input on a serial port's RTS or DTR, off while low; invert the line if low is on."""

    called = "the lamp"

    def __init__(self, port: Any, name: str = "the lamp", line: str = "rts") -> None:
        if line not in LINES:
            port.close()
            raise BadInput(f"a serial port has no output {line!r}; give one of {', '.join(LINES)}")
        self.name = name
        self._port, self._line = port, line
        with closed_on_error(port):
            self._set(False)

    @classmethod
    def open(cls, url: str, line: str = "rts") -> Self:
        """Open the port; both control lines are low before it opens, where the system allows."""
        wire = open_wire(url, "the lamp", lines_low=True)
        return cls(wire.port, wire.name, line)

    def _set(self, level: bool) -> None:
        try:
            setattr(self._port, self._line, level)
        except OSError as error:
            raise DeviceLost(f"{self.name} is lost ({error}); check its plug: its light may be on") from error

    def on(self, power: float = 1.0) -> None:
        """Turn the light on; its driver sets the power."""
        self._set(True)

    def off(self) -> None:
        self._set(False)

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self.off, self._port.close
