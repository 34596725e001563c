"""Rules that compare a buildup with the design and project what is missing or too much: SC, SC2 and DC.

Source: B. Wang et al., Lateral contrast enhancement via binary photoinhibition, "Periodicity", Figs 6 and 8. The text
leaves scales open; what is chosen here is said where it is chosen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod, sqrt
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput
from vamgpu.methods.dual.colors import Colors, Pass, constant
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.reductions import dot, extent

PASSES = 23
"""The paper's limit."""
ENOUGH = 1e-6
"""Root mean square of undersupply at which the paper stops; not expected to be reached."""


class Bench:
    """Fields and sinograms of one run, and the steps the rules share."""

    def __init__(self, colors: Colors, design: DeviceArray) -> None:
        self.colors, self.design, self.device = colors, design, design.device
        self.light = self.sinogram()
        self.uv: DeviceArray | None = None
        self.pairs = 0.0
        self.count = 0

    def volume(self) -> DeviceArray:
        return self.device.empty(self.design.shape)

    def sinogram(self) -> DeviceArray:
        return self.device.empty(self.colors.visible.range.shape)

    def paint(self, pattern: DeviceArray, operator: LinearOperator, out: DeviceArray) -> None:
        """A pattern of dose as light, by the painter or by the color's own operator."""
        (self.colors.painter or operator)(pattern, out=out)
        self.pairs += 0.5

    def expose(self, operator: LinearOperator, light: DeviceArray, out: DeviceArray) -> None:
        operator.T(light, out=out)
        self.pairs += 0.5

    def greatest(self, field: DeviceArray) -> float:
        return max(extent(field)[1], 1e-30)

    def scale(self, factor: float, field: DeviceArray) -> None:
        combine(factor, field, 0.0, field, field)

    def start(self, dose: DeviceArray) -> None:
        """Light painted from the design and its buildup, both scaled so that the greatest dose is the design's."""
        self.paint(self.design, self.colors.visible, self.light)
        self.expose(self.colors.visible, self.light, dose)
        factor = self.greatest(self.design) / self.greatest(dose)
        self.scale(factor, self.light)
        self.scale(factor, dose)

    def gain(self, operator: LinearOperator) -> float:
        """A bound of the greatest eigenvalue of painting and exposing: the greatest dose of a painted 1."""
        one, light = constant(1.0, self.colors.visible.domain.shape, self.design), self.sinogram()
        self.paint(one, operator, light)
        self.expose(operator, light, one)
        return self.greatest(one)

    def step(self, operator: LinearOperator) -> float:
        """Length of a step that is sure to descend."""
        return 1.5 / self.gain(operator)

    def compare(self, dose: DeviceArray, most: DeviceArray, under: DeviceArray, over: DeviceArray) -> Pass:
        """under = max(0, design − dose), over = max(0, dose − most)."""
        combine(1.0, self.design, -1.0, dose, under, 0.0)
        combine(1.0, dose, -1.0, most, over, 0.0)
        self.count += 1
        rms = (sqrt(dot(field, field) / prod(field.shape)) for field in (under, over))
        return Pass(self.count, self.pairs, *rms)


@dataclass(frozen=True)
class SingleColor:
    """SC: the design projected and nothing more; the greatest dose is the design's."""

    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def steps(self, bench: Bench) -> Iterator[Pass]:
        """One pass."""
        dose = bench.volume()
        bench.start(dose)
        yield bench.compare(dose, bench.design, bench.volume(), bench.volume())


@dataclass(frozen=True)
class Tolerant:
    """SC2: one color, corrected by what the part lacks and by what exceeds a one-sided tolerance around it.

    tolerance: dose allowed anywhere, over the greatest of the design; gray values below it are ignored where the dose
    is too high, as in the paper.  passes: at most.  enough: root mean square of undersupply at which it stops.
    The scale of the first pass is kept, so that passes are steps of a projected descent.  Raises `BadInput`.
    """

    tolerance: float = 0.75
    passes: int = PASSES
    enough: float = ENOUGH
    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance < 1.0 or self.passes < 1 or not self.enough >= 0.0:
            raise BadInput(f"{self!r}: wanted 0 ≤ tolerance < 1, passes ≥ 1 and enough ≥ 0")

    def steps(self, bench: Bench) -> Iterator[Pass]:
        """One pass is one projector pair. Oversupply is that beyond the tolerance."""
        dose, under, over, change = bench.volume(), bench.volume(), bench.volume(), bench.sinogram()
        bench.start(dose)
        most, step = bench.volume(), bench.step(bench.colors.visible)
        combine(1.0, bench.design, 0.0, bench.design, most, self.tolerance * bench.greatest(bench.design))
        while True:
            record = bench.compare(dose, most, under, over)
            yield record
            if record.number >= self.passes or record.error < self.enough:
                return
            combine(1.0, under, -1.0, over, under)
            bench.paint(under, bench.colors.visible, change)
            combine(1.0, bench.light, step, change, bench.light, 0.0)
            bench.expose(bench.colors.visible, bench.light, dose)


@dataclass(frozen=True)
class DualColor:
    """DC: what is too much becomes UV light, what is too little more visible light.

    recompute: True, the default, is the rule of the text, what it leaves open settled as the erratum has it. The
    oversupply of the visible buildup, scaled by its maximum, is painted anew as UV light in every pass, while
    undersupply adds up in the visible light; both buildups are then scaled by one factor, the maximum of their
    difference (never by minimum and maximum). UV light is as bright as painted, or dimmer where it could undo more than
    the greatest oversupply: a thin part in a wide void would have no dose left. Undersupply falls, oversupply grows
    with the passes, since the visible light grows and the UV light does not: read both, and take False for contrast.
    False keeps the scale of the first pass, compares the difference of the buildups, and adds to both colors:
    a projected descent that lowers both.
    passes: at most.  enough: root mean square of undersupply at which it stops.  Raises `BadInput`.
    """

    recompute: bool = True
    passes: int = PASSES
    enough: float = ENOUGH
    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def __post_init__(self) -> None:
        if self.passes < 1 or not self.enough >= 0.0:
            raise BadInput(f"{self!r}: wanted passes ≥ 1 and enough ≥ 0")

    def steps(self, bench: Bench) -> Iterator[Pass]:
        """One pass is two projector pairs. Leaves the light scaled so that the greatest dose is the design's."""
        bench.uv = bench.sinogram()
        yield from self._text(bench) if self.recompute else self._kept(bench)

    def _text(self, bench: Bench) -> Iterator[Pass]:
        uv, colors, peak = bench.uv, bench.colors, bench.greatest(bench.design)
        assert uv is not None
        dose, undone, under, over = (bench.volume() for _ in range(4))
        light, change, scaled = bench.sinogram(), bench.sinogram(), bench.sinogram()
        gain = bench.gain(colors.uv) * colors.strength
        bench.paint(bench.design, colors.visible, light)
        while True:
            bench.expose(colors.visible, light, dose)
            scale = peak / bench.greatest(dose)
            combine(scale, dose, -1.0, bench.design, over, 0.0)
            bench.scale(min(1.0, 1.0 / (scale * gain)), over)
            bench.paint(over, colors.uv, scaled)
            bench.expose(colors.uv, scaled, undone)
            combine(1.0, dose, -colors.strength, undone, dose)
            factor = peak / bench.greatest(dose)
            bench.scale(factor, dose)
            combine(factor, scaled, 0.0, scaled, uv)
            combine(factor, light, 0.0, light, bench.light)
            record = bench.compare(dose, bench.design, under, over)
            yield record
            if record.number >= self.passes or record.undersupply < self.enough:
                return
            bench.paint(under, colors.visible, change)
            combine(1.0, light, 1.0, change, light)

    def _kept(self, bench: Bench) -> Iterator[Pass]:
        uv, colors = bench.uv, bench.colors
        assert uv is not None
        dose, undone, under, over = (bench.volume() for _ in range(4))
        change, step, uv_step = bench.sinogram(), bench.step(colors.visible), bench.step(colors.uv)
        bench.start(dose)
        bench.uv = uv = constant(0.0, colors.uv.range.shape, uv)  # not 0·uv: it may hold NaN
        while True:
            record = bench.compare(dose, bench.design, under, over)
            yield record
            if record.number >= self.passes or record.undersupply < self.enough:
                return
            bench.paint(under, colors.visible, change)
            combine(1.0, bench.light, step, change, bench.light)
            bench.paint(over, colors.uv, change)
            combine(1.0, uv, uv_step / colors.strength, change, uv)
            bench.expose(colors.visible, bench.light, dose)
            bench.expose(colors.uv, uv, undone)
            combine(1.0, dose, -colors.strength, undone, dose)
