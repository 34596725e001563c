"""The part an optimizer is asked for: checked, and on the operator's device."""

from __future__ import annotations

import warnings
from math import inf, isfinite
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, EmptyMesh, OpticsWarning, TargetTooLarge
from vamgpu.operators.reductions import extent, total
from vamgpu.operators.space import require
from vamgpu.optimize.projector import Projector
from vamgpu.optimize.reach import check_reach
from vamgpu.web import WebGrid


def fractions_of(operator: Projector, target: Any) -> DeviceArray:
    """The target's fractions [x, y, z] on the operator's device, after checking that light can reach it all.

    target: a `Target`, or fractions (NumPy or on the device).  Raises `BadInput` for another pitch and for values
    beyond 0..1, `EmptyMesh` where nothing is to be printed, `NoLight` where light does not get to it all,
    `ShapeMismatch`, `TargetTooLarge`, `DeviceError`.
    """
    if not hasattr(operator, "grid") or not hasattr(operator, "beam"):
        raise BadInput(f"got {operator!r} as operator; wanted a projector, or something made of one")
    radius = getattr(target, "radius", None)
    if not isinstance(operator.grid, WebGrid):
        check = getattr(operator.vessel, "check_fits", None)
        if radius is not None and check is not None:
            check(radius)
        _check_beam(operator, radius, getattr(target, "height", None))
    fractions = on_device(operator, target)
    _check_values(fractions)
    known = hasattr(target, "radius")  # then vessel and beam were asked above, and absorption alone is left
    if not isinstance(operator.grid, WebGrid) and not (known and operator.vessel is None):
        check_reach(operator, fractions)
    return fractions


def on_device(operator: Projector, target: Any) -> DeviceArray:
    """The target's fractions [x, y, z] on the operator's device; arguments and errors as for `fractions_of`."""
    wanted = operator.grid.pitch
    pitch = getattr(getattr(target, "grid", None), "pitch", wanted)
    if not np.allclose(pitch, wanted, rtol=1e-9, atol=0.0):
        raise BadInput(
            f"the target has voxels of {_edge(pitch)} mm, the operator of {_edge(wanted)} mm; "
            "build the operator on target.grid"
        )
    fractions = target.on(operator.device) if hasattr(target, "on") else target
    require(operator.domain, fractions, "the target")
    if not isinstance(fractions, DeviceArray):
        return operator.device.upload(fractions)
    operator.device.check_mine(fractions)
    return fractions


def _edge(pitch: Any) -> str:
    return " × ".join(f"{edge:g}" for edge in np.atleast_1d(pitch))


def _check_values(fractions: DeviceArray) -> None:
    low, high = extent(fractions, lower=-inf, upper=inf)
    if not isfinite(total(fractions)):
        raise BadInput("the target holds NaN or infinity; expected fractions in 0..1")
    if not (low >= 0.0 and high <= 1.0):
        raise BadInput(f"the target reaches from {low:g} to {high:g}; wanted fractions in 0..1: scale it")
    if high == 0.0:
        raise EmptyMesh("every voxel of the target is 0; wanted some that are filled")


def _check_beam(operator: Projector, radius: float | None, height: float | None) -> None:
    """Refuse a part [mm] higher than the light; warn of one wider, which only the poses along it light whole."""
    (columns, rows), pitch, vessel = operator.beam.pixels, operator.beam.pitch, operator.vessel
    if height is not None and height > rows * pitch * (1.0 + 1e-6):
        raise TargetTooLarge(
            f"the target is {height:.4g} mm high, the light of {operator.beam} {rows * pitch:.4g} mm; "
            "scale or center the target, or take a beam of more rows"
        )
    edge = np.array([0.5 * columns * pitch])
    reach = float((edge if vessel is None else vessel.chords(edge).p)[0])
    if radius is not None and radius > reach * (1.0 + 1e-6):
        warnings.warn(
            f"the target has a radius of {radius:.4g} mm, the light of {operator.beam} one of {reach:.4g} mm in the "
            "resin: what lies beyond is lit at some poses only; scale the target or take a beam of more columns",
            OpticsWarning,
            stacklevel=4,
        )
