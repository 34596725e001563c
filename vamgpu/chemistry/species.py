"""The three species of binary photoinhibition, their rate constants, and the light that they receive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Positive, numeric

Floats = NDArray[np.float64]

PAPER = "B. Wang et al., Lateral contrast enhancement in tomographic volumetric 3D-printing via binary photoinhibition"

SPECIES = {"A": "oxygen", "B": "lophyl", "C": "o-Cl-HABI"}
"""Letter in the equations → name. A is the dissolved inhibitor; UV makes the inhibitor B from C."""


@dataclass(frozen=True)
class Rates:
    """Rate constants of eqs 5–7 of the photoinhibition paper, and the depletion of the supply C.

    Concentrations are in mol/m³, or normalized to ``oxygen`` = 1; use the same unit throughout.

    k_a, k_b, k_c: loss of A and of B by visible light, splitting of C by UV [concentration/s per mW/mm²]
    k_2: pairing of B to C [1/(concentration·s)]
    oxygen: [A] before printing; 1e-6 of it counts as depleted
    supply: [C] before printing
    order: of the splitting in [C]. 0, as in eq. 7, until C is used up; then only the C that pairing returns is split,
        at once: [C] never falls below 0. 1, as in the paper's simulation; equal to order 0 at [C] = supply.

    Raises `BadInput` for negative or infinite numbers, an order that is not 0 or 1, or order 1 without a supply.
    """

    k_a: NonNegative
    k_b: NonNegative
    k_c: NonNegative
    k_2: NonNegative
    oxygen: Positive = 1.0
    supply: NonNegative = 5.0
    order: int = 1

    def __post_init__(self) -> None:
        check(self)
        if self.order not in (0, 1):
            raise BadInput(f"order is {self.order!r}; expected 0 (eq. 7) or 1 (in proportion to [C])")
        if self.order == 1 and self.supply == 0:
            raise BadInput("order 1 with a supply of 0; expected [C] > 0 to compare with, or order 0")

    @property
    def alpha(self) -> float:
        """α = k_B/k_A: sensitivity of B to visible light over that of A. Raises `BadInput` if k_A is 0."""
        if self.k_a == 0:
            raise BadInput("k_a is 0; expected k_a > 0, or α = k_b/k_a has no value")
        return self.k_b / self.k_a

    def beta(self, visible: float, uv: float) -> float:
        """β = k_C·I_UV/(k_A·I_vis), for irradiances [mW/mm²]. Raises `BadInput` without visible light."""
        lost = self.k_a * positive("visible", visible)
        if lost == 0:
            raise BadInput("k_a is 0; expected k_a > 0, or β has no value")
        return self.k_c * positive("uv", uv, zero=True) / lost

    def start(self, lophyl: float = 0.0) -> SpeciesState:
        """The state before printing, with [B] = ``lophyl``."""
        return SpeciesState(self.oxygen, lophyl, self.supply)

    @property
    def row(self) -> tuple[float, ...]:
        """The arguments of kernels, (8,)."""
        reference = self.supply if self.order else 0.0
        return (self.k_a, self.k_b, self.k_c, self.k_2, self.oxygen, reference, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SpeciesState:
    """[A], [B] and [C] of items, arrays (items,), in the unit of their `Rates`. Raises `BadInput`."""

    a: ArrayLike
    b: ArrayLike = 0.0
    c: ArrayLike = 0.0

    def __post_init__(self) -> None:
        values = [np.atleast_1d(concentration(letter, getattr(self, letter.lower()))) for letter in SPECIES]
        try:
            values = np.broadcast_arrays(*values)
        except ValueError as error:
            raise BadInput(f"[A], [B], [C] have shapes {[v.shape for v in values]}; expected one length") from error
        for name, value in zip("abc", values, strict=True):
            if value.ndim != 1 or not value.size:
                raise BadInput(f"[{name.upper()}] has shape {value.shape}; expected (items,) with at least one item")
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(np.asarray(self.a))

    @property
    def table(self) -> Floats:
        """(items, 3)."""
        return np.stack([self.a, self.b, self.c], axis=1)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class LightCycle:
    """Irradiances in intervals of constant light, repeated cyclically. Raises `BadInput`."""

    visible: ArrayLike  # [mW/mm²], (intervals,) or (sources, intervals)
    uv: ArrayLike  # [mW/mm²], (intervals,) or (sources, intervals)
    seconds: ArrayLike

    def __post_init__(self) -> None:
        seconds = np.atleast_1d(_checked("seconds [s]", self.seconds))
        shades = [np.atleast_1d(_checked(f"{name} [mW/mm²]", getattr(self, name))) for name in ("visible", "uv")]
        try:
            visible, uv = np.broadcast_arrays(*shades)
            visible, uv = (np.broadcast_to(v, (*v.shape[:-1], seconds.size)) for v in (visible, uv))
        except ValueError as error:
            got = f"light of shapes {[v.shape for v in shades]} for {seconds.size} intervals"
            raise BadInput(f"{got}; expected (sources, intervals)") from error
        if visible.ndim > 2 or seconds.ndim > 1 or not visible.size:
            raise BadInput(
                f"light of shape {visible.shape} for {seconds.shape} intervals; expected (sources, intervals)"
            )
        object.__setattr__(self, "visible", np.atleast_2d(visible))
        object.__setattr__(self, "uv", np.atleast_2d(uv))
        object.__setattr__(self, "seconds", seconds)

    @property
    def table(self) -> Floats:
        """(sources, intervals, 2)."""
        return np.stack([self.visible, self.uv], axis=2)  # type: ignore[arg-type]

    @property
    def sources(self) -> int:
        return np.asarray(self.visible).shape[0]

    @property
    def intervals(self) -> int:
        return np.asarray(self.seconds).size


def concentration(letter: str, value: ArrayLike) -> Floats:
    """``value`` as float64 if it is finite and nowhere negative, else `BadInput`."""
    return _checked(f"[{letter}]", value)


def _checked(name: str, value: ArrayLike) -> Floats:
    array = numeric(name, value, (), "finite numbers ≥ 0")
    if array.size and array.min() < 0:
        raise BadInput(f"{name} is {array.min():g} at its lowest; expected nothing below 0")
    return array
