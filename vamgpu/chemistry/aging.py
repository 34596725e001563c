"""Print times of repeatedly used resin: a model that is fitted, and judged by data left out of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp

import numpy as np

from vamgpu.chemistry.history import Lost, ResinHistory, recovery
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import ExposureTime, NonNegative

BENCHY_SECONDS = (56.8, 45.8, 41.8, 37.2, 39.8)
"""Mean print times of five generations of resin [s]. Source: Table S1 of the automatic exposure paper."""
BENCHY_DEVIATIONS = (0.4, 0.8, 0.4, 1.3, 2.4)  # standard deviations of five prints each [s]. Source: as above.
LOST = 0.125  # share of the resin lost in a print: the middle of the 10 to 15 % of the automatic exposure paper


@dataclass(frozen=True)
class Aging:
    """Model of how a resin ages from print to print. Raises `BadInput`."""

    fresh: ExposureTime  # print time in fresh resin [s]
    spent: Lost  # share of the oxygen of the remaining liquid that a print uses up
    refill: NonNegative  # D·t/depth² of a night in the full vial, stirring included: oxygen from the free surface
    lost: Lost = LOST  # share of the resin that leaves with each print

    def __post_init__(self) -> None:
        check(self)

    def night(self, vial: ResinHistory, full: float) -> ResinHistory:
        """The vial after stirring and a night; ``full``: its depth [mm] before the first print."""
        return vial.stirred(recovery(1.0, self.refill, vial.depth / full), note="stirred, a night's rest")

    def seconds(self, generations: int) -> tuple[float, ...]:
        """Print times [s] of the given number of generations, each printed once, stirred and left overnight."""
        vial, times = ResinHistory("", 1.0), []
        for _ in range(generations):
            times.append(vial.seconds(self.fresh))
            vial = self.night(vial.printed(spent=self.spent, lost=self.lost, seconds=times[-1]), 1.0)
        return tuple(times)


@dataclass(frozen=True)
class AgingFit:
    """A fitted model and its errors."""

    aging: Aging
    residuals: tuple[float, ...]  # model minus measured [s], with all generations fitted
    left_out: tuple[float, ...]  # the same, each generation predicted from a fit to the others
    naive: tuple[float, ...]  # the same if the mean of the others is the prediction

    @property
    def error(self) -> float:
        """Root mean square error [s] of a generation left out; use this number to judge the model."""
        return _rms(self.left_out)

    @property
    def naive_error(self) -> float:
        """Root mean square error [s] if the mean of the other generations is the prediction."""
        return _rms(self.naive)

    @property
    def residual(self) -> float:
        """Root mean square residual [s]; always smaller than `error`."""
        return _rms(self.residuals)


def fit_aging(
    seconds: Sequence[float] = BENCHY_SECONDS, *, lost: float = LOST, deviations: Sequence[float] | None = None
) -> AgingFit:
    """Fit `Aging` to print times of consecutive generations, all and with each left out.

    Args:
        seconds: Print times [s], four or more.
        lost: Share of the resin that a print removes.
        deviations: Standard deviations of the times [s], as weights; none by default.

    Returns:
        The fit, and its errors with and without each generation.

    Raises:
        BadInput: There are too few times, or one is not positive.
    """
    times = np.array([positive("print time [s]", t) for t in seconds])
    if len(times) < 4:
        raise BadInput(f"{len(times)} generations; expected at least 4 to fit three numbers without one")
    weights = [1.0] * len(times) if deviations is None else deviations
    spreads = np.array([positive("deviation [s]", s) for s in weights])
    if len(spreads) != len(times):
        raise BadInput(f"{len(spreads)} deviations of {len(times)} generations; expected one each")
    every = np.ones(len(times), bool)
    whole = _fit(times, spreads, every, lost)
    left_out, naive = [], []
    for k in range(len(times)):
        others = every.copy()
        others[k] = False
        left_out.append(_fit(times, spreads, others, lost).seconds(len(times))[k] - times[k])
        naive.append(times[others].mean() - times[k])
    residuals = np.array(whole.seconds(len(times))) - times
    return AgingFit(whole, *(tuple(np.array(each).tolist()) for each in (residuals, left_out, naive)))


def _fit(times: np.ndarray, spreads: np.ndarray, used: np.ndarray, lost: float) -> Aging:
    """Least squares from several initial values; logarithms keep every number positive."""
    from scipy.optimize import least_squares

    def model(p: np.ndarray) -> Aging:
        return Aging(exp(p[0]), 1.0 - exp(-exp(p[1])), exp(p[2]), lost)

    def gaps(p: np.ndarray) -> np.ndarray:
        return ((np.array(model(p).seconds(len(times))) - times) / spreads)[used]

    low, high = np.log([1e-3, 1e-3, 1e-6]), np.log([1e6, 3.0, 3.0])
    starts = [np.log([times[used][0], spent, refill]) for spent in (0.1, 0.4) for refill in (1e-3, 0.05)]
    found = [least_squares(gaps, start, bounds=(low, high), xtol=1e-10, ftol=1e-10) for start in starts]
    return model(min(found, key=lambda fit: fit.cost).x)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
