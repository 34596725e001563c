"""The tables of a rig's file that are no roles: the rig itself, the controller, safety, and a camera's stage."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator

from vamgpu.hosts.drivers.controller_protocol import LONGEST_LEASE_MS
from vamgpu.hosts.rigs.roles import Baud
from vamgpu.schema.quantities import Count, NonNegative, Speed, Thickness, Time
from vamgpu.schema.section import Section

SHORTEST_LEASE_MS = 20  # A host renews it four times meanwhile


class RigSection(Section):
    """The rig itself. machine: what jobs it prints."""

    name: str
    machine: Literal["vial", "web", "slices", "any"]


class ControllerSection(Section):
    """The line to the controller, for the roles that it fills: motion, clock, light, lens line and lease."""

    driver: Literal["vam-controller", "emulated"] = "vam-controller"
    port: str | None = None
    baud: Baud = 115200


class SafetySection(Section):
    """Limits of the light. tolerance: of motion, in poses.  budget: light over what the plan needs.

    lease: how long the controller keeps the light by itself, 20 ms to 1 s.  resume: the longest pause after which a
    print goes on; resin forgets a dose meanwhile.  drift: of the frames against the motion that is accepted where no
    clock keeps them in step [deg/min] or [mm/min].
    """

    lease: Time = 0.25
    tolerance: Annotated[float, Field(gt=0, le=5)] = 0.5
    budget: Annotated[float, Field(ge=1, le=2)] = 1.01
    resume: Time = 30.0
    drift: NonNegative = 0.0

    @field_validator("lease")
    @classmethod
    def _kept(cls, lease: float) -> float:
        if not SHORTEST_LEASE_MS <= 1000 * lease <= LONGEST_LEASE_MS:
            raise ValueError(
                f"expected {SHORTEST_LEASE_MS} ms to {LONGEST_LEASE_MS} ms, as the controller keeps a lease"
            )
        return lease


DATE = re.compile(r"none|\d{4}(-\d\d(-\d\d(T\d*)?)?)?")


def _chosen(value: str) -> str:
    if not DATE.fullmatch(value):
        raise ValueError('expected the date of one, such as "2026-11-20", or "none"')
    return value


Chosen = Annotated[str, AfterValidator(_chosen)] | None


class CalibrationSection(Section):
    """Which calibrations of the rig are applied: of each kind the newest, or that of a date, or ``"none"``.

    warn_after: age from which a calibration is reported as old.
    """

    gray: Chosen = None
    flat: Chosen = None
    axis: Chosen = None
    focus: Chosen = None
    mtf: Chosen = None
    runout: Chosen = None
    warn_after: Time = 90 * 86400.0


class CameraStageSection(Section):
    """The stage that carries the camera along the light. microsteps: a millimeter; a Standa's have 256 in a step.

    middle: its position [mm] on the axis of rotation, from which positions are counted.
    """

    driver: Literal["zaber", "standa", "emulated"]
    port: str | None = None
    device: Count = 1
    axis: Count = 1
    microsteps: Annotated[float, Field(gt=0)] = 1000.0
    speed: Speed = 5.0
    middle: Thickness = 0.0
