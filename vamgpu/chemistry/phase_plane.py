"""The phase plane of oxygen and lophyl: drift, nullclines, and the one stationary state away from the origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.chemistry.species import Floats, Rates, concentration
from vamgpu.errors import BadInput
from vamgpu.geometry import positive


@dataclass(frozen=True, eq=False)
class Stationary:
    """A stationary state under light of two colors, eqs 8–10; concentrations in the unit of the rates."""

    b: float  # [B], while [A] is 0
    jacobian: Floats  # of the drift (F1, F2) there [1/s], (2, 2)
    eigenvalues: Floats  # [1/s], (2,), both real and negative: a stable node, if it exists

    @property
    def slowest(self) -> float:
        """Time in which a small disturbance falls to 1/e [s]."""
        return float(1.0 / -self.eigenvalues.max())


def made(rates: Rates, uv: float, supply: float | None = None) -> float:
    """Splitting of C by ``uv`` [mW/mm²], in concentration/s, while [C] is ``supply`` (None: as before printing)."""
    held = rates.supply if supply is None else positive("supply", supply, zero=True)
    if rates.order == 0:
        return rates.k_c * positive("uv", uv, zero=True)
    return rates.k_c * positive("uv", uv, zero=True) * held / rates.supply


def stationary(rates: Rates, visible: float, uv: float, supply: float | None = None) -> Stationary | None:
    """Find the stationary state of constant light at constant [C].

    It exists only for 2k_C·I_UV > k_B·I_vis (β > α/2) and is (0, √((2k_C·I_UV − k_B·I_vis)/(2k₂))). It is a stable
    node: the oscillating center of the paper's text is impossible, because [A] never grows.

    Args:
        rates: Rates of the reactions.
        visible, uv: Irradiances [mW/mm²].
        supply: Constant concentration of C; by default that of the rates.

    Returns:
        The state, or None if there is none.

    Raises:
        BadInput: An irradiance is negative, or k₂ is 0 and [B] would grow for ever.
    """
    a, b = (k * positive("visible", visible, zero=True) for k in (rates.k_a, rates.k_b))
    surplus = 2.0 * made(rates, uv, supply) - b
    if surplus <= 0.0:
        return None
    if rates.k_2 == 0.0:
        raise BadInput("k_2 is 0; expected k_2 > 0, because otherwise [B] grows without limit if 2k_C·I_UV > k_B·I_vis")
    level = float(np.sqrt(surplus / (2.0 * rates.k_2)))
    jacobian = np.array([[-a / level, 0.0], [b / level, -4.0 * rates.k_2 * level]])
    return Stationary(level, jacobian, np.sort(np.diag(jacobian)))


def drift(
    rates: Rates, a: ArrayLike, b: ArrayLike, visible: float, uv: float, supply: float | None = None
) -> tuple[Floats, Floats, Floats]:
    """d[A]/dt, d[B]/dt, d[C]/dt (eqs 5–7) [concentration/s] at [A], [B]; 0 at the origin. Raises `BadInput`."""
    A, B = np.broadcast_arrays(concentration("A", a), concentration("B", b))
    whole = A + B
    lit = positive("visible", visible, zero=True)
    at_origin = whole == 0.0
    share = A / np.where(at_origin, 1.0, whole)
    split, paired = made(rates, uv, supply), rates.k_2 * B**2
    rest = np.where(at_origin, 0.0, 1.0 - share)
    first = -rates.k_a * lit * share
    second = np.where(at_origin, 0.0, -rates.k_b * lit * rest + 2.0 * (split - paired))
    return first, second, np.where(at_origin, 0.0, paired - split)


def nullcline(rates: Rates, b: ArrayLike, visible: float, uv: float, supply: float | None = None) -> Floats:
    """[A] at which [B] is stationary, for each [B]; NaN if there is none. ([A] is stationary only at [A] = 0.)"""
    B = concentration("B", b)
    gain = 2.0 * (made(rates, uv, supply) - rates.k_2 * B**2)
    lost = rates.k_b * positive("visible", visible, zero=True)
    level = B * (lost / np.where(gain > 0.0, gain, np.nan) - 1.0)
    return np.where(level >= 0.0, level, np.nan)
