"""The tables of a rig's file, one for each machine."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from vamgpu.hosts.protocols.controller import LONGEST_LEASE_MS, STEEPEST
from vamgpu.optics.lens import TunableLens
from vamgpu.schema.quantities import Count, Exposure, Irradiance, Length, Rate, Time
from vamgpu.schema.read import Listed, Section

Share = Annotated[float, Field(gt=0, le=1)]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Color = Literal["red", "green", "blue"]
FINEST = 1e6
"""Most microsteps of a millimeter or degree; more are a slip of the pen."""
SHORTEST_LEASE_MS = 20
"""A host renews it four times meanwhile."""
MIRRORS = (1080, 1920)
SCREEN = (1140, 912)
ORDERS: dict[int, tuple[Color, ...]] = {8: ("green", "red"), 7: ("green", "red", "blue")}
"""Bits → channels of a video frame in the order that its pictures are shown."""
ONLY = {
    "alp": {"library", "serial", "size", "picture"},
    "hdmi": {"screen", "size", "refresh", "bits", "order", "latency"},
    "emulated": {"size", "picture"},
}
"""Driver → what its projector is told."""


class RigSection(Section):
    """The rig itself. machine: what jobs it prints."""

    name: str
    machine: Literal["vial", "web", "slices", "any"]


class ControllerSection(Section):
    """What keeps trigger, lease, motion and light. microsteps: of the motion, a millimeter or degree.

    ramp: how fast the motion changes its speed [mm/s2] or [deg/s2]; without it as the controller's own firmware does.
    """

    driver: Literal["vam-controller", "emulated"]
    port: str | None = None
    baud: Baud = 115200
    microsteps: Annotated[float, Field(gt=0, le=FINEST)] = 3200.0
    ramp: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _stepped(self) -> ControllerSection:
        if self.ramp is not None and self.ramp * self.microsteps > STEEPEST:
            found = self.ramp * self.microsteps
            raise ValueError(f"ramp = {self.ramp:g} is {found:.4g} microsteps/s2; wanted {STEEPEST:.4g} at most")
        return self


class ProjectorSection(Section):
    """Mirrors behind a trigger, or on a video cable. size: rows, columns.  picture: least time from one to the next.

    refresh: of the cable.  order: channels of a video frame, as their pictures are shown.  latency: video frames from
    cable to mirrors. The light of the first projector is the controller's channel 0, that of the second 1.
    """

    driver: Literal["alp", "hdmi", "emulated"]
    library: str | None = None
    serial: int = 0
    size: Annotated[tuple[Count, Count] | None, Listed] = None
    picture: Exposure = 1.0 / 266.0
    screen: Annotated[int, Field(ge=0)] = 0
    refresh: Rate = 60.0
    bits: Literal[7, 8] = 8
    order: Annotated[tuple[Color, ...] | None, Listed] = None
    latency: Annotated[int, Field(ge=0, le=8)] = 1

    @model_validator(mode="after")
    def _of_its_driver(self) -> ProjectorSection:
        if odd := sorted(self.model_fields_set - ONLY[self.driver] - {"driver"}):
            raise ValueError(f'driver "{self.driver}" takes no {", ".join(odd)}: remove what belongs to other drivers')
        if self.driver == "alp" and not self.library:
            raise ValueError('driver "alp" wanted library = "path of the maker\'s library"')
        if self.order is not None and sorted(self.order) != sorted(ORDERS[self.bits]):
            names = ", ".join(ORDERS[self.bits])
            raise ValueError(f"{self.bits} bits go to {names}, each once; wanted order to say in which order")
        return self

    @property
    def array(self) -> tuple[int, int]:
        """Rows and columns of the mirrors."""
        return self.size or (SCREEN if self.driver == "hdmi" else MIRRORS)


class LensRigSection(Section):
    """The tunable lens. firmware: type letter it must have.  settle: from plane to plane.  latency: that it thinks.

    baud: of the line on which the controller tells it.  lowest, highest: powers it may be told [dpt].  axis: power that
    focuses on the roller's axis [dpt].  slope: way of the focus per power [mm/dpt], below 0; as a calibration finds
    both. Without a slope it is that of the relays, ``focal`` lengths, in the web's bath.
    """

    driver: Literal["optotune", "emulated"]
    port: str | None = None
    firmware: str | None = None
    settle: Time = 0.005
    latency: Time = 0.0
    baud: Baud = 38400
    lowest: float = -1.5
    highest: float = 3.5
    axis: float = 0.0
    slope: Annotated[float, Field(lt=0)] | None = None
    focal: Annotated[tuple[Length, Length, Length, Length], Listed] = TunableLens.focal

    @model_validator(mode="after")
    def _rising(self) -> LensRigSection:
        if not self.lowest < self.highest:
            raise ValueError(f"powers go from {self.lowest:g} to {self.highest:g} dpt; wanted lowest below highest")
        return self


class StageSection(Section):
    """The stage that turns a vial before a video projector. steps: of the motor, a degree; microsteps for a Zaber."""

    driver: Literal["zaber", "standa", "emulated"]
    port: str | None = None
    steps: Annotated[float, Field(gt=0)] = 6400.0 / 3.0
    device: Count = 1
    axis: Count = 1


class LightSection(Section):
    """The light. power: share of full drive.  irradiance: of a full-on pixel at full drive."""

    power: Share = 1.0
    irradiance: Irradiance | None = None


class SafetySection(Section):
    """What holds the light. tolerance: of motion, in poses.  budget: light over what the plan needs.

    lease: how long the controller keeps the light by itself, 20 ms to 1 s.  resume: the longest pause after which a
    print goes on; resin forgets a dose meanwhile.
    """

    lease: Time = 0.25
    tolerance: Annotated[float, Field(gt=0, le=5)] = 0.5
    budget: Annotated[float, Field(ge=1, le=2)] = 1.01
    resume: Time = 30.0

    @field_validator("lease")
    @classmethod
    def _kept(cls, lease: float) -> float:
        if not SHORTEST_LEASE_MS <= 1000 * lease <= LONGEST_LEASE_MS:
            raise ValueError(f"wanted {SHORTEST_LEASE_MS} ms to {LONGEST_LEASE_MS} ms, as the controller keeps a lease")
        return lease
