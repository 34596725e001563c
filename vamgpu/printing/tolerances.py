"""Sensitivity to errors: the same frames on a machine with an error, which grows until the first voxel is wrong.

The change in dose of the solver's type of operator is added to the proved dose, at the same threshold.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import ahead
from vamgpu.errors import BadInput
from vamgpu.metrics.depth import LARGEST_REACH, padded_depth
from vamgpu.metrics.histogram import above, extremes
from vamgpu.metrics.parts import IN, OUT
from vamgpu.metrics.scores import score
from vamgpu.operators.compose import combine
from vamgpu.operators.projection import Projection, prepared
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.scenarios import SCENARIOS, Scenario
from vamgpu.targets.limits import NOWHERE, Limits

REFINED = 2
"""Greatest number of exposures in the search for a first wrong voxel between known amounts; one more beyond them."""
_CLOSE = 0.002
"""Share of the greatest dose: the search ends when the nearest voxel is this near to the threshold, on either side."""


@dataclass(frozen=True)
class ToleranceRow:
    """One scenario."""

    name: str
    change: str  # the amount, with its unit
    window: float = nan  # strict window of the part's own voxels that count; NaN if the scenario does not apply
    missing: int | None = None  # voxels of the part that would not print; None without numbers
    excess: int | None = None  # voxels outside that would print; None without numbers
    note: str = ""  # reason why there are no numbers; otherwise empty

    @property
    def wrong(self) -> int | None:
        """Voxels that would print incorrectly; None without numbers."""
        return None if self.missing is None or self.excess is None else self.missing + self.excess


@dataclass(frozen=True)
class FirstWrong:
    """The least amount at which a voxel prints incorrectly."""

    name: str
    amount: float  # 0 if a voxel is wrong without an error, NaN if none is wrong up to ``farthest``
    # greatest amount that was searched, with its sign; smaller than requested if larger amounts do not apply, 0 if no
    # amount applies
    farthest: float
    text: str  # the amount with its unit, or a text instead


@dataclass(frozen=True)
class ToleranceTable:
    """The sensitivity of a print to errors."""

    nominal: ToleranceRow  # the print without errors
    rows: tuple[ToleranceRow, ...]  # the scenarios, in the order of `SCENARIOS`
    first_wrong: tuple[FirstWrong, ...]  # of every scenario with an amount that could be exposed, in both directions
    exposures: int  # number of back projections, each half a projector evaluation

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
    limits: Limits | None = None,
    deep: float = 0.0,
    scenarios: Sequence[Scenario] = SCENARIOS,
) -> ToleranceTable:
    """Expose the same light on machines with small errors."""
    # light [angle, r, z]; fraction [x, y, z]; proved [x, y, z]; deep [mm]
    exact = _Nominal(A, light, fraction, proved, threshold, limits, deep)
    asked = [(scenario, amount) for scenario in scenarios for amount in scenario.amounts]
    rows: list[ToleranceRow] = []
    known: dict[str, dict[float, _Seen]] = {scenario.name: {} for scenario in scenarios}
    for (scenario, amount), seen in zip(asked, exact.exposed(asked), strict=True):
        change = scenario.written(amount)
        if isinstance(seen, BadInput):
            rows.append(ToleranceRow(scenario.name, change, note=str(seen)))
        else:
            known[scenario.name][amount] = seen
            rows.append(seen.row(scenario.name, change))
    searches = [(scenario, _first_wrong(exact, scenario, sign, known[scenario.name]))
                for scenario in scenarios if known[scenario.name] for sign in scenario.signs]  # fmt: skip
    first = _together(exact, searches)
    return ToleranceTable(exact.nominal.row("nominal", ""), tuple(rows), first, exact.exposures)


@dataclass(frozen=True)
class _Seen:
    """The effect of one exposure on the voxels that count."""

    # least, greatest: doses in the part and outside. margin: distance of the threshold from the nearest voxel's dose on
    # either side, over the peak of the nominal print; below 0 if a voxel is wrong.

    least: float
    greatest: float
    window: float
    missing: int
    excess: int
    margin: float

    def row(self, name: str, change: str) -> ToleranceRow:
        """The effect as a row of the table."""
        return ToleranceRow(name, change, self.window, self.missing, self.excess)


class _Nominal:
    """The nominal print, and the same light exposed with errors."""

    def __init__(
        self,
        A: Projection,
        light: DeviceArray,
        fraction: DeviceArray,
        proved: DeviceArray | None,
        threshold: float | None,
        limits: Limits | None = None,
        far_off: float = 0.0,
    ) -> None:
        self.A, self.light, self.limits = A, light, limits
        self.fraction = fraction
        if far_off:
            counted = _far_from_the_surface(fraction, far_off / A.grid.pitch, A.beam.flat)
            self.fraction = fraction.device.upload(counted)
        self.dose, self.exposures = A.T(light), 1
        self._more: DeviceArray | None = None
        if proved is not None:
            self._more = combine(1.0, proved, -1.0, self.dose, self.dose)
            self.dose = proved
        held = judged_parts(self.dose, fraction, limits)
        scores = score(held.dose, held.target, threshold=threshold)
        self.threshold, self.peak = scores.threshold, scores.peak or 1.0
        self.nominal = self._seen(self.dose, 1.0)

    def exposed(self, asked: Sequence[tuple[Scenario, float]]) -> Iterator[_Seen | BadInput]:
        """The light on machines with errors of these amounts, or why an error does not apply; threads make tables."""
        for (_, amount), made in zip(asked, ahead(lambda one: _prepared(self.A, *one), asked), strict=True):
            if made is None:
                yield self._seen(self.dose, 1.0 + amount)
            elif isinstance(made, BadInput):
                yield made
            else:
                dose = made().T(self.light)
                self.exposures += 1
                yield self._seen(dose if self._more is None else combine(1.0, dose, 1.0, self._more, dose), 1.0)

    def _seen(self, dose: DeviceArray, times: float) -> _Seen:
        """Judge a dose that is exposed ``times`` as long, without a copy."""
        parts, at = judged_parts(dose, self.fraction, self.limits), self.threshold / times
        dose = parts.dose
        ends, counts = extremes(parts), above(parts, at)[0]
        peak = float(ends.greatest.max()) or 1.0
        least, greatest = float(ends.least[0, IN]), max(float(ends.greatest[0, OUT]), 0.0)
        return _Seen(
            least=least,
            greatest=greatest,
            window=(least - greatest) / peak,
            missing=int(counts[IN, 0]),
            excess=int(counts[OUT, 1]),
            margin=min(least - at, at - greatest) * times / self.peak,
        )


def _prepared(A: Any, scenario: Scenario, amount: float) -> Callable[[], Projection] | BadInput | None:
    """The projection of a machine with an error, or why the error does not apply; None if only the dose is scaled."""
    if scenario.off is None:
        return None
    if not isinstance(A, Projection):
        return BadInput(f"got {type(A).__name__}; expected a Projection, whose light no insert or medium bends")
    try:
        return prepared(A, *scenario.off(A, amount))
    except BadInput as error:
        return error


def _far_from_the_surface(field: DeviceArray, voxels: float, flat: bool) -> np.ndarray:
    """The fractions, with `NOWHERE` closer to the surface than ``voxels``; all fractions if no voxel is that deep."""
    reach, fraction = min(voxels * (1.0 - 1e-3), LARGEST_REACH - 3.0), field.numpy()
    depth, pad = padded_depth(fraction, reach, flat, field.device)
    counted = np.where(np.abs(depth[pad:-pad, pad:-pad, pad:-pad]) >= reach, fraction, NOWHERE).astype(np.float32)
    return counted if (counted >= 0.5).any() else fraction


Point = tuple[float, float]
"""An amount, and the margin of the print with it; below 0 if voxels are wrong."""
Search = Generator[float, "_Seen | BadInput", FirstWrong]
"""A search that asks for the effect of amounts."""


def _together(exact: _Nominal, searches: Sequence[tuple[Scenario, Search]]) -> tuple[FirstWrong, ...]:
    """Results of searches, which all wait for their next amounts together."""
    found: dict[int, FirstWrong] = {}
    answers: dict[int, Any] = dict.fromkeys(range(len(searches)))
    while answers:
        asked: dict[int, float] = {}
        for number, answer in answers.items():
            try:
                asked[number] = searches[number][1].send(answer)
            except StopIteration as end:
                found[number] = end.value
        seen = exact.exposed([(searches[number][0], amount) for number, amount in asked.items()])
        answers = dict(zip(asked, seen, strict=True))
    return tuple(found[number] for number in range(len(searches)))


def _first_wrong(exact: _Nominal, scenario: Scenario, sign: int, known: dict[float, _Seen]) -> Search:
    """The first amount of one sign at which a voxel is wrong."""
    farthest = sign * scenario.farthest
    if exact.nominal.missing + exact.nominal.excess:
        return FirstWrong(scenario.name, 0.0, farthest, "wrong without an error")
    if scenario.off is None:  # a shorter or longer time is known without an exposure
        nearest = exact.nominal.least if sign < 0 else exact.nominal.greatest
        amount = exact.threshold / nearest - 1.0 if nearest > 0 else nan
    else:
        amount, farthest = yield from _closed_in(exact, farthest, known)
    if not abs(amount) <= scenario.farthest:
        text = f"none up to {scenario.written(farthest)}" if farthest else "not exposed"
        return FirstWrong(scenario.name, nan, farthest, text)
    return FirstWrong(scenario.name, amount, farthest, scenario.written(amount, 2))


def _closed_in(
    exact: _Nominal, farthest: float, known: dict[float, _Seen]
) -> Generator[float, _Seen | BadInput, tuple[float, float]]:
    """The amount, interpolated between a good and a bad one, NaN if none is bad; and the greatest amount searched."""
    # If the next amount does not apply, this is the largest amount that was exposed, or 0 if there is none.
    good: list[Point] = [(0.0, exact.nominal.margin)]
    bad: list[Point] = []
    for amount in sorted((a for a in known if a * farthest > 0), key=abs):
        (good if known[amount].margin >= 0 else bad).append((amount, known[amount].margin))
        if bad:
            break
    for tried in range(REFINED + (not bad)):
        amount = _crossing(good, bad, farthest) if bad or not tried else farthest
        seen = yield amount
        if isinstance(seen, BadInput):
            break
        good, bad = ([*good, (amount, seen.margin)], bad) if seen.margin >= 0 else (good, [(amount, seen.margin)])
        if good[-1][0] == farthest:
            return nan, farthest
        crossing = _crossing(good, bad, farthest)
        if abs(seen.margin) < _CLOSE and crossing != farthest:
            return crossing, farthest
    return (_crossing(good, bad, farthest), farthest) if bad else (nan, good[-1][0])


def _crossing(good: list[Point], bad: list[Point], farthest: float) -> float:
    """The next amount at which a parabola through the last three margins, or a line through two, reaches 0."""
    amounts, margins = zip(*(good + bad)[-3:], strict=True)
    roots = np.roots(np.polyfit(amounts, margins, len(amounts) - 1))
    near, limit = good[-1][0], bad[-1][0] if bad else farthest
    ahead = [float(root.real) for root in roots if not root.imag and (root.real - near) * (limit - root.real) >= 0]
    return min(ahead, key=abs, default=limit)
