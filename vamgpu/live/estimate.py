"""Estimates the effect of the light so far: first a few parameters, then a gain for every voxel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.loss import look_up
from vamgpu.kernels.resample import resample
from vamgpu.kernels.watch import likelihood_weights, match_dose, share_gain, tilted_gain
from vamgpu.live.calibrated_projection import CalibratedProjection
from vamgpu.live.fields import here, picked, places, scaled
from vamgpu.live.local_dose import Fit, LocalDose
from vamgpu.live.prior import LEAST, MOST, NAMES, OPTICAL, Prior
from vamgpu.live.rings import on_rings
from vamgpu.live.smoothing import Smoothing
from vamgpu.losses.response import Response
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import extent
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.row_resampler import banded
from vamgpu.operators.space import require
from vamgpu.printing.scenarios import clouded_and_displaced, displaced

EDGE = 1e-3  # least distance of initial values from their bounds
STEPS = (0.05, 0.1, 0.1)
"""Steps of the finite differences for derivatives: a factor of absorption, and shares of a pixel."""
APART = (4, 2, 2)
"""Distances between the points about which derivatives are taken; between them the dose is known to second order."""
FAR = 0.75  # share of these distances beyond which derivatives are computed again
KEPT = 16  # number of operators whose tables are kept
REWEIGHTED = 2
"""Number of fits per set of derivatives; later ones are weighted by the number of voxels with a common error."""
SAMPLES = 20_000  # greatest number of voxels used for the parameters
ROUNDS = 2  # number of times that derivatives are computed again
RESIDUAL, NEIGHBORS = 0.03, 2.0
"""Standard deviations: of a voxel's own relative gain, and of the neighborhood over which it is smoothed [voxels]."""
SLICES = 32  # greatest number of slices used to estimate parameters; slices do not light each other
TINY = 1e-30  # a value below any variance of conversion
FAINT = 0.02  # share of the greatest dose below which two operators are not compared
OTHER = 1.5  # largest expected ratio between them
STILL = 0.05  # distance [pixels] of the axis from the light's middle up to which it makes no difference to a plan
BLOCK = 8  # edge of the blocks of voxels in which errors are compared [voxels]: wider than errors are correlated
FEWEST = 30.0  # fewest voxels of a reconstruction that count as one: its resolution is about three voxels


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters and dose of the light so far.

    Args:
        values: Value of each of `NAMES`, (7,).
        covariance: Covariance matrix, (7, 7), larger if the residuals exceed the noise.
        delivered: Dose so far, in units of Aᵀ(light), [x, y, z] on the device.
        lit: That dose by the parameters only, [x, y, z] on the device.
        std: Standard deviation of the dose of each voxel, in its unit, [x, y, z] on the device.
        chi_square: Sum of squared residuals of the voxels used, each over its variance.
        voxels: Number of voxels used for the parameters.
        unexplained: Mean square residual of the conversion of these voxels, over its variance.
    """

    values: np.ndarray
    covariance: np.ndarray
    delivered: DeviceArray
    lit: DeviceArray
    std: DeviceArray
    chi_square: float
    voxels: int
    unexplained: float

    @cached_property
    def dose(self) -> np.ndarray:
        """`delivered` as a NumPy array, [x, y, z]."""
        return self.delivered.numpy()

    @cached_property
    def deviation(self) -> np.ndarray:
        """`std` as a NumPy array, [x, y, z]."""
        return self.std.numpy()

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter by name."""
        spread = np.sqrt(np.diag(self.covariance))
        return {name: (float(v), float(s)) for name, v, s in zip(NAMES, self.values, spread, strict=True)}

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the parameters, −1 to 1, (7, 7)."""
        spread = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(spread, spread)


def _raising(rows: int, up: float) -> np.ndarray:
    """The matrix (rows, rows) that raises light by ``up`` rows, by linear interpolation."""
    return np.maximum(1.0 - np.abs(np.arange(rows)[:, None] - up - np.arange(rows)), 0.0)


class Estimator:
    """The most probable parameters of a print, given the observed conversion.

        minimize Σ ((M(D(p)) − seen) / deviation)² + (p − mean)ᵀ covariance⁻¹ (p − mean)

    by Gauss-Newton. The dose D and its derivatives come from operators whose resin is shifted or absorbs more. The
    remaining deviation gives each voxel a relative gain, which is smoothed over its neighbors and drawn towards 0.

    Args:
        operator: The operator of the plan.
        response: Conversion M of a dose in units of Aᵀ(light).
        rings: Whether `nearly` computes on rings, see `RingProjection`; None if they are faster.

    Raises:
        BadInput: The operator is not a `Projection`.
    """

    operator: Projection
    response: Response
    rings: bool | None

    def __init__(self, operator: Projection, response: Response, *, rings: bool | None = None) -> None:
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r}; expected a Projection, whose axis and absorption can be varied")
        self.operator, self.response, self.rings = operator, response, rings
        self._curve = response.curve()
        self._placed = lru_cache(KEPT)(self._placed_anew)
        x, y, z = operator.grid.axes()
        top, rim = max(float(z[-1]), operator.grid.pitch), operator.grid.inscribed_radius
        self._up, self._out = z / top, (x[:, None] ** 2 + y[None, :] ** 2) / rim**2 - 0.5

    def conversion(self, dose: np.ndarray) -> np.ndarray:
        """Conversion of a dose.

        Args:
            dose: Dose in units of Aᵀ(light), (...,).

        Returns:
            Conversion, (...,).
        """
        return look_up(dose, self._curve.values, self._curve.start, self._curve.density)[0]

    def gain(self, values: np.ndarray) -> DeviceArray:
        """Dose relative to that with the same light at every height and radius.

        Args:
            values: Value of each of `NAMES`, (7,).

        Returns:
            The factor of each voxel, [x, y, z] on the device.
        """
        gain = self.operator.device.empty(self.operator.domain.shape)
        up, aside = self._profiles
        self.operator.device.launch(
            tilted_gain, up=up, aside=aside, level=values[0], along=values[4], across=values[5], gain=gain
        )
        return gain

    @cached_property
    def _profiles(self) -> tuple[DeviceArray, DeviceArray]:
        """Profiles of the gain along z and across, as tables."""
        return self.operator.device.table(self._up), self.operator.device.table(self._out)

    def calibrated(self, values: np.ndarray) -> CalibratedProjection:
        """The operator with these parameters; its transpose gives the delivered dose.

        Args:
            values: Value of each of `NAMES`, (7,).

        Returns:
            The operator, on the device of the planned one.
        """
        placed = self._placed(float(values[1]), float(values[2]))
        return CalibratedProjection(placed, self.gain(values), float(values[3]))

    def nearly(self, values: np.ndarray, light: Any, dose: Any, height: float | None = None) -> CalibratedProjection:
        """A faster form of `calibrated` for planning: on rings if they are faster, otherwise `calibrated` itself.

        It uses the rings' tables of the planned operator. Light is moved; a gain represents the changed absorption.
        It is exact for one given light, and approximate for any other.

        Args:
            values: Value of each of `NAMES`, (7,).
            light: Light similar to the remaining light, [angle, r, z], NumPy or on the device.
            dose: Its dose with these parameters, such as `Estimate.lit`, [x, y, z], NumPy or on the device.
            height: Height of the remaining light [mm]; None for that in the parameters.

        Returns:
            The operator, on the device of the planned one.
        """
        later = np.array([*values[:3], values[3] if height is None else height, *values[4:]])
        if self.quick is None:
            return self.calibrated(later)
        device, raised = self.operator.device, self.quick.raised(float(values[3]))
        across = float(values[2]) if abs(values[2]) > STILL * self.operator.beam.pitch else 0.0
        moved, planned = CalibratedProjection(raised, self.gain(values), across=across), here(device, dose)
        got = moved.T(here(device, light))
        device.launch(match_dose, dose=planned, got=got, least=FAINT * extent(planned)[1], most=OTHER, gain=moved.gain)
        return CalibratedProjection(self.quick.raised(float(later[3])), moved.gain, across=across)

    @cached_property
    def quick(self) -> RingProjection | None:
        """The planned operator on rings; None if rays are used. Its tables are made on first use."""
        return on_rings(self.operator, self.rings)

    def _placed_anew(self, absorption: float, across: float) -> Projection:
        return clouded_and_displaced(self.operator, absorption - 1.0, across / self.operator.beam.pitch)

    def estimate(
        self, light: Any, seen: Any, deviation: Any, prior: Prior, start: np.ndarray | None = None,
        correlated: bool = False, common: float = 0.0,
    ) -> Estimate:  # fmt: skip
        """Estimate parameters and delivered dose.

        Args:
            light: Sum over the turns, as planned, [angle, r, z], NumPy or on the device.
            seen: Current conversion, [x, y, z], NumPy or on the device; NaN in a NumPy array for invalid voxels.
            deviation: Standard deviation of each voxel's conversion, [x, y, z], NumPy or on the device, or one for all.
            prior: Prior of the parameters.
            start: Initial values of the search, for example the last values, (7,); None for the prior's.
            correlated: Whether errors of neighbors may be correlated; their correlation is then measured.
            common: Relative error of the conversion common to all voxels, such as that of the turbidity, and its
                change from the middle to the top, and to the rim.

        Returns:
            The estimate.

        Raises:
            BadInput: An array does not hold numbers, or the parameters are impossible.
            ShapeMismatch: An array has another geometry.
        """
        require(self.operator.range, light, "the light")
        require(self.operator.domain, seen, "the conversion seen")
        device, shape = self.operator.device, self.operator.domain.shape
        lit, slices = here(device, light), self._slices(light)
        seen, spread, good = self._told(seen, deviation)
        used = self._used(slices, good)
        at = places(device, used, shape)
        measured, sigma = picked(seen, at), picked(spread, at)
        if not (np.isfinite(measured).all() and np.isfinite(sigma).all() and (sigma > 0.0).all()):
            raise self._unseen(used.size)
        whitening = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        values = np.array(prior.mean if start is None else start, float)
        if values.shape != prior.mean.shape or not np.isfinite(values).all():
            raise BadInput(f"start is {start!r}; expected {len(NAMES)} finite values of {', '.join(NAMES)}")
        fit = Fit(lit, used, measured, sigma, prior.mean, whitening)
        values, data, residuals, count = self._fitted(fit, values, correlated)
        spread = scaled(spread, sqrt(count))
        chi = float(count * (residuals @ residuals))
        self._check(values, chi)
        excess = max(chi / used.size, 1.0)
        unexplained = float(count * np.square(residuals * sigma).mean() / max(float(measured.var()), TINY))
        covariance = np.linalg.inv(data.T @ data / excess + whitening.T @ whitening)
        seen_off = common * measured * trends(*self._profile(used)) / (excess * sqrt(count) * sigma)
        shifts = covariance @ data.T @ seen_off.T  # by errors common to all voxels
        covariance = covariance + shifts @ shifts.T
        dose = self.calibrated(values).T(lit)
        field = scaled(dose, 1.0, values[6])
        std = self._by_voxel(field, seen, spread)
        return Estimate(values, covariance, field, dose, std, chi, used.size, unexplained)

    def _fitted(
        self, fit: Fit, values: np.ndarray, correlated: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Most probable parameters; derivatives and residuals of the voxels used; how many share an error."""
        data, residuals, near, count = np.empty((0, len(NAMES))), np.empty(0), None, FEWEST if correlated else 1.0
        voxels, curve = np.stack(np.unravel_index(fit.used, self.operator.domain.shape)), self._curve
        for _ in range(ROUNDS):
            if near is not None and (np.abs(values - near.center)[list(OPTICAL)] <= FAR * self._apart).all():
                break
            near = self._near(fit.light, self._center(values), fit.used)

            def gaps(p: np.ndarray, sigma: np.ndarray, near: LocalDose = near) -> np.ndarray:
                seen_less = (self.conversion(near.dose(p)) - fit.seen) / sigma
                return np.concatenate([seen_less, fit.whitening @ (p - fit.mean)])

            def rise(p: np.ndarray, sigma: np.ndarray, near: LocalDose = near) -> np.ndarray:
                rate = look_up(near.dose(p), curve.values, curve.start, curve.density)[1] * curve.density / sigma
                return np.concatenate([(rate * near.rates(p)).T, fit.whitening])

            for turn in range(REWEIGHTED if correlated else 1):
                count = max(alike(voxels, residuals), FEWEST) if turn else count
                begin, sigma = np.clip(values, LEAST + EDGE, MOST - EDGE), sqrt(count) * fit.sigma
                found: Any = least_squares(gaps, begin, jac=rise, bounds=(LEAST, MOST), args=(sigma,))  # pyright: ignore[reportArgumentType]
                values, data, residuals = found.x, found.jac[: fit.used.size], found.fun[: fit.used.size]
        return values, data, residuals, count

    def _told(self, seen: Any, deviation: Any) -> tuple[DeviceArray, DeviceArray, np.ndarray | None]:
        """Conversion and its deviation on the device, 0 at unseen voxels; mask of seen voxels, None for all."""
        device = self.operator.device
        known = None if isinstance(seen, DeviceArray) else np.isfinite(seen)
        good = None if known is None or known.all() else known
        measured = here(device, seen if good is None else np.where(good, seen, 0.0))
        if isinstance(deviation, DeviceArray) and good is None:
            return measured, here(device, deviation), None
        spread = np.broadcast_to(np.asarray(deviation, float), measured.shape)
        if good is not None:
            spread = np.where(good, spread, 0.0)
        if not np.isfinite(spread).all():
            raise self._unseen(spread.size if good is None else int(good.sum()))
        return measured, device.upload(spread), good

    def _unseen(self, count: int) -> BadInput:
        return BadInput(f"the conversion seen has {count} finite voxels in the judged cylinder; expected some, with "
                        "finite deviations above 0: drop this turn's images")  # fmt: skip

    def _slices(self, light: Any) -> np.ndarray:
        """Numbers of the slices to use: half of them spread evenly, half where light changes most along z."""
        count = self.operator.grid.shape[2]
        if count <= SLICES:
            return np.arange(count)
        angles = range(0, light.shape[0], max(light.shape[0] // 32, 1))
        some = [light.part(k, k + 1) for k in angles] if isinstance(light, DeviceArray) else [light[angles]]
        change = np.abs(np.gradient(np.concatenate(some), axis=2)).sum(axis=(0, 1), dtype=float)
        steep = self.operator.row_weights @ change
        even = np.linspace(0, count - 1, SLICES // 2).round().astype(int)
        steep[even] = -1.0
        return np.sort(np.concatenate([even, np.argsort(-steep, kind="stable")[: SLICES // 2]]))

    def _used(self, slices: np.ndarray, good: np.ndarray | None) -> np.ndarray:
        """Numbers of the voxels used to estimate parameters, spread evenly over those of the judged cylinder."""
        columns, count = np.flatnonzero(self.operator.grid.cylinder()), self.operator.grid.shape[2]
        if good is None:
            some, draw = None, columns.size * slices.size
        else:
            some = (columns[:, None] * count + slices).reshape(-1)
            some = some[good.reshape(-1)[some]]
            draw = some.size
        if not draw:
            raise self._unseen(0)
        drawn = np.sort(np.random.default_rng(0).choice(draw, min(SAMPLES, draw), replace=False))
        if some is not None:
            return some[drawn]
        column, k = np.divmod(drawn, slices.size)
        return columns[column] * count + slices[k]

    def _center(self, values: np.ndarray) -> np.ndarray:
        """The nearest values for derivatives: few different ones, because tables of operators then serve many turns."""
        center = values.copy()
        center[list(OPTICAL)] = self._apart * np.round(values[list(OPTICAL)] / self._apart)
        return center

    @cached_property
    def _apart(self) -> np.ndarray:
        return np.array(APART) * self._steps

    @cached_property
    def _steps(self) -> tuple[float, ...]:
        """`STEPS` in the units of the parameters."""
        return STEPS[0], *(step * self.operator.beam.pitch for step in STEPS[1:])

    def _mixed(self, light: DeviceArray, weights: np.ndarray) -> DeviceArray:
        """Slices of light, weighted by the weights of its rows, (slices, rows)."""
        device = self.operator.device
        mixed = device.empty((*light.shape[:2], len(weights)))
        device.launch(resample, source=light, lanes=light, **banded(device, weights), target=mixed)
        return mixed

    def _near(self, light: DeviceArray, center: np.ndarray, used: np.ndarray) -> LocalDose:
        """The dose near given parameters, by finite differences of operators."""
        count, weights, step = self.operator.grid.shape[2], self.operator.row_weights, STEPS[2]
        slices, place = np.unique(used % count, return_inverse=True)
        shape = (*self.operator.grid.shape[:2], slices.size)
        at = places(self.operator.device, used // count * slices.size + place, shape)
        rows, pitch = light.shape[2], self.operator.beam.pitch
        higher, lower = (_raising(rows, center[3] / pitch + side * step) for side in (1, -1))
        still, rising = (
            self._mixed(light, weights[slices] @ mix)
            for mix in (_raising(rows, center[3] / pitch), (higher - lower) / (2.0 * step * pitch))
        )

        absorption, across = (round(center[k + 1] / self._steps[k]) for k in (0, 1))

        def even(light: DeviceArray, clouds: int = 0, aside: int = 0) -> np.ndarray:
            """Dose of a gain of 1 at the voxels used, with given steps of absorption and of the axis off the center."""
            placed = self._placed((absorption + clouds) * self._steps[0], (across + aside) * self._steps[1])
            return picked(placed.lit_slices(light), at)

        middle, vessel = even(still), self.operator.vessel
        absorbs = vessel is not None and vessel.absorption > 0.0
        slopes, curves = np.zeros((2, len(OPTICAL), used.size))
        slopes[2] = even(rising)  # its curve has a kink, because light is interpolated linearly between rows
        for k, possible in enumerate((absorbs, self._movable)):
            if possible:
                low, high = (even(still, side * (k == 0), side * (k == 1)) for side in (-1, 1))
                slopes[k] = (high - low) / (2.0 * self._steps[k])
                curves[k] = (high - 2.0 * middle + low) / self._steps[k] ** 2
        return LocalDose(center, middle, slopes, curves, *self._profile(used))

    def _profile(self, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Profiles of the gain along z and across, at voxels."""
        count = self.operator.grid.shape[2]
        return self._up[used % count], self._out.reshape(-1)[used // count]

    @cached_property
    def _movable(self) -> bool:
        """Whether the vessel looks the same at every angle, which allows it to be off the light's middle."""
        try:
            return displaced(self.operator, STEPS[1]) is not None
        except BadInput:
            return False

    def _check(self, values: np.ndarray, chi: float) -> None:
        """Reject impossible parameters."""
        off = max(abs(values[2]) / (0.1 * self._width(0)), abs(values[3]) / (0.1 * self._width(1)))
        absurd = (values <= 1.05 * LEAST) | (values >= 0.95 * MOST)
        if not (np.isfinite(values).all() and np.isfinite(chi)) or absurd.any() or off > 1.0:
            measured = ", ".join(f"{name} {value:.4g}" for name, value in zip(NAMES, values, strict=True))
            raise BadInput(f"got {measured} from the conversion seen, impossible for a print; expected that of this "
                           "print: discard this turn's images and continue with the last plan")  # fmt: skip

    def _width(self, axis: int) -> float:
        return self.operator.beam.pixels[axis] * self.operator.beam.pitch

    def _by_voxel(self, dose: DeviceArray, seen: DeviceArray, spread: DeviceArray) -> DeviceArray:
        """Give each voxel's dose a gain estimated from its neighbors; return the remaining deviation."""
        device, curve = self.operator.device, self._curve
        shared = 1.0 / (2.0 * NEIGHBORS * np.sqrt(np.pi)) ** 3  # Σ of the squared weights of a neighborhood
        weight, pull = (device.empty(dose.shape) for _ in range(2))
        device.launch(
            likelihood_weights, dose=dose, seen=seen, deviation=spread, judged=self._judged, samples=self._samples,
            start=curve.start, density=curve.density, weight=weight, pull=pull,
        )  # fmt: skip
        weight, pull = self._neighborhoods(weight), self._neighborhoods(pull)
        least, std = RESIDUAL**-2, device.empty(dose.shape)
        device.launch(
            share_gain, pull=pull, weight=weight, least=shared * least, shared=shared, strength=least, dose=dose,
            deviation=std,
        )  # fmt: skip
        return std

    @cached_property
    def _judged(self) -> DeviceArray:
        """1 where columns are in the judged cylinder, a table."""
        return self.operator.device.table(self.operator.grid.cylinder().astype(np.float32))

    @cached_property
    def _samples(self) -> DeviceArray:
        return self.operator.device.table(self._curve.values)

    @cached_property
    def _neighborhoods(self) -> Smoothing:
        return Smoothing(self.operator.device, self.operator.grid.shape, NEIGHBORS)


def alike(voxels: np.ndarray, residuals: np.ndarray) -> float:
    """Number of voxels (3, voxels) with one error, which count as one: variance of blocks over that of voxels alone."""
    _, block = np.unique(voxels // BLOCK, axis=1, return_inverse=True)
    together, apart = np.square(np.bincount(block.ravel(), residuals)).sum(), np.square(residuals).sum()
    return float(max(together / apart, 1.0)) if apart > 0.0 else 1.0


def trends(up: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Errors common to all voxels: constant, in proportion to height, and to the squared radius; (3, voxels)."""
    return np.stack([np.ones_like(up), up, 2.0 * out])
