"""The part that an optimizer must print: checked, and on the operator's device."""

from __future__ import annotations

import warnings
from math import inf, isfinite
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, NoLight, OpticsWarning, ShapeMismatch, TargetTooLarge
from vamgpu.geometry import Grid
from vamgpu.kernels.update import fill_background, linear
from vamgpu.operators.compose import Composed, capped, combine
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.protocol import ATTRIBUTES, Operator
from vamgpu.operators.reductions import EVERYWHERE, dot, extent, total
from vamgpu.operators.scaling import Scaled
from vamgpu.operators.space import require
from vamgpu.targets.limits import Limits
from vamgpu.web import WebGrid

LOST = 1e-6
"""Ratio of the dose of the darkest voxel of a part to that of the brightest voxel anywhere, in uniform light, below
which there is no solution: float32 rounds sums by about 1e-7, and this voxel's dose would be a rounding error."""
MET = 1e-3
"""Share of the greatest projection of a part above which a pixel meets the part; fainter light of rings and point
spreads extends farther. On a boat with pixels of 3/4 voxel, rings and rays then agree on all but 0.3 % of them."""
SHARP = 1e5  # slope of the step from 0 to 1, divided by its position
HALF = 0.5 * (1.0 - 1e-4)  # fraction at which that step is placed; voxels filled by half lie beyond it
DIM = 1e-2
"""The same ratio below which a print is possible but unlikely to succeed: light for the darkest voxel passes others
that get a hundred times as much."""


def fractions_of(operator: Operator, target: Any) -> DeviceArray:
    """The target's fractions [x, y, z] on the operator's device, checked, and reached by light. Raises `BadInput`."""
    _check_projector(operator)
    radius = getattr(target, "radius", None)
    if not isinstance(operator.grid, WebGrid):
        check = getattr(_vessel(operator), "check_fits", None)
        if radius is not None and check is not None:
            check(radius)
        _check_beam(operator, radius, getattr(target, "height", None))
    fractions = on_device(operator, target)
    check_values(fractions)
    if isinstance(operator.grid, Grid):
        check_cylinder(fractions, operator.grid, stacklevel=5)
    known = hasattr(target, "radius")  # vessel and beam were checked above; only absorption remains
    if not isinstance(operator.grid, WebGrid) and not (known and _vessel(operator) is None):
        _check_reach(operator, fractions)
    return fractions


def radius_of(operator: Any, target: Any, fractions: DeviceArray) -> float:
    """Radius of the part about the axis [mm]: a target's own, or that of the voxels filled by half."""
    if hasattr(target, "radius") or not isinstance(operator.grid, Grid):
        return float(getattr(target, "radius", 0.0))
    near, far = 0.0, reach_of(operator.grid)
    whole = total(_stepped(fractions, HALF, far))
    while far - near > 0.5:
        middle = 0.5 * (near + far)
        near, far = (near, middle) if total(_stepped(fractions, HALF, middle)) >= whole else (middle, far)
    return far * operator.grid.pitch


def one_limit(target: Any) -> Any:
    """The target; `BadInput` if its voxels have limits of their own, for methods that support only one limit."""
    if getattr(target, "limits", None) is not None:
        raise BadInput(f"the voxels of {target.name!r} have limits of their own; expected a part without bodies: "
                       "use optimize()")  # fmt: skip
    return target


def limited(operator: Any, limits: Limits) -> Any:
    """A projector whose doses are relative to the limits of their voxels; 1 is then the limit everywhere."""
    if limits.dose.shape != operator.domain.shape:
        raise ShapeMismatch(
            f"the target's limits have shape {limits.dose.shape}; expected {operator.domain.shape}, that of the grid"
        )
    return Composed(operator, Scaled(operator.grid, limits.scale, operator.device))


def lit_pixels(operator: Any, fractions: DeviceArray) -> DeviceArray:
    """1 for pixels whose rays meet a part, and 0 for idle pixels."""
    met = operator(_stepped(fractions, HALF * (extent(fractions)[1] or 1.0), reach_of(operator.grid)))
    return _stepped(met, max(MET * extent(met)[1], 1e-30))


def _stepped(values: DeviceArray, at: float, reach: float = EVERYWHERE) -> DeviceArray:
    """1 where values exceed ``at`` within ``reach`` samples of the axis, else 0."""
    out, steep = values.device.empty(values.shape), {"low": -SHARP, "high": SHARP / at - SHARP}
    values.device.launch(fill_background, target=values, **steep, reach=reach, model=out)
    return capped(combine(1.0, out, 0.0, out, out, floor=0.0), 1.0)


def idle_light(operator: Any, light: DeviceArray, lit: DeviceArray) -> float:
    """Share of light [angle, r, z] in pixels whose rays never meet a part, by `lit_pixels`; 0 for dark light."""
    sent = Dwell(operator.motion, operator.beam, operator.device).sent(light)
    whole = total(sent)
    return max(1.0 - dot(sent, lit) / whole, 0.0) if whole > 0.0 else 0.0


def _check_projector(operator: Any) -> None:
    lacking = [name for name in ATTRIBUTES if not hasattr(operator, name)]
    if lacking or not callable(operator):
        raise BadInput(
            f"got {operator!r} as operator; expected a projector, or something made of one: it lacks "
            f"{', '.join(lacking) or 'a call'} (see vamgpu.operators.protocol)"
        )


def _vessel(operator: Any) -> Any:
    return getattr(operator, "vessel", None)


def reach_of(grid: Grid | WebGrid) -> float:
    """Radius [voxels] of the judged cylinder, which light reaches at every angle; a web is judged everywhere."""
    return grid.inscribed_radius / grid.pitch * (1.0 + 1e-6) if isinstance(grid, Grid) else EVERYWHERE


def on_device(operator: Operator, target: Any) -> DeviceArray:
    """The target's fractions [x, y, z] on the operator's device; arguments and errors as for `fractions_of`."""
    _check_projector(operator)
    operator_pitch = operator.grid.pitch
    pitch = getattr(getattr(target, "grid", None), "pitch", operator_pitch)
    if not np.allclose(pitch, operator_pitch, rtol=1e-9, atol=0.0):
        raise BadInput(
            f"the target has voxels of {_edge(pitch)} mm, the operator of {_edge(operator_pitch)} mm; "
            "build the operator on target.grid"
        )
    fractions = target.on(operator.device) if hasattr(target, "on") else target
    require(operator.domain, fractions, "the target")
    if not isinstance(fractions, DeviceArray):
        return uploaded(operator.device, fractions, "the target")
    operator.device.check_mine(fractions)
    return fractions


def uploaded(device: Device, values: Any, name: str) -> DeviceArray:
    """An array on a device, after checking that every value is a number that float32 can hold."""
    array = np.asarray(values)
    least, most = (float(end(array)) if array.size else 0.0 for end in (np.min, np.max))  # NaN if any value is
    if not max(abs(least), abs(most)) <= float(np.finfo(np.float32).max):
        raise BadInput(f"{name} reaches from {least:g} to {most:g}; expected finite numbers that float32 can hold")
    return device.upload(array)


def _edge(pitch: Any) -> str:
    return " × ".join(f"{edge:g}" for edge in np.atleast_1d(pitch))


def check_values(fractions: DeviceArray, name: str = "the target", unit: str = "fractions") -> None:
    """Raise `BadInput` for fractions beyond 0..1, and `EmptyMesh` if none is above 0."""
    low, high = extent(fractions, lower=-inf, upper=inf)
    if not isfinite(total(fractions)):
        raise BadInput(f"{name} holds NaN or infinity; expected {unit} in 0..1")
    if not (low >= 0.0 and high <= 1.0):
        raise BadInput(f"{name} reaches from {low:g} to {high:g}; expected {unit} in 0..1: scale it")
    if high == 0.0:
        raise EmptyMesh(f"every voxel of {name} is 0; expected some that are filled")


def check_cylinder(fractions: DeviceArray, grid: Grid, stacklevel: int = 3) -> None:
    """Reject a target without a voxel to judge; warn, at ``stacklevel``, of a part outside the cylinder."""
    reach = reach_of(grid)
    _, most = extent(fractions, reach=reach)
    if not most >= 0.5:
        raise EmptyMesh(
            f"no voxel of the target within {grid.inscribed_radius:.4g} mm of the axis is at least half filled (the "
            f"fullest one: {max(most, 0.0):g}); center the target on the axis, scale it, or choose a finer pitch"
        )
    inside = fractions.device.empty(fractions.shape)
    fractions.device.launch(fill_background, target=fractions, low=0.0, high=1.0, reach=reach, model=inside)
    out = 1.0 - total(inside) / total(fractions)
    if out > 1e-6:
        warnings.warn(
            f"{100 * out:.2g} % of the target is farther than {grid.inscribed_radius:.4g} mm from the axis, outside "
            "the cylinder that every angle lights: it is neither optimized nor judged; use a wider grid",
            OpticsWarning,
            stacklevel=stacklevel,
        )


def _check_beam(operator: Operator, radius: float | None, height: float | None) -> None:
    """Reject a part [mm] that is higher than the light; warn of a part wider than the light at some angles."""
    (columns, rows), pitch, vessel = operator.beam.pixels, operator.beam.pitch, _vessel(operator)
    if height is not None and height > rows * pitch * (1.0 + 1e-6):
        raise TargetTooLarge(
            f"the target is {height:.4g} mm high, the light of {operator.beam} {rows * pitch:.4g} mm; "
            "scale or center the target, or use a beam of more rows"
        )
    edge = np.array([0.5 * columns * pitch])
    reach = float((edge if vessel is None else vessel.chords(edge).p)[0])
    if radius is not None and radius > reach * (1.0 + 1e-6):
        warnings.warn(
            f"the target has a radius of {radius:.4g} mm, the light of {operator.beam} one of {reach:.4g} mm in the "
            "resin: only some angles light the rest; scale the target or use a beam of more columns",
            OpticsWarning,
            stacklevel=5,
        )


def _check_reach(operator: Any, fractions: DeviceArray) -> None:
    """Reject a part that light does not reach, and warn of one that it hardly reaches; takes one evaluation."""
    device, vessel = operator.device, _vessel(operator)
    even, dose = device.empty(operator.range.shape), device.empty(operator.domain.shape)
    operator(fractions, out=even)  # finite numbers, which new memory need not contain
    device.launch(linear, a=0.0, x=even, b=0.0, y=even, floor=1.0, out=even)
    operator.T(even, out=dose)
    least, greatest = extent(dose, fractions, 0.5, inf, reach_of(operator.grid))[0], extent(dose)[1]
    if not isfinite(least):  # no judged voxel is filled by half
        return
    share = least / greatest if greatest > 0.0 else 0.0
    if share >= DIM:
        return
    absorption, lit = float(getattr(vessel, "absorption", 0.0)), float(getattr(vessel, "lit_radius", inf))
    reason = (
        f"uniform light leaves the darkest voxel of the part {share:.2g} of the greatest dose; expected {DIM:g} or "
        f"more, at least {LOST:g}: absorption is {absorption:g} /mm, the resin is lit out to {lit:.4g} mm from the "
        f"axis, and the light is that of {operator.beam}: use less absorber, a smaller part nearer to the axis, or a "
        "beam of more pixels"
    )
    if share < LOST:
        raise NoLight(f"light does not reach the part: {reason}")
    warnings.warn(f"light hardly reaches the part: {reason}", OpticsWarning, stacklevel=5)
