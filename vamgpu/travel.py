"""The path of a part through its resin, or with it past the projector, during a print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.quantity import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import (
    Count,
    DensityDifference,
    ExposureTime,
    Length,
    Place,
    Time,
    Viscosity,
    measured,
    numeric,
)

GRAVITY = 9806.65  # [mm/s²]
MOST = 1_000_000  # frames of all turns
TALLEST = 300.0  # farthest way along z [mm]; no vial is as tall
NEAR = 1e-9  # turns by which rounding may change a number of turns
Path = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, init=False)
class Travel:
    """Where the part is at every angle of every turn of a print, relative to the place for which it is solved.

    The whole volume moves. Patterns stay those of a part at rest, one for each angle; frames are moved by whole pixels,
    and operators and proofs include the fraction that is left. A part taller than the projector's image rises through
    it: patterns are as tall as the part, and every row is shown in equally many turns, while it is most central.

    Args:
        up: Height of the part [mm], (turns, angles), or (turns, 1) for the same at all angles of a turn.
        x: Distance along x of the turning vial [mm]; one number, or as for ``up``. Light must be straight and not
            absorbed. The part is at its place for the middle of a frame.
        y: Distance along y of the turning vial [mm], as for ``x``.
        follow: Whether frames are moved with the part. If not, they are shown as for a part at rest.
        rows: Rows of the projector's image, if a taller part passes it, at most those of the beam; None for
            images as tall as the frames need.
        period: Time of a turn [s], from which proofs find the irradiance; None if it is free.

    Raises:
        BadInput: A value is out of its range, or shapes differ.
    """

    up: Path
    x: float | Path
    y: float | Path
    follow: bool
    rows: int | None
    period: float | None

    def __init__(
        self,
        up: Sequence[Sequence[Place]] | np.ndarray,
        x: Place | Sequence[Sequence[Place]] | np.ndarray = 0.0,
        y: Place | Sequence[Sequence[Place]] | np.ndarray = 0.0,
        follow: bool = True,
        rows: Count | None = None,
        period: ExposureTime | None = None,
    ) -> None:
        heights = numeric("Travel up", up, (2,), "finite heights [mm], (turns, angles) or (turns, 1)")
        if (far := float(np.abs(heights).max())) > TALLEST:
            raise BadInput(f"Travel moves the part by {far:.4g} mm along z; expected at most {TALLEST:g} mm, within a "
                           "vial: check units, such as mPa s written for Pa s")  # fmt: skip
        for name, values in (("up", heights), ("x", x), ("y", y)):
            object.__setattr__(self, name, _path(name, values, len(heights)))
        if not isinstance(follow, bool):
            raise BadInput(f"Travel follow is {follow!r}; expected True or False")
        if rows is not None and not follow:
            raise BadInput("Travel got rows with follow=False; expected follow=True: a part passes the projector only "
                           "if its frames follow it")  # fmt: skip
        object.__setattr__(self, "follow", follow)
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "period", period)
        check(self)

    @classmethod
    def through(
        cls, times: Sequence[float] | np.ndarray, heights: Sequence[float] | np.ndarray, turns: int, angles: int,
        period: float,
    ) -> Travel:  # fmt: skip
        """A part whose height was measured, or follows from a law; linear between times.

        Args:
            times: Times since the first frame [s], rising, from 0 to the last frame.
            heights: Heights of the part at these times [mm], above the place for which it is solved.
            turns: Turns of the print.
            angles: Angles of a turn, evenly in time.
            period: Time of a turn [s].

        Returns:
            The heights at every angle of every turn.

        Raises:
            BadInput: Times do not rise or leave out a frame, a number is not finite, or there are too many frames.
        """
        when, height = numeric("times [s]", times), numeric("heights [mm]", heights)
        if when.shape != height.shape:
            raise BadInput(f"a travel got times of shape {when.shape} and heights of shape {height.shape}; expected "
                           "equally many")  # fmt: skip
        for row in np.flatnonzero(np.diff(when) <= 0)[:1]:
            raise BadInput(f"row {row + 2} has {when[row + 1]:g} s after {when[row]:g} s; expected rising times [s]")
        seconds = _turned(turns, angles) * positive("period [s]", period)
        end = float(seconds[-1, -1])
        if when[0] > 0.0 or when[-1] < end * (1.0 - NEAR):
            raise BadInput(f"heights are from {when[0]:g} to {when[-1]:g} s; expected 0 to {end:.4g} s: add the others")
        return cls(np.interp(seconds, when, height), period=period)

    @classmethod
    def sinking(
        cls, turns: int, angles: int, period: float, *, density_difference: DensityDifference | str,
        viscosity: Viscosity | str, diameter: Length | str, start: Time | str = 0.0,
    ) -> Travel:  # fmt: skip
        """A part that sinks steadily, at the speed of a sphere far from all walls (Stokes), Δρ·g·d² / 18η.

        Args:
            turns: Turns of the print.
            angles: Angles of a turn, evenly in time.
            period: Time of a turn [s].
            density_difference: Density of the gelled part − that of the resin [mJ·s²/mm⁵], or text: "20 kg/m3";
                negative if the part rises.
            viscosity: Viscosity of the resin [mJ·s/mm³], or text: "1 Pa s".
            diameter: Diameter of a sphere that sinks as fast as the part [mm], or text.
            start: Time at which the part has gelled and begins to sink [s].

        Returns:
            The heights at every angle of every turn.

        Raises:
            BadInput: A value is out of its range.
        """
        given = (density_difference, DensityDifference), (viscosity, Viscosity), (diameter, Length), (start, Time)
        names = "density_difference", "viscosity", "diameter", "start"
        denser, viscous, wide, begin = (measured(name, *each) for name, each in zip(names, given, strict=True))
        speed = denser * GRAVITY * wide**2 / (18.0 * viscous)
        left = measured("turns", turns, Count) * positive("period [s]", period)
        if begin >= left:
            raise BadInput(f"start is {begin:g} s, when the {left:g} s of all turns are over; expected an earlier one")
        return cls(-speed * np.maximum(_turned(turns, angles) * period - begin, 0.0), period=period)

    @classmethod
    def helix(cls, angles: int, rise: float, *, height: float, rows: int, pitch: float) -> Travel:
        """A part taller than the projector's image that rises through it steadily while it turns.

        Args:
            angles: Angles of a turn, evenly in time.
            rise: Height by which the part rises in each turn [mm]; negative if it is lowered.
            height: Height of the patterns [mm], that of the part and the spare rows.
            rows: Rows of the projector's image, at most those of the patterns.
            pitch: Pitch of the beam [mm].

        Returns:
            The heights at every angle of as many turns as show every row equally often.

        Raises:
            BadInput: The image is too low for the rise of a turn, or too tall, or a value is out of its range.
        """
        step = positive("rise [mm], up or down,", abs(measured("rise", rise, Place)))
        seen = (measured("rows", rows, Count) - 1) * positive("pitch [mm]", pitch)
        often = floor(seen / step + NEAR)
        if often < 1:
            raise BadInput(f"a helix rises {step:g} mm in a turn, and the first and last of {rows} rows are {seen:.4g} "
                           "mm apart; expected at most that: use a smaller rise, or more rows")  # fmt: skip
        if rows * pitch > positive("height [mm]", height) + NEAR * pitch:
            raise BadInput(f"the image of {rows} rows is {rows * pitch:g} mm high, and patterns {height:g}; use fewer")
        turns = max(ceil((height - seen) / step + 2 * often - NEAR), 1)
        way = _turned(turns, angles)
        return cls(np.sign(rise) * step * (way - 0.5 * (turns - 1.0 / angles)), rows=rows)

    def __repr__(self) -> str:
        how = "" if self.follow else ", follow=False"
        return f"Travel(from {np.min(self.up):+.4g} to {np.max(self.up):+.4g} mm along z in {self.turns} turns{how})"

    @property
    def turns(self) -> int:
        """Number of turns."""
        return len(self.up)

    @property
    def aside(self) -> bool:
        """Whether the part moves sideways."""
        return bool(np.any(self.x) or np.any(self.y))


def _turned(turns: int, angles: int) -> np.ndarray:
    """Turns before each frame, (turns, angles). Raises `BadInput`."""
    whole, count = measured("turns", turns, Count), measured("angles", angles, Count)
    if whole * count > MOST:
        raise BadInput(f"a path of {whole:,} turns with {count:,} angles has {whole * count:,} frames; expected "
                       f"at most {MOST:,}: use fewer turns or angles, or a larger rise")  # fmt: skip
    return np.arange(whole)[:, None] + np.arange(count) / count


def _path(name: str, values: Any, turns: int) -> float | Path:
    """A number, or numbers (turns, angles), as plain values. Raises `BadInput`."""
    expected = f"finite distances [mm], one or ({turns}, angles)"
    numbers = numeric(f"Travel {name}", values, (0, 2), expected)
    if numbers.ndim and len(numbers) != turns:
        raise BadInput(f"Travel {name} has shape {numbers.shape}; expected {expected}")
    return float(numbers) if numbers.ndim == 0 else tuple(tuple(row) for row in numbers.tolist())


def check_angles(travel: Travel | None, angles: int) -> None:
    """Raise `BadInput` unless a path fits a turn of some angles."""
    if not isinstance(travel, Travel | None):
        raise BadInput(f"Turntable travel is {travel!r}; expected a Travel, or None for a part at rest")
    for path in () if travel is None else (travel.up, travel.x, travel.y):
        if isinstance(path, tuple) and len(path[0]) not in (1, angles):
            raise BadInput(f"Travel has {len(path[0])} angles, and the turntable {angles}; expected one height for "
                           "each angle, or one for each turn")  # fmt: skip


def at_rest(name: str, motion: Any) -> None:
    """Raise `BadInput` if the part of a turntable moves, which ``name`` cannot follow."""
    if getattr(motion, "travel", None) is not None:
        raise BadInput(f"{name} got a part that moves (travel); expected one at rest: only a Projection, and vessels "
                       "with level light, follow it")  # fmt: skip
