"""Light that a line turns on and off: a laser's or LED driver's TTL input on a serial port's RTS or DTR."""

from __future__ import annotations

import logging
from typing import Any, Protocol, Self, runtime_checkable

from vamgpu.errors import BadInput, DeviceLost
from vamgpu.hosts.drivers.wire import open_wire
from vamgpu.hosts.run_all import Closing

log: logging.Logger = logging.getLogger(__name__)
LINES = ("rts", "dtr")


@runtime_checkable
class Lamp(Protocol):
    """Light that can be turned on and off any number of times; it knows no lease, so a host that hangs leaves it on."""

    def on(self, power: float = 1.0) -> None: ...  # light; again does no harm
    def off(self) -> None: ...  # dark, without waiting for anything; again does no harm
    def is_on(self) -> bool: ...  # what it was told last, or what it says
    def close(self) -> None: ...  # dark, and let go


class TtlLamp(Closing):
    """A laser's TTL input on a control line of a serial port; dark from the first moment on.

    ``port`` has pyserial's ``rts`` and ``dtr``. Where light comes on a low level, wire an inverter: an unplugged or
    unopened port leaves the line low, which must be dark.
    """

    name: str

    def __init__(self, port: Any, name: str = "the lamp", line: str = "rts") -> None:
        if line not in LINES:
            port.close()
            raise BadInput(f"a serial port has no output {line!r}; give one of {', '.join(LINES)}")
        self._port, self.name, self._line, self._open = port, name, line, True
        try:
            self._set(False)
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(cls, url: str, line: str = "rts") -> Self:
        """Open the port; both control lines are low before it opens, where the system allows.

        Args:
            url: The serial port.
            line: ``rts`` or ``dtr``.

        Returns:
            The lamp, dark.

        Raises:
            DeviceNotFound: There is no such port, or pyserial is missing.
            DeviceBusy: Another program uses the port.
        """
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

    def is_on(self) -> bool:
        """Whether it was turned on; the line carries no answer."""
        return bool(getattr(self._port, self._line))

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
