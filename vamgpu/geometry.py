"""The nouns a print is described with: grids, beams, motions and the protocol a vessel answers to.

Axes are ``[x, y, z]`` for volumes and ``[angle, r, z]`` for sinograms; the axis of rotation is x = y = 0 and every
grid and beam is centered on it. With θ the pose, ``r = y·cosθ − x·sinθ`` and light travels towards −(cosθ, sinθ).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.quantity import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Fill, Length, Positive, Turn, Width

HALF_A_PIXEL = 0.5
"""Standard deviation [pixels] of the point spread of a projector in focus, where nobody measured it."""
WIDEST = 30
"""Standard deviation [pixels] from which on a point spread is a mistake of units, not a lens."""
FULL_TURN = 2.0 * np.pi
SAME_ANGLE = 1e-9
"""Angles [rad] this close are the same: files write decimals."""


def counts(name: str, values: object, length: int) -> tuple[int, ...]:
    """``values`` as a tuple of ``length`` positive integers, else `BadInput`."""
    expected = f"{length} positive integers" if length > 1 else "a positive integer"
    try:
        numbers = tuple(int(v) for v in values)  # type: ignore[attr-defined]
        exact = all(int(v) == v for v in values)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{name} is {_told(values)}; expected {expected}") from error
    if len(numbers) != length or not exact or min(numbers) < 1:
        raise BadInput(f"{name} is {_told(values)}; expected {expected}")
    return numbers


def _told(values: object) -> str:
    """Values as a user gave them: one number is no tuple."""
    return repr(values[0] if isinstance(values, tuple) and len(values) == 1 else values)


def centers(n: int, pitch: float) -> np.ndarray:
    """Positions [mm] of ``n`` samples ``pitch`` apart, centered on zero; shape (n,)."""
    return (np.arange(n) - 0.5 * (n - 1)) * pitch


@dataclass(frozen=True)
class Grid:
    """A box of cubic voxels centered on the axis of rotation.

    Args:
        shape: Voxels along x, y, z.
        pitch: Voxel edge [mm].

    Raises:
        BadInput: A value is out of its range.
    """

    shape: tuple[int, int, int]
    pitch: Length

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", counts("Grid shape", self.shape, 3))
        check(self)

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel [mm³]."""
        return self.pitch**3

    @property
    def inscribed_radius(self) -> float:
        """Radius [mm] of the largest cylinder about the axis whose voxel centers all lie in the box."""
        return 0.5 * (min(self.shape[:2]) - 1) * self.pitch

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Voxel centers.

        Returns:
            Places along x (nx,), y (ny,) and z (nz,) [mm].
        """
        nx, ny, nz = (centers(n, self.pitch) for n in self.shape)
        return nx, ny, nz

    def cylinder(self) -> np.ndarray:
        """Which columns of voxels have their center inside the inscribed cylinder.

        Returns:
            Booleans (nx, ny).
        """
        x, y, _ = self.axes()
        return x[:, None] ** 2 + y[None, :] ** 2 <= self.inscribed_radius**2 * (1 + 1e-12)


@dataclass(frozen=True)
class Beam:
    """A collimated beam of light pixels, centered on the axis of rotation.

    A pixel lights a square box, blurred by a Gaussian point spread. Both keep its power.

    Args:
        pixels: Columns along r, rows along z. A single row stands for a print that is the same at every height: its
            light does not spread along z.
        pitch: Pixel edge [mm], measured in air.
        fill: Share of a pixel's area that is lit (the fill factor of the mirrors), above 0, at most 1.
        spread: Standard deviation of the point spread [mm], measured in air in place of the vial; refraction narrows
            columns and their blur alike. A number, or what `vam calibrate mtf` measured, read by
            `vamgpu.calibration.pointspread.PointSpread`. None is a projector in focus: half a pixel. 0 is a perfect
            lens.

    Raises:
        BadInput: A value is out of its range.
    """

    pixels: tuple[int, int]
    pitch: Length
    fill: Fill = 1.0
    spread: Width | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", counts("Beam pixels", self.pixels, 2))
        object.__setattr__(self, "spread", getattr(self.spread, "width", self.spread))
        check(self)
        if self.sigma > WIDEST:
            raise BadInput(f"spread is {self.spread:g} mm, {self.sigma:.3g} pixels of {self.pitch:g} mm; expected "
                           f"{WIDEST} pixels at most: check the unit, 25 µm is 0.025 mm")  # fmt: skip

    @property
    def pixel_area(self) -> float:
        """Area of one pixel [mm²]."""
        return self.pitch**2

    def columns(self) -> np.ndarray:
        """Offsets of the columns from the axis.

        Returns:
            Offsets r [mm], (columns,).
        """
        return centers(self.pixels[0], self.pitch)

    @property
    def flat(self) -> bool:
        """Whether its single row stands for a print that is the same at every height."""
        return self.pixels[1] == 1

    @property
    def sigma(self) -> float:
        """Standard deviation of the point spread [pixels], along columns and along rows."""
        return HALF_A_PIXEL if self.spread is None else self.spread / self.pitch


def one_ray_a_pixel(operator: str, beam: Beam) -> None:
    """Raise `BadInput` if ``beam`` says what its pixels look like, which ``operator`` would ignore."""
    if beam.fill != 1.0 or beam.spread:
        raise BadInput(f"got {beam!r}, expected no fill below 1 and no spread: {operator} traces one ray a pixel and "
                       "knows no point spread; leave fill and spread out")  # fmt: skip


@dataclass(frozen=True, init=False, repr=False)
class Turntable:
    """A resin container that turns about z. A turn shows every angle once, in order.

    ``Turntable(360)`` has 360 even angles over a full turn from θ = 0, `arc` spreads them over a part of a turn, and
    ``Turntable([0.0, 0.017, …])`` has them where they were measured. The attributes ``theta`` [rad] and ``dwell`` are
    None where angles are even over a full turn from 0, and lit equally long.

    Args:
        angles: How many angles, or each angle θ [rad], in the order they are shown, within one turn.
        dwell: How long each angle is lit, relative to the mean; (angles,), above 0, scaled to a mean of 1. None:
            equally long. Light stays an irradiance: operators weight each angle by its time.

    Raises:
        BadInput: A number is not finite, angles exceed a turn, or times and angles differ in number.
    """

    angles: int
    theta: tuple[float, ...] | None
    dwell: tuple[float, ...] | None

    def __init__(
        self, angles: int | Sequence[Turn] | np.ndarray, dwell: Sequence[Positive] | np.ndarray | None = None
    ) -> None:
        listed = isinstance(angles, (list, tuple, range)) or np.ndim(angles) > 0  # pyright: ignore[reportArgumentType]
        theta = _finite("Turntable angles [rad]", angles) if listed else None
        count = counts("Turntable angles", (angles,), 1)[0] if theta is None else theta.size
        if theta is not None and np.ptp(theta) > FULL_TURN * (1.0 + 1e-12):
            raise BadInput(
                f"Turntable angles go from {theta.min():g} to {theta.max():g} rad; expected one turn (2π) at most: "
                "convert with units.deg, and give one turn of a scan that repeats"
            )
        if theta is not None and np.allclose(theta, _even(count), rtol=0.0, atol=SAME_ANGLE):
            theta = None
        object.__setattr__(self, "angles", count)
        object.__setattr__(self, "theta", None if theta is None else tuple(theta.tolist()))
        object.__setattr__(self, "dwell", None if dwell is None else _relative(dwell, count))

    @classmethod
    def arc(
        cls, angles: int, span: float, start: float = 0.0, dwell: Sequence[float] | np.ndarray | None = None
    ) -> Turntable:
        """Even angles over a part of a turn: θ = start + span·k / angles, so that a half turn has no direction twice.

        Args:
            angles: How many angles.
            span: The part of a turn [rad], at most 2π.
            start: First angle [rad].
            dwell: Times relative to their mean, (angles,), as for `Turntable`.

        Returns:
            The turntable.

        Raises:
            BadInput: The span exceeds a turn.
        """
        count = counts("Turntable angles", (angles,), 1)[0]
        part = positive("Turntable span [rad]", span)
        if part > FULL_TURN * (1.0 + 1e-12):
            raise BadInput(f"Turntable span is {part:g} rad; expected at most 2π, a full turn: convert with units.deg")
        return cls(start + part / FULL_TURN * _even(count), dwell)

    def part(self, first: int, stop: int) -> Turntable:
        """A stretch of the turn, each angle lit as long as in the whole turn.

        Args:
            first: Number of its first angle.
            stop: Number after its last one.

        Returns:
            The stretch.
        """
        piece = Turntable(self.poses[first:stop])
        if self.dwell is not None:
            object.__setattr__(piece, "dwell", self.dwell[first:stop])
        return piece

    def described(self) -> dict[str, Any]:
        """What the constructor was given.

        Returns:
            Its arguments by name.
        """
        return {"angles": self.angles if self.theta is None else self.theta, "dwell": self.dwell}

    @property
    def poses(self) -> np.ndarray:
        """Pose angles θ [rad]; shape (angles,)."""
        return _even(self.angles) if self.theta is None else np.array(self.theta)

    @property
    def times(self) -> np.ndarray:
        """Time of each pose over the mean of a turn; shape (angles,)."""
        return np.ones(self.angles) if self.dwell is None else np.array(self.dwell)

    @property
    def is_even(self) -> bool:
        """Whether poses are even over a full turn from θ = 0, each lit as long."""
        return self.theta is None and self.dwell is None

    def __repr__(self) -> str:
        times = "" if self.dwell is None else f", dwell={_shortened(self.dwell)}"
        return f"Turntable(angles={self.angles if self.theta is None else _shortened(self.theta)}{times})"

    def __str__(self) -> str:
        low, high = (np.degrees(end) for end in (self.poses.min(), self.poses.max()))
        where = "over a full turn" if self.theta is None else f"measured, from {low:.4g}° to {high:.4g}°"
        lit = "" if self.dwell is None else f", each lit {min(self.dwell):.3g} to {max(self.dwell):.3g} times the mean"
        return f"{self.angles} {where}{lit}"


def _even(count: int) -> np.ndarray:
    """Angles [rad] of ``count`` even poses over a full turn."""
    return FULL_TURN * np.arange(count) / count


def _finite(name: str, values: Any) -> np.ndarray:
    """A list of finite numbers as float64 (n,), else `BadInput`."""
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{name} is {values!r}; expected a list of numbers") from error
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise BadInput(f"{name} has shape {numbers.shape} and {np.count_nonzero(~np.isfinite(numbers))} numbers that "
                       "are not finite; expected a list of finite numbers, at least one")  # fmt: skip
    return numbers


def _relative(dwell: Any, count: int) -> tuple[float, ...] | None:
    """Times over their mean; None where all are the same."""
    times = _finite("Turntable dwell", dwell)
    if times.size != count or times.min() <= 0.0:
        raise BadInput(f"Turntable dwell has {times.size} times, the least {times.min():g}; expected {count}, "
                       "one above 0 for each angle: leave out angles that are never lit")  # fmt: skip
    mean = times.mean()
    times = times if abs(mean - 1.0) < 1e-12 else times / mean  # what a file keeps comes back to the last bit
    return None if np.allclose(times, 1.0, rtol=0.0, atol=1e-12) else tuple(times.tolist())


def _shortened(values: tuple[float, ...]) -> str:
    """A list as messages show it."""
    shown = [f"{value:.4g}" for value in values]
    return f"[{', '.join(shown if len(shown) <= 6 else [*shown[:3], '…', shown[-1]])}]"


@dataclass(frozen=True)
class Chords:
    """The straight piece of every ray inside the resin, for light entering at offset u [mm] from the axis.

    All arrays have the shape of u; a ray that misses the resin has transmittance 0.

    Attributes:
        p: Signed distance [mm] of the chord from the axis.
        angle: Its turn d [rad] against the light's direction.
        spread: d′(u) [rad/mm].
        transmittance: Share of the power that reaches the resin.
        length: Path in the resin [mm].
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
        """Chords in the resin of rays that enter at some offsets.

        Args:
            u: Offsets [mm] of the columns from the axis, (...,).

        Returns:
            The chords, arrays (...,); a column that misses the resin has transmittance 0 and length 0.

        Raises:
            BadInput: An offset is not finite.
        """
        ...

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ray through each point.

        Args:
            across: Laboratory X [mm], (...,).
            along: Laboratory Y [mm], (...,), broadcast with ``across``.

        Returns:
            Offset u [mm] of the ray that lights each point, (...,), and its weight there, (...,): transmittance × ray
            density × (absorption·exp(−absorption·path) [1/mm] if the vessel absorbs, else 1); 0 where no ray comes.

        Raises:
            BadInput: A coordinate is not finite.
        """
        ...
