"""Rules that project missing and excess dose: SC, SC2 and DC of B. Wang et al., Lateral contrast enhancement via binary
photoinhibition, "Periodicity", Figs 6 and 8. Comments mark choices that the paper leaves open.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod, sqrt
from typing import Any, ClassVar, Protocol, cast

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput
from vamgpu.methods.dual.colors import Colors, Pair, Pass, constant
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.reductions import dot, extent

PASSES = 23  # the paper's limit
ENOUGH = 1e-6  # root mean square of undersupply at which the paper stops; it is usually not reached


class DualState(OptimizerState):
    """One run of a rule: the light of both colors, and the steps that the rules share."""

    evaluations: float

    def __init__(self, colors: Colors, design: DeviceArray) -> None:
        super().__init__(cast(Any, colors.visible), design, {}, "loss")
        self.colors = colors
        self.light: DeviceArray = self.sinogram()
        self.uv: DeviceArray | None = None
        self.count: int = 0

    def light_of(self, pattern: DeviceArray, operator: LinearOperator, out: DeviceArray) -> None:
        """out = a pattern of dose as light, by the projector or by the color's own operator; half an evaluation."""
        (self.colors.projector or operator)(pattern, out=out)
        self.evaluations += 0.5

    def dose_of(self, light: DeviceArray, operator: LinearOperator, out: DeviceArray) -> None:
        """out = the dose of light of a color; half an evaluation."""
        operator.T(light, out=out)
        self.evaluations += 0.5

    def greatest(self, field: DeviceArray) -> float:
        return max(extent(field)[1], 1e-30)

    def start(self, dose: DeviceArray) -> None:
        """Light projected from the design, and its buildup, both scaled to give the design's greatest dose."""
        self.light_of(self.target, self.colors.visible, self.light)
        self.dose_of(self.light, self.colors.visible, dose)
        factor = self.greatest(self.target) / self.greatest(dose)
        self.scale(factor, self.light, self.light)
        self.scale(factor, dose, dose)

    def gain(self, operator: LinearOperator) -> float:
        """Upper bound of the greatest eigenvalue of projecting and exposing: the greatest dose of a volume of ones."""
        nx, ny, nz = self.target.shape
        one, light = constant(1.0, (nx, ny, nz), self.target), self.sinogram()
        self.light_of(one, operator, light)
        self.dose_of(light, operator, one)
        return self.greatest(one)

    def descent_step(self, operator: LinearOperator) -> float:
        """Length of a step that is certain to descend."""
        return 1.5 / self.gain(operator)

    def compare(self, dose: DeviceArray, most: DeviceArray, under: DeviceArray, over: DeviceArray) -> Pass:
        """under = max(0, design − dose), over = max(0, dose − most)."""
        combine(1.0, self.target, -1.0, dose, under, 0.0)
        combine(1.0, dose, -1.0, most, over, 0.0)
        self.count += 1
        rms = (sqrt(dot(field, field) / prod(field.shape)) for field in (under, over))
        return Pass(self.count, self.evaluations, *rms)


class Rule(Protocol):
    """A way to find light of two colors."""

    papers: ClassVar[tuple[str, ...]]

    def steps(self, state: DualState) -> Iterator[Pass]:
        """Improve ``state.light`` and ``state.uv``.

        Args:
            state: State of the run; whenever a pass is yielded, its light is in units of the design.

        Returns:
            The records of the passes, one after each.
        """
        ...

    def dose(self, colors: Colors, light: Pair, finer: bool = False) -> DeviceArray:  # noqa: ARG002
        """Compute the effective dose of light of both colors; by default their difference.

        Args:
            colors: Operators of both colors.
            light: Sinograms [angle, r, z] of both colors.
            finer: In the steps of a proof, if those of the rule are longer.

        Returns:
            Effective dose [x, y, z].
        """
        return colors.expose(light)


@dataclass(frozen=True)
class SingleColor(Rule):
    """SC: only the projected design, scaled to give the design's greatest dose."""

    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def steps(self, state: DualState) -> Iterator[Pass]:
        dose = state.volume()
        state.start(dose)
        yield state.compare(dose, state.target, state.volume(), state.volume())


@dataclass(frozen=True)
class Tolerant(Rule):
    """SC2: one color, corrected by the missing dose and by the dose above a one-sided tolerance.

    The scale of the first pass is kept; the passes are then steps of a projected descent.

    Args:
        tolerance: Dose allowed anywhere, relative to the greatest of the design. As in the paper, gray values below it
            are ignored where the dose is too high.
        passes: Largest number of passes, one projector evaluation each.
        enough: Undersupply at which it stops, a root mean square in units of dose.

    Raises:
        BadInput: A value is out of its range.
    """

    tolerance: float = 0.75
    passes: int = PASSES
    enough: float = ENOUGH
    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance < 1.0 or self.passes < 1 or not self.enough >= 0.0:
            raise BadInput(f"{self!r}: expected 0 ≤ tolerance < 1, passes ≥ 1 and enough ≥ 0")

    def steps(self, state: DualState) -> Iterator[Pass]:
        dose, under, over, change = state.volume(), state.volume(), state.volume(), state.sinogram()
        state.start(dose)
        most, step = state.volume(), state.descent_step(state.colors.visible)
        combine(1.0, state.target, 0.0, state.target, most, self.tolerance * state.greatest(state.target))
        while True:
            record = state.compare(dose, most, under, over)
            yield record
            if record.number >= self.passes or record.error < self.enough:
                return
            combine(1.0, under, -1.0, over, under)
            state.light_of(under, state.colors.visible, change)
            combine(1.0, state.light, step, change, state.light, 0.0)
            state.dose_of(state.light, state.colors.visible, dose)


@dataclass(frozen=True)
class DualColor(Rule):
    """DC: excess dose becomes UV light, missing dose becomes additional visible light.

    Args:
        recompute: True, the default, is the rule of the paper's text, with open points as in the erratum. In every
            pass, the oversupply of the visible buildup, scaled by its maximum, is projected again as UV light, while
            undersupply is added to the visible light. Both buildups are then scaled by one factor, the maximum of their
            difference (never by minimum and maximum). UV light is as bright as projected, or dimmer if it would remove
            more than the greatest oversupply: otherwise a thin part in a wide void would have no dose left. With more
            passes, undersupply falls and oversupply grows, because only the visible light grows: check both, and use
            False for contrast. False keeps the scale of the first pass, compares the difference of the buildups, and
            corrects both colors: a projected descent that lowers both errors.
        passes: Most passes.
        enough: Undersupply at which it stops, a root mean square in units of dose.

    Raises:
        BadInput: A value is out of its range.
    """

    recompute: bool = True
    passes: int = PASSES
    enough: float = ENOUGH
    papers: ClassVar[tuple[str, ...]] = (PAPER,)

    def __post_init__(self) -> None:
        if self.passes < 1 or not self.enough >= 0.0:
            raise BadInput(f"{self!r}: expected passes ≥ 1 and enough ≥ 0")

    def steps(self, state: DualState) -> Iterator[Pass]:
        yield from self._text(state) if self.recompute else self._kept(state)

    def _text(self, state: DualState) -> Iterator[Pass]:
        state.uv = uv = state.sinogram()
        colors, peak = state.colors, state.greatest(state.target)
        dose, undone, under, over = (state.volume() for _ in range(4))
        light, change, scaled = state.sinogram(), state.sinogram(), state.sinogram()
        gain = state.gain(colors.uv) * colors.strength
        state.light_of(state.target, colors.visible, light)
        while True:
            state.dose_of(light, colors.visible, dose)
            scale = peak / state.greatest(dose)
            combine(scale, dose, -1.0, state.target, over, 0.0)
            state.scale(min(1.0, 1.0 / (scale * gain)), over, over)
            state.light_of(over, colors.uv, scaled)
            state.dose_of(scaled, colors.uv, undone)
            combine(1.0, dose, -colors.strength, undone, dose)
            factor = peak / state.greatest(dose)
            state.scale(factor, dose, dose)
            combine(factor, scaled, 0.0, scaled, uv)
            combine(factor, light, 0.0, light, state.light)
            record = state.compare(dose, state.target, under, over)
            yield record
            if record.number >= self.passes or record.undersupply < self.enough:
                return
            state.light_of(under, colors.visible, change)
            combine(1.0, light, 1.0, change, light)

    def _kept(self, state: DualState) -> Iterator[Pass]:
        colors = state.colors
        dose, undone, under, over = (state.volume() for _ in range(4))
        change, step, uv_step = state.sinogram(), state.descent_step(colors.visible), state.descent_step(colors.uv)
        state.start(dose)
        state.uv = uv = constant(0.0, colors.uv.range.shape, state.light)
        while True:
            record = state.compare(dose, state.target, under, over)
            yield record
            if record.number >= self.passes or record.undersupply < self.enough:
                return
            state.light_of(under, colors.visible, change)
            combine(1.0, state.light, step, change, state.light)
            state.light_of(over, colors.uv, change)
            combine(1.0, uv, uv_step / colors.strength, change, uv)
            state.dose_of(state.light, colors.visible, dose)
            state.dose_of(uv, colors.uv, undone)
            combine(1.0, dose, -colors.strength, undone, dose)
