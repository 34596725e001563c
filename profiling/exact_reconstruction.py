"""A grayscale slice reproduced exactly by light that may be negative, one point after another.

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
"""Points of a buildup that are evaluated together."""


@dataclass(frozen=True)
class Slice:
    """A square slice of points, its diagonal the diameter of the curing volume [pixels]. Raises `BadInput`."""

    pixels: int  # points along x and y
    angles: int = 360  # how many, evenly spaced over a full turn
    width: float = 0.02  # of a bin along r, in pixels of the slice
    extinction: float = 1.0  # μR of positive light, Beer–Lambert extinction times the radius
    subtraction: float | None = None  # μR of negative light; None for the same

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
        """Coordinates x and y [pixels] of the points in raster order, ``factor`` along each side of a pixel."""
        place = centers(self.pixels * factor, 1.0 / factor)
        x, y = np.meshgrid(place, place, indexing="ij")
        return x.ravel(), y.ravel()

    def rays(self, x: Floats, y: Floats) -> tuple[npt.NDArray[np.intp], Floats]:
        """Bin of each point at each angle, and the light's path to it [pixels], both (points, angles)."""
        theta = self.step * np.arange(self.angles)
        cosine, sine = np.cos(theta), np.sin(theta)
        across = y[:, None] * cosine - x[:, None] * sine
        along = x[:, None] * cosine + y[:, None] * sine
        path = np.sqrt(np.maximum(self.radius**2 - across**2, 0.0)) - along
        bins = np.floor(across / self.width + 0.5 * self.bins).astype(np.intp)
        return np.clip(bins, 0, self.bins - 1), path


@dataclass(frozen=True, eq=False)
class ExactPlan:
    """Light of the exact reconstruction, and the points that it does not reproduce."""

    slice: Slice  # its geometry
    light: Floats  # I′ [angle, bin], dose per rad at the wall of the curing volume, negative where dose is subtracted
    blocked: npt.NDArray[np.bool_]  # boolean [x, y], points left without a free angle

    @property
    def positive(self) -> Floats:
        """Light of the first color [angle, bin] ≥ 0."""
        return np.maximum(self.light, 0.0)

    @property
    def negative(self) -> Floats:
        """Light of the second color [angle, bin] ≥ 0, whose dose is subtracted."""
        return np.maximum(-self.light, 0.0)

    def buildup(self, factor: int = 1) -> Floats:
        """Absolute dose [x, y] at ``factor`` positions along each side of a pixel, never rescaled."""
        at, angle = self.slice, np.arange(self.slice.angles)
        x, y = at.points(factor)
        dose = np.empty(x.size, self.light.dtype)
        for start in range(0, x.size, _CHUNK):
            part = np.s_[start : start + _CHUNK]
            bins, path = at.rays(x[part], y[part])
            dose[part] = _received(at, self.light[angle, bins], path).sum(axis=1)
        return dose.reshape(at.pixels * factor, -1)

    def error(self, design: npt.ArrayLike, factor: int = 1) -> float:
        """Root mean square of buildup − design [x, y]; a factor above 1 includes positions between the points."""
        target = np.kron(np.asarray(design, np.float64), np.ones((factor, factor)))
        return float(np.sqrt(np.mean((self.buildup(factor).astype(np.float64) - target) ** 2)))


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
    """Light of two signs whose buildup is the design [x, y] at all points that keep a free angle. Raises `BadInput`."""
    # Points are processed in raster order. Each gets its missing dose, or loses its excess, spread evenly over the
    # angles at which no earlier point shares its bin: I′ = I·e^{μl}, μ by the sign of I; these bins stay as they are.
    target = np.asarray(design, dtype)
    if target.ndim != 2 or target.shape[0] != target.shape[1] or not np.isfinite(target).all():
        raise BadInput(f"the design has shape {target.shape}; expected a square of finite grey values [x, y]")
    if target.dtype not in (np.float32, np.float64):
        raise BadInput(f"dtype is {target.dtype}; expected float64 or float32")
    at = Slice(target.shape[0], angles, width, extinction, subtraction)
    light, taken = np.zeros((at.angles, at.bins), target.dtype), np.zeros((at.angles, at.bins), bool)
    blocked, (x, y), angle = np.zeros(target.size, bool), at.points(), np.arange(at.angles)
    for start in range(0, target.size, at.pixels):
        row = np.s_[start : start + at.pixels]
        for n, bins, path in zip(range(start, start + at.pixels), *at.rays(x[row], y[row]), strict=True):
            lacking = target.flat[n] - _received(at, light[angle, bins], path).sum()
            free = ~taken[angle, bins]
            taken[angle, bins] = True
            blocked[n] = not free.any()
            if free.any() and lacking != 0:
                _spread(at, light, angle[free], bins[free], path[free], lacking)
        if progress is not None:
            progress((start + at.pixels) / target.size)
    return ExactPlan(at, light, blocked.reshape(target.shape))


def _received(at: Slice, light: Floats, path: Floats) -> Floats:
    """Dose of light [dose per rad] after a path [pixels], at each angle."""
    extinction = np.where(light < 0, at.negative, at.extinction) / at.radius
    return light * np.exp(-extinction * path).astype(light.dtype) * light.dtype.type(at.step)


def _spread(at: Slice, light: Floats, angle: npt.NDArray[np.intp], bins: npt.NDArray[np.intp], path: Floats,
            dose: float) -> None:  # fmt: skip
    """Put a dose on unused bins, in equal shares at the point."""
    extinction = (at.negative if dose < 0 else at.extinction) / at.radius
    light[angle, bins] = dose / (len(angle) * at.step) * np.exp(extinction * path)


def sufficient(pixels: int, spacing: float = 1.0) -> tuple[int, float]:
    """Number of angles and width of a bin [pixels] that leave every point a free angle. Raises `BadInput`."""
    # More than 2N angles, N = pixels², because two trajectories cross twice; bins narrower than spacing·sin Δθ.
    (across,) = counts("pixels", (pixels,), 1)
    angles = 2 * across**2 + 1
    return angles, positive("spacing [pixels]", spacing) * float(np.sin(2.0 * pi / angles))
