"""Light of two colors through the kinetics, as a rule of two-color jobs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, cast

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.oxygen import Spreads
from vamgpu.chemistry.species import PAPER, Rates
from vamgpu.errors import BadInput
from vamgpu.methods.dual.colors import Colors, Pair, Pass, constant
from vamgpu.methods.dual.passes import DualState, Rule
from vamgpu.methods.dual.window import BothColors, WidestWindow, widened
from vamgpu.methods.joint.models import KineticModel
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.papers import LIMITED_MEMORY
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.schema import check
from vamgpu.schema.quantities import Count, ExposureTime, NonNegative, Positive

FLOOR = 0.002  # ε of the model. With a large ε the model cures, in many turns, what inhibitors still protect.
LINEAR = 200  # number of evaluations of doses that add up; they take little time


@dataclass(frozen=True)
class ThroughKinetics(Rule):
    """Kinetics: both colors optimized with the reaction of oxygen A, lophyl radicals B and o-Cl-HABI C, turn by turn.

    The dose of the plan is the peak effective dose of `KineticModel`, 1 at the end of the induction. Light is in mJ/mm²
    per angle. The window of doses of at most ``most`` is maximized as by the rule "window", from the optimum of
    doses that add up. Undersupply is what the part lacks to 1; oversupply is dose above ``most`` in it, 1 elsewhere. A
    strength of the colors other than 1 is refused: the rates say how strongly ultraviolet light acts.

    Args:
        k_a, k_b, k_c: Rates of A and B in visible light, and of C in ultraviolet light, [A]₀/s per mW/mm².
        k_2: Rate at which B recombines, 1/([A]₀·s).
        supply: [C]₀/[A]₀.
        turns: Number of turns, all with the same patterns.
        period: Time of a turn [s].
        runs: Number of runs of angles per turn; the light of a run arrives at once. By default every angle by itself:
            patterns make use of longer runs in ways that no print can.
        diffusivity_a, diffusivity_b, diffusivity_c: D [mm²/s] of A, B and C.
        most: Greatest effective dose in the part, above 1.
        iterations: Number of evaluations of the kinetics.

    Raises:
        BadInput: A value is out of its range.
    """

    k_a: Positive
    k_b: Positive
    k_c: Positive
    k_2: NonNegative
    supply: Positive
    turns: Count
    period: ExposureTime
    runs: Count | None = None
    diffusivity_a: Spreads = 0.0
    diffusivity_b: Spreads = 0.0
    diffusivity_c: Spreads = 0.0
    most: Positive = 1.5
    iterations: Count = 200
    papers: ClassVar[tuple[str, ...]] = (PAPER, LIMITED_MEMORY)

    def __post_init__(self) -> None:
        check(self)
        if not self.most > 1.0:
            raise BadInput(f"most is {self.most:g}; expected an effective dose above 1, the end of the induction")

    def model(self, visible: Any, ultraviolet: Any, finer: bool = False) -> KineticModel:
        """The model of both colors; ``finer``: four steps for every angle and a tenth of the floor, for proofs."""
        rates = Rates(self.k_a, self.k_b, self.k_c, self.k_2, supply=self.supply)
        resin = TwoColorResin.of(rates, visible, ultraviolet, floor=0.1 * FLOOR if finer else FLOOR)
        angles = visible.range.shape[0]
        runs, steps = (angles, 4) if finer else (self.runs or angles, 1)
        spreads = (self.diffusivity_a, self.diffusivity_b, self.diffusivity_c)
        return KineticModel(visible, ultraviolet, resin, self.turns, period=self.period, runs=runs,
                            steps=steps, diffusivities=spreads, peak=True)  # fmt: skip

    def steps(self, state: DualState) -> Iterator[Pass]:
        model = self._of(state.colors)
        for _ in WidestWindow(LINEAR).steps(state):
            pass
        resin, colors = model.resin, state.colors
        visible, uv = (self.most / (self.turns * answer) for answer in (resin.visible, resin.subtraction))
        both = BothColors(colors.visible, model, (visible, uv), self.most)
        assert state.uv is not None
        light = both.join(Pair(state.light, state.uv), both.device.empty(both.range.shape))
        run = OptimizerState(cast(Any, both), state.target, {"light": light})
        run.reach = EVERYWHERE if colors.whole else run.reach
        state.count = 0
        most, dose, under, over = (state.volume() for _ in range(4))
        even = constant(1.0, model.operators[0].grid.shape, state.target)
        combine(self.most - 1.0, state.target, 1.0, even, most)
        for better in widened(run, self.iterations, relative=False):
            state.evaluations = 2.0 * run.evaluations
            if better is not None:
                state.light, state.uv = both.split(run.buffer("best"))
                combine(-self.most, better, 0.0, better, dose, floor=0.0)
            yield state.compare(dose, most, under, over)

    def dose(self, colors: Colors, light: Pair, finer: bool = False) -> DeviceArray:
        return self._of(colors, finer).expose(light)

    def _of(self, colors: Colors, finer: bool = False) -> KineticModel:
        """The model of both colors. Raises `BadInput` for a strength, which the rates already give."""
        if colors.strength != 1.0:
            raise BadInput(f"got strength {colors.strength:g} with the rule 'kinetics', which has rates for "
                           "ultraviolet light; expected no strength: leave it out")  # fmt: skip
        return self.model(colors.visible, colors.uv, finer)
