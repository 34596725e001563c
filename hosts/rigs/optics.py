"""Lights, by the part that switches them, and tunable lenses."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from vamgpu.errors import DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.drivers.diode_laser import DiodeLaser
from vamgpu.hosts.drivers.icc import IccLens
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.lens import Lens, LensDriver
from vamgpu.hosts.rigs.roles import Baud, LensPart, LightPart
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


class DiodeLaserLight(LightPart):
    """A diode laser that takes commands.  port: serial port.  kind: its kind.  watts: full power.  baud: baud rate."""

    gate: ClassVar[Literal["controller", "line", "display"]] = "line"
    port: str
    kind: Literal["cobolt", "obis"]
    watts: Annotated[float, Field(gt=0, le=100)]
    baud: Baud = 115200

    def open(self) -> Lamp:
        return DiodeLaser.open(self.port, self.kind, self.watts * self.power, self.baud)


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
            _ready(self, lens, found.least, found.greatest)
        return lens


class IccLensPart(LensPart):
    """A lens by Optotune on an ICC-1C, ICC-4C or ECC-1C.  port: serial port.  channel: its channel, from 0."""

    controlled_by: Literal["host"] = "host"  # type: ignore[assignment]  # the controller's line speaks to a driver 4
    port: str
    channel: Annotated[int, Field(ge=0, le=3)] = 0

    def open(self) -> Lens:
        """Open the lens, and check it against the rig's file."""
        lens = IccLens.open(self.port, self.channel)
        with closed_on_error(lens):
            _ready(self, lens, lens.least, lens.greatest)
        return lens


def _ready(part: LensPart, lens: Lens, least: float, greatest: float) -> None:
    """Raise `WrongDevice` for a lens without the powers of the rig's file, `DeviceRefused` for one with a fault."""
    if not least <= part.lowest < part.highest <= greatest:
        raise WrongDevice(
            f"the lens guarantees {least:.4g} to {greatest:.4g} dpt; expected "
            f"{part.lowest:g} to {part.highest:g} dpt; correct lowest and highest in [lens], or warm it up"
        )
    if said := lens.status():
        raise DeviceRefused(f"the lens is not ready: {', '.join(said)}", "status")


class EmulatedLensPart(LensPart):
    """The emulated lens."""

    emulated: ClassVar[bool] = True
