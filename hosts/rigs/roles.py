"""Roles of a rig: the base of every part, which says what it can do and opens its machine.

A part is a `Section` that `vamgpu.schema.registry` names by its role, such as ``rig_motion.zaber``; another brand is
one file with one class, registered by one line or by an entry point of its package.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.safety.light import Lamp
from vamgpu.optics.lens import TunableLens
from vamgpu.schema.quantities import Count, ExposureTime, Irradiance, Length, Rate, Time
from vamgpu.schema.section import Listed, Section

Share = Annotated[float, Field(gt=0, le=1)]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Ppm = Annotated[float, Field(ge=0, le=10_000)]
FINEST = 1e6  # most microsteps of a millimeter or degree; more are a slip of the pen
Microsteps = Annotated[float, Field(gt=0, le=FINEST)]
CRYSTAL = 50.0
"""Error of a machine's clock that is assumed [ppm]: what makers of quartz oscillators for computers
and microcontrollers specify over temperature and age; measure the rate of a machine, and tell it, to do better."""
MIRRORS = (1080, 1920)


class Part(Section):
    """A machine, or what stands for one. emulated: whether it is one of a rehearsal."""

    emulated: ClassVar[bool] = False


class MotionPart(Part):
    """A motion that turns the vial, or moves the web or platform.

    microsteps: of a millimeter or degree.  tolerance: of the clock that its speed follows [ppm].  reports: whether it
    says itself where it is, be that steps that it counts.  triggers: whether it has an output that fires at every so
    many degrees or mm.  runs: whether it moves at a speed for as long as it is let; else from place to place alone.
    """

    reports: ClassVar[bool] = True
    runs: ClassVar[bool] = True
    triggers: ClassVar[bool] = False
    microsteps: Microsteps = 3200.0
    tolerance: Ppm = CRYSTAL

    @property
    def measured(self) -> bool:
        """Whether where it is is measured; steps that are counted may be lost."""
        return False

    def open(self, unit: str) -> Stage:
        """Open the stage, for positions in mm or deg. Raises what its driver does."""
        raise NotImplementedError


class StagePart(MotionPart):
    """A stage that says where it is.  encoder: whether an encoder on its axis tells it; else it counts its steps."""

    encoder: bool = False

    @property
    def measured(self) -> bool:
        return self.encoder


class DisplayPart(Part):
    """A display of frames.

    size: rows, columns; None for the usual ones.  triggered: whether it shows one frame at each trigger; else it
    takes them from a video cable.  lamps: whether it has LEDs that the host switches, by a ``lamp`` of what it opens.
    """

    triggered: ClassVar[bool] = True
    lamps: ClassVar[bool] = False
    usual: ClassVar[tuple[int, int]] = MIRRORS
    size: Annotated[tuple[Count, Count] | None, Listed] = None

    @property
    def array(self) -> tuple[int, int]:
        """Rows and columns of the mirrors."""
        return self.size or self.usual

    def open(self) -> Any:
        """Open the projector: a `Dmd`, or an `HdmiProjector`. Raises what its driver does."""
        raise NotImplementedError


class MirrorPart(DisplayPart):
    """Mirrors that show a frame at each trigger.  frame_time: the shortest that a frame of 8 bits is shown."""

    frame_time: ExposureTime = 1.0 / 266.0


Color = Literal["red", "green", "blue"]
ORDERS: dict[int, tuple[Color, ...]] = {8: ("green", "red"), 7: ("green", "red", "blue")}
"""Bits → channels of a video frame in the order that its frames are shown."""
SCREEN = (1140, 912)


class CablePart(DisplayPart):
    """A projector on a video cable.

    refresh: of the cable.  bits: of a frame, 7 or 8.  screen: number of the output.  order: channels of a video
    frame, as their frames are shown.  slots: 1 on a projector that shows the colors of a video frame at once.
     latency: video frames from cable to mirrors.  tolerance: of the clock that the refresh follows [ppm].
    """

    triggered: ClassVar[bool] = False
    usual: ClassVar[tuple[int, int]] = SCREEN
    screen: Annotated[int, Field(ge=0)] = 0
    refresh: Rate = 60.0
    bits: Literal[7, 8] = 8
    order: Annotated[tuple[Color, ...] | None, Listed] = None
    slots: Literal[1] | None = None
    latency: Annotated[int, Field(ge=0, le=8)] = 1
    tolerance: Ppm = CRYSTAL

    def model_post_init(self, _: Any) -> None:
        """Raise `ValueError` for channels that are not those of the bits."""
        if self.order is not None and self.slots == 1:
            raise ValueError("slots = 1 shows all colors at once; remove order")
        if self.order is not None and sorted(self.order) != sorted(ORDERS[self.bits]):
            names = ", ".join(ORDERS[self.bits])
            raise ValueError(f"{self.bits} bits go to {names}, each once; expected order to say in which order")


class LightPart(Part):
    """The light.

    power: share of full drive.  irradiance: of a full-on pixel at full drive.  gate: who switches it: the
    controller, the host by a line of its own, or the projector by what it shows.
    """

    gate: ClassVar[Literal["controller", "line", "display"]]
    power: Share = 1.0
    irradiance: Irradiance | None = None

    def open(self) -> Lamp | None:
        """Open the lamp's switch; None where the projector or the controller is it. Raises what its driver does."""
        return None


class LensPart(Part):
    """The tunable lens.

    settle: from plane to plane.  latency: that its driver thinks.  lowest, highest: powers it may be set to [dpt].
     controlled_by: who controls it, on whose line: the controller in time with its rows, or the host before a print,
    which leaves it at one focus.  baud: of the controller's line to it.  axis: power that focuses on the roller's axis
    [dpt].  slope: way of the focus per power [mm/dpt], below 0; as a calibration finds both. Without a slope it is
    that of the relays, ``focal`` lengths, in the web's bath.  focal: of the relays.
    """

    controlled_by: Literal["controller", "host"] = "controller"
    settle: Time = 0.005
    latency: Time = 0.0
    baud: Baud = 38400
    lowest: float = -1.5
    highest: float = 3.5
    axis: float = 0.0
    slope: Annotated[float, Field(lt=0)] | None = None
    focal: Annotated[tuple[Length, Length, Length, Length], Listed] = TunableLens.focal

    def model_post_init(self, _: Any) -> None:
        """Raise `ValueError` for powers that do not rise."""
        if not self.lowest < self.highest:
            raise ValueError(f"powers go from {self.lowest:g} to {self.highest:g} dpt; expected lowest below highest")

    def open(self) -> LensDriver:
        """Open the lens in focal power mode. Raises what its driver does."""
        raise NotImplementedError


class FeedbackPart(Part):
    """A sensor of the motion, the light or the resin. sees: which of them."""

    sees: ClassVar[Literal["motion", "resin", "light"]]
