"""What the controller can step: refused with numbers before a print, and heeded by emulated machines."""

from __future__ import annotations

from vamgpu.errors import TimingInfeasible
from vamgpu.hosts.protocols.controller import FASTEST
from vamgpu.hosts.schedules.schedule import Schedule

FINE = 1000
"""Microsteps of an emulated motion in a pose, where that is not too fast."""


def steppable(schedule: Schedule, microsteps: float) -> None:
    """Raise `TimingInfeasible` for a motion of more microsteps a second than the controller steps."""
    rate = float(schedule.speed) * microsteps
    if rate > FASTEST:
        most, unit = FASTEST / microsteps, f"{schedule.unit}/s"
        raise TimingInfeasible(
            f"{float(schedule.speed):.4g} {unit} are {rate:.4g} microsteps/s, and the controller steps {FASTEST:.4g} "
            f"at most: move at {most:.4g} {unit} at most, or set a coarser division at the motor's driver and tell it "
            "as microsteps in [controller]",
            "motor", most, unit,
        )  # fmt: skip


def emulated_microsteps(schedule: Schedule) -> int:
    """Microsteps of an emulated motion in a pose: `FINE`, or as many as the controller can step."""
    return max(1, min(FINE, int(FASTEST * float(schedule.advance / schedule.speed))))
