"""Roles of a rig: the base of every part, which states its abilities and opens its machine.

A part is a `Section` that `vamgpu.schema.registry` names by its role; another brand is one class and one line.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from vamgpu.hosts.drivers.lens import Lens
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.safety.light import Lamp
from vamgpu.optics.lens import TunableLens
from vamgpu.schema.quantities import Count, FrameTime, Irradiance, Length, Rate, Time
from vamgpu.schema.section import Listed, Misplaced, Section

Share = Annotated[float, Field(gt=0, le=1)]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Ppm = Annotated[float, Field(ge=0, le=10_000)]
FINEST = 1e6  # most microsteps per millimeter or degree; more are a typing error
Microsteps = Annotated[float, Field(gt=0, le=FINEST)]
CRYSTAL = 50.0
"""Assumed error of a machine's clock [ppm]: the specification of quartz oscillators for computers and microcontrollers
over temperature and age; for a smaller one, measure the rate of a machine and set its tolerance."""
LensDiopters = Annotated[float, Field(ge=-50, le=50)]  # twice what liquid lenses reach
MIRRORS = (1080, 1920)


class Part(Section):
    """A machine, or its emulator. emulated: whether it is an emulator."""

    emulated: ClassVar[bool] = False


class MotionPart(Part):
    """A motion that turns the vial, or moves the web or platform.

    microsteps: microsteps per millimeter or degree.  tolerance: error of the clock that sets its speed [ppm].  reports:
    whether it reports its position, even if it only counts steps.  triggers: whether it has an output that fires at
    equal steps of degrees or mm.  scaled: whether its machine reports its microsteps per turn.
    """

    reports: ClassVar[bool] = True
    scaled: ClassVar[bool] = False
    triggers: ClassVar[bool] = False
    microsteps: Microsteps
    tolerance: Ppm = CRYSTAL

    @property
    def measured(self) -> bool:
        """Whether its position is measured; counted steps may be lost."""
        return False

    def open(self, unit: str) -> Stage:
        """Open the stage, for positions in mm or deg. Raises as its driver does."""
        raise NotImplementedError


class StagePart(MotionPart):
    """A stage that reports its position.  encoder: whether an encoder measures it; otherwise steps are counted."""

    encoder: bool = False

    @property
    def measured(self) -> bool:
        return self.encoder


class DisplayPart(Part):
    """A display of frames.

    size: rows, columns; None for the usual ones.  triggered: whether it shows one frame at each trigger; else frames
    come by a video cable.  lamps: whether it has LEDs that the host switches, with a ``lamp`` of its driver.
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
        """Open the projector: a `Dmd`, or an `HdmiProjector`. Raises as its driver does."""
        raise NotImplementedError


class MirrorPart(DisplayPart):
    """Mirrors that show a frame at each trigger.

    frame_time: shortest time of a frame of 8 bits.  duty: greatest share of its time slot for which a frame is lit.
    """

    frame_time: FrameTime = 1.0 / 266.0
    duty: Share = 1.0


Color = Literal["red", "green", "blue"]
ORDERS: dict[int, tuple[Color, ...]] = {8: ("green", "red"), 7: ("green", "red", "blue")}
"""Bits → color channels of a video frame in the order in which they are shown."""
SCREEN = (1140, 912)


class CablePart(DisplayPart):
    """A projector on a video cable.

    refresh: refresh rate of the cable.  bits: bits per pixel of a frame, 7 or 8.  screen: number of the output.  order:
    color channels of a video frame in the order in which they are shown.  slots: 1 if the projector shows all colors at
    once; with one color in order, that color alone carries the frame.  latency: delay from cable to mirrors [video
    frames].  tolerance: error of the clock that sets the refresh [ppm].
    """

    triggered: ClassVar[bool] = False
    usual: ClassVar[tuple[int, int]] = SCREEN
    colors: ClassVar[dict[int, tuple[Color, ...]]] = ORDERS  # bits → usual order
    screen: Annotated[int, Field(ge=0)] = 0
    refresh: Rate = 60.0
    bits: Literal[7, 8] = 8
    order: Annotated[tuple[Color, ...] | None, Listed] = None
    slots: Literal[1] | None = None
    latency: Annotated[int, Field(ge=0, le=8)] = 1
    tolerance: Ppm = CRYSTAL

    def model_post_init(self, _: Any) -> None:
        """Raise `ValueError` for channels that do not match the bits."""
        if self.slots == 1:
            if self.order is not None and len(self.order) != 1:
                raise ValueError(
                    "slots = 1 shows all colors at once; expected order with the one color that has light, or no order"
                )
        elif self.order is not None and sorted(self.order) != sorted(self.colors[self.bits]):
            names = ", ".join(self.colors[self.bits])
            raise ValueError(f"frames of {self.bits} bits use {names}; expected order to list each of them once")


class LightPart(Part):
    """The light.

    power: share of full drive.  irradiance: irradiance of a full-on pixel at full drive.  gate: what switches it: the
    controller, a separate line of the host, or the projector with its frames.
    """

    gate: ClassVar[Literal["controller", "line", "display"]]
    power: Share = 1.0
    irradiance: Irradiance | None = None

    def open(self) -> Lamp | None:
        """Open the lamp's switch; None if the projector or the controller switches it. Raises as its driver does."""
        return None


class LensPart(Part):
    """The tunable lens.

    settle: settling time from plane to plane.  latency: response delay of its driver.  lowest: lowest power allowed
    [dpt].  highest: highest power allowed [dpt].  controlled_by: what controls it: the controller, at every row, or
    the host, which sets one focus before a print.  baud: speed of the controller's line to it.  axis: power
    that focuses on the roller's axis [dpt], from a calibration.  slope: focus shift per power [mm/dpt], negative, from
    a calibration; by default that of the relays, ``focal``, in the web's bath.  focal: focal lengths of the relays.
    """

    controlled_by: Literal["controller", "host"] = "controller"
    settle: Time = 0.005
    latency: Time = 0.0
    baud: Baud = 38400
    lowest: LensDiopters = -1.5
    highest: LensDiopters = 3.5
    axis: LensDiopters = 0.0
    slope: Annotated[float, Field(lt=0)] | None = None
    focal: Annotated[tuple[Length, Length, Length, Length], Listed] = TunableLens.focal

    def model_post_init(self, _: Any) -> None:
        """Raise `ValueError` if lowest is not below highest, or axis is not between them."""
        powers = f"powers go from {self.lowest:g} to {self.highest:g} dpt"
        if not self.lowest < self.highest:
            raise ValueError(f"{powers}; expected lowest below highest")
        if not self.lowest <= self.axis <= self.highest:
            raise Misplaced(
                f"got {self.axis:g}; the lens's {powers}, expected one of them: correct axis, or lowest and highest",
                "axis",
            )

    def open(self) -> Lens:
        """Open the lens in focal power mode. Raises as its driver does."""
        raise NotImplementedError


class FeedbackPart(Part):
    """A sensor of the motion, the light or the resin. sees: what it measures."""

    sees: ClassVar[Literal["motion", "resin", "light"]]
