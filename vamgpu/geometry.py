"""The nouns a print is described with: grids, beams, motions and the protocol a vessel answers to.

Axes are ``[x, y, z]`` for volumes and ``[angle, r, z]`` for sinograms; the axis of rotation is x = y = 0 and every
grid and beam is centered on it. With θ the pose, ``r = y·cosθ − x·sinθ`` and light travels towards −(cosθ, sinθ).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Protocol, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput


HALF_A_PIXEL = 0.5
"""Standard deviation [pixels] of the point spread of a projector in focus, where nobody measured it."""


def positive(name: str, value: float, *, zero: bool = False) -> float:
    """``value`` as a float if it is finite and positive (or zero, where allowed), else `BadInput`."""
    try:
        number = float(value) if not isinstance(value, (str, bytes)) else float("nan")
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{name} is {value!r}; wanted a number") from error
    if not isfinite(number) or number < 0 or (number == 0 and not zero):
        raise BadInput(f"{name} is {value!r}; wanted a finite number {'≥' if zero else '>'} 0")
    return number


def counts(name: str, values: object, length: int) -> tuple[int, ...]:
    """``values`` as a tuple of ``length`` positive integers, else `BadInput`."""
    try:
        numbers = tuple(int(v) for v in values)  # type: ignore[attr-defined]
        exact = all(int(v) == v for v in values)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{name} is {values!r}; wanted {length} positive integers") from error
    if len(numbers) != length or not exact or min(numbers) < 1:
        raise BadInput(f"{name} is {values!r}; wanted {length} positive integers")
    return numbers


def centers(n: int, pitch: float) -> np.ndarray:
    """Positions [mm] of ``n`` samples ``pitch`` apart, centered on zero; shape (n,)."""
    return (np.arange(n) - 0.5 * (n - 1)) * pitch


@dataclass(frozen=True)
class Grid:
    """A box of cubic voxels centered on the axis of rotation.

    shape: voxels along x, y, z.  pitch: voxel edge [mm].  Raises `BadInput`.
    """

    shape: tuple[int, int, int]
    pitch: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", counts("Grid shape", self.shape, 3))
        object.__setattr__(self, "pitch", positive("Grid pitch [mm]", self.pitch))

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel [mm³]."""
        return self.pitch**3

    @property
    def inscribed_radius(self) -> float:
        """Radius [mm] of the largest cylinder about the axis whose voxel centers all lie in the box."""
        return 0.5 * (min(self.shape[:2]) - 1) * self.pitch

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Voxel centers [mm] along x, y and z."""
        nx, ny, nz = (centers(n, self.pitch) for n in self.shape)
        return nx, ny, nz

    def cylinder(self) -> np.ndarray:
        """Boolean (nx, ny): voxel centers inside the inscribed cylinder."""
        x, y, _ = self.axes()
        return x[:, None] ** 2 + y[None, :] ** 2 <= self.inscribed_radius**2 * (1 + 1e-12)


@dataclass(frozen=True)
class Beam:
    """A collimated beam of light pixels, centered on the axis of rotation.

    A pixel lights a square box, blurred by a Gaussian point spread. Both keep its power.

    Args:
        pixels: columns along r, rows along z.
        pitch: pixel edge [mm], measured in air.
        fill: share of a pixel's area that is lit (the fill factor of the mirrors), above 0, at most 1.
        spread: standard deviation of the point spread in the resin [mm], or what was measured of it (anything with a
            ``width`` [mm], such as the `EdgeResponse` of `vam calibrate mtf`). None, the default, is a projector in
            focus: half a pixel, along columns and along rows. 0 is a perfect lens, which no machine has.

    Raises:
        BadInput: a value is out of its range.
    """

    pixels: tuple[int, int]
    pitch: float
    fill: float = 1.0
    spread: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", counts("Beam pixels", self.pixels, 2))
        object.__setattr__(self, "pitch", positive("Beam pitch [mm]", self.pitch))
        object.__setattr__(self, "fill", positive("Beam fill", self.fill))
        if self.fill > 1.0:
            raise BadInput(f"Beam fill is {self.fill:g}; expected a share of the pixel's area, above 0 and at most 1")
        if self.spread is not None:
            measured = getattr(self.spread, "width", self.spread)
            object.__setattr__(self, "spread", positive("Beam spread [mm]", measured, zero=True))

    @property
    def pixel_area(self) -> float:
        """Area of one pixel [mm²]."""
        return self.pitch**2

    def columns(self) -> np.ndarray:
        """Offsets r [mm] of the columns from the axis."""
        return centers(self.pixels[0], self.pitch)

    def blur(self, column: float | None = None) -> tuple[float, float]:
        """Standard deviations of the point spread, in columns and in rows.

        Args:
            column: width of a column in the resin on the axis [mm], where refraction makes it another than the pitch.
        """
        if self.spread is None:
            return HALF_A_PIXEL, HALF_A_PIXEL
        return self.spread / (self.pitch if column is None else column), self.spread / self.pitch


@dataclass(frozen=True)
class Turntable:
    """A resin container turning about z: ``angles`` equal poses over a full turn, from θ = 0.  Raises `BadInput`."""

    angles: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles", counts("Turntable angles", (self.angles,), 1)[0])

    @property
    def poses(self) -> np.ndarray:
        """Pose angles θ [rad]; shape (angles,)."""
        return 2.0 * np.pi * np.arange(self.angles) / self.angles


@dataclass(frozen=True)
class Chords:
    """The straight piece of every ray inside the resin, for light entering at offset u [mm] from the axis.

    p: signed distance [mm] of the chord from the axis.  angle: its turn d [rad] against the light's direction.
    spread: d′(u) [rad/mm].  transmittance: power that reached the resin.  length: path [mm] in the resin.
    All arrays have the shape of u; a ray that misses the resin has transmittance 0.
    """

    p: np.ndarray
    angle: np.ndarray
    spread: np.ndarray
    transmittance: np.ndarray
    length: np.ndarray


@runtime_checkable
class Vessel(Protocol):
    """What a projector asks of the container the resin stands in, at one pose.

    Laboratory coordinates at pose θ: ``X = y·cosθ − x·sinθ`` across the light and ``Y = −(x·cosθ + y·sinθ)`` along it.
    """

    @property
    def absorption(self) -> float:
        """Absorbed share per length in the resin [1/mm], natural logarithm."""
        ...

    @property
    def lit_radius(self) -> float:
        """Radius [mm] about the axis inside which every point is lit by exactly one ray at every pose."""
        ...

    def chords(self, u: np.ndarray) -> Chords:
        """Chords in the resin of rays entering at offsets u [mm]."""
        ...

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ray through each point: its entry offset u [mm] and its weight there.

        The weight is transmittance × ray density × (absorption·exp(−absorption·path) if the vessel absorbs, else 1).
        """
        ...
