"""Light that a line turns on and off: a laser's or LED driver's TTL input on a serial port's RTS or DTR."""

from __future__ import annotations

import logging
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceLost
from vamgpu.hosts.drivers.closing import closed_on_error
from vamgpu.hosts.drivers.wire import open_wire
from vamgpu.hosts.run_all import Closing

log: logging.Logger = logging.getLogger(__name__)
LINES = ("rts", "dtr")


class TtlLamp(Closing):
    """A laser's TTL input on a serial port's RTS or DTR, dark while low; invert it where low is light."""

    name: str

    def __init__(self, port: Any, name: str = "the lamp", line: str = "rts") -> None:
        if line not in LINES:
            port.close()
            raise BadInput(f"a serial port has no output {line!r}; give one of {', '.join(LINES)}")
        self._port, self.name, self._line, self._open = port, name, line, True
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
            raise DeviceLost(f"{self.name} is gone ({error}); check its plug: its light may be on") from error

    def on(self, power: float = 1.0) -> None:
        """Light on; its power is what its driver was set to."""
        self._set(True)

    def off(self) -> None:
        """Light off."""
        self._set(False)

    def close(self) -> None:
        """Light off, and let go of the port; more than once does no harm."""
        if not self._open:
            return
        self._open = False
        try:
            self.off()
        except DeviceLost as error:
            log.warning("closing the lamp: %s", error)
        self._port.close()
