"""Measurements of a resin and of a projector, fitted."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.curethrough.spectrum import LampSpectrum
from vamgpu.errors import BadInput, SliceWarning
from vamgpu.geometry import positive
from vamgpu.schema.quantities import numeric
from vamgpu.storage.tables import read_table

LN10 = float(np.log(10.0))
TOP = 255
LOST = 4.0  # a plug should have gelled if its expected height is more than this number of standard deviations
BENT = 0.01  # level of significance: if scatter is less likely to bend the heights so, they do not follow the law


@dataclass(frozen=True)
class Range:
    """A fitted value and its confidence interval.

    Args:
        value: The value; both bounds are in the unit of the fitted quantity [mm or mJ/mm³].
        low: Lower bound [mm or mJ/mm³].
        high: Upper bound [mm or mJ/mm³].
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class WorkingCurve:
    """Cured height z = h_a·log10[I₀·t·ln10 / (D_gel·h_a)] fitted to plugs (Pritchard et al. 2019, eq. S1).

    The likelihood counts a plug of height 0 as censored: the curve gives it 0 or less. Leaving such plugs out, or
    fitting them as heights, makes both numbers too small.

    Args:
        absorption_height: h_a [mm].
        gel_dose: D_gel [mJ/mm³].
        confidence: Share of repetitions whose interval contains the true value.
        spread: Standard deviation [mm] of the heights about the curve.
        plugs: Measurements used.
        uncured: How many of them did not gel.
        lamp: Spectrum of the light; None for one wavelength. The absorption height is that of its mean absorption.
    """

    absorption_height: Range
    gel_dose: Range
    confidence: float
    spread: float
    plugs: int
    uncured: int = 0
    lamp: LampSpectrum | None = None

    def height(self, exposure: Any) -> np.ndarray:
        """Cured height for exposures.

        Args:
            exposure: I₀·t [mJ/mm²], a number or an array.

        Returns:
            Height [mm], shaped as [the exposures]; negative if nothing gels.
        """
        h, gel = self.absorption_height.value, self.gel_dose.value
        found = np.log10(np.asarray(exposure, dtype=np.float64) * LN10 / (gel * h))
        return h * (found if self.lamp is None else self.lamp.depth(found))

    @classmethod
    def fit(
        cls, exposure: Any, height: Any, confidence: float = 0.95, lamp: LampSpectrum | None = None
    ) -> WorkingCurve:
        """Maximum likelihood for heights that scatter alike; intervals by its profile, also of few plugs.

        Args:
            exposure: I₀·t [mJ/mm²] of each plug.
            height: Height [mm] of each plug; 0 where nothing gelled.
            confidence: Share of repetitions whose interval contains the true value, between 0 and 1.
            lamp: Spectrum of the light, if it has several wavelengths that the resin absorbs differently.

        Returns:
            The curve.

        Raises:
            BadInput: Fewer than three plugs gelled, or at fewer than two exposures, or heights do not grow.

        Warns:
            SliceWarning: The heights do not follow the law.
        """
        x, z = _pairs(exposure, height, "exposures [mJ/mm²]", "heights [mm]")
        if not 0.0 < confidence < 1.0:
            raise BadInput(f"confidence is {confidence!r}; expected a share between 0 and 1")
        cured = z > 0
        several = len(np.unique(np.round(np.log10(np.maximum(x[cured], 1e-300)), 6)))
        if cured.sum() < 3 or several < 2 or (x <= 0).any() or (z < 0).any():
            raise BadInput(f"got {cured.sum()} plugs that gelled, at {several} exposures; expected 3 at 2 or more, all "
                           "> 0, and no height below 0")  # fmt: skip
        line = _Line(np.log10(x), z, cured, lamp)
        if line.best[1] <= 0:
            raise BadInput(f"heights change by {line.best[1]:g} mm for ten times the exposure; expected them to grow")
        level, slope = line.bounds(confidence)
        for doubt in line.doubts():
            warnings.warn(doubt, SliceWarning, stacklevel=2)
        h, gel = float(line.best[1]), float(_gel_dose(*line.best))
        doses = _gel_dose(level[slope > 0], slope[slope > 0])
        high = float(doses.max()) if (slope > 0).all() else np.inf
        return cls(Range(h, float(slope.min()), float(slope.max())), Range(gel, float(doses.min()), high), confidence,
                   line.spread, len(x), int((~cured).sum()), lamp)  # fmt: skip

    @classmethod
    def read(
        cls, path: str | Path, irradiance: float | None = None, confidence: float = 0.95,
        lamp: LampSpectrum | None = None,
    ) -> WorkingCurve:  # fmt: skip
        """Fit a table whose header names ``height_mm`` and ``exposure_mJ_cm2``, or ``time_s`` with an irradiance.

        Headers may have other names and units, such as ``Depth [µm]``; `read_table` lists what may separate cells.

        Args:
            path: The file.
            irradiance: I₀ [mW/mm²] if the file has only times; a column such as ``irradiance_mW_cm2`` replaces it.
            confidence: Share of repetitions whose interval contains the true value, between 0 and 1.
            lamp: Spectrum of the light, if it has several wavelengths that the resin absorbs differently.

        Returns:
            The curve.

        Raises:
            StorageError: The file cannot be read.
            BadInput: It lacks a column, or its numbers fit no curve.
        """
        table = read_table(path)
        height, dose = table.find("height"), table.find("exposure")
        if height is None:
            raise table.lacks("height_mm among them, or another length such as 'height [µm]'")
        if dose is None:
            seconds, light = table.find("time"), table.find("irradiance")
            if seconds is None:
                raise table.lacks("exposure_mJ_cm2", "time_s")
            if light is None and irradiance is not None:
                light = positive("irradiance [mW/mm²]", irradiance)
            if light is None:
                raise BadInput(
                    f"{table.name} gives times; add a column irradiance_mW_cm2, or give the "
                    'irradiance: --irradiance "10 mW/cm2", in Python irradiance=0.1 [mW/mm²]'
                )
            dose = seconds * light
        return cls.fit(dose, height, confidence, lamp)


class _Line:
    """The likeliest line z = c + h·log10 x of heights above 0 that scatter alike; a curve by `LampSpectrum.depth`."""

    def __init__(self, x: np.ndarray, z: np.ndarray, cured: np.ndarray, lamp: LampSpectrum | None) -> None:
        from scipy.optimize import minimize

        self.x, self.z, self.cured, self.n, self.lamp = x, z, cured, int(cured.sum()), lamp
        self.least = (1e-9 * float(z.max())) ** 2  # of a variance, for heights without scatter
        rows = np.stack([np.ones(self.n), x[cured]], 1)
        best, *_ = np.linalg.lstsq(rows, z[cured], rcond=None)
        if not cured.all() or lamp is not None:
            start = (*best, 0.5 * np.log(self._variance(*best[:, None])[0]))
            options = {"xatol": 1e-10, "fatol": 1e-10, "maxiter": 5000}
            best = minimize(lambda p: self._loss(*p)[0], start, method="Nelder-Mead", options=options).x[:2]
        self.best = best
        deviation, self.lowest = (found[0] for found in self._profile(*best[:, None]))
        self.spread = float(deviation) * (self.n / (self.n - 2)) ** 0.5
        self.scale = self.spread * np.linalg.cholesky(np.linalg.inv(rows.T @ rows))

    def bounds(self, confidence: float, directions: int = 120) -> tuple[np.ndarray, np.ndarray]:
        """Levels and slopes about the best, as unlikely as ``confidence`` allows."""
        from scipy.stats import t as student

        t = float(student.ppf(0.5 + 0.5 * confidence, self.n - 2))
        limit = self.lowest + 0.5 * self.n * np.log1p(t**2 / (self.n - 2))  # without uncured plugs this is Student's t
        angle = 2.0 * np.pi * np.arange(directions) / directions
        ways = self.scale @ np.stack([np.cos(angle), np.sin(angle)])
        low, high = np.zeros(directions), np.full(directions, 1e3 * t)
        for _ in range(32):
            middle = 0.5 * (low + high)
            beyond = self._profile(*(self.best[:, None] + middle * ways))[1] > limit
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        level, slope = self.best[:, None] + low * ways
        return level, slope

    def doubts(self) -> list[str]:
        """Why the heights do not follow the law."""
        from scipy.stats import t as student

        found, z, way = [], self.z[self.cured], self.x
        if self.lamp is not None:  # along it, heights are a line again
            way = self.lamp.depth(self.x + self.best[0] / self.best[1])
        x = way[self.cured] - way[self.cured].mean()
        if self.n > 4 and len(np.unique(x)) > 3:
            rows = np.stack([np.ones(self.n), x, x**2], 1)
            inverse = np.linalg.pinv(rows.T @ rows)
            fit = inverse @ rows.T @ z
            rest = float(((z - rows @ fit) ** 2).sum()) / (self.n - 3)
            error = np.sqrt(max(rest, self.least) * inverse[2, 2])
            if 2.0 * student.sf(abs(fit[2]) / error, self.n - 3) < BENT:
                more = "less" if fit[2] < 0 else "more"
                found.append(f"the heights do not follow the law: they grow {more} at high exposures than at low ones; "
                             "use plugs near the heights that you print, and one wavelength")  # fmt: skip
        slope, level = np.polyfit(way[self.cured], z, 1)  # without the lost ones, which would widen the scatter
        deviation = max(float(((z - level - slope * way[self.cured]) ** 2).mean()), self.least) ** 0.5
        expected = level + slope * way[~self.cured]
        if odd := int((expected > LOST * deviation).sum()):
            found.append(f"{odd} plugs of height 0 got exposures for which the curve gives up to {expected.max():.3g} "
                         "mm: were they lost? leave their lines out")  # fmt: skip
        return found

    def _heights(self, level: np.ndarray, slope: np.ndarray, some: np.ndarray) -> np.ndarray:
        """Heights (lines, plugs) of some plugs."""
        level, slope, x = level[:, None], slope[:, None], self.x[some]
        if self.lamp is None:
            return level + slope * x
        steep = np.maximum(slope, 1e-9 * self.z.max())
        return np.where(slope > 0, steep * self.lamp.depth(x + level / steep), level + slope * x)

    def _variance(self, level: np.ndarray, slope: np.ndarray) -> np.ndarray:
        apart = self.z[self.cured] - self._heights(level, slope, self.cured)
        return np.maximum((apart**2).mean(axis=1), self.least)

    def _loss(self, level: Any, slope: Any, log_deviation: Any) -> np.ndarray:
        """−ln likelihood of lines, without constants."""
        from scipy.special import log_ndtr

        level, slope, log_deviation = np.atleast_1d(level, slope, log_deviation)
        below = self._heights(level, slope, ~self.cured) / np.exp(log_deviation)[:, None]
        spread = 0.5 * self._variance(level, slope) * np.exp(-2.0 * log_deviation)
        return self.n * (log_deviation + spread) - log_ndtr(-below).sum(axis=1)

    def _profile(self, level: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The most likely deviation of each line, and its loss."""
        log = 0.5 * np.log(self._variance(level, slope))
        if not self.cured.all():  # uncured plugs only widen or narrow it a little: golden sections
            low, high = log - 2.0, log + 3.0
            for _ in range(20):
                one, two = low + 0.381966 * (high - low), low + 0.618034 * (high - low)
                left = self._loss(level, slope, one) < self._loss(level, slope, two)
                low, high = np.where(left, low, one), np.where(left, two, high)
            log = 0.5 * (low + high)
        return np.exp(log), self._loss(level, slope, log)


def _gel_dose(level: Any, slope: Any) -> Any:
    """D_gel of the line z = level + slope·log10 x."""
    return LN10 / slope * 10.0 ** (-level / slope)


@dataclass(frozen=True)
class GrayFit:
    """Light of a projector over its gray levels: straight pieces that never fall, fitted to readings.

    Args:
        levels: Gray levels at which pieces meet, from 0 to 255.
        intensity: Light there [mW/mm²].
        spread: Standard deviation of the readings about the curve [mW/mm²].
    """

    levels: tuple[int, ...]
    intensity: tuple[float, ...]
    spread: float

    def __call__(self, level: Any) -> np.ndarray:
        """Light of gray levels 0 to 255."""
        return np.interp(level, self.levels, self.intensity)

    def table(self) -> tuple[float, ...]:
        """Light of every level, in the form for printers."""
        return tuple(self(np.arange(TOP + 1)).tolist())


def fit_gray(levels: Any, intensity: Any, pieces: int | None = None) -> GrayFit:
    """Fit straight pieces that never fall to light at gray levels, 0 and 255 among them. Raises `BadInput`."""
    from scipy.optimize import nnls

    x, y = _pairs(levels, intensity, "gray levels", "intensities")
    if (x != np.round(x)).any() or x.min() != 0 or x.max() != TOP or (y < 0).any():
        raise BadInput(f"gray levels run from {x.min():g} to {x.max():g}; expected whole ones from 0 to 255, light ≥ 0")
    read = np.unique(x)
    count = min(len(read) - 1, 32) if pieces is None else pieces
    if not 1 <= count < len(read):
        raise BadInput(f"pieces is {pieces!r}; expected 1 to {len(read) - 1} for readings at {len(read)} levels")
    knots = read[np.round(np.linspace(0, len(read) - 1, count + 1)).astype(int)]
    ramps = [np.clip((x - a) / (b - a), 0.0, 1.0) for a, b in zip(knots[:-1], knots[1:], strict=True)]
    steps, _ = nnls(np.stack([np.ones_like(x), *ramps], axis=1), y)
    light = np.cumsum(steps)
    apart = y - np.interp(x, knots, light)
    spread = float(np.sqrt((apart**2).sum() / max(1, len(x) - len(knots))))
    return GrayFit(tuple(int(k) for k in knots), tuple(light.tolist()), spread)


def read_gray(path: str | Path, pieces: int | None = None) -> GrayFit:
    """Fit a CSV file with columns ``level`` and ``intensity_mW_cm2``.

    Args:
        path: The file.
        pieces: Straight pieces of the fit; None for the greatest number that the readings support.

    Returns:
        The fit, in mW/mm².

    Raises:
        StorageError: The file cannot be read.
        BadInput: It lacks a column, or its numbers fit no curve.
    """
    table = read_table(path)
    light = table.find("irradiance")
    if light is None or "level" not in table.cells:
        raise table.lacks("level and intensity_mW_cm2")
    return fit_gray(table.numbers("level"), light, pieces)


def _pairs(x: Any, y: Any, name_x: str, name_y: str) -> tuple[np.ndarray, np.ndarray]:
    """Two rows of finite numbers of equal length, else `BadInput`."""
    one, two = numeric(name_x, x), numeric(name_y, y)
    if one.shape != two.shape:
        raise BadInput(f"got {one.shape} {name_x} and {two.shape} {name_y}; expected the same number of each")
    return one, two
