"""Measurements of a resin and of a projector, fitted."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import positive
from vamgpu.storage.reading import read_text

LN10 = float(np.log(10.0))
TOP = 255


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

    Args:
        absorption_height: h_a [mm].
        gel_dose: D_gel [mJ/mm³].
        confidence: Share of repetitions whose interval contains the true value.
        spread: Standard deviation [mm] of the heights about the curve.
        plugs: Measurements used.
    """

    absorption_height: Range
    gel_dose: Range
    confidence: float
    spread: float
    plugs: int

    def height(self, exposure: Any) -> np.ndarray:
        """Cured height for exposures.

        Args:
            exposure: I₀·t [mJ/mm²], a number or an array.

        Returns:
            Height [mm], shaped as [the exposures]; negative if nothing gels.
        """
        h, gel = self.absorption_height.value, self.gel_dose.value
        return h * np.log10(np.asarray(exposure, dtype=np.float64) * LN10 / (gel * h))

    @classmethod
    def fit(cls, exposure: Any, height: Any, confidence: float = 0.95) -> WorkingCurve:
        """Least squares over heights of plugs; intervals by Student's t, that of D_gel on its logarithm to first order.

        Args:
            exposure: I₀·t [mJ/mm²] of each plug.
            height: Height [mm] of each plug.
            confidence: Share of repetitions whose interval contains the true value, between 0 and 1.

        Returns:
            The curve.

        Raises:
            BadInput: Fewer than three plugs, fewer than two exposures, or heights that do not grow.
        """
        from scipy.stats import t as student

        x, z = _pairs(exposure, height, "exposures [mJ/mm²]", "heights [mm]")
        if not 0.0 < confidence < 1.0:
            raise BadInput(f"confidence is {confidence!r}; expected a share between 0 and 1")
        if len(x) < 3 or len(np.unique(x)) < 2 or (x <= 0).any():
            raise BadInput(f"got {len(x)} plugs at {len(np.unique(x))} exposures; expected 3 at 2 or more, all > 0")
        log = np.log10(x)
        center = log.mean()
        room = float(((log - center) ** 2).sum())
        slope = float(((log - center) * (z - z.mean())).sum()) / room
        if slope <= 0:
            raise BadInput(f"heights change by {slope:g} mm for ten times the exposure; expected them to grow")
        level = float(z.mean()) - slope * center
        spread = float(np.sqrt(((z - slope * log - level) ** 2).sum() / (len(x) - 2)))
        wide = float(student.ppf(0.5 + 0.5 * confidence, len(x) - 2)) * spread
        # ln D_gel = ln(ln10) − ln h − ln10·c/h with the line z = c + h·log10 x
        by_slope, by_level = -1.0 / slope + LN10 * level / slope**2, -LN10 / slope
        variance = (by_level**2 / len(x) + (by_slope - by_level * center) ** 2 / room) * wide**2
        gel, factor = LN10 / slope * 10.0 ** (-level / slope), float(np.exp(np.sqrt(variance)))
        reach = wide / room**0.5
        return cls(Range(slope, slope - reach, slope + reach), Range(gel, gel / factor, gel * factor), confidence,
                   spread, len(x))  # fmt: skip

    @classmethod
    def read(cls, path: str | Path, irradiance: float | None = None, confidence: float = 0.95) -> WorkingCurve:
        """Fit a CSV file whose header names ``height_mm`` and ``exposure_mJ_cm2``, or ``time_s`` with an irradiance.

        Args:
            path: The file.
            irradiance: I₀ [mW/mm²] if the file has only times; a column ``irradiance_mW_cm2`` replaces it.
            confidence: Share of repetitions whose interval contains the true value, between 0 and 1.

        Returns:
            The curve.

        Raises:
            StorageError: The file cannot be read.
            BadInput: It lacks a column, or its numbers fit no curve.
        """
        table = read_columns(path)
        if "height_mm" not in table:
            raise BadInput(f"{Path(path).name} has columns {', '.join(table)}; expected height_mm among them")
        if "exposure_mJ_cm2" in table:
            return cls.fit(table["exposure_mJ_cm2"] / 100.0, table["height_mm"], confidence)
        if "time_s" not in table:
            raise BadInput(f"{Path(path).name} has columns {', '.join(table)}; expected exposure_mJ_cm2 or time_s")
        if "irradiance_mW_cm2" in table:
            light = table["irradiance_mW_cm2"] / 100.0
        elif irradiance is not None:
            light = positive("irradiance [mW/mm²]", irradiance)
        else:
            raise BadInput(
                f"{Path(path).name} gives times; add a column irradiance_mW_cm2, or say the "
                'irradiance: --irradiance "10 mW/cm2", in Python irradiance=0.1 [mW/mm²]'
            )
        return cls.fit(table["time_s"] * light, table["height_mm"], confidence)


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
    table = read_columns(path)
    if not {"level", "intensity_mW_cm2"} <= set(table):
        raise BadInput(f"{Path(path).name} has columns {', '.join(table)}; expected level and intensity_mW_cm2")
    return fit_gray(table["level"], table["intensity_mW_cm2"] / 100.0, pieces)


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Read the columns of numbers of a CSV file.

    Args:
        path: The file.

    Returns:
        Name → values, float64 [line].

    Raises:
        StorageError: The file cannot be read.
        BadInput: The file is not a table of finite numbers; the message names the line.
    """
    file = Path(path)
    try:
        reader = csv.reader(StringIO(read_text(file)))
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StorageError(f"cannot read {str(path)!r}: {error}; check the path") from error
    if len(rows) < 2:
        raise BadInput(f"{file.name} has {len(rows)} lines; expected a header and numbers below it")
    header = [cell.strip() for cell in rows[0][1]]
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise BadInput(f"{file.name} has the column {twice[0]!r} more than once; keep one of them")
    values = []
    for number, row in rows[1:]:
        try:
            values.append([float(cell) for cell in row])
        except ValueError as error:
            raise BadInput(f"{file.name}, line {number}: {error}; expected numbers below the header") from error
        if len(row) != len(header):
            raise BadInput(f"{file.name}, line {number} has {len(row)} values; expected {len(header)}")
        if not np.isfinite(values[-1]).all():
            raise BadInput(f"{file.name}, line {number} holds NaN or infinity; correct it, or leave the line out")
    return dict(zip(header, np.array(values).T, strict=True))


def _pairs(x: Any, y: Any, name_x: str, name_y: str) -> tuple[np.ndarray, np.ndarray]:
    """Two rows of finite numbers of equal length, else `BadInput`."""
    try:
        one, two = np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name_x} and {name_y} must be numbers: {error}") from error
    if one.ndim != 1 or one.shape != two.shape or not one.size or not (np.isfinite(one) & np.isfinite(two)).all():
        raise BadInput(f"got {one.shape} {name_x} and {two.shape} {name_y}; expected as many of each, finite")
    return one, two
