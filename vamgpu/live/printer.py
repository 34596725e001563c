"""A simulated print: resin on its own voxels, lit by its own rays, and the camera that watches it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log1p
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Grid, positive
from vamgpu.live.camera import MonitoringCamera
from vamgpu.live.turbidity import Turbidity
from vamgpu.losses.response import Interpolated
from vamgpu.operators.projection import Projection
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.scenarios import clouded_and_displaced
from vamgpu.schema import check
from vamgpu.schema.quantities import Positive, Share

FINER = 2  # number of voxels of the resin along an edge of the plan's voxels
HIGHEST = 3.0  # greatest dose at which the response is sampled, in units of the part's
MOST = 0.999  # greatest conversion at a gel point
GENERATIONS = (56.8, 45.8, 41.8, 37.2, 39.8)
"""Induction times of five prints from one vial [s], of the automatic exposure paper."""


@dataclass(frozen=True)
class CuringResin:
    """Resin whose inhibitor must be consumed before it cures, and that continues to cure in the dark.

    dose rate E: inhibitor −E until it is consumed; from then on radicals R' = E − R/dark, and conversion M' = rate·(1 −
    M)·R/dark. In the end M = 1 − exp(−rate·(dose − induction)).

    Args:
        induction: Dose that consumes the inhibitor of fresh resin, in units of the part's.
        rate: Rate of curing, per dose.
        solid: Least dose that makes fresh resin solid, in units of the part's.
        dark: Lifetime of radicals [turns].
        gel_error: Relative error of the conversion at the gel point.

    Raises:
        BadInput: A value is out of its range, or the resin is solid before it cures.
    """

    induction: Positive = 0.65
    rate: Positive = 4.0
    solid: Positive = 0.865
    dark: Positive = 0.3
    gel_error: Share = 0.1

    def __post_init__(self) -> None:
        check(self)
        if self.solid <= self.induction:
            raise BadInput(f"the resin is solid from a dose of {self.solid:g}, but its induction ends at "
                           f"{self.induction:g}; expected the induction to end at a lower dose")  # fmt: skip

    def conversion(self, dose: Any) -> np.ndarray:
        """Final conversion.

        Args:
            dose: Dose in units of the part's, (...,).

        Returns:
            Conversion, (...,).
        """
        return -np.expm1(-self.rate * np.maximum(np.asarray(dose, float) - self.induction, 0.0))

    @property
    def gel(self) -> float:
        """Conversion from which resin is solid."""
        return float(self.conversion(self.solid))

    @property
    def solid_doses(self) -> tuple[float, float]:
        """Least and greatest dose that makes fresh resin solid, within the error of the gel point."""
        low, high = (min(self.gel * (1.0 + side * self.gel_error), MOST) for side in (-1.0, 1.0))
        return self.induction - log1p(-low) / self.rate, self.induction - log1p(-high) / self.rate

    @property
    def response(self) -> Interpolated:
        """Response of fresh resin, for an `Estimator`."""
        doses = np.linspace(0.0, HIGHEST, 601)
        return Interpolated(tuple(doses), tuple(self.conversion(doses)))

    def expose(self, state: np.ndarray, dose: np.ndarray) -> np.ndarray:
        """The state after a turn, exactly.

        Args:
            state: Inhibitor [dose], radicals [dose] and conversion of voxels, (3, ...).
            dose: Dose of the turn, spread evenly over it, (voxels,) or [x, y, z].

        Returns:
            The state after the turn, (3, ...).
        """
        inhibitor, radicals, conversion = state
        used = np.minimum(dose, inhibitor)
        made = dose - used
        lit = np.divide(made, dose, out=np.zeros_like(made), where=dose > 0)  # share of the turn that makes radicals
        left = made * self.dark * np.divide(-np.expm1(-lit / self.dark), lit, out=np.zeros_like(made), where=lit > 0)
        after = radicals * np.exp(-1.0 / self.dark) + left
        acted = radicals + made - after
        return np.stack([inhibitor - used, after, 1.0 - (1.0 - conversion) * np.exp(-self.rate * acted)])

    def rest(self, state: np.ndarray) -> np.ndarray:
        """Let all radicals react.

        Args:
            state: As for `expose`, (3, ...).

        Returns:
            Conversion when no radicals remain, with the shape of a voxel field, (voxels,) or [x, y, z].
        """
        return 1.0 - (1.0 - state[2]) * np.exp(-self.rate * state[1])


@dataclass(frozen=True)
class Truth:
    """Differences of a print from its plan.

    Args:
        inhibitor: Inhibitor relative to fresh resin, dimensionless.
        lamp: Power relative to the plan, dimensionless.
        drift: Change of the lamp's power per turn, relative to the plan.
        absorption: Excess absorption of the resin, relative to the plan.
        across: Distance of the axis from the middle of the light [pixels].
        along_z: Relative rise of the gain from the middle to the top.
    """

    inhibitor: float = 1.0
    lamp: float = 1.0
    drift: float = 0.0
    absorption: float = 0.0
    across: float = 0.0
    along_z: float = 0.0


class VirtualPrinter:
    """A print in progress: voxels half as wide as the plan's, exposed by traced rays and seen by a camera with noise.

    Only the geometry of the plan's operator is used: `IndependentExposure` lights voxels half as wide again, shifted
    by a quarter of one. The camera's images are made from the resin's own voxels.

    Args:
        operator: The operator of the plan.
        camera: The monitoring camera, on the plan's grid.
        resin: True kinetics.
        turbidity: True turbidity.
        truth: Differences from the plan.
        seed: Seed of the camera's noise.
    """

    resin: CuringResin
    turbidity: Turbidity
    truth: Truth
    seed: int

    def __init__(
        self, operator: Projection, camera: MonitoringCamera, resin: CuringResin, turbidity: Turbidity,
        truth: Truth = Truth(), seed: int = 0,
    ) -> None:  # fmt: skip
        self.resin, self.turbidity, self.truth, self.seed = resin, turbidity, truth, seed
        self.plan: Projection = operator
        positive("lamp", truth.lamp)
        positive("inhibitor", truth.inhibitor)
        self._exposure = IndependentExposure(clouded_and_displaced(_finer(operator), truth.absorption, truth.across))
        self.camera: MonitoringCamera = replace(camera, projection=_finer(camera.projection))
        self.grid: Grid = self._exposure.grid
        self.turns: int = 0
        self.state: np.ndarray = np.zeros((3, *self.grid.shape))
        self.state[0] = truth.inhibitor * resin.induction

    def dose(self, light: np.ndarray) -> np.ndarray:
        """Dose of a turn at full lamp power.

        Args:
            light: Light of the turn, [angle, r, z].

        Returns:
            Dose in units of the plan's, [x, y, z] of the resin's grid.
        """
        device, z = self._exposure.device, self.grid.axes()[2]
        # Light per voxel is planned for the plan's voxels; the resin's voxels are smaller and get proportionally less.
        gain = FINER**3 * (1.0 + self.truth.along_z * z / z[-1])
        return np.asarray(self._exposure.averaged(device.upload(light))[0], float) * gain

    def turn(self, dose: np.ndarray) -> None:
        """Expose the resin for one turn.

        Args:
            dose: The result of `dose`, [x, y, z].
        """
        power = max(self.truth.lamp + self.truth.drift * self.turns, 0.0)
        self.state = self.resin.expose(self.state, np.maximum(power * dose, 0.0))
        self.turns += 1

    def through(self) -> np.ndarray:
        """Gray levels through the vial in one turn, with noise, uint16 [angle, row, column]."""
        return self.camera.noise.expose(self.images(), 1000 * self.seed + self.turns)

    def images(self) -> np.ndarray:
        """Light through the vial in one turn, gray levels without noise, [angle, row, column]."""
        return self.camera.transmitted(self._extinction)

    def aside(self) -> np.ndarray:
        """Gray levels of scattered light in one turn, with noise, uint16 [angle, row, column]."""
        light = self.camera.scattered(self._extinction)
        return self.camera.noise.expose(light, 1000 * self.seed + self.turns + 500)

    @property
    def _extinction(self) -> np.ndarray:
        return self.turbidity.extinction_at(self.state[2]).astype(np.float32)

    def printed(self) -> np.ndarray:
        """Conversion when no radicals remain, averaged over each voxel of the plan, [x, y, z]."""
        nx, ny, nz = (n // FINER for n in self.grid.shape)
        return self.resin.rest(self.state).reshape(nx, FINER, ny, FINER, nz, FINER).mean(axis=(1, 3, 5))


def _finer(operator: Projection) -> Projection:
    grid = operator.grid
    nx, ny, nz = (FINER * n for n in grid.shape)
    return Projection(
        Grid((nx, ny, nz), grid.pitch / FINER), operator.beam, operator.motion, operator.vessel, operator.device
    )
