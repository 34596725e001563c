"""The reason why there is no light: in a plan before packing, or in frames that should print."""

from __future__ import annotations

from math import inf
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import NoLight
from vamgpu.kernels.update import linear
from vamgpu.metrics.parts import Parts
from vamgpu.operators.reductions import extent
from vamgpu.printing.placement import Placement


def no_light(plan: Any, settings: Placement) -> NoLight:
    """The error that explains why no pixel of a plan's frames has light above 0."""
    light = plan.sinogram
    low, high = extent(light, lower=-inf, upper=inf)
    if high > 0.0:
        columns, rows = light.shape[1:]
        return NoLight(
            f"the plan has light, but its shift of {settings.shift} pixels moves all of it off the {columns} × {rows} "
            "pixels of a frame; expected a shift that keeps some: check its sign and its unit, pixels"
        )
    if low < 0.0:
        return NoLight(
            f"the plan's light reaches from {low:.3g} to {high:.3g}, but mirrors cannot show negative light; expected "
            "some above 0: clip it as the methods do, or show its two signs as two colors"
        )
    operator = getattr(plan, "operator", None)
    if operator is not None and not _lights_anything(operator, light):
        return NoLight(
            "the plan is dark everywhere, and no column lights the grid: the columns of the beam miss it, or the "
            "resin absorbs all light before it; widen the beam, or use less absorber"
        )
    method, steps = getattr(plan, "method", None), len(getattr(plan, "history", ()))
    name = getattr(method, "name", type(method).__name__)
    who = f"{name} found no light in {steps} iterations" if steps else "its method found no light"
    return NoLight(
        f"the plan is dark everywhere, although its columns reach the grid: {who}; expected some light above 0: check "
        "that the target is not empty, then try another method"
    )


def check_dose(light: DeviceArray, parts: Parts) -> None:
    """Reject frames that print nothing."""
    # light [angle, r, z]
    everywhere = {"lower": -inf, "upper": inf}
    if extent(parts.dose, parts.target, **everywhere, reach=parts.reach or 0.0)[1] > 0.0:
        return
    if extent(light, lower=-inf, upper=inf)[1] > 0.0:
        raise NoLight(
            "the frames have light, but none of it reaches the judged cylinder: it passes beside it or is absorbed "
            "before; expected a dose above 0 there: check the shift, the beam's width and the absorption"
        )
    raise NoLight("every frame is dark; expected light above 0: pack a plan that has light, or use a smaller scale")


def _lights_anything(operator: Any, like: DeviceArray) -> bool:
    """Whether uniform light gives any dose."""
    even = like.device.empty(like.shape)
    like.device.launch(linear, a=0.0, x=like, b=0.0, y=like, floor=1.0, out=even)
    return extent(operator.T(even), lower=-inf, upper=inf)[1] > 0.0
