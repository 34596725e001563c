"""The tables of a rig's file for the instruments of calibrations."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from vamgpu.schema.quantities import Count, Exposure, Length, Speed, Thickness, Time
from vamgpu.schema.read import Section


class CameraSection(Section):
    """A camera that looks along the light. producer: file of its maker's driver.  pixel: in the plane that it sees.

    bits: of its levels.  discard: pictures that are on their way when mirrors or lens have changed.
    """

    driver: Literal["genicam", "emulated"]
    producer: str | None = None
    serial: str | None = None
    exposure: Exposure = 0.01
    pixel: Length | None = None
    bits: Annotated[int, Field(ge=8, le=16)] = 8
    discard: Annotated[int, Field(ge=0, le=100)] = 1

    @model_validator(mode="after")
    def _of_its_driver(self) -> CameraSection:
        if self.driver == "genicam" and not self.producer:
            raise ValueError('driver "genicam" wanted producer = "path of the maker\'s .cti file"')
        return self


class CameraStageSection(Section):
    """The stage that carries the camera along the light. microsteps: a millimeter; a Standa's have 256 in a step.

    middle: its position [mm] on the axis of rotation, from which positions are told.
    """

    driver: Literal["zaber", "standa", "emulated"]
    port: str | None = None
    device: Count = 1
    axis: Count = 1
    microsteps: Annotated[float, Field(gt=0)] = 1000.0
    speed: Speed = 5.0
    middle: Thickness = 0.0


class PhotodiodeSection(Section):
    """A meter of light. wavelength: [nm].  average: samples a reading.  settle: how long it takes to follow light."""

    driver: Literal["scpi", "emulated"]
    port: str | None = None
    wavelength: Annotated[float, Field(gt=100, lt=3000)] | None = None
    average: Count = 1
    settle: Time = 0.1
