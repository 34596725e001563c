"""Point spread of light within arcsin m of a film's normal, m being the index around it over the resin's: J. Toombs et
al., Roll-to-roll tomographic volumetric additive manufacturing, section S10.
"""

from __future__ import annotations

from math import asin, log, pi

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import centers, counts, positive

Array = npt.NDArray[np.float64]

ANGLES = 1801  # default number of directions of a cumulative point spread


def steepest(ratio: float) -> float:
    """Greatest angle [rad] between light in the film and its normal: arcsin m, with m = n_medium/n_resin in 0..1."""
    if positive("index ratio m = n_medium/n_resin", ratio) > 1.0:
        raise BadInput(f"index ratio m = n_medium/n_resin is {ratio:g}; expected at most 1: above it, no angle is lost")
    return asin(ratio)


def coverage(ratio: float) -> float:
    """Range [rad] of directions in the film: 2·arcsin m."""
    return 2.0 * steepest(ratio)


def point_dose(along: Array, depth: Array, fwhm: float, ratio: float, angles: int = ANGLES) -> Array:
    """Cumulative dose at (l, ρ) [mm] from a point, 1 at the point: one Gaussian beam through it per direction."""
    # fwhm: of the beam [mm]. ratio: m. Directions are spread evenly over the range in the film, ±arcsin m. Beams are
    # assumed to have constant width, which holds within the depth of focus. Arguments broadcast.
    width, limit = positive("fwhm [mm]", fwhm), steepest(ratio)
    number = counts("angles", (angles,), 1)[0]
    along, depth = np.broadcast_arrays(np.asarray(along, np.float64), np.asarray(depth, np.float64))
    dose = np.zeros(along.shape)
    for angle in centers(number, 2.0 * limit / number):
        dose += np.exp(-4.0 * log(2.0) * ((along * np.cos(angle) - depth * np.sin(angle)) / width) ** 2)
    return dose / number


def spread(fwhm: float, ratio: float, angles: int = ANGLES) -> tuple[float, float]:
    """Full widths at half maximum [mm] of the cumulative point spread, along l and along ρ."""
    # As m falls from 1, the one along l narrows and the one along ρ widens.
    return _width(fwhm, ratio, angles, 1.0, 0.0), _width(fwhm, ratio, angles, 0.0, 1.0)


def _width(fwhm: float, ratio: float, angles: int, along: float, depth: float) -> float:
    """Twice the distance at which the dose in one direction is half, by bisection (the dose falls monotonically)."""
    low, high = 0.0, positive("fwhm [mm]", fwhm)
    while point_dose(np.array(high * along), np.array(high * depth), fwhm, ratio, angles) > 0.5:
        low, high = high, 2.0 * high
        if high > 1e6 * fwhm:
            raise BadInput(f"at m = {ratio:g} and {angles} angles the point spread has no width; expected more angles")
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        above = point_dose(np.array(middle * along), np.array(middle * depth), fwhm, ratio, angles) > 0.5
        low, high = (middle, high) if above else (low, middle)
    return low + high


def wedge(shape: tuple[int, int], pitch: tuple[float, float] | float, ratio: float) -> npt.NDArray[np.bool_]:
    """Spatial frequencies of a plane [l, rho] that some direction of light carries, in the order of ``numpy.fft``."""
    # A direction carries the frequencies perpendicular to it (central slice theorem); frequencies closer than 90° −
    # arcsin m to the ρ axis are therefore missing, except zero. pitch: [mm] along l and rho.
    n_l, n_rho = counts("shape", shape, 2)
    edges = (pitch, pitch) if isinstance(pitch, (int, float)) else tuple(pitch)
    k_l, k_rho = (np.fft.fftfreq(n, positive("pitch [mm]", d)) for n, d in zip((n_l, n_rho), edges, strict=True))
    angle = np.arctan2(np.abs(k_rho)[None, :], np.abs(k_l)[:, None])
    covered = angle <= steepest(ratio) * (1.0 + 1e-12)
    covered[0, 0] = True
    return covered


def covered_share(ratio: float) -> float:
    """Share of all directions of the plane's frequencies that light carries: 2·arcsin m / π."""
    return 2.0 * steepest(ratio) / pi
