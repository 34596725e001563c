"""Parts that make light, by who switches it."""

from __future__ import annotations

from typing import ClassVar, Literal

from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.rigs.roles import LightPart
from vamgpu.hosts.safety.light import Lamp


class ControllerLight(LightPart):
    """A light behind the controller's gate.

    power: share of full drive.  irradiance: of a full-on pixel at full drive. The light of the first display is the
    controller's channel 0, that of the second 1.
    """

    gate: ClassVar[Literal["controller", "line", "display"]] = "controller"


class LaserLight(LightPart):
    """A laser or LED whose driver has a TTL input that enables it.

    power: share of full drive that it was set to.  port: serial port whose control line enables it.  line: which of
    its lines.  irradiance: of a full-on pixel. Where the driver's TTL input also wants the projector's synch
    output, wire both by a logic AND.
    """

    gate: ClassVar[Literal["controller", "line", "display"]] = "line"
    port: str
    line: Literal["rts", "dtr"] = "rts"

    def open(self) -> Lamp:
        """See `LightPart`."""
        return TtlLamp.open(self.port, self.line)


class DisplayLight(LightPart):
    """The projector's own light, which its frames switch: dark is black frames, or mirrors at rest.

    power: share of full drive that it was set to.  irradiance: of a full-on pixel.
    """

    gate: ClassVar[Literal["controller", "line", "display"]] = "display"
