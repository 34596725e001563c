"""A Gaussian fitted to a histogram, which summarizes deviations of prints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import counts
from vamgpu.schema.quantities import numeric


@dataclass(frozen=True, eq=False)
class Gaussian:
    """height · exp(−(x − mean)² / 2σ²) over a histogram."""

    mean: float  # μ, in units of the values
    sigma: float  # σ, in units of the values
    r2: float  # coefficient of determination R² over the bins
    height: float  # in counts
    edges: np.ndarray  # (bins + 1,)
    counts: np.ndarray  # (bins,)

    def __call__(self, values: npt.ArrayLike) -> np.ndarray:
        """The curve, in counts per bin."""
        return _bell(np.asarray(values, np.float64), self.height, self.mean, self.sigma)


def fit_gaussian(values: npt.ArrayLike, bins: int = 100, limits: tuple[float, float] | None = None) -> Gaussian:
    """Least squares fit of a Gaussian to the histogram of values."""
    # limits: of the histogram; by default four standard deviations about the mean, but not beyond the values.
    from scipy.optimize import curve_fit

    data = numeric("values", values, (), "finite numbers").ravel()
    number = counts("bins", (bins,), 1)[0]
    if number < 4 or data.size < 10:
        raise BadInput(f"got {data.size} values and {number} bins; expected at least 10 values and 4 bins")
    middle, spread = float(data.mean()), float(data.std())
    if spread <= 1e-12 * max(1.0, abs(middle)):
        raise BadInput(f"all {data.size} values are {middle:g}; expected some spread for a Gaussian")
    low, high = limits if limits else (max(data.min(), middle - 4 * spread), min(data.max(), middle + 4 * spread))
    if not low < high:
        raise BadInput(f"limits are {low:g} and {high:g}; expected the lower one first")
    count, edges = np.histogram(data, number, (low, high))
    if count.sum() < 10:
        raise BadInput(f"{count.sum()} of {data.size} values lie between {low:g} and {high:g}; expected at least 10")
    place = 0.5 * (edges[1:] + edges[:-1])
    try:
        (height, mean, sigma), _ = curve_fit(_bell, place, count, (float(count.max()), middle, spread), maxfev=5000)
    except RuntimeError as error:
        raise BadInput(f"no Gaussian fits {data.size} values in {number} bins; use fewer bins or limits=") from error
    left = float(((count - _bell(place, height, mean, sigma)) ** 2).sum())
    r2 = 1.0 - left / float(((count - count.mean()) ** 2).sum())
    return Gaussian(float(mean), abs(float(sigma)), r2, float(height), edges, count)


def _bell(x: np.ndarray, height: float, mean: float, sigma: float) -> np.ndarray:
    return height * np.exp(-0.5 * ((x - mean) / sigma) ** 2)
