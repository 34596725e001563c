"""Scattering and absorption of a resin from light that passes cuvettes of two or more thicknesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import atanh, ceil, exp, inf, log, tanh

import numpy as np
from scipy.ndimage import gaussian_filter1d

from vamgpu.errors import BadInput
from vamgpu.geometry import counts
from vamgpu.optics.cuvette import Cuvette, detected, ring_edges
from vamgpu.optics.inputs import Floats
from vamgpu.optics.scattering import Scattering
from vamgpu.quantity import positive

RINGS = 24  # rings of an image whose light is fitted
PHOTONS = 200_000  # photons that are followed through each cuvette
LEAST = 1000  # fewest photons that may be followed
MOST = 30  # greatest number of steps of the fit, and of those towards the middle of an image
NEAR, SETTLED = 10.0, 0.5
"""Fall of the sum of squares by a step, over their mean, below which all photons are followed, and the fit ends."""
LONGEST = np.array([0.5, 0.4])  # greatest step of ln μ_s and of artanh g
SHARPEST = atanh(0.975)  # greatest artanh of the anisotropy
CONTRADICTED = 5.0  # standard deviations from the others above which a reading contradicts them
UNKNOWN = 0.25  # greatest standard deviation of g, and of μ_s relative to itself
HOT = 1e-3  # share of saturated pixels that may be faults of the camera
PILED, BELOW = 3.0, 20
"""Pixels at the greatest gray level, over those at any of so many levels below, from which it is taken as saturated."""
LOST = 0.1  # light of photons that were given up, in standard deviations of total light, from which a fit is refused
FEW = 10  # photons that the darkest ring should receive
TWO_SIDED = 1.96  # standard deviations of a 95 % interval to either side


@dataclass(frozen=True, eq=False)
class CuvetteSample:
    """Light that passed a cuvette of one thickness, in shares of the beam without a cuvette.

    Args:
        thickness: Path through the resin [mm].
        collimated: Share that arrives on the meter of collimated light.
        total: Share that arrives in the sphere.
        image: Gray levels of the paper, [row, column]; None if it was not photographed.

    Raises:
        BadInput: A value is out of its range.
    """

    thickness: float
    collimated: float
    total: float
    image: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name in ("thickness", "collimated", "total"):
            object.__setattr__(self, name, positive(f"CuvetteSample {name}", getattr(self, name)))
        if self.collimated > self.total:
            raise BadInput(f"the cuvette of {self.thickness:g} mm passes {self.total:g} of the beam in all, of which "
                           f"{self.collimated:g} are collimated; expected less: exchange the two")  # fmt: skip
        image = np.zeros((1, 1)) if self.image is None else np.asarray(self.image)
        if image.ndim != 2 or image.dtype.kind not in "uif" or not np.isfinite(image).all():
            raise BadInput(f"the image of {self.thickness:g} mm has shape {image.shape} and holds {image.dtype}; "
                           "expected finite gray levels [row, column]")  # fmt: skip


@dataclass(frozen=True)
class MeasuredScattering:
    """A resin's scattering and absorption with their standard deviations."""

    scattering: Scattering
    absorption: float  # [1/mm]; 0 if it was not measured
    errors: tuple[float, float, float]  # of μ_s [1/mm], g and absorption [1/mm]; infinite if not measured
    misfit: float  # root mean square of the residuals, in standard deviations

    def lines(self) -> tuple[tuple[str, str, str], ...]:
        """(name, value, meaning) of the numbers."""
        values = self.scattering.coefficient, float(self.scattering.anisotropy), self.absorption
        names = ("scattering", "{:.4g} /mm"), ("anisotropy", "{:.4f}"), ("absorption", "{:.4g} /mm")
        rows = [(name, form.format(value), f"± {form.format(TWO_SIDED * error)} with 95 %")
                for (name, form), value, error in zip(names, values, self.errors, strict=True)]  # fmt: skip
        if not self.absorption:
            rows[2] = ("absorption", "not measured", "too little for these readings: thicker cuvettes, or total again")
        return *rows, ("misfit", f"{self.misfit:.2g}", "of the readings, in their standard deviations; about 1")

    def toml(self) -> str:
        """``[scattering]`` and ``[vial]`` of a job file, with 95 % intervals as remarks."""
        (_, rate, rates), (_, g, gs), (_, absorption, absorptions), _ = self.lines()
        vial = f'absorption = "{absorption}"  # {absorptions}' if self.absorption else "# absorption was not measured"
        return f'[scattering]\ncoefficient = "{rate}"  # {rates}\nanisotropy = {g}  # {gs}\n\n[vial]\n{vial}\n'


def fit_scattering(
    cuvette: Cuvette, samples: Sequence[CuvetteSample], *, photons: int = PHOTONS, seed: int = 0
) -> MeasuredScattering:  # fmt: skip
    """Find scattering coefficient, anisotropy and absorption of a resin from cuvettes of two or more thicknesses.

    Least squares with the light of photons that are followed through the cuvettes, for the phase function of Henyey and
    Greenstein. The brightness of each image is free.

    Args:
        cuvette: The cuvettes and what measures the light.
        samples: Readings of two or more thicknesses, at least one with an image.
        photons: Number of photons through each cuvette.
        seed: Selects the photons.

    Returns:
        The resin, with standard deviations that include the noise of the photons.

    Raises:
        BadInput: Readings are impossible or contradict each other, an image is dark, saturated or too small, or light
            is scattered too little to be measured.
    """
    if counts("photons", (photons,), 1)[0] < LEAST:
        raise BadInput(f"photons is {photons}; expected at least {LEAST}, better {PHOTONS}")
    _check(cuvette, samples)
    readings = [_readings(cuvette, sample) for sample in samples]
    depth, dark = (-np.log([getattr(each, name) for each in samples]) for name in ("collimated", "total"))
    rates = np.polyfit([each.thickness for each in samples], np.stack([depth, dark], axis=1), 1)[0]
    absorption = float(np.clip(0.5 * rates[1], 1e-3 * rates[0], 0.5 * rates[0]))

    x, count = np.array([log(rates[0] - absorption), atanh(0.8), absorption]), max(photons // 8, LEAST)
    for _ in range(MOST):
        residual, slope = _equations(cuvette, samples, readings, x, count, seed, count == photons)
        bounded = x[2] == 0.0 and slope[:, 2] @ residual > 0.0
        free = slope * [1.0, 1.0, 0.0 if bounded else 1.0]
        step = -np.linalg.pinv(free) @ residual
        falls = ((free @ step) ** 2).sum() / max((residual**2).mean(), 1.0)
        if count == photons and falls < SETTLED:
            return _judged(samples, x, residual, slope)
        count = photons if falls < NEAR else count
        step = step * min(1.0, *(LONGEST / np.maximum(np.abs(step[:2]), 1e-9)))
        x = np.clip(x + step, (-np.inf, -SHARPEST, 0.0), (np.inf, SHARPEST, np.inf))
    raise BadInput(f"the fit does not settle in {MOST} steps; expected readings of one resin: check them")


def _equations(
    cuvette: Cuvette, samples: Sequence[CuvetteSample], readings: Sequence[tuple[Floats, Floats, Floats]], x: Floats,
    photons: int, seed: int, last: bool,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Residuals of all readings, and their slopes by ln μ_s, artanh g and absorption. Raises `BadInput`."""
    resin, found = Scattering(exp(x[0]), tanh(x[1])), []
    inner = np.array([resin.coefficient, 1.0 - tanh(x[1]) ** 2, 1.0])[:, None]
    for k, (sample, (value, error, edges)) in enumerate(zip(samples, readings, strict=True)):
        light, slope, variance, lost = detected(cuvette, sample.thickness, resin, float(x[2]), edges, photons, seed + k)
        rings = light[2:]
        if rings.size and not rings.any() or last and not rings.all():
            enough = ceil(FEW * value[2:].sum() / (value[2:].min() * max(rings.sum(), 1.0 / photons)))
            raise BadInput(f"none of {photons:_} photons reached the paper {edges[np.argmin(rings)]:.3g} mm from the "
                           f"beam; expected some: use photons={enough:_}, or leave out such pixels")  # fmt: skip
        if last and lost > LOST * cuvette.error * light[1]:
            raise BadInput(f"{lost:.2g} of the beam was given up in the cuvette of {sample.thickness:g} mm, "
                           f"whose total light is {light[1]:.2g}; expected next to none: use thinner ones")  # fmt: skip
        found.append(_compared(value, error, light, variance, inner * slope))
    residual, slope = (np.concatenate(each, axis=-1) for each in zip(*found, strict=True))
    return residual, slope.T


def _check(cuvette: Cuvette, samples: Sequence[CuvetteSample]) -> None:
    """Raise `BadInput` for readings that no resin has."""
    samples = sorted(samples, key=lambda each: each.thickness)
    if not samples or samples[0].thickness == samples[-1].thickness:
        raise BadInput(f"got {f'{samples[0].thickness:g} mm alone' if samples else 'no sample'}; expected two or more "
                       "thicknesses: scattering and absorption follow from how light falls with it")  # fmt: skip
    if all(each.image is None for each in samples):
        raise BadInput("no sample has an image; expected at least one, whose light gives the anisotropy: add it")
    for each in samples:
        if each.total > cuvette.clear * (1.0 + 3.0 * cuvette.error):
            raise BadInput(
                f"total light of {each.thickness:g} mm is {each.total:g} of the beam, but the near face "
                f"passes {cuvette.clear:.3g}; expected less: divide by the beam without a cuvette"
            )
    pairs = [("collimated", *pair) for pair in pairwise(samples)] + [("total", samples[0], samples[-1])]
    for name, thin, thick in pairs:
        before, behind = getattr(thin, name), getattr(thick, name)
        if behind >= before and thick.thickness > thin.thickness:
            raise BadInput(f"{name} light is {before:g} at {thin.thickness:g} mm and {behind:g} at {thick.thickness:g} "
                           "mm; expected it to fall: measure again")  # fmt: skip


def _compared(
    value: Floats, error: Floats, light: Floats, variance: Floats, slope: Floats
) -> tuple[Floats, Floats]:  # fmt: skip
    """Residuals of readings, in standard deviations, and their slopes, at the best brightness of the image."""
    scale, lit = np.ones(light.size), slice(2, None)
    if light.size > 2:
        scale[lit] = value[lit].sum() / light[lit].sum()
        weight = light / (error**2 + scale**2 * variance)
        scale[lit] = (weight[lit] @ value[lit]) / (weight[lit] @ light[lit])
    sigma = np.sqrt(error**2 + scale**2 * variance)
    model, slope = scale * light / sigma, scale * slope / sigma
    slope[:, lit] -= np.outer(slope[:, lit] @ model[lit], model[lit]) / max(model[lit] @ model[lit], 1e-300)
    return model - value / sigma, slope


def _judged(samples: Sequence[CuvetteSample], x: Floats, residual: Floats, slope: Floats) -> MeasuredScattering:
    """The result of a fit. Raises `BadInput` if readings contradict each other or leave the resin unknown."""
    names = [f"{name} of {each.thickness:g} mm" for each in samples for name in (
        "collimated light", "total light", *["the image"] * (0 if each.image is None else RINGS))]  # fmt: skip
    worst, free = int(np.abs(residual).argmax()), 3 + sum(each.image is not None for each in samples)
    if abs(residual[worst]) > CONTRADICTED:
        raise BadInput(f"{names[worst]} is {abs(residual[worst]):.0f} standard deviations from what other readings "
                       "mean; expected agreement: correct it or a dimension, or give a larger error")  # fmt: skip
    misfit = float(np.sqrt((residual**2).sum() / (residual.size - free)))
    sigma = np.sqrt(np.diag(np.linalg.pinv(slope.T @ slope))) * max(misfit, 1.0)
    rate, g = exp(x[0]), tanh(x[1])
    errors = float(rate * sigma[0]), float((1.0 - g * g) * sigma[1]), float(sigma[2]) if x[2] else inf
    if sigma[0] > UNKNOWN or errors[1] > UNKNOWN:
        raise BadInput(f"scattering is {rate:.3g} ± {errors[0]:.2g} /mm and its anisotropy {g:.3g} ± {errors[1]:.2g}; "
                       "expected smaller errors: use thicker cuvettes, which scatter more light")  # fmt: skip
    return MeasuredScattering(Scattering(rate, g), float(x[2]), errors, misfit)


def _readings(cuvette: Cuvette, sample: CuvetteSample) -> tuple[Floats, Floats, Floats]:
    """Collimated and total light and that of rings of the image, their standard deviations, and radii of the rings."""
    shares = np.array([sample.collimated, sample.total])
    if sample.image is None:
        return shares, cuvette.error * shares, np.zeros(1)
    image, what = np.asarray(sample.image), f"the image of {sample.thickness:g} mm"
    light, hole = image.astype(np.float64) - cuvette.dark, 0.5 * cuvette.hole / cuvette.pixel
    away, reach = _from_middle(light, hole)
    if reach < hole + 2 * RINGS:
        raise BadInput(f"{what} shows the paper {reach * cuvette.pixel:.3g} mm around the beam; expected at least "
                       f"{(hole + 2 * RINGS) * cuvette.pixel:.3g} mm: photograph more of it, from farther away or with "
                       "smaller pixels")  # fmt: skip
    edges = ring_edges(cuvette, reach * cuvette.pixel, RINGS)
    ring = np.digitize(away * cuvette.pixel, edges) - 1
    lit = (ring >= 0) & (ring < RINGS)
    if image.dtype.kind == "f" and not cuvette.full:
        raise BadInput(f"{what} holds {image.dtype}; expected whole numbers, or full in [cuvette]: the gray level of a "
                       "saturated pixel, which floats do not state")  # fmt: skip
    full = min(
        cuvette.full or np.inf, np.iinfo(image.dtype).max if image.dtype.kind in "ui" else np.inf, _top(image[lit])
    )
    if (image[lit] >= full).mean() > HOT:
        raise BadInput(f"{what} is saturated outside the hole; expected gray levels below {full:g}: expose it for a "
                       "shorter time, or make the hole larger")  # fmt: skip
    count, total, square = (np.bincount(ring[lit], light[lit] ** power, RINGS) for power in (0, 1, 2))
    mean, error = total / count, np.sqrt(np.maximum(square * count - total**2, 0.0) / count**3)
    dark = np.flatnonzero(mean <= 3.0 * error)
    if dark.size:
        raise BadInput(f"{what} is dark {edges[dark[0]]:.3g} mm from the beam; expected light: expose it longer, "
                       "correct dark, or leave out pixels farther away")  # fmt: skip
    area = np.pi * np.diff(edges**2)  # photons are counted on whole rings
    value, own = np.append(shares, mean * area), np.append([0.0, 0.0], error * area)
    return value, np.hypot(own, cuvette.error * value), edges


def _top(gray: np.ndarray) -> float:
    """The greatest gray level if pixels pile up there, as at the last one of 12 bits in a file of 16; else infinity."""
    level, count = np.unique(gray, return_counts=True)
    piled = level.size > 1 and count[-1] > PILED * count[-BELOW:-1].max()
    return float(level[-1]) if piled else inf


def _from_middle(light: Floats, hole: float) -> tuple[Floats, float]:
    """Distance of pixels from the point about which light is even, by how it falls, and that of the nearest border."""
    (rows, columns), away, reach = light.shape, np.zeros(light.shape), 0.0
    row, column, right, down = 0.5 * (rows - 1), 0.5 * (columns - 1), 0.0, 0.0
    for _ in range(MOST):
        row, column = row + float(down), column + float(right)
        y, x = np.indices(light.shape) - np.array([row, column])[:, None, None]
        away, reach = np.hypot(x, y), min(column, row, columns - 1 - column, rows - 1 - row)
        some = (away > hole + 1.0) & (away < reach)
        if reach < hole + 2 * RINGS:
            break
        ring = away[some].astype(int)
        mean = np.bincount(ring, light[some]) / np.maximum(np.bincount(ring), 1)
        mean[: ring.min()] = mean[ring.min()]
        fall = np.asarray(np.gradient(gaussian_filter1d(mean, 2.0)))[ring] / away[some]
        right, down = np.linalg.pinv(np.stack([fall * x[some], fall * y[some]], axis=1)) @ (mean[ring] - light[some])
        if max(abs(right), abs(down)) < 0.01:
            break
    return away, reach
