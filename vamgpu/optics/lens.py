"""A lens tuned by a current, in the Fourier plane of a relay: where the projector focuses, and how to set the focus.

It stands where light crosses between L1 and L2 of two relays: magnification and telecentricity do not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.schema import check
from vamgpu.schema.quantities import Count, Index, Length, LensPower, Place, Thickness, Time

DIOPTER = 1e-3  # one diopter [1/mm]


@dataclass(frozen=True)
class TunableLens:
    """Two relays with a tunable lens, and the number of focus planes that it steps through at every angle.

    Defaults are the lenses of J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", table S1,
    in air.

    Args:
        focal: Focal lengths of L1 to L4 [mm].
        offset: Focal length of the fixed lens next to the tunable one [mm], < 0 if it diverges.
        powers: Lowest and highest power of the tunable lens [dpt].
        index: Refractive index beyond the last window.
        air: Distance from L4 to the last window [mm].
        bins: Number of depth bins, and of focus planes.
        quantum: Smallest step of the power that the driver can set [dpt]; 0 for none.
        settle: Time that the lens needs to settle at a new power [s].

    Raises:
        BadInput: A value is out of its range.
    """

    focal: tuple[Length, Length, Length, Length] = (150.0, 150.0, 150.0, 200.0)
    offset: Place = -200.0
    powers: tuple[LensPower, LensPower] = (5.0, 10.0)
    index: Index = 1.0
    air: Thickness = 0.0
    bins: Count = 3
    quantum: LensPower = 0.0
    settle: Time = 5e-3

    def __post_init__(self) -> None:
        if len(self.focal) != 4:
            raise BadInput(f"focal is {self.focal!r}; expected the focal lengths of L1, L2, L3 and L4 [mm]")
        if not isinstance(self.powers, (tuple, list)) or len(self.powers) != 2:
            raise BadInput(f"powers is {self.powers!r}; expected (lowest, highest) [dpt]")
        check(self)
        if self.offset == 0:
            raise BadInput(f"offset is {self.offset!r}; expected the focal length of the fixed lens [mm], not 0")
        low, high = self.powers
        if low >= high:
            raise BadInput(f"powers go from {low:g} to {high:g} dpt; expected the lowest first and a higher one next")

    @property
    def magnification(self) -> float:
        """Ratio of the size of the image to that of the mirror array; positive, because two relays invert twice."""
        f1, f2, f3, f4 = self.focal
        return f2 * f4 / (f1 * f3)

    @property
    def slope(self) -> float:
        """Shift of the focus per power of the lens [mm/dpt]: −n·f₂²·M²·1 dpt with M = f₄/f₃ (S7)."""
        _, f2, f3, f4 = self.focal
        return -self.index * (f2 * f4 / f3) ** 2 * DIOPTER

    def matrix(self, power: float) -> np.ndarray:
        """Ray transfer matrix from L1 to L4, both included (S1).

        Args:
            power: Power of the tunable lens [dpt].

        Returns:
            The matrix (2, 2) on (height [mm], angle [rad]).
        """
        f1, f2, f3, f4 = self.focal
        stop = _lens(power * DIOPTER + 1.0 / self.offset)
        first = _lens(1 / f2) @ _way(f2) @ stop @ _way(f1) @ _lens(1 / f1)
        return _lens(1 / f4) @ _way(f3 + f4) @ _lens(1 / f3) @ _way(f2 + f3) @ first

    def focus(self, power: ArrayLike) -> Floats:
        """Distance of the focus beyond the last window (S3).

        Args:
            power: Powers of the tunable lens [dpt], (...,).

        Returns:
            Distances [mm], (...,).

        Raises:
            BadInput: A power is out of the lens's range.
        """
        chosen = self._reachable(as_offsets("power", power))
        _, f2, f3, f4 = self.focal
        bent = chosen * DIOPTER + 1.0 / self.offset
        return self.index * (f4 - (f2 * f4 / f3) ** 2 * bent - self.air)

    def shift(self, power: ArrayLike) -> Floats:
        """Shift of the focus from that at the lowest power: −|slope|·(power − lowest), never > 0 (S5).

        Args:
            power: Powers of the tunable lens [dpt], (...,).

        Returns:
            Shifts [mm], (...,).
        """
        return self.slope * (self._reachable(as_offsets("power", power)) - self.powers[0])

    def power(self, depth: ArrayLike, axis: float | None = None) -> Floats:
        """Powers that focus at some depths, rounded to the driver's quantum.

        Args:
            depth: Depths along the light from the roller's axis [mm], < 0 before it, (...,).
            axis: Power that focuses on the axis, from a calibration [dpt]; by default the lowest power.

        Returns:
            Powers [dpt], (...,).

        Raises:
            BadInput: A depth is out of reach.
        """
        start = self.powers[0] if axis is None else positive("axis [dpt]", axis, zero=True)
        chosen = start + as_offsets("depth", depth) / self.slope
        if self.quantum > 0:
            chosen = np.round(chosen / self.quantum) * self.quantum
        return self._reachable(chosen)

    def _reachable(self, power: Floats) -> Floats:
        low, high = self.powers
        slack = 1e-9 * high
        if power.size and (power.min() < low - slack or power.max() > high + slack):
            reach = self.slope * (high - low)
            raise BadInput(
                f"power goes from {power.min():.4g} to {power.max():.4g} dpt; the lens reaches {low:g} to {high:g} dpt,"
                f" which moves the focus by {reach:.4g} mm: set up the projector so that this range covers the depths"
            )
        return power


def _lens(power: float) -> np.ndarray:
    """A thin lens of a power [1/mm]."""
    return np.array([[1.0, 0.0], [-power, 1.0]])


def _way(length: float) -> np.ndarray:
    """A straight path [mm]."""
    return np.array([[1.0, length], [0.0, 1.0]])
