"""A greyscale slice reproduced exactly by light that may be negative: points one after another.

Source: B. Wang et al., Lateral contrast enhancement via binary photoinhibition, "Necessity of dose subtraction".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, hypot, pi

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import centers, counts, positive

Floats = npt.NDArray[np.floating]
_CHUNK = 4096
"""Points looked at together when a buildup is evaluated."""


@dataclass(frozen=True)
class Slice:
    """A square slice of points whose diagonal is the diameter of the curing volume, and the light around it.

    Args:
        pixels: Points along x and y.
        angles: How many, even over a full turn.
        width: Of a bin along r, in pixels of the slice.
        extinction, subtraction: Beer–Lambert extinction of positive and of negative light, times the radius (μR,
            dimensionless; None for ``subtraction`` takes the same). Lengths are in pixels.

    Raises:
        BadInput: A value is out of its range.
    """

    pixels: int
    angles: int = 360
    width: float = 0.02
    extinction: float = 1.0
    subtraction: float | None = None

    def __post_init__(self) -> None:
        for name in ("pixels", "angles"):
            object.__setattr__(self, name, counts(f"Slice {name}", (getattr(self, name),), 1)[0])
        object.__setattr__(self, "width", positive("Slice width [pixels]", self.width))
        for name, value in (("extinction", self.extinction), ("subtraction", self.negative)):
            object.__setattr__(self, name, positive(f"Slice {name} μR", value, zero=True))

    @property
    def negative(self) -> float:
        """μR of negative light."""
        return self.extinction if self.subtraction is None else self.subtraction

    @property
    def radius(self) -> float:
        """R [pixels]: half the diagonal."""
        return 0.5 * hypot(self.pixels, self.pixels)

    @property
    def bins(self) -> int:
        """Bins along r; together at least as wide as the diagonal, centered on the axis."""
        return ceil(2.0 * self.radius / self.width)

    @property
    def step(self) -> float:
        """Δθ [rad]."""
        return 2.0 * pi / self.angles

    def points(self, factor: int = 1) -> tuple[Floats, Floats]:
        """List the points in raster order.

        Args:
            factor: Points along each side of a pixel.

        Returns:
            Coordinates x and y [pixels], each (points,).
        """
        place = centers(self.pixels * factor, 1.0 / factor)
        x, y = np.meshgrid(place, place, indexing="ij")
        return x.ravel(), y.ravel()

    def rays(self, x: Floats, y: Floats) -> tuple[npt.NDArray[np.intp], Floats]:
        """Find the bin of each point at each angle, and the path of the light to it.

        Args:
            x, y: Coordinates [pixels], (points,).

        Returns:
            Bins and paths [pixels], both (points, angles).
        """
        theta = self.step * np.arange(self.angles)
        cosine, sine = np.cos(theta), np.sin(theta)
        across = y[:, None] * cosine - x[:, None] * sine
        along = x[:, None] * cosine + y[:, None] * sine
        path = np.sqrt(np.maximum(self.radius**2 - across**2, 0.0)) - along
        bins = np.floor(across / self.width + 0.5 * self.bins).astype(np.intp)
        return np.clip(bins, 0, self.bins - 1), path


@dataclass(frozen=True, eq=False)
class ExactPlan:
    """Light of the exact reconstruction and what became of the points.

    Args:
        slice: Its geometry.
        light: I′ [angle, bin], dose per rad at the wall of the curing volume, negative where dose is subtracted; units
            of the design.
        blocked: Boolean [x, y], points left without a free angle.
    """

    slice: Slice
    light: Floats
    blocked: npt.NDArray[np.bool_]

    @property
    def positive(self) -> Floats:
        """Light of the first color [angle, bin] ≥ 0."""
        return np.maximum(self.light, 0.0)

    @property
    def negative(self) -> Floats:
        """Light of the second color [angle, bin] ≥ 0, whose dose is subtracted."""
        return np.maximum(-self.light, 0.0)

    def buildup(self, factor: int = 1) -> Floats:
        """Compute the absolute dose at the points, never rescaled.

        Args:
            factor: Places along each side of a pixel.

        Returns:
            Dose [x, y].
        """
        at, angle = self.slice, np.arange(self.slice.angles)
        x, y = at.points(factor)
        dose = np.empty(x.size, self.light.dtype)
        for start in range(0, x.size, _CHUNK):
            part = np.s_[start : start + _CHUNK]
            bins, path = at.rays(x[part], y[part])
            dose[part] = _received(at, self.light[angle, bins], path).sum(axis=1)
        return dose.reshape(at.pixels * factor, -1)

    def error(self, design: npt.ArrayLike, factor: int = 1) -> float:
        """Compare the buildup with the design, with a factor between the points too.

        Args:
            design: Gray values [x, y].
            factor: Places along each side of a pixel.

        Returns:
            Root mean square of the difference, a dose in units of the design.
        """
        wanted = np.kron(np.asarray(design, np.float64), np.ones((factor, factor)))
        return float(np.sqrt(np.mean((self.buildup(factor).astype(np.float64) - wanted) ** 2)))


def reconstruct(
    design: npt.ArrayLike,
    *,
    angles: int = 360,
    width: float = 0.02,
    extinction: float = 1.0,
    subtraction: float | None = None,
    dtype: npt.DTypeLike = np.float64,
    progress: Callable[[float], None] | None = None,
) -> ExactPlan:
    """Find light, positive and negative, whose buildup is the design at every point that keeps a free angle.

    Points go in raster order; each gets what it lacks, or loses what it has too much, spread evenly over all angles at
    which no earlier point shares its bin: I′ = I·e^{μl}, μ by the sign of I. Bins that an earlier point passes stay as
    they are, lit or not, so its dose never changes again. A point without a free angle keeps its error. Exact up to
    rounding where none is left without: only narrow bins do that.

    Args:
        design: Gray values [x, y], square.
        angles, width, extinction, subtraction: As for `Slice`; the width in pixels, the others dimensionless.
        dtype: float64 or float32, of the light and all sums.
        progress: Notified of the share done.

    Returns:
        The light and what became of the points.

    Raises:
        BadInput: A value is out of its range.
    """
    wanted = np.asarray(design, dtype)
    if wanted.ndim != 2 or wanted.shape[0] != wanted.shape[1] or not np.isfinite(wanted).all():
        raise BadInput(f"the design has shape {wanted.shape}; expected a square of finite grey values [x, y]")
    if wanted.dtype not in (np.float32, np.float64):
        raise BadInput(f"dtype is {wanted.dtype}; expected float64 or float32")
    at = Slice(wanted.shape[0], angles, width, extinction, subtraction)
    light, taken = np.zeros((at.angles, at.bins), wanted.dtype), np.zeros((at.angles, at.bins), bool)
    blocked, (x, y), angle = np.zeros(wanted.size, bool), at.points(), np.arange(at.angles)
    for start in range(0, wanted.size, at.pixels):
        row = np.s_[start : start + at.pixels]
        for n, bins, path in zip(range(start, start + at.pixels), *at.rays(x[row], y[row]), strict=True):
            lacking = wanted.flat[n] - _received(at, light[angle, bins], path).sum()
            free = ~taken[angle, bins]
            taken[angle, bins] = True
            blocked[n] = not free.any()
            if free.any() and lacking != 0:
                _spread(at, light, angle[free], bins[free], path[free], lacking)
        if progress is not None:
            progress((start + at.pixels) / wanted.size)
    return ExactPlan(at, light, blocked.reshape(wanted.shape))


def _received(at: Slice, light: Floats, path: Floats) -> Floats:
    """Dose of light [dose per rad] after a path [pixels], at each angle."""
    extinction = np.where(light < 0, at.negative, at.extinction) / at.radius
    return light * np.exp(-extinction * path).astype(light.dtype) * light.dtype.type(at.step)


def _spread(at: Slice, light: Floats, angle: npt.NDArray[np.intp], bins: npt.NDArray[np.intp], path: Floats,
            dose: float) -> None:  # fmt: skip
    """Put a dose on bins nobody has passed, equal shares as received."""
    extinction = (at.negative if dose < 0 else at.extinction) / at.radius
    light[angle, bins] = dose / (len(angle) * at.step) * np.exp(extinction * path)


def sufficient(pixels: int, spacing: float = 1.0) -> tuple[int, float]:
    """Tell how many angles, and what width of a bin, surely leave every point a free angle; far fewer can do.

    More than 2N angles, N = pixels² points, since two trajectories cross twice; and bins narrower than spacing·sin Δθ,
    so that neighbors part within one angle. Source: "Angular Resolution".

    Args:
        pixels: Points along x and y.
        spacing: Distance of neighbors [pixels].

    Returns:
        Angles, and the width of a bin [pixels].

    Raises:
        BadInput: A value is out of its range.
    """
    (across,) = counts("pixels", (pixels,), 1)
    angles = 2 * across**2 + 1
    return angles, positive("spacing [pixels]", spacing) * float(np.sin(2.0 * pi / angles))
