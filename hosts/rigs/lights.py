"""Parts that make light, by who switches it."""

from __future__ import annotations

from typing import ClassVar, Literal

from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.rigs.roles import LightPart
from vamgpu.hosts.safety.light import Lamp


class ControllerLight(LightPart):
    """A light behind the controller's gate: channel 0 of the first display, 1 of the second."""

    gate: ClassVar[Literal["controller", "line", "display"]] = "controller"


class LaserLight(LightPart):
    """A laser or LED whose driver has a TTL input that enables it; AND it with the projector's synch output, if any.

    port: serial port whose control line enables it.  line: which of its lines.
    """

    gate: ClassVar[Literal["controller", "line", "display"]] = "line"
    port: str
    line: Literal["rts", "dtr"] = "rts"

    def open(self) -> Lamp:
        return TtlLamp.open(self.port, self.line)


class DisplayLight(LightPart):
    """The projector's own light, which its frames switch: dark is black frames, or mirrors at rest."""

    gate: ClassVar[Literal["controller", "line", "display"]] = "display"
