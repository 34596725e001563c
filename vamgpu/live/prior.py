"""Parameters of a print: their names, bounds, and prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vamgpu.chemistry.history import ResinHistory
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

NAMES = ("sensitivity", "absorption", "across", "height", "along_z", "along_r", "initial_dose")
"""Factors of the dose and of the absorption coefficient; positions of the axis across the light and of the light along
z [mm]; change of the gain from the middle to the top, and over half of the squared radius; dose of the resin before the
print, for example where inhibitor was consumed."""
NOMINAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
OPTICAL = (1, 2, 3)  # parameters that need an operator of their own; the dose is linear in the others
DEVIATIONS = (0.3, 0.2, 0.1, 0.1, 0.1, 0.1, 1e-3)
LEAST = np.array([0.1, 0.2, -np.inf, -np.inf, -1.0, -1.0, -np.inf])
MOST = np.array([10.0, 5.0, np.inf, np.inf, 1.0, 1.0, np.inf])
"""Values beyond these are impossible for a print; the axis and the height are also at most a tenth of the beam off."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of the parameters before the first images: a normal distribution.

    Args:
        mean: Mean of each of `NAMES`, (7,).
        covariance: Covariance matrix, (7, 7).

    Raises:
        BadInput: A number is not finite, or the covariance is not positive definite.
    """

    mean: np.ndarray
    covariance: np.ndarray

    def __post_init__(self) -> None:
        mean, covariance = np.array(self.mean, float), np.array(self.covariance, float)
        count = len(NAMES)
        fits = mean.shape == (count,) and covariance.shape == (count, count)
        if not (fits and np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise BadInput(f"a prior has shapes {mean.shape} and {covariance.shape}; expected {count} finite means and "
                           f"a covariance of {', '.join(NAMES)}")  # fmt: skip
        if np.linalg.eigvalsh(covariance).min() <= 0.0:
            raise BadInput("the covariance of a prior is not positive definite; expected variances above 0")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def of(cls, history: ResinHistory | None = None, deviations: Mapping[str, float] | None = None) -> Prior:
        """The prior for a vial with a history: resin with less oxygen needs less light in proportion.

        Args:
            history: History of the vial; None for fresh resin.
            deviations: Standard deviations by the names in `NAMES`, dimensionless or [mm]; those left out are the
                usual ones.

        Returns:
            The prior.

        Raises:
            BadInput: A name is unknown, a deviation not positive, or no oxygen is left.
        """
        usual = dict(zip(NAMES, DEVIATIONS, strict=True)) | dict(deviations or {})
        if set(usual) != set(NAMES):
            raise BadInput(f"got deviations of {', '.join(usual)}; expected names among {', '.join(NAMES)}")
        mean = NOMINAL.copy()
        if history is not None:
            mean[0] = 1.0 / positive("oxygen", history.oxygen)
        return cls(mean, np.diag([positive(f"deviation of {name}", usual[name]) ** 2 for name in NAMES]))
