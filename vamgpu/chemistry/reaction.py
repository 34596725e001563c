"""Rate constants of a resin with a photoinhibitor."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.chemistry.species import Rates
from vamgpu.errors import BadInput
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Positive


@dataclass(frozen=True)
class Reaction:
    """Rates of A (oxygen), B (lophyl) and C (o-Cl-HABI) per irradiance, eqs 5-7 of the paper. Raises `BadInput`."""

    k_a: NonNegative  # [mol/m³ per s and mW/mm²], as k_b and k_c
    k_b: NonNegative
    k_c: NonNegative  # at the initial [C] where order is 1
    k_2: NonNegative  # [m³/(mol·s)]
    initial: Positive = 1.0  # [C] before printing [mol/m³]
    order: int = 1  # of the splitting in [C]; 0 while C lasts
    cross: NonNegative = 0.0  # radicals per amount of ultraviolet light, relative to visible light
    optical: Positive = 1.0  # T_opt: dose [mJ/mm²] of light whose radicals met no inhibitor
    mechanical: Positive = 2.0  # T_mec [mJ/mm²]

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
        """The reaction for a resin's kinetics; C splits at the rate that ``rates`` gives at its supply."""
        k, supply = (rates.k_a, rates.k_b, rates.k_c, rates.k_2), rates.supply or 1.0
        return cls(*k, supply, rates.order, cross, optical, mechanical)
