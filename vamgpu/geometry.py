"""The objects that describe a print: grids, beams, motions and the protocol of vessels.

Axes are ``[x, y, z]`` for volumes and ``[angle, r, z]`` for sinograms; the axis of rotation is x = y = 0 and every
grid and beam is centered on it. With the angle θ, ``r = y·cosθ − x·sinθ`` and light travels towards −(cosθ, sinθ).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vamgpu.card import card
from vamgpu.errors import BadInput
from vamgpu.quantity import positive
from vamgpu.schema import check, write
from vamgpu.schema.quantities import Fill, Pitch, PixelPitch, Positive, Turn, Width, numeric
from vamgpu.travel import Travel, at_rest, check_angles

HALF_A_PIXEL = 0.5  # default standard deviation [pixels] of the point spread of a projector in focus
WIDEST = 30  # standard deviation [pixels] above which a point spread is a wrong unit, not a lens
FULL_TURN = 2.0 * np.pi
DIAL = 96  # pixels along the side of the picture of a turntable
SAME_ANGLE = 1e-9  # angles [rad] closer than this count as equal, because files write decimals


def counts(name: str, values: object, length: int) -> tuple[int, ...]:
    """``values`` as a tuple of ``length`` positive integers, else `BadInput`."""
    expected = f"{length} positive integers" if length > 1 else "a positive integer"
    try:
        numbers = tuple(int(v) for v in values)  # type: ignore[attr-defined]
        exact = all(int(v) == v for v in values)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{name} is {_as_given(values)}; expected {expected}") from error
    if len(numbers) != length or not exact or min(numbers) < 1:
        raise BadInput(f"{name} is {_as_given(values)}; expected {expected}")
    return numbers


def _as_given(values: object) -> str:
    """Values as the user gave them; a single number is not a tuple."""
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
    pitch: Pitch

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", counts("Grid shape", self.shape, 3))
        check(self)

    def __str__(self) -> str:
        return f"{' × '.join(map(str, self.shape))} voxels of {1e3 * self.pitch:.4g} µm"

    def _repr_html_(self) -> str:
        size = " × ".join(f"{n * self.pitch:.4g}" for n in self.shape)
        return card("Grid", {**write(self, units=True), "size": f"{size} mm"})

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
            Positions along x (nx,), y (ny,) and z (nz,) [mm].
        """
        nx, ny, nz = (centers(n, self.pitch) for n in self.shape)
        return nx, ny, nz

    def cylinder(self) -> np.ndarray:
        """Columns of voxels whose center is inside the inscribed cylinder.

        Returns:
            Booleans (nx, ny).
        """
        x, y, _ = self.axes()
        return x[:, None] ** 2 + y[None, :] ** 2 <= self.inscribed_radius**2 * (1 + 1e-12)


@dataclass(frozen=True)
class Beam:
    """A collimated beam of light pixels, centered on the axis of rotation.

    A pixel lights a square box, blurred by a Gaussian point spread; neither spread nor fill factor changes its power.

    Args:
        pixels: Columns along r, rows along z. A single row represents a print that is the same at every height: its
            light does not spread along z.
        pitch: Pixel edge [mm], measured in air.
        fill: Share of a pixel's area that is lit (the fill factor of the mirrors), above 0, at most 1.
        spread: Standard deviation of the point spread [mm], measured in air in place of the vial; refraction narrows
            columns and their blur equally. A number, or a result of `vam calibrate mtf`, read by
            `vamgpu.calibration.pointspread.PointSpread`. None is a projector in focus: half a pixel. 0 is a perfect
            lens.

    Raises:
        BadInput: A value is out of its range.
    """

    pixels: tuple[int, int]
    pitch: PixelPitch
    fill: Fill = 1.0
    spread: Width | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", counts("Beam pixels", self.pixels, 2))
        object.__setattr__(self, "spread", getattr(self.spread, "width", self.spread))
        check(self)
        if self.sigma > WIDEST:
            raise BadInput(f"spread is {self.spread:g} mm, {self.sigma:.3g} pixels of {self.pitch:g} mm; expected "
                           f"{WIDEST} pixels at most: check the unit, 25 µm is 0.025 mm")  # fmt: skip

    def _repr_html_(self) -> str:
        size = " × ".join(f"{n * self.pitch:.4g}" for n in self.pixels)
        blur = f"{self.sigma:.3g} pixels, standard deviation"
        return card("Beam", {**write(self, units=True), "size": f"{size} mm", "point spread": blur})

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
        """Whether its single row represents a print that is the same at every height."""
        return self.pixels[1] == 1

    @property
    def sigma(self) -> float:
        """Standard deviation of the point spread [pixels], along columns and along rows."""
        return HALF_A_PIXEL if self.spread is None else self.spread / self.pitch


def one_ray_a_pixel(operator: str, beam: Beam) -> None:
    """Raise `BadInput` if ``beam`` has a fill factor or a spread, which ``operator`` would ignore."""
    if beam.fill != 1.0 or beam.spread:
        raise BadInput(f"got {beam!r}, expected no fill below 1 and no spread: {operator} traces one ray per pixel and "
                       "knows no point spread; leave fill and spread out")  # fmt: skip


@dataclass(frozen=True, init=False, repr=False)
class Turntable:
    """A resin container that turns about z. A turn shows every angle once, in order.

    ``Turntable(360)`` has 360 evenly spaced angles over a full turn from θ = 0, `arc` spreads them over part of a
    turn, and ``Turntable([0.0, 0.017, …])`` has measured angles. The attributes ``theta`` [rad] and
    ``dwell`` are None if angles are evenly spaced over a full turn from 0, and lit equally long.

    The container turns steadily while a frame is lit, through an arc centered on its angle; ``lit_share`` is that arc
    divided by the step to the next angle. It is 0 if the container does not turn while a frame is
    lit.

    Args:
        angles: Number of angles, or each angle θ [rad], in the order in which they are shown, within one turn.
        dwell: Time for which each angle is lit, relative to the mean; (angles,), above 0, scaled to a mean of 1. None:
            equally long. Light is still an irradiance: operators weight each angle by its time.
        lit_share: Share of each step during which its frame is lit while the container turns, 0 to 1. None: 1 for even
            angles, and 0 for listed angles, which are positions and not steps.
        travel: Path of the part through all turns of the print; None for a part at rest.

    Raises:
        BadInput: A number is not finite, angles exceed a turn, or times, heights and angles differ in number.
    """

    angles: int
    theta: tuple[float, ...] | None
    dwell: tuple[float, ...] | None
    lit_share: float
    travel: Travel | None
    _arcs: tuple[float, ...] | None

    def __init__(
        self,
        angles: int | Sequence[Turn] | np.ndarray,
        dwell: Sequence[Positive] | np.ndarray | None = None,
        lit_share: float | None = None,
        travel: Travel | None = None,
    ) -> None:
        listed = isinstance(angles, (list, tuple, range)) or np.ndim(angles) > 0  # pyright: ignore[reportArgumentType]
        theta = numeric("Turntable angles [rad]", angles) if listed else None
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
        object.__setattr__(self, "lit_share", _lit_share(lit_share, 0.0 if listed else 1.0))
        object.__setattr__(self, "travel", travel)
        object.__setattr__(self, "_arcs", None)
        check_angles(travel, count)

    @classmethod
    def arc(
        cls,
        angles: int,
        span: float,
        start: float = 0.0,
        dwell: Sequence[float] | np.ndarray | None = None,
        lit_share: float = 1.0,
    ) -> Turntable:
        """Even angles over a part of a turn: θ = start + span·k / angles; over a half turn, no direction occurs twice.

        Args:
            angles: Number of angles.
            span: The part of a turn [rad], at most 2π.
            start: First angle [rad].
            dwell: Times relative to their mean, (angles,), as for `Turntable`.
            lit_share: Share of each step during which its frame is lit, as for `Turntable`.

        Returns:
            The turntable.

        Raises:
            BadInput: The span exceeds a turn.
        """
        count = counts("Turntable angles", (angles,), 1)[0]
        part = positive("Turntable span [rad]", span)
        if part > FULL_TURN * (1.0 + 1e-12):
            raise BadInput(f"Turntable span is {part:g} rad; expected at most 2π, a full turn: convert with units.deg")
        return cls(start + part / FULL_TURN * _even(count), dwell, lit_share)

    def chosen(self, numbers: Sequence[int]) -> Turntable:
        """Some of the angles, each lit as long and over the same arc as in the whole turn.

        Args:
            numbers: Numbers of the angles, in the order in which they are shown.

        Returns:
            The turntable with these angles.
        """
        at_rest("a part of a turn", self)
        some = list(numbers)
        piece = Turntable(self.poses[some], lit_share=self.lit_share)
        if self.dwell is not None:
            object.__setattr__(piece, "dwell", tuple(self.dwell[number] for number in some))
        if not np.allclose(piece.arcs, self.arcs[some], rtol=0.0, atol=SAME_ANGLE):
            object.__setattr__(piece, "_arcs", tuple(self.arcs[some].tolist()))
        return piece

    def described(self) -> dict[str, Any]:
        """Describe the constructor's arguments.

        Returns:
            Its arguments by name.
        """
        angles = self.angles if self.theta is None else self.theta
        return {"angles": angles, "dwell": self.dwell, "lit_share": self.lit_share, "travel": self.travel}

    def along(self, travel: Travel | None) -> Turntable:
        """The same turntable with a part on another path.

        Args:
            travel: The path; None for a part at rest.

        Returns:
            The turntable.
        """
        return Turntable(**{**self.described(), "travel": travel})

    @property
    def steps(self) -> np.ndarray:
        """Rotation [rad] per angle, the mean of the steps to both neighbors; shape (angles,)."""
        if self.angles == 1:
            return np.full(1, FULL_TURN)
        if self.theta is None:
            return np.full(self.angles, FULL_TURN / self.angles)
        order = np.argsort(self.poses, kind="stable")
        gaps = np.diff(self.poses[order])
        around = FULL_TURN - gaps.sum()  # from the last angle to the first
        whole = around <= 1.5 * gaps.max()
        before = np.concatenate([[around if whole else gaps[0]], gaps])
        after = np.concatenate([gaps, [around if whole else gaps[-1]]])
        found = np.empty(self.angles)
        found[order] = 0.5 * (before + after)
        return found

    @property
    def arcs(self) -> np.ndarray:
        """Rotation [rad] of the container while each frame is lit, half of it before the angle; shape (angles,)."""
        return self.lit_share * self.steps if self._arcs is None else np.array(self._arcs)

    @property
    def stepped(self) -> Turntable:
        """The same turntable at rest while a frame is lit."""
        rest = copy(self)
        object.__setattr__(rest, "lit_share", 0.0)
        object.__setattr__(rest, "_arcs", None)
        return rest

    @property
    def poses(self) -> np.ndarray:
        """Angles θ [rad]; shape (angles,)."""
        return _even(self.angles) if self.theta is None else np.array(self.theta)

    @property
    def times(self) -> np.ndarray:
        """Ratio of the time of each angle to the mean of a turn; shape (angles,)."""
        return np.ones(self.angles) if self.dwell is None else np.array(self.dwell)

    @property
    def is_even(self) -> bool:
        """Whether the angles are even over a full turn from θ = 0, each lit equally long, past a part at rest."""
        return self.theta is None and self.dwell is None and self.travel is None

    def __repr__(self) -> str:
        times = "" if self.dwell is None else f", dwell={_shortened(self.dwell)}"
        usual = self.lit_share == (1.0 if self.theta is None else 0.0)
        lit = "" if usual else f", lit_share={self.lit_share:g}"
        lit += "" if self.travel is None else f", travel={self.travel!r}"
        return f"Turntable(angles={self.angles if self.theta is None else _shortened(self.theta)}{times}{lit})"

    def __str__(self) -> str:
        where = "over a full turn"
        if self.theta is not None:
            where = f"measured, from {np.degrees(min(self.theta)):.4g}° to {np.degrees(max(self.theta)):.4g}°"
        lit = "" if self.dwell is None else f", each lit {min(self.dwell):.3g} to {max(self.dwell):.3g} times the mean"
        part = "" if self.travel is None else f", with a part that moves in {self.travel.turns} turns"
        return f"{self.angles} {where}{lit}, {self.moves}{part}"

    def _repr_html_(self) -> str:
        lit = 0.5 + 0.5 * self.times / self.times.max()
        seen = np.zeros((DIAL, DIAL))
        for radius in range(DIAL // 4, DIAL // 2):
            x, y = (np.rint(0.5 * (DIAL - 1) + radius * part(self.poses)).astype(int) for part in (np.cos, np.sin))
            seen[x, y] = lit
        return card("Turntable", {"angles": self, "lit share": f"{self.lit_share:g}"}, {"angles, from above": seen})

    @property
    def moves(self) -> str:
        """The vial's motion while a frame is lit, in words."""
        return "at rest while lit" if not self.lit_share else f"turning while lit for {self.lit_share:g} of each step"


def _even(count: int) -> np.ndarray:
    """Angles [rad] of ``count`` even steps over a full turn."""
    return FULL_TURN * np.arange(count) / count


def _lit_share(value: Any, usual: float) -> float:
    """A share of a step, else `BadInput`."""
    if value is None:
        return usual
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
        raise BadInput(f"Turntable lit_share is {value!r}; expected 0 (at rest while a frame is lit) to 1 (lit all the "
                       "time)")  # fmt: skip
    return float(value)


def _relative(dwell: Any, count: int) -> tuple[float, ...] | None:
    """Ratios of times to their mean; None if all are equal."""
    times = numeric("Turntable dwell", dwell)
    if times.size != count or times.min() <= 0.0:
        raise BadInput(f"Turntable dwell has {times.size} times, the least {times.min():g}; expected {count}, "
                       "one above 0 for each angle: leave out angles that are never lit")  # fmt: skip
    mean = times.mean()
    times = times if abs(mean - 1.0) < 1e-12 else times / mean  # a value read from a file is the same to the last bit
    return None if np.allclose(times, 1.0, rtol=0.0, atol=1e-12) else tuple(times.tolist())


def _shortened(values: tuple[float, ...]) -> str:
    """A list in the form for messages."""
    shown = [f"{value:.4g}" for value in values]
    return f"[{', '.join(shown if len(shown) <= 6 else [*shown[:3], '…', shown[-1]])}]"


@dataclass(frozen=True)
class Chords:
    """The straight segment of every ray inside the resin, for light entering at offset u [mm] from the axis."""

    # Arrays in the shape of u. p: signed distance [mm] of the chord from the axis. angle: its rotation d [rad] against
    # the light's direction. spread: d′(u) [rad/mm]. transmittance: share of the power that reaches the resin, 0 for a
    # ray that misses it. length: path in the resin [mm].

    p: np.ndarray
    angle: np.ndarray
    spread: np.ndarray
    transmittance: np.ndarray
    length: np.ndarray


@runtime_checkable
class Vessel(Protocol):
    """The container of the resin for a projector, at one angle.

    Fixed coordinates at the angle θ: ``X = y·cosθ − x·sinθ`` across the light and ``Y = −(x·cosθ + y·sinθ)`` along it.
    """

    @property
    def absorption(self) -> float:
        """Absorbed share per length in the resin [1/mm], natural logarithm."""
        ...

    @property
    def lit_radius(self) -> float:
        """Radius [mm] about the axis within which exactly one ray lights every point at every angle."""
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
            across: Position X across the light [mm], (...,).
            along: Position Y along the light [mm], (...,), broadcast with ``across``.

        Returns:
            Offset u [mm] of the ray that lights each point, (...,), and its weight there, (...,): transmittance × ray
            density × (absorption·exp(−absorption·path) [1/mm] if the vessel absorbs, else 1); 0 if no ray lights it.

        Raises:
            BadInput: A coordinate is not finite.
        """
        ...


def columns_of(vessel: Vessel, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Offset of the ray through each point, without its weight if the vessel has ``columns``."""
    columns: Any = getattr(vessel, "columns", lambda *at: vessel.illuminate(*at)[0])
    return columns(across, along)


@dataclass(frozen=True)
class PlaneTime:
    """Time of a bit plane, in shares of the step from frame to frame; 0 is when the container is at its angle."""

    bit: int  # of the levels, 0 the lowest
    begin: float  # of its light
    width: float  # how long it is lit


def resin_radius(vessel: Any) -> float:
    """Radius [mm] of the resin that turns freely: the inner wall; infinite in open air."""
    if vessel is None:
        return float("inf")
    for name in ("inner_radius", "printable_radius"):
        if hasattr(vessel, name):
            return float(getattr(vessel, name))
    inner = getattr(vessel, "inner", None)
    return resin_radius(inner) if inner is not None else float(vessel.lit_radius)
