"""The certificate of a process window: dual variables that prove that no patterns have a wider one."""

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
from vamgpu.operators.compose import combine
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import folded, parts_for, total

if TYPE_CHECKING:
    from vamgpu.methods.plan import Plan

SWEEPS = 4  # number of successive covers; each has more light where the previous one was weakest
GOLDEN, TRIED = 0.5 * (5**0.5 - 1.0), 20
"""Golden ratio and number of steps of the search, to 1e-4, for the share of the part's gain that is cheaper to omit
than to cover; the bound is convex in it."""
ROUNDING = 1e-4
"""Share of the part's gain that is omitted because of float32 rounding, over a hundred times the rounding seen on any
device; it raises the bound by the same amount."""


@dataclass(frozen=True, eq=False, repr=False)
class Bound:
    """Upper bound on the strict process window of any patterns, which the dual variables prove.

    Let dual variables p be ≥ 0 outside the part, and A p ≥ 0 on every pixel. Patterns g ≥ 0 of greatest dose 1 have a
    dose D = Aᵀg, and 0 ≤ g·A p = p·D. Let a ≥ b be the least dose in the part and the greatest in the voids; then

        a − b ≤ 1 + Σ p inside + max(0, Σ p outside − 1),

    where the negative variables sum to −1 or more. The right side is the bound; the sums are rounded upwards.

    Attributes:
        value: The bound, a share of the greatest dose; 1, the widest possible window, if nothing is known.
        prices: Dual variable of each voxel [x, y, z], on the operator's device; 0 for voxels that are not judged.
        evaluations: Projector evaluations, including those of the run that found the dual variables.
        on: The voxels and the motion of the vial for which the bound holds, in words. It does not hold for finer voxels
            or another motion. Empty if the operator does not describe them.
    """

    value: float
    prices: DeviceArray = field(repr=False)
    evaluations: float
    on: str = ""

    def share(self, plan: Plan | float) -> float:
        """Divide a window by the bound.

        Args:
            plan: A plan, or a strict window relative to the greatest dose.

        Returns:
            The window as a fraction of the bound.
        """
        return _window(plan) / self.value

    def statement(self, plan: Plan | float | None = None) -> str:
        """Describe the bound in words, and how close a window comes to it.

        Args:
            plan: A plan, or a strict window relative to the greatest dose; None for only the bound.

        Returns:
            One sentence.
        """
        said = f"no patterns give more than {self.value:+.3f}{f' on {self.on}' if self.on else ''}"
        return said if plan is None else f"{said}; this one has {_window(plan):+.3f} ({100 * self.share(plan):.0f} %)"

    def __repr__(self) -> str:
        return f"Bound({self.statement()}; {self.evaluations:g} evaluations)"


def _window(plan: Plan | float) -> float:
    window = getattr(plan, "window", plan)
    if isinstance(window, bool) or not isinstance(window, Real) or not isfinite(window):
        raise BadInput(f"got {plan!r}; expected a plan, or a strict window relative to the greatest dose")
    return float(window)


def certified(
    operator: Operator, target: DeviceArray, reach: float, lower: DeviceArray, upper: DeviceArray,
    rows: DeviceArray, columns: DeviceArray, evaluations: float = 0.0,
) -> Bound:  # fmt: skip
    """The bound by a run's multipliers, 0 where voxels do not count, made feasible; takes `SWEEPS` + 1 evaluations."""
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
        if not 0.0 < scale < NEVER:  # there is nothing to cover, or the first cover fails everywhere
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


def limited(
    operator: Operator, target: DeviceArray, lower: DeviceArray, upper: DeviceArray, most: float, evaluations: float
) -> Bound:  # fmt: skip
    """The bound for light of at most ``most`` times the greatest dose: what A p lacks to 0 costs that many times it."""
    device = operator.device
    paid, cost = device.empty(target.shape), device.empty(target.shape)
    own = {"lower": lower, "upper": upper, "target": target, "inside": 1.0, "outside": 0.0}
    device.launch(divide_prices, **own, paid=paid, cost=cost)
    inside, caps = total(paid), total(cost)
    device.launch(divide_prices, **own | {"outside": 1.0}, paid=paid, cost=cost)
    share, outside = 1.0 / max(1.0, inside), total(cost) - caps
    prices = combine(share, cost, -share, paid, cost)
    short = operator(prices)
    value = 1.0 + share * (caps - inside) + max(0.0, share * outside - 1.0) + ROUNDING
    value += most * total(combine(-1.0, short, 0.0, short, short, floor=0.0))
    on = f"light of at most {most:.4g} times the greatest dose"
    return Bound(min(value, 1.0), prices if value < 1.0 else combine(0.0, prices, 0.0, prices, prices), evaluations, on)


def _scale(paid: DeviceArray, cost: DeviceArray, cover: DeviceArray, keep: float) -> float:
    """Factor of a cover at which ``keep`` of the gain is balanced on every pixel."""
    highs = parts_for(cover_scale, paid)
    paid.device.launch(cover_scale, paid=paid, cost=cost, cover=cover, keep=keep, highs=highs)
    return folded(highs, HIGH)


def _lowest(of: Callable[[float], tuple[float, float, float]], most: float) -> tuple[float, float, float]:
    """The least first result of a convex function between 0 and most; the function may be infinite at small values."""
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
