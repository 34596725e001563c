"""Numbers of turns and powers of light that satisfy three conditions on the doses of a turn.

(a) (N_R − 1)·D_in,max < T_opt: nothing in the part hardens, and bends light, before the last turn.
(b) N_R·D_in,min > T_mec: all of the part is firm at the end.
(c) N_R·D_out,max < T_opt: nothing else has hardened by then.
Doses of a turn are proportional to the power, and may be negative outside the part, where ultraviolet outweighs visible
light. Thresholds and doses share one unit, which may be any.

Source: the paper on binary photoinhibition, "Printability" and Fig. 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, inf, isfinite
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.geometry import counts, positive
from vamgpu.operators.reductions import EVERYWHERE, extent
from vamgpu.schema import check
from vamgpu.schema.quantities import Positive


@dataclass(frozen=True)
class Thresholds:
    """Doses at which resin begins to bend light (T_opt) and at which it is firm (T_mec ≥ T_opt). Raises `BadInput`."""

    optical: Positive
    mechanical: Positive

    def __post_init__(self) -> None:
        check(self)
        if self.mechanical < self.optical:
            raise BadInput(f"T_mec is {self.mechanical:g}, below T_opt = {self.optical:g}; resin is firm only after it "
                           "has begun to harden")  # fmt: skip

    @property
    def gap(self) -> float:
        """ΔT = T_mec − T_opt."""
        return self.mechanical - self.optical

    def delayed(self, dose: float) -> Thresholds:
        """Thresholds with more dissolved inhibitor: both are higher by ``dose``. Raises `BadInput` if T_opt < 0."""
        return Thresholds(self.optical + dose, self.mechanical + dose)


@dataclass(frozen=True)
class TurnDoses:
    """Extremes of the dose of one turn at full power: D_in,min, D_in,max and D_out,max. Raises `BadInput`."""

    in_least: float
    in_most: float
    out_most: float

    def __post_init__(self) -> None:
        values = (self.in_least, self.in_most, self.out_most)
        if not all(isfinite(value) for value in values) or self.in_least > self.in_most:
            raise BadInput(f"{self!r}: expected finite doses, and in_least ≤ in_most")

    @property
    def gap(self) -> float:
        """ΔD = D_in,min − D_out,max, of the worst pair of points."""
        return self.in_least - self.out_most

    @classmethod
    def of(cls, dose: Any, target: Any, reach: float = EVERYWHERE) -> TurnDoses:
        """Extremes of a dose [x, y, z] inside and outside a target, within ``reach`` [voxels]. Raises `EmptyMesh`."""
        if tuple(dose.shape) != tuple(target.shape):
            raise ShapeMismatch(f"the dose has shape {dose.shape}, the target {target.shape}; expected the same")
        if isinstance(dose, DeviceArray):
            inside, outside = extent(dose, target, 0.5, inf, reach), extent(dose, target, -inf, 0.5, reach)
        else:
            i, j = (np.arange(n) - 0.5 * (n - 1) for n in dose.shape[:2])
            near = np.broadcast_to((i[:, None] ** 2 + j[None] ** 2 <= reach**2)[..., None], dose.shape)
            part, rest = dose[near & (target >= 0.5)], dose[near & (target < 0.5)]
            inside, outside = (part.min(initial=inf), part.max(initial=-inf)), (0.0, rest.max(initial=-inf))
        if not isfinite(inside[0]) or not isfinite(outside[1]):
            raise EmptyMesh("no voxel is in the part, or none is out of it; printability compares the two")
        return cls(float(inside[0]), float(inside[1]), float(outside[1]))

    @classmethod
    def worst(cls, *cases: TurnDoses) -> TurnDoses:
        """The worst of several cases: conditions that hold for it hold for each. Raises `BadInput` without cases."""
        if not cases:
            raise BadInput("got no cases; expected at least one")
        return cls(min(c.in_least for c in cases), max(c.in_most for c in cases), max(c.out_most for c in cases))


@dataclass(frozen=True)
class PowerVerdict:
    """Whether the three conditions hold."""

    early: float  # margins until (a), (b) and (c) fail, in dose; not above 0 if one fails
    firm: float
    overcure: float

    @property
    def holds(self) -> bool:
        """Whether all three conditions hold."""
        return min(self.early, self.firm, self.overcure) > 0.0

    @classmethod
    def of(cls, before: TurnDoses, after: TurnDoses, thresholds: Thresholds) -> PowerVerdict:
        """Check doses before and after the last turn, for light whose effect is not proportional to turns."""
        return cls(thresholds.optical - before.in_most, after.in_least - thresholds.mechanical,
                   thresholds.optical - after.out_most)  # fmt: skip


@dataclass(frozen=True)
class LegalRange:
    """Powers at which a number of turns is allowed: between low and high, or none if low ≥ high."""

    turns: int
    low: float
    high: float

    @property
    def legal(self) -> bool:
        """Whether any power is allowed."""
        return self.low < self.high


class PowerWindow(LegalRange):
    """Powers at which a number of turns is allowed."""

    @property
    def middle(self) -> float:
        """Power at the geometric middle of the range; twice the lowest if there is no upper end."""
        return (self.low * self.high) ** 0.5 if isfinite(self.high) else 2.0 * self.low

    @property
    def tolerance(self) -> float:
        """Share by which the power may deviate from the middle; 0 if no power is allowed."""
        return max(0.0, 1.0 - self.low / self.middle) if self.legal else 0.0


def power_window(doses: TurnDoses, thresholds: Thresholds, turns: int) -> PowerWindow:
    """All powers at which ``turns`` turns meet (a) to (c); empty if the part gets no dose. Raises `BadInput`."""
    n = counts("turns", (turns,), 1)[0]
    low = thresholds.mechanical / (n * doses.in_least) if doses.in_least > 0 else inf
    early = thresholds.optical / ((n - 1) * doses.in_most) if n > 1 and doses.in_most > 0 else inf
    overcure = thresholds.optical / (n * doses.out_most) if doses.out_most > 0 else inf
    return PowerWindow(n, low, min(early, overcure))


def most_turns(doses: TurnDoses, thresholds: Thresholds) -> float:
    """The greatest allowed number of turns at the best power: inf if any number is allowed, 0 if none is."""
    # (a) and (b) require (N − 1)/N < T_opt·D_in,min/(T_mec·D_in,max), (b) and (c) T_opt·D_in,min > T_mec·D_out,max
    if not power_window(doses, thresholds, 1).legal:
        return 0
    ratio = thresholds.optical * doses.in_least / (thresholds.mechanical * doses.in_most)
    if ratio >= 1.0:
        return inf
    count = floor(1.0 / (1.0 - ratio)) + 1
    while count > 1 and not power_window(doses, thresholds, count).legal:
        count -= 1
    return count


def static_inhibition(doses: TurnDoses, thresholds: Thresholds, turns: int, power: float = 1.0) -> LegalRange:
    """The delay [dose] that allows ``turns`` turns at a power: (b) and (c) give N_R·ΔD > ΔT. Raises `BadInput`."""
    n, power = counts("turns", (turns,), 1)[0], positive("power", power)
    hottest = max(n * doses.out_most, (n - 1) * doses.in_most)
    low = max(power * hottest - thresholds.optical, -thresholds.optical)
    return LegalRange(n, low, n * power * doses.in_least - thresholds.mechanical)


def static_turns(doses: TurnDoses, thresholds: Thresholds, power: float = 1.0) -> float:
    """The least number of turns with N_R·ΔD > ΔT; inf if ΔD is not above 0. Raises `BadInput`."""
    gained = positive("power", power) * doses.gap
    return inf if gained <= 0.0 else floor(thresholds.gap / gained) + 1
