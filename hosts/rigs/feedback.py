"""Parts that see the motion, the resin or the light."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from vamgpu.hosts.drivers.camera import GenicamCamera
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.drivers.controller import Encoder, Index
from vamgpu.hosts.drivers.micromanager import MicroManagerCamera
from vamgpu.hosts.rigs.roles import FeedbackPart
from vamgpu.schema.quantities import Count, FrameTime, Length, Time
from vamgpu.schema.section import Listed

Sees = Literal["motion", "resin", "light"]
Tolerance = Annotated[float, Field(gt=0)]
Whole = Annotated[int, Field(ge=0)]
TURN = 360.0


class EncoderFeedback(FeedbackPart):
    """An encoder on the axis, at the controller's input.

    counts: quadrature edges per millimeter or degree, negative if it counts down.  tolerance: allowed difference
    between encoder and motor [mm] or [deg]; beyond it the light goes off.
    """

    sees: ClassVar[Sees] = "motion"
    counts: float
    tolerance: Tolerance = 0.1

    @model_validator(mode="after")
    def _distinguishable(self) -> EncoderFeedback:
        if abs(self.counts) * self.tolerance < 2:
            raise ValueError(
                f"counts = {self.counts:g} and tolerance = {self.tolerance:g} are less than the two counts that an "
                f"encoder distinguishes; expected a finer encoder or a wider tolerance"
            )
        return self

    def sensor(self) -> Encoder:
        return Encoder(self.counts, self.tolerance)


class IndexFeedback(FeedbackPart):
    """A mark that a sensor detects once per turn, at an input of the controller or of a computer.

    pin: input pin of the computer, for its stepper.  distance: distance from mark to mark [mm] or [deg]; by default a
    turn.  tolerance: allowed error of the motor at the mark [mm] or [deg]; beyond it the light goes off.
    """

    sees: ClassVar[Sees] = "motion"
    pin: Annotated[int, Field(ge=0)] | None = None
    distance: Annotated[float, Field(gt=0)] | None = None
    tolerance: Tolerance = 0.1

    def sensor(self) -> Index:
        return Index(self.distance or TURN, self.tolerance)


class CameraFeedback(FeedbackPart):
    """A camera that looks along the light: through GenICam, or through Micro-Manager.

    producer: file of its maker's GenICam driver.  serial: serial number of that camera.  config: Micro-Manager's
    configuration file.  label: label of the camera in it.  exposure: exposure time of an image.  gain: gain in the
    camera's unit, mostly dB.  format: pixel format, such as Mono8.  trigger: input whose edge takes an image, "" for
    none.  binning: sensor pixels along an edge of an image's pixel.  crop: left, top, columns and rows of images
    [pixels].  pixel: edge of an image's pixel in the plane that it sees.  flip: whether images are mirrored left-right.
    rotation: angle [deg] by which they are then turned clockwise; `vam calibrate live` measures both.  bits: bits per
    pixel.  discard: images to discard after a change of mirrors or lens.
    """

    sees: ClassVar[Sees] = "resin"
    producer: str | None = None
    serial: str | None = None
    config: str | None = None
    label: str | None = None
    exposure: FrameTime = 0.01
    gain: float | None = None
    format: str | None = None
    trigger: str | None = None
    binning: Count = 1
    crop: Annotated[tuple[Whole, Whole, Count, Count] | None, Listed] = None
    flip: bool = False
    rotation: Literal[0, 90, 180, 270] = 0
    pixel: Length | None = None
    bits: Annotated[int, Field(ge=8, le=16)] = 8
    discard: Annotated[int, Field(ge=0, le=100)] = 1

    @property
    def view(self) -> tuple[int, int] | None:
        """Rows and columns of its images, were they upright; None if only the camera knows."""
        if self.crop is None:
            return None
        columns, rows = self.crop[2:] if self.rotation % 180 == 0 else self.crop[:1:-1]
        return rows, columns

    @model_validator(mode="after")
    def _one_way(self) -> CameraFeedback:
        if self.emulated:
            return self
        if (self.producer is None) == (self.config is None) or (self.config is None) != (self.label is None):
            raise ValueError("expected producer, of a GenICam camera, or config and label, of Micro-Manager's")
        others = [name for name in ("serial", "gain", "format", "trigger") if getattr(self, name) is not None]
        if self.config is not None and others:
            raise ValueError(f"Micro-Manager's configuration file sets {others[0]}; set it there, and remove it here")
        return self

    def open(self, free: bool = False) -> Any:
        """Open the camera with its settings, ``free`` of its trigger. Raises what its driver does."""
        exposure = 1e6 * self.exposure
        if self.producer is not None:
            trigger = "" if free and self.trigger else self.trigger
            settings = {"gain": self.gain, "pixels": self.format, "trigger": trigger, "binning": self.binning,
                        "crop": self.crop}  # fmt: skip
            return GenicamCamera.open(self.producer, self.serial, exposure_us=exposure, **settings)
        camera = MicroManagerCamera.open(str(self.config), str(self.label))
        with closed_on_error(camera):
            camera.frame(self.binning, self.crop)
            camera.expose(exposure)
        return camera


class EmulatedCameraFeedback(CameraFeedback):
    """The emulated camera."""

    emulated: ClassVar[bool] = True


class PowerMeterFeedback(FeedbackPart):
    """A power meter, or a photodiode on one.  port: address.  wavelength: wavelength of the light [nm].

    average: samples per reading.  settle: time until it follows a change of light.
    """

    sees: ClassVar[Sees] = "light"
    port: str
    wavelength: Annotated[float, Field(gt=100, lt=3000)] | None = None
    average: Count = 1
    settle: Time = 0.1


class EmulatedPowerMeterFeedback(PowerMeterFeedback):
    """The emulated photodiode."""

    emulated: ClassVar[bool] = True
    port: str = ""
