"""Lights, by who switches them, and tunable lenses."""

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


class OptotuneLens(LensPart):
    """A lens by Optotune on a Lens Driver 4 or 4i.  port: serial port.  firmware: type letter it must have."""

    port: str
    firmware: str | None = None

    def open(self) -> LensDriver:
        """Open the lens, checked against the rig's file and the powers that it must reach."""
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
    """The lens of a rehearsal."""

    emulated: ClassVar[bool] = True
