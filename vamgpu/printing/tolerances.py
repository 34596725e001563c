"""What a print bears: the same frames through a machine that is off by a little, and the first voxel that goes wrong.

Each scenario is one exposure by the solver's kind of operator with one thing changed: half a projector evaluation. What
it changes is added to the proved dose, voxel by voxel. The exposure time stays as it is: one threshold, that of the
proof, tells wrong voxels in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite, nan

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.update import linear
from vamgpu.metrics.depth import signed_depth
from vamgpu.metrics.histogram import above, extremes
from vamgpu.metrics.parts import IN, OUT, Parts
from vamgpu.metrics.scores import score
from vamgpu.operators.compose import NO_FLOOR
from vamgpu.operators.projection import Projection
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.scenarios import SCENARIOS, Scenario
from vamgpu.targets.limits import Limits

REFINED = 2
"""Exposures, at most, that close in on a first wrong voxel between two known amounts."""
_CLOSE = 0.002
"""Of the greatest dose: a voxel this near to the threshold is where the search ends."""
_HALF = 0.499
"""Voxels: a center half a voxel deep counts as being there whatever the rounding, e.g. in a print of one slice."""


@dataclass(frozen=True)
class ToleranceRow:
    """One scenario.

    Args:
        name: what is off.
        change: by how much, with its unit.
        half_voxel: W at half a voxel; NaN where the part is nowhere as thick as a voxel or the scenario means nothing.
        window: strict window over the part's own voxels.
        missing: voxels of the part that would not print; None where there are no numbers.
        excess: voxels outside that would; likewise.
        note: why there are no numbers; empty where there are.
    """

    name: str
    change: str
    half_voxel: float = nan
    window: float = nan
    missing: int | None = None
    excess: int | None = None
    note: str = ""

    @property
    def wrong(self) -> int | None:
        """Voxels that would print wrong; None where there are no numbers."""
        return None if self.missing is None or self.excess is None else self.missing + self.excess


@dataclass(frozen=True)
class FirstWrong:
    """The first amount at which a voxel prints wrong.

    Args:
        name: what is off.
        amount: by how much; 0 where a voxel is wrong already, NaN where none is up to ``farthest``.
        farthest: amount up to which it was searched, with its sign; less than asked where more means nothing, 0 where
            no amount means anything.
        text: the amount with its unit, or what there is to say instead.
    """

    name: str
    amount: float
    farthest: float
    text: str


@dataclass(frozen=True)
class ToleranceTable:
    """What a print bears.

    Args:
        nominal: the print as it should be.
        rows: the scenarios, in the order of `SCENARIOS`.
        first_wrong: of every scenario of which some amount could be exposed, below and above.
        exposures: back projections that the table took, each half a projector evaluation.
    """

    nominal: ToleranceRow
    rows: tuple[ToleranceRow, ...]
    first_wrong: tuple[FirstWrong, ...]
    exposures: int

    def limits(self, name: str) -> tuple[FirstWrong, ...]:
        """The first wrong voxels of one scenario."""
        return tuple(first for first in self.first_wrong if first.name == name)


def tolerance_table(
    A: Projection,
    light: DeviceArray,
    fraction: DeviceArray,
    *,
    proved: DeviceArray | None = None,
    threshold: float | None = None,
    half_voxel: float | None = None,
    limits: Limits | None = None,
    scenarios: Sequence[Scenario] = SCENARIOS,
) -> ToleranceTable:
    """Expose the same light through machines that are off by a little.

    Args:
        A: the operator the light was made for; only a plain `Projection` can be varied, for others the rows say so.
        light: of every pixel and angle [angle, r, z] on the device of ``A``.
        fraction: of the part [x, y, z], on the same device.
        proved: dose of the independent proof [x, y, z], in units of Aᵀ(light); Aᵀ(light) itself by default.
        threshold: dose from which a voxel prints; by default the one with the best overlap.
        half_voxel: proved W at half a voxel, found on finer voxels; that of the part's own voxels by default.
        limits: what single voxels are asked for; None where the part is to print and nothing else.
        scenarios: what may be off.

    Raises:
        BadInput: no voxel of the part is judged.
        ShapeMismatch, DeviceError: fields that do not fit ``A``.
    """
    exact = _Nominal(A, light, fraction, proved, threshold, limits)
    known_half = exact.nominal.half_voxel if half_voxel is None else half_voxel
    finer = known_half - exact.nominal.half_voxel
    rows: list[ToleranceRow] = []
    first: list[FirstWrong] = []
    for scenario in scenarios:
        known: dict[float, _Seen] = {}
        for amount in scenario.amounts:
            change = scenario.written(amount)
            try:
                known[amount] = exact.exposed(scenario, amount)
            except BadInput as error:
                rows.append(ToleranceRow(scenario.name, change, note=str(error)))
            else:
                rows.append(known[amount].row(scenario.name, change, finer))
        if known:
            first += [_first_wrong(exact, scenario, sign, known) for sign in scenario.signs]
    return ToleranceTable(exact.nominal.row("as it should be", "", finer), tuple(rows), tuple(first), exact.exposures)


# ---- one exposure after the other -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Seen:
    """What an exposure did; margin: how far the threshold is from the nearest voxel that would go wrong, over the peak
    of the print as it should be, below 0 where one is wrong."""

    window: float
    half_voxel: float
    missing: int
    excess: int
    margin: float

    def row(self, name: str, change: str, finer: float) -> ToleranceRow:
        """As a row of the table; finer: what W at half a voxel is more on finer voxels."""
        return ToleranceRow(name, change, self.half_voxel + finer, self.window, self.missing, self.excess)


class _Nominal:
    """The print as it should be, and the same light exposed otherwise."""

    def __init__(
        self,
        A: Projection,
        light: DeviceArray,
        fraction: DeviceArray,
        proved: DeviceArray | None,
        threshold: float | None,
        limits: Limits | None = None,
    ) -> None:
        self.A, self.light, self.fraction, self.limits = A, light, fraction, limits
        depth = signed_depth(np.pad(fraction.numpy(), 2), 1.0)[2:-2, 2:-2, 2:-2]
        deep, far = (each if limits is None else limits.classes(each) for each in (depth, -depth))
        self._deep, self._far = fraction.device.upload(deep), fraction.device.upload(far)
        self.dose, self.exposures = A.T(light), 1
        self._more: DeviceArray | None = None
        if proved is not None:
            self._more = _combined(1.0, proved, -1.0, self.dose)
            self.dose = proved
        held = judged_parts(self.dose, fraction, limits)
        scores = score(held.dose, held.target, threshold=threshold)
        self.threshold, self.peak = scores.threshold, scores.peak or 1.0
        self.least, self.greatest = scores.least_in, scores.greatest_out
        self.nominal = self._seen(self.dose, 1.0)

    def exposed(self, scenario: Scenario, amount: float) -> _Seen:
        """The light in a machine that is off by an amount. Raises `BadInput` where that means nothing."""
        if scenario.off is None:
            return self._seen(self.dose, 1.0 + amount)
        if not isinstance(self.A, Projection):
            raise BadInput(f"{type(self.A).__name__} is exposed as it is; only a plain Projection is varied")
        dose = scenario.off(self.A, amount).T(self.light)
        self.exposures += 1
        return self._seen(dose if self._more is None else _combined(1.0, dose, 1.0, self._more), 1.0)

    def _seen(self, dose: DeviceArray, times: float) -> _Seen:
        """Judge a dose that is exposed ``times`` as long; no copy of it is made."""
        parts, at = judged_parts(dose, self.fraction, self.limits), self.threshold / times
        dose = parts.dose
        ends, counts = extremes(parts), above(parts, at)[0]
        peak = float(ends.greatest.max()) or 1.0
        least, greatest = float(ends.least[0, IN]), max(float(ends.greatest[0, OUT]), 0.0)
        deep = float(extremes(Parts(dose, self._deep, _HALF)).least[0, IN])
        far = max(float(extremes(Parts(dose, self._far, _HALF)).greatest[0, IN]), 0.0)
        return _Seen(
            window=(least - greatest) / peak,
            half_voxel=(deep - far) / peak if isfinite(deep) else nan,
            missing=int(counts[IN, 0]),
            excess=int(counts[OUT, 1]),
            margin=min(least - at, at - greatest) * times / self.peak,
        )


def _combined(a: float, x: DeviceArray, b: float, y: DeviceArray) -> DeviceArray:
    """a·x + b·y, a new field."""
    out = x.device.empty(x.shape)
    x.device.launch(linear, a=a, x=x, b=b, y=y, floor=NO_FLOOR, out=out)
    return out


# ---- the first wrong voxel ------------------------------------------------------------------------------------------
Point = tuple[float, float]
"""An amount, and how far the print is from a wrong voxel there; below 0 there are some."""


def _first_wrong(exact: _Nominal, scenario: Scenario, sign: int, known: dict[float, _Seen]) -> FirstWrong:
    """The first amount of one sign at which a voxel is wrong."""
    farthest = sign * scenario.farthest
    if exact.nominal.missing + exact.nominal.excess:
        return FirstWrong(scenario.name, 0.0, farthest, "wrong already")
    if scenario.off is None:
        amount = _of_dose(exact, sign)
    else:
        amount, farthest = _closed_in(exact, scenario, farthest, known)
    if not abs(amount) <= scenario.farthest:
        text = f"none up to {scenario.written(farthest)}" if farthest else "not exposed"
        return FirstWrong(scenario.name, nan, farthest, text)
    return FirstWrong(scenario.name, amount, farthest, scenario.written(amount, 2))


def _of_dose(exact: _Nominal, sign: int) -> float:
    """Less or more time: known without an exposure. NaN where no dose is outside."""
    nearest = exact.least if sign < 0 else exact.greatest
    return exact.threshold / nearest - 1.0 if nearest > 0 else nan


def _closed_in(exact: _Nominal, scenario: Scenario, farthest: float, known: dict[float, _Seen]) -> tuple[float, float]:
    """The amount by interpolation between a good and a bad one, NaN where none is bad; and the farthest looked at.

    Where the farthest means nothing that is the largest amount that was exposed, 0 if there is none.
    """
    good: Point = (0.0, exact.nominal.margin)
    bad: Point | None = None
    for amount in sorted((a for a in known if a * farthest > 0), key=abs):
        margin = known[amount].margin
        if margin < 0:
            bad = (amount, margin)
            break
        good = (amount, margin)
    if bad is None:
        try:
            bad = (farthest, exact.exposed(scenario, farthest).margin)
        except BadInput:
            return nan, good[0]
    if bad[1] >= 0:
        return nan, farthest
    with suppress(BadInput):
        for _ in range(REFINED):
            amount = _crossing(good, bad)
            margin = exact.exposed(scenario, amount).margin
            good, bad = (good, (amount, margin)) if margin < 0 else ((amount, margin), bad)
            if abs(margin) < _CLOSE:
                break
    return _crossing(good, bad), farthest


def _crossing(good: Point, bad: Point) -> float:
    """Where the straight line through two points is 0."""
    return good[0] + (bad[0] - good[0]) * good[1] / (good[1] - bad[1])
