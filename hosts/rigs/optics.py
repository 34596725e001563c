"""Lights, by the part that switches them, and tunable lenses."""

from __future__ import annotations

from typing import ClassVar, Literal

from vamgpu.errors import DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.rigs.roles import LensPart, LightPart
from vamgpu.hosts.safety.light import Lamp


class ControllerLight(LightPart):
    """A light behind the controller's gate: channel 0 of the first display, 1 of the second."""

    gate: ClassVar[Literal["controller", "line", "display"]] = "controller"


class LaserLight(LightPart):
    """A laser or LED with a TTL enable input; AND the line with the projector's sync output, if there is one.

    port: serial port whose control line enables it.  line: name of the control line.
    """

    gate: ClassVar[Literal["controller", "line", "display"]] = "line"
    port: str
    line: Literal["rts", "dtr"] = "rts"

    def open(self) -> Lamp:
        return TtlLamp.open(self.port, self.line)


class DisplayLight(LightPart):
    """The projector's own light, which its frames switch: black frames or resting mirrors are dark."""

    gate: ClassVar[Literal["controller", "line", "display"]] = "display"


class OptotuneLens(LensPart):
    """A lens by Optotune on a Lens Driver 4 or 4i.  port: serial port.  firmware: required type letter."""

    port: str
    firmware: str | None = None

    def open(self) -> LensDriver:
        """Open the lens, and check it against the rig's file and the required powers."""
        lens = LensDriver.open(self.port, self.firmware)
        with closed_on_error(lens):
            found = lens.focal_power_mode()
            if not found.least <= self.lowest < self.highest <= found.greatest:
                raise WrongDevice(
                    f"the lens guarantees {found.least:.4g} to {found.greatest:.4g} dpt; expected "
                    f"{self.lowest:g} to {self.highest:g} dpt; correct lowest and highest in [lens], or warm it up"
                )
            if said := lens.status():
                raise DeviceRefused(f"the lens is not ready: {', '.join(said)}", "status")
        return lens


class EmulatedLensPart(LensPart):
    """The emulated lens."""

    emulated: ClassVar[bool] = True
