"""Response of a resin of two inhibitors to light of two colors, relative to its induction."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.chemistry.species import Rates
from vamgpu.errors import BadInput
from vamgpu.operators.projection import Projection
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Positive


@dataclass(frozen=True)
class TwoColorResin:
    """Oxygen A, lophyl radicals B and o-Cl-HABI C by eqs 5-7, concentrations relative to [A]₀.

    Extinction is constant: neither color follows the depletion of C. Doses are in the unit of the operators.

    Args:
        visible: Share of the induction that a unit of visible dose consumes (k_A/[A]₀).
        ultraviolet: Exponent: a unit of ultraviolet dose splits 1 − exp(−ultraviolet) of C, a reaction of first order
            (k_C/[C]₀).
        supply: [C]₀/[A]₀.
        alpha: Ratio k_B/k_A, visible light's preference for B.
        pairing: Rate k₂·[A]₀ [1/s] at which B recombines to C.
        cross: Share of the induction that a unit of ultraviolet dose consumes, because it also starts chains.
        floor: ε, the share of [A]₀ by which the monomer competes for radicals; eqs 5-7 are the limit ε = 0.

    Raises:
        BadInput: A value is out of its range.
    """

    visible: Positive
    ultraviolet: Positive
    supply: Positive
    alpha: Positive
    pairing: NonNegative = 0.0
    cross: NonNegative = 0.0
    floor: Positive = 0.02

    def __post_init__(self) -> None:
        check(self)
        if self.floor > 0.5:
            raise BadInput(f"floor is {self.floor:g}; expected at most 0.5: above it, A and B hardly inhibit")

    @classmethod
    def of(
        cls, rates: Rates, visible: Projection, ultraviolet: Projection, *, cross: float = 0.0, floor: float = 0.02
    ) -> TwoColorResin:  # fmt: skip
        """Convert rate constants, for light in mJ/mm² per angle, measured in air.

        Args:
            rates: Rate constants, of order 1 in [C].
            visible, ultraviolet: Operators of both colors.
            cross: Number of radicals that ultraviolet light starts, relative to the same amount of visible light, as in
                `Reaction`.
            floor: ε, a share; see the class.

        Returns:
            The resin.

        Raises:
            BadInput: The rates are of order 0 in [C], where the supply may end within a step, or C is missing.
        """
        if not rates.supply:
            raise BadInput("the resin has a supply of 0; expected [C] > 0, on which ultraviolet light acts")
        if rates.order != 1:
            raise BadInput("the rates are of order 0 in [C]; expected order 1, the same while [C] is the supply")
        a, seen = rates.oxygen, (_fluence(visible), _fluence(ultraviolet))
        return cls(rates.k_a * seen[0] / a, rates.k_c * seen[1] / rates.supply, rates.supply / a, rates.alpha,
                   rates.k_2 * a, cross * rates.k_a * seen[1] / a, floor)  # fmt: skip

    @property
    def subtraction(self) -> float:
        """k of the linear model: share of the induction that a unit of ultraviolet dose restores at first."""
        return 2.0 * self.supply * self.ultraviolet / self.alpha - self.cross

    @property
    def lowest(self) -> float:
        """Lower bound of the effective dose: all of C as B."""
        return -2.0 * self.supply / self.alpha


def _fluence(operator: Projection) -> float:
    """Fluence [mJ/mm²] at a voxel for a unit of the operator's dose from light in mJ/mm²."""
    absorbed = 1.0 if operator.vessel is None else operator.vessel.absorption or 1.0
    return operator.beam.pixel_area / operator.grid.voxel_volume / absorbed
