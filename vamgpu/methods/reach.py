"""Whether light gets to a part at all: even light from every pixel and pose, and the dose that it leaves."""

from __future__ import annotations

import warnings
from math import inf, isfinite
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import NoLight, OpticsWarning
from vamgpu.kernels.update import linear
from vamgpu.operators.reductions import extent

LOST = 1e-6
"""Dose of the darkest voxel of a part over that of the brightest anywhere, by even light, below which there is no
solving: float32 rounds what is summed up by some 1e-7 of it, so that this voxel's dose would be rounding."""
DIM = 1e-2
"""The same share, below which a print is possible but unlikely to come out: light for the darkest voxel passes others
that take a hundred times as much of it."""


def check_reach(operator: Any, fractions: DeviceArray) -> None:
    """Refuse a part that stays in the dark whatever the light, and warn of one that light hardly gets to.

    Voxels out of the cylinder that is judged do not count. Costs one projector pair, no part of a run's.

    Args:
        operator: a projector of a volume that turns.
        fractions: of the part [x, y, z], on its device.

    Raises:
        NoLight: even light leaves a voxel of the part less than `LOST` of the greatest dose.
    """
    device, vessel = operator.device, operator.vessel
    even, dose = device.empty(operator.range.shape), device.empty(operator.domain.shape)
    operator(fractions, out=even)  # finite numbers, as new memory need not hold
    device.launch(linear, a=0.0, x=even, b=0.0, y=even, floor=1.0, out=even)
    operator.T(even, out=dose)
    judged = operator.grid.inscribed_radius / operator.grid.pitch * (1.0 + 1e-6)
    least, greatest = extent(dose, fractions, 0.5, inf, judged)[0], extent(dose)[1]
    if not isfinite(least):  # no voxel that is judged is filled by half
        return
    share = least / greatest if greatest > 0.0 else 0.0
    if share >= DIM:
        return
    absorption, lit = float(getattr(vessel, "absorption", 0.0)), float(getattr(vessel, "lit_radius", inf))
    told = (
        f"even light leaves the darkest voxel of the part {share:.2g} of the greatest dose; wanted {DIM:g} or more, "
        f"{LOST:g} at the very least: absorption is {absorption:g} /mm, the resin is lit out to {lit:.4g} mm from the "
        f"axis, and the light is that of {operator.beam}: take less absorber, a smaller part nearer to the axis, or a "
        "beam of more pixels"
    )
    if share < LOST:
        raise NoLight(f"light does not reach the part: {told}")
    warnings.warn(f"light hardly reaches the part: {told}", OpticsWarning, stacklevel=5)
