"""Effective dose of light of two colors, and its derivatives: through the kinetics, or as a plain difference."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.kernels.inhibition import inhibition_adjoint, inhibition_step, put_poses, take_poses
from vamgpu.kernels.update import fill_background
from vamgpu.methods.dual.colors import Pair, subtracted, subtracted_gradient
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.operators.compose import combine, same_device
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.operators.space import require


class PoseRuns:
    """The operators of the runs that the poses of a turn are cut into. Raises `BadInput` for fewer poses than runs."""

    def __init__(self, operator: Projection, count: int) -> None:
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r}; expected a Projection, which can be cut into runs of angles")
        angles = operator.motion.angles
        if isinstance(count, bool) or int(count) != count or not 1 <= count <= angles:
            raise BadInput(f"{count!r} runs of {angles} angles; expected a whole number of 1 to {angles}")
        runs = np.array_split(np.arange(angles), int(count))
        self.whole = operator
        self.first: tuple[int, ...] = tuple(int(run[0]) for run in runs)
        self.parts: tuple[Projection, ...] = tuple(
            operator.turned(operator.motion.part(int(run[0]), int(run[-1]) + 1)) for run in runs
        )

    def __len__(self) -> int:
        return len(self.parts)

    def expose(self, run: int, light: DeviceArray, out: DeviceArray) -> None:
        """out = dose [x, y, z] of one run of poses of a turn's light [angle, r, z]."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        device.launch(take_poses, light=light, first=self.first[run], part=rows)
        part.T(rows, out=out)

    def project(self, run: int, volume: DeviceArray, light: DeviceArray) -> None:
        """Write the projection of a volume [x, y, z] into the poses of a run."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        part(volume, out=rows)
        device.launch(put_poses, part=rows, first=self.first[run], light=light)


class SpeciesFields(NamedTuple):
    """The state of every voxel between turns, relative to [A]₀.

    Args:
        oxygen, lophyl, supply: [A], [B] and [C], volumes [x, y, z].
        exposure: 1 + X, where X is the exposure of the monomer, [x, y, z].
    """

    oxygen: DeviceArray
    lophyl: DeviceArray
    supply: DeviceArray
    exposure: DeviceArray

    def effective_dose(self, resin: TwoColorResin) -> DeviceArray:
        """Compute 1 + X − [A] − [B]/α.

        Args:
            resin: The resin with these species.

        Returns:
            Effective dose [x, y, z].
        """
        dose = combine(1.0, self.exposure, -1.0, self.oxygen, self.exposure.device.empty(self.exposure.shape))
        return combine(1.0, dose, -1.0 / resin.alpha, self.lophyl, dose)


class Model(Protocol):
    """Effective dose of the light of a turn, repeated; it is 1 at the end of the induction."""

    operators: tuple[Projection, Projection]
    resin: TwoColorResin
    turns: int

    def expose(self, light: Pair) -> DeviceArray:
        """Compute the effective dose after the last turn.

        Args:
            light: Sinograms [angle, r, z] of both colors.

        Returns:
            Effective dose [x, y, z].
        """
        ...

    def gradient(self, slope: DeviceArray) -> Pair:
        """Compute derivatives with respect to the last exposed light from those with respect to its effective dose.

        Args:
            slope: Derivatives with respect to the effective dose [x, y, z].

        Returns:
            Derivatives with respect to the light [angle, r, z] of both colors.

        Raises:
            BadInput: No light was exposed before.
        """
        ...


def _checked(visible: Projection, ultraviolet: Projection, turns: int) -> int:
    for operator in (visible, ultraviolet):
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r} as operator of a color; expected a Projection")
    same_device(visible, ultraviolet)
    if visible.grid != ultraviolet.grid or visible.motion != ultraviolet.motion:
        raise BadInput(f"visible light has {visible.grid!r} and {visible.motion!r}, ultraviolet {ultraviolet.grid!r} "
                       f"and {ultraviolet.motion!r}; build both on one grid and one turntable")  # fmt: skip
    return counts("turns", (turns,), 1)[0]


class LinearModel(Model):
    """turns·(visible·A_visᵀ light − k·A_uvᵀ light), with the resin's `subtraction` k: no order, no depletion, no decay.

    Args:
        visible, ultraviolet: Operators of both colors.
        resin: Response of the resin to light.
        turns: Number of turns, all with the same light.
    """

    resin: TwoColorResin
    turns: int
    device: Device

    def __init__(self, visible: Projection, ultraviolet: Projection, resin: TwoColorResin, turns: int = 3) -> None:
        self.operators: tuple[Projection, Projection] = (visible, ultraviolet)
        self.resin, self.turns, self.device = resin, _checked(visible, ultraviolet, turns), visible.device
        self.gains: tuple[float, float] = (self.turns * resin.visible, -self.turns * resin.subtraction)

    def expose(self, light: Pair) -> DeviceArray:
        return subtracted(self.operators, self.gains, light)

    def gradient(self, slope: DeviceArray) -> Pair:
        return subtracted_gradient(self.operators, self.gains, slope)


class KineticModel(Model):
    """The state of every voxel through all turns; light arrives in the order of rotation.

    Effective dose = 1 + X − [A] − [B]/α, relative to the induction: the visible exposure so far, minus the exposure
    that consumes the inhibitors made by ultraviolet. Below an effective dose of 1, only a share set by ε polymerizes;
    above 1, the exposure X does.

    Memory, in volumes: 4·runs for light and gradients, 3·turns for the states at the beginnings of turns, 3·runs·steps
    for those of the turn that is recomputed, and about 10.

    Args:
        visible, ultraviolet: Operators of both colors on one grid, turntable and device; absorbing vessels attenuate
            each color separately.
        resin: Response of the resin to light.
        turns: Number of turns, all with the same light.
        period: Time of a turn [s], needed for pairing.
        runs: Number of runs of angles per turn; the light of a run arrives at once.
        steps: Depletion substeps within a run.
        start: The state before the first of these turns; None for fresh resin.

    Raises:
        BadInput: A value is out of its range.
        DeviceError: Arrays are on different devices.
    """

    resin: TwoColorResin
    turns: int
    device: Device

    def __init__(
        self, visible: Projection, ultraviolet: Projection, resin: TwoColorResin, turns: int = 3, *,
        period: float = 0.0, runs: int = 12, steps: int = 1, start: SpeciesFields | None = None,
    ) -> None:  # fmt: skip
        self.operators: tuple[Projection, Projection] = (visible, ultraviolet)
        self.resin, self.turns, self.device = resin, _checked(visible, ultraviolet, turns), visible.device
        self.period: float = positive("period [s]", period, zero=True)
        if resin.pairing and not self.period:
            raise BadInput("B recombines in pairs, which takes time; expected period > 0, the time of a turn [s]")
        if resin.pairing and visible.motion.dwell is not None:
            raise BadInput(f"B recombines in pairs, but {visible.motion} angles are lit for unequal times; expected "
                           "equal times: leave dwell out of Turntable")  # fmt: skip
        self.steps: int = counts("steps", (steps,), 1)[0]
        self.runs: tuple[PoseRuns, ...] = tuple(PoseRuns(A, runs) for A in self.operators)
        self.shape: tuple[int, int, int] = visible.domain.shape
        self.start: SpeciesFields | None = start
        self._doses: list[Pair] = []
        self._starts: list[tuple[DeviceArray, ...]] = []

    def going_on(
        self, turns: int, start: SpeciesFields | None = None, *, visible: float = 1.0, ultraviolet: float = 1.0,
        operators: tuple[Projection, Projection] | None = None,
    ) -> KineticModel:  # fmt: skip
        """The same resin for other turns; the lamps may have changed.

        Args:
            turns: Number of turns, all with the same light.
            start: The state before; None for fresh resin.
            visible, ultraviolet: Light of each lamp, relative to this model's lamp.
            operators: Operators of both colors, if they have changed; None for this model's.

        Returns:
            The model.

        Raises:
            BadInput: A value is out of its range.
            ShapeMismatch: The state is of another grid.
        """
        for name, values in zip(SpeciesFields._fields, () if start is None else start, strict=False):
            require(self.operators[0].domain, values, f"the {name}")
        gains = positive("light of the visible lamp", visible), positive("light of the ultraviolet lamp", ultraviolet)
        resin = self.resin
        resin = replace(resin, visible=gains[0] * resin.visible, ultraviolet=gains[1] * resin.ultraviolet,
                        cross=gains[1] * resin.cross)  # fmt: skip
        return KineticModel(*(operators or self.operators), resin, turns, period=self.period, runs=len(self.runs[0]),
                            steps=self.steps, start=start)  # fmt: skip

    def state(self, light: Pair) -> SpeciesFields:
        """Compute the state after the last turn.

        Args:
            light: Sinograms [angle, r, z] of both colors.

        Returns:
            The state of every voxel.
        """
        return SpeciesFields(*self._through(light))

    def expose(self, light: Pair) -> DeviceArray:
        return self.state(light).effective_dose(self.resin)

    def _through(self, light: Pair) -> tuple[DeviceArray, ...]:
        self._light_up(light)
        state, spare = self._start(), self._volumes(4)
        for turn in range(self.turns):
            self._keep(turn, state)
            for sub in range(len(self._doses) * self.steps):
                self._step(sub, state, spare)
                state, spare = spare, state
        return state

    def gradient(self, slope: DeviceArray) -> Pair:
        if not self._starts:
            raise BadInput("no light was exposed before the gradient; call expose() first")
        count = len(self._doses) * self.steps
        slopes = [Pair(*(self._constant(0.0) for _ in range(2))) for _ in self._doses]
        a, b, c = self._volumes(3)
        combine(-1.0, slope, 0.0, slope, a)
        combine(-1.0 / self.resin.alpha, slope, 0.0, slope, b)
        combine(0.0, slope, 0.0, slope, c)
        path = [self._volumes(3) for _ in range(count)]
        x = self._constant(1.0)
        for start in reversed(self._starts):
            states = [start, *path[1:]]
            for sub in range(count - 1):
                self._step(sub, (*states[sub], x), (*states[sub + 1], x))
            for sub in reversed(range(count)):
                self._back(sub, states[sub], (a, b, c), slope, slopes)
        return self._gathered(slopes)

    def _light_up(self, light: Pair) -> None:
        """Doses of every run of a turn; the same in every turn."""
        runs = len(self.runs[0])
        if not self._doses:
            self._doses = [Pair(*self._volumes(2)) for _ in range(runs)]
        for run in range(runs):
            for color in range(2):
                self.runs[color].expose(run, light[color], self._doses[run][color])

    def _gathered(self, slopes: list[Pair]) -> Pair:
        light = Pair(*(self.device.empty(A.range.shape) for A in self.operators))
        for run, pair in enumerate(slopes):
            for color in range(2):
                self.runs[color].project(run, pair[color], light[color])
        return light

    def _given(self, sub: int) -> dict[str, object]:
        """Arguments of a step, shared with its adjoint."""
        dose, resin, share = self._doses[sub // self.steps], self.resin, 1.0 / self.steps
        pairing = resin.pairing * self.period / (len(self._doses) * self.steps)
        gains = {"visible_gain": resin.visible * share, "ultraviolet_gain": resin.ultraviolet * share}
        return {"visible": dose.visible, "ultraviolet": dose.ultraviolet, **gains, "cross_gain": resin.cross * share,
                "alpha": resin.alpha, "pairing": pairing, "floor": resin.floor}  # fmt: skip

    def _step(self, sub: int, before: tuple[DeviceArray, ...], after: tuple[DeviceArray, ...]) -> None:
        state = dict(zip("abcx", before, strict=True))
        ends = {f"{name}_end": value for name, value in zip("abcx", after, strict=True)}
        self.device.launch(inhibition_step, **self._given(sub), **state, **ends)

    def _back(
        self, sub: int, before: tuple[DeviceArray, ...], state: tuple[DeviceArray, ...], x: DeviceArray,
        slopes: list[Pair],
    ) -> None:  # fmt: skip
        pair = slopes[sub // self.steps]
        states = dict(zip("abc", before, strict=True))
        ends = {f"{name}_slope": value for name, value in zip("abcx", (*state, x), strict=True)}
        by_light = {"visible_slope": pair.visible, "ultraviolet_slope": pair.ultraviolet}
        self.device.launch(inhibition_adjoint, **self._given(sub), **states, **ends, **by_light)

    def _start(self) -> tuple[DeviceArray, ...]:
        """The state before the first turn; x of fresh resin starts at 1, the constant of the effective dose."""
        if self.start is not None:
            return tuple(combine(1.0, part, 0.0, part, self.device.empty(self.shape)) for part in self.start)
        return tuple(self._constant(value) for value in (1.0, 0.0, self.resin.supply, 1.0))

    def _keep(self, turn: int, state: tuple[DeviceArray, ...]) -> None:
        if turn >= len(self._starts):
            self._starts.append(self._volumes(3))
        for kept, value in zip(self._starts[turn], state[:3], strict=True):
            combine(1.0, value, 0.0, value, kept)

    def _volumes(self, count: int) -> tuple[DeviceArray, ...]:
        return tuple(self.device.empty(self.shape) for _ in range(count))

    def _constant(self, value: float) -> DeviceArray:
        filled, finite = self.device.empty(self.shape), self._doses[0].visible
        self.device.launch(fill_background, target=finite, low=value, high=value, reach=EVERYWHERE, model=filled)
        return filled
