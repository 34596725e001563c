"""Rate constants of a resin with a photoinhibitor, and the same in the dimensionless form of Damköhler numbers."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.chemistry.species import Rates
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Positive


@dataclass(frozen=True)
class Reaction:
    """Rates of A (oxygen), B (lophyl) and C (o-Cl-HABI) per irradiance.

    k_a, k_b, k_c [mol/m³ per s and mW/mm²]; k_2 [m³/(mol·s)]; cross: radicals that ultraviolet light starts, over
    those of as much visible light. order: 1 if C splits as fast as there is of it, k_c at its ``initial`` [mol/m³],
    0 if at k_c while it lasts. optical and mechanical: doses [mJ/mm²] of light whose radicals met no inhibitor at
    which a voxel turns visible (T_opt) and solid (T_mec). Any units that agree serve: `scaled` makes them bare numbers.

    Ultraviolet light first makes more B than its own radicals take, and promotes cure once C is gone.
    Source: paper eqs 5-7; C of first order as "Reactive Transport Simulation" has it. Raises `BadInput`.
    """

    k_a: NonNegative
    k_b: NonNegative
    k_c: NonNegative
    k_2: NonNegative
    initial: Positive = 1.0
    order: int = 1
    cross: NonNegative = 0.0
    optical: Positive = 1.0
    mechanical: Positive = 2.0

    def __post_init__(self) -> None:
        check(self)
        if self.order not in (0, 1):
            raise BadInput(f"Reaction order is {self.order!r}; C splits by order 0 or 1")
        if self.mechanical < self.optical:
            raise BadInput(
                f"Reaction mechanical {self.mechanical:g} is below optical {self.optical:g}; resin turns visible first"
            )

    @classmethod
    def of(cls, rates: Rates, cross: float = 0.0, optical: float = 1.0, mechanical: float = 2.0) -> Reaction:
        """The reaction of a resin's kinetics, C splitting as fast as ``rates`` says at its supply."""
        k, supply = (rates.k_a, rates.k_b, rates.k_c, rates.k_2), rates.supply or 1.0
        return cls(*k, supply, rates.order, cross, optical, mechanical)

    def damkohler(self, length: float, concentration: float, diffusivity: float, irradiance: float) -> float:
        """Da = l²·k_A·I / ([A]₀·D_A), eq. 14 with its rate from the dimensional form.

        length [mm], concentration [mol/m³], diffusivity [mm²/s], irradiance [mW/mm²].
        """
        return length**2 * self.k_a * irradiance / (concentration * diffusivity)

    def scaled(self, length: float, concentration: float, diffusivity: float) -> Reaction:
        """The same reaction with lengths in l, times in l²/D_A and concentrations in [A]₀; irradiance stays.

        So k_a becomes Da per irradiance, and the diffusivity of each species its ratio to D_A (eqs 12-14).
        """
        time = positive("length [mm]", length) ** 2 / positive("diffusivity [mm²/s]", diffusivity)
        rate = time / positive("concentration [mol/m³]", concentration)
        return Reaction(
            self.k_a * rate,
            self.k_b * rate,
            self.k_c * rate,
            self.k_2 * time * concentration,
            self.initial / concentration,
            self.order,
            self.cross,
            self.optical / time,
            self.mechanical / time,
        )
