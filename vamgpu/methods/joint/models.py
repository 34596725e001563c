"""Effective dose of light of two colors, and its derivatives: through the kinetics, or as a plain difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.turns import Fields, Turns, check_times, copy_all
from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.kernels.inhibition import add_peak_slope, inhibition_adjoint, inhibition_step, raise_peak
from vamgpu.methods.dual.colors import Pair, subtracted, subtracted_gradient
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.operators.compose import combine, same_device
from vamgpu.operators.projection import Projection
from vamgpu.operators.space import require

NEVER = 1e30  # depth of a peak before the first step


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

    def __init__(self, visible: Projection, ultraviolet: Projection, resin: TwoColorResin, turns: int = 3) -> None:
        self.operators: tuple[Projection, Projection] = (visible, ultraviolet)
        self.resin: TwoColorResin = resin
        self.turns: int = _checked(visible, ultraviolet, turns)
        self.gains: tuple[float, float] = (self.turns * resin.visible, -self.turns * resin.subtraction)

    def expose(self, light: Pair) -> DeviceArray:
        return subtracted(self.operators, self.gains, light)

    def gradient(self, slope: DeviceArray) -> Pair:
        return subtracted_gradient(self.operators, self.gains, slope)


class KineticModel(Turns, Model):
    """The state of every voxel through all turns; light arrives in the order of rotation.

    Effective dose = 1 + X − [A] − [B]/α, relative to the induction: the visible exposure so far, minus the exposure
    that consumes the inhibitors made by ultraviolet. Below an effective dose of 1, only a share set by ε polymerizes;
    above 1, the exposure X does.

    Args:
        visible, ultraviolet: Operators of both colors on one grid, turntable and device; absorbing vessels attenuate
            each color separately.
        resin: Response of the resin to light.
        turns: Number of turns, all with the same light.
        period: Time of a turn [s], needed for pairing and diffusion.
        runs: Number of runs of angles per turn; the light of a run arrives at once.
        steps: Depletion substeps within a run.
        start: The state before the first of these turns; None for fresh resin.
        diffusivities: D [mm²/s] of A, B and C; no flux passes the faces of the grid.
        peak: Whether the effective dose is the greatest after any run of angles, not the last. Inhibitors that
            ultraviolet makes later do not dissolve what has cured.

    Raises:
        BadInput: A value is out of its range.
        DeviceError: Arrays are on different devices.
    """

    def __init__(
        self, visible: Projection, ultraviolet: Projection, resin: TwoColorResin, turns: int = 3, *,
        period: float = 0.0, runs: int = 12, steps: int = 1, start: SpeciesFields | None = None,
        diffusivities: Sequence[float] = (0.0, 0.0, 0.0), peak: bool = False,
    ) -> None:  # fmt: skip
        _checked(visible, ultraviolet, turns)
        if len(diffusivities) != 3:
            raise BadInput(f"got {len(diffusivities)} diffusivities; expected those of A, B and C")
        self.operators: tuple[Projection, Projection] = (visible, ultraviolet)
        self.resin: TwoColorResin = resin
        self.start: SpeciesFields | None = start
        self.peak: bool = peak
        self._peak: Fields = ()
        if resin.pairing:
            check_times(visible.motion, positive("period [s]", period, zero=True), "B recombines in pairs")
        super().__init__(self.operators, turns, period, runs, steps, diffusivities)

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
                            steps=self.steps, start=start, diffusivities=self.diffusivities,
                            peak=self.peak)  # fmt: skip

    def state(self, light: Pair) -> SpeciesFields:
        """Compute the state after the last turn.

        Args:
            light: Sinograms [angle, r, z] of both colors.

        Returns:
            The state of every voxel.
        """
        return SpeciesFields(*self._through(light))

    def expose(self, light: Pair) -> DeviceArray:
        if not self.peak:
            return self.state(light).effective_dose(self.resin)
        self._through(light, self._raise)
        return self._peak[0]

    def _raise(self, number: int, fields: Fields) -> None:
        """Raise the peak to the dose after a reaction."""
        if number == 0:
            self._peak = self._constant(-NEVER), self._constant(-1.0)
        a, b, _, x = fields
        peak, when = self._peak
        self.device.launch(raise_peak, a=a, b=b, x=x, alpha=self.resin.alpha, number=number, peak=peak, when=when)

    def gradient(self, slope: DeviceArray) -> Pair:
        if self.peak:
            if not self._peak:
                raise BadInput("no light was exposed before the gradient; call expose() first")
            *none, x = (self._constant(0.0) for _ in range(4))
            return Pair(*self._back(tuple(none), x, lambda *after: self._add_slope(slope, *after)))
        species = self._volumes(3)
        for factor, field in zip((-1.0, -1.0 / self.resin.alpha, 0.0), species, strict=True):
            combine(factor, slope, 0.0, slope, field)
        return Pair(*self._back(species, slope))

    def _add_slope(self, slope: DeviceArray, number: int, slopes: Fields) -> None:
        """Add derivatives with respect to the peak after a reaction."""
        names = dict(zip(("a_slope", "b_slope", "x_slope"), (slopes[0], slopes[1], slopes[3]), strict=True))
        given = {"slope": slope, "when": self._peak[1], "number": number, "alpha": self.resin.alpha}
        self.device.launch(add_peak_slope, **given, **names)

    def _given(self, dose: Fields, share: float) -> dict[str, object]:
        """Arguments of a step, shared with its adjoint."""
        resin, pairing = self.resin, self.resin.pairing * self.period / self._substeps * share
        share /= self.steps
        gains = {"visible_gain": resin.visible * share, "ultraviolet_gain": resin.ultraviolet * share}
        return {"visible": dose[0], "ultraviolet": dose[1], **gains, "cross_gain": resin.cross * share,
                "alpha": resin.alpha, "pairing": pairing, "floor": resin.floor}  # fmt: skip

    def _react(self, dose: Fields, share: float, before: Fields, after: Fields) -> None:
        state = dict(zip("abcx", before, strict=True))
        ends = {f"{name}_end": value for name, value in zip("abcx", after, strict=True)}
        self.device.launch(inhibition_step, **self._given(dose, share), **state, **ends)

    def _react_back(
        self, dose: Fields, share: float, species: Fields, slopes: Fields, x_slope: DeviceArray, by_dose: Fields
    ) -> None:  # fmt: skip
        states = dict(zip("abc", species, strict=True))
        ends = {f"{name}_slope": value for name, value in zip("abcx", (*slopes, x_slope), strict=True)}
        by_light = {"visible_slope": by_dose[0], "ultraviolet_slope": by_dose[1]}
        self.device.launch(inhibition_adjoint, **self._given(dose, share), **states, **ends, **by_light)

    def _start(self) -> Fields:
        """X of fresh resin starts at 1, the constant of the effective dose."""
        if self.start is not None:
            fields = self._volumes(4)
            copy_all(self.start, fields)
            return fields
        return tuple(self._constant(value) for value in (1.0, 0.0, self.resin.supply, 1.0))
