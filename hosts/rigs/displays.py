"""Parts that show frames: triggered mirrors, and projectors on a video cable."""

from __future__ import annotations

from math import floor
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from vamgpu.hosts.drivers import projector
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.drivers.dlpc350_protocol import DLPC350, Dlpc, times
from vamgpu.hosts.drivers.dlpc900_protocol import DLPC900
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lightcrafter import LightCrafter, LightCrafterScreen
from vamgpu.hosts.rigs.roles import MIRRORS, CablePart, Color, MirrorPart, Share
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.schema.section import Listed


class AlpDisplay(MirrorPart):
    """Mirrors by Vialux.

    library: path of the maker's library.  serial: serial number of the device; 0 for any.  edge: edge of the trigger.
    synch: numbers of the gated synch outputs that are active while a frame is lit, to gate a laser.  active: their
    level.
    """

    library: str
    serial: int = 0
    edge: Literal["rising", "falling"] = "rising"
    synch: Annotated[tuple[Annotated[int, Field(ge=1, le=3)], ...], Listed] = ()
    active: Literal["high", "low"] = "high"

    def open(self) -> Any:
        mirrors = Dmd.open(self.library, self.serial, self.array, self.edge == "rising")
        with closed_on_error(mirrors):
            if self.synch:
                mirrors.pulse(self.synch, self.active == "high")
        return mirrors


class VideoDisplay(CablePart):
    """A projector on a video cable (HDMI), which shows several frames in each video frame."""

    @property
    def channels(self) -> tuple[int, ...]:
        """Color channels of a video frame (0 red, 1 green, 2 blue), in the order in which they are shown."""
        return tuple({"red": 0, "green": 1, "blue": 2}[name] for name in self.order or self.colors[self.bits])

    @property
    def dark(self) -> float:
        """Time without light in each slot [s]."""
        return 0.0

    @property
    def shortest(self) -> tuple[Any, ...]:
        """Shortest times of frames of 1 to 8 bits [s]."""
        return HdmiTiming.exposures

    @property
    def layout(self) -> projector.SlotLayout:
        """Channels of a video frame for the frames."""
        gray = self.slots == 1 and self.order is None
        return projector.ONE_GRAY if gray else projector.SlotLayout(self.channels, self.bits)

    def open(self) -> Any:
        window = projector.PygletWindow(self.screen, self.array, self.refresh)
        return projector.HdmiProjector(window, self.layout, self.latency)


class LightCrafterDisplay(VideoDisplay):
    """A LightCrafter 4500 (DLPC350) in video pattern mode: frames by cable, settings and its own LEDs by USB.

    control: usb, or usb: and its serial number.  leds: LEDs that light the frames.  current: LED current,
    a share of the greatest; if left out, the projector keeps its own.  slots: not used; bits sets the number of frames.
    """

    lamps: ClassVar[bool] = True
    dlpc: ClassVar[Dlpc] = DLPC350
    control: str = "usb"
    leds: Annotated[tuple[Color, ...], Listed] = ("blue",)
    current: Share | None = None

    @model_validator(mode="after")
    def _shown(self) -> LightCrafterDisplay:
        if self.control.partition(":")[0] != "usb":
            raise ValueError(f'control is "{self.control}"; expected "usb", or "usb:" and the serial number')
        if not self.leds or self.slots is not None:
            raise ValueError("expected leds that light the frames, and no slots: bits sets the number of frames")
        exposure, frame = self.exposure, floor(1e6 / self.refresh)
        times(self.bits, len(self.channels), exposure, exposure, frame, self.dlpc.shortest_us)
        return self

    @property
    def exposure(self) -> int:
        """Time of each frame [us]: its share of a video frame without the controller's rest."""
        return floor((1e6 / self.refresh - self.dlpc.rest_us) / len(self.channels))

    @property
    def dark(self) -> float:
        return max(0.0, self.dlpc.rest_us * 1e-6 / len(self.channels))

    @property
    def shortest(self) -> tuple[Any, ...]:
        return tuple(1e-6 * self.dlpc.shortest_us[bits] for bits in sorted(self.dlpc.shortest_us))

    def open(self) -> Any:
        """See `DisplayPart`; its LEDs are off, and the ``lamp`` of the returned projector switches them."""
        box = LightCrafter.open(self.control.partition(":")[2] or None, dlpc=self.dlpc)
        with closed_on_error(box):
            if self.current is not None:
                box.drive(**dict.fromkeys(self.leds, self.current))
            box.show_video(self.channels, self.bits, self.exposure, self.exposure, self.leds, self.refresh)
            shown = super().open()
        return LightCrafterScreen(shown.window, shown.layout, shown.latency, box)


class Dlpc900Display(LightCrafterDisplay):
    """A LightCrafter 6500 or 9000 (DLPC900) in video pattern mode, which shows three frames in each video frame."""

    usual: ClassVar[tuple[int, int]] = MIRRORS
    colors: ClassVar[dict[int, tuple[Color, ...]]] = {8: ("green", "red", "blue"), 7: ("green", "red", "blue")}
    dlpc: ClassVar[Dlpc] = DLPC900


class EmulatedDisplay(MirrorPart):
    """Emulated mirrors.  size: rows, columns; by default those of the job."""

    emulated: ClassVar[bool] = True
