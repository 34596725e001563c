"""The certificate of a process window: prices of dose by which no light whatever has a wider one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from numbers import Real
from typing import TYPE_CHECKING

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.covering import NEVER, cover_scale, divide_prices, level_cover, light_short_pixels
from vamgpu.kernels.reduce import HIGH
from vamgpu.methods.projector import Projector
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import folded, parts_for, total

if TYPE_CHECKING:
    from vamgpu.methods.plan import Plan

SWEEPS = 4
"""Covers in a row, each with more light where the one before was shortest."""
GOLDEN, TRIED = 0.5 * (5**0.5 - 1.0), 20
"""Share of the way, and times, that the share of what the part pays is looked for that is left out, where that is
cheaper than to cover it: by golden sections, to 1e-4, for the bound is convex in it."""
ROUNDING = 1e-4
"""Share of what the part pays that is left out for the rounding of float32, over a hundred times as large as it was
seen to be on any device; the bound is greater by as much."""


@dataclass(frozen=True, eq=False, repr=False)
class Bound:
    """No light whatever has a strict process window wider than this; anyone can check it by the prices.

    Let prices p be ≥ 0 outside the part, and A p ≥ 0 on every pixel. Light g ≥ 0 of greatest dose 1 has a dose D = Aᵀg,
    and 0 ≤ g·A p = p·D. If the part has the dose a at least and the voids b at most, a ≥ b, then

        a − b ≤ 1 + Σ p inside + max(0, Σ p outside − 1),

    where prices below 0 come to −1 at least in all. That is the value; the prices' sums are rounded upwards.

    Attributes:
        value: The bound, a share of the greatest dose; 1, the widest window that could be, where nothing is known.
        prices: Of a dose in each voxel [x, y, z], on the operator's device; 0 where voxels are not judged.
        evaluations: Projector evaluations it took, those of the run that found the prices included.
        on: The voxels and the motion of the vial that it holds for, in words; of finer voxels, and of a vial that moves
            otherwise, it says nothing. Empty where the operator does not tell.
    """

    value: float
    prices: DeviceArray = field(repr=False)
    evaluations: float
    on: str = ""

    def share(self, plan: Plan | float) -> float:
        """How near a light comes to the best there can be.

        Args:
            plan: Its plan, or its strict window, a share of the greatest dose.

        Returns:
            The window over the bound, a share.
        """
        return _window(plan) / self.value

    def statement(self, plan: Plan | float | None = None) -> str:
        """The bound in words, and how near a light comes.

        Args:
            plan: Its plan, or its strict window, a share of the greatest dose; None for the bound alone.

        Returns:
            One sentence.
        """
        said = f"no light whatever gives more than {self.value:+.3f}{f' on {self.on}' if self.on else ''}"
        return said if plan is None else f"{said}; this one has {_window(plan):+.3f} ({100 * self.share(plan):.0f} %)"

    def __repr__(self) -> str:
        return f"Bound({self.statement()}; {self.evaluations:g} evaluations)"


def _window(plan: Plan | float) -> float:
    window = getattr(plan, "window", plan)
    if isinstance(window, bool) or not isinstance(window, Real) or not isfinite(window):
        raise BadInput(f"got {plan!r}; expected a plan, or a strict window, a share of the greatest dose")
    return float(window)


def certified(
    operator: Projector, target: DeviceArray, reach: float, lower: DeviceArray, upper: DeviceArray,
    rows: DeviceArray, columns: DeviceArray, evaluations: float = 0.0,
) -> Bound:  # fmt: skip
    """The bound by the multipliers of a run, made feasible; takes `SWEEPS` and one more evaluations.

    lower, upper: of `vamgpu.kernels.pdhg.dual_step`; 0 where voxels do not count.  rows, columns: dose of light 1 and
    projection of the voxels that count, of any scale.
    """
    device = operator.device
    spent = evaluations + SWEEPS + 1.0
    paid, cost, raised = (device.empty(target.shape) for _ in range(3))

    def divide(inside: float, outside: float) -> tuple[float, float]:
        own = {"lower": lower, "upper": upper, "target": target, "inside": inside, "outside": outside}
        device.launch(divide_prices, **own, paid=paid, cost=cost)
        return total(paid), total(cost)

    inside, caps = divide(1.0, 0.0)
    outside = divide(1.0, 1.0)[1] - caps
    if not inside > 0.0:
        return Bound(1.0, combine(0.0, paid, 0.0, paid, paid), spent)
    share = 1.0 / inside
    divide(share, 1.0 / outside if outside > 0.0 else 0.0)
    gain, loss = operator(paid), operator(cost)
    cover, light = columns, combine(0.0, columns, 0.0, columns, device.empty(columns.shape), floor=1.0)
    for sweep in range(SWEEPS):
        scale = _scale(gain, loss, cover, 1.0)
        if not 0.0 < scale < NEVER:  # nothing to cover, or the first cover fails everywhere
            scale = 1.0
        device.launch(light_short_pixels, paid=gain, cost=loss, cover=cover, scale=scale, light=light)
        operator.T(light, out=raised)
        device.launch(level_cover, rows=rows, reach=reach, cover=raised)
        cover = operator(raised, out=None if sweep == 0 else cover)
    price = total(raised)

    def leaving(left: float) -> tuple[float, float, float]:
        scale = _scale(gain, loss, cover, 1.0 - left)
        return share * (caps + left * inside) + scale * price, left, scale

    value, left, scale = min(_lowest(leaving, 1.0), leaving(0.0))
    value += ROUNDING * share * inside
    if not value < 1.0:
        return Bound(1.0, combine(0.0, paid, 0.0, paid, paid), spent)
    combine(1.0, cost, left + ROUNDING - 1.0, paid, cost)
    return Bound(value, combine(1.0, cost, scale, raised, cost), spent)


def _scale(paid: DeviceArray, cost: DeviceArray, cover: DeviceArray, keep: float) -> float:
    """What a cover is to be multiplied by so that ``keep`` of what is paid costs as much on every pixel."""
    highs = parts_for(cover_scale, paid)
    paid.device.launch(cover_scale, paid=paid, cost=cost, cover=cover, keep=keep, highs=highs)
    return folded(highs, HIGH)


def _lowest(of: Callable[[float], tuple[float, float, float]], most: float) -> tuple[float, float, float]:
    """Least of a convex function between 0 and most, by its first number; right of where it is not finite."""
    low, high = 0.0, most
    first, second = of(high - GOLDEN * (high - low)), of(low + GOLDEN * (high - low))
    for _ in range(TRIED):
        if first[0] < second[0]:
            high, second = second[1], first
            first = of(high - GOLDEN * (high - low))
        else:
            low, first = first[1], second
            second = of(low + GOLDEN * (high - low))
    return min(first, second)
