"""What the columns of a beam become inside the resin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vamgpu.errors import BadInput

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Chords:
    """Straight chords in the resin, one for each column of the beam; all arrays share the shape of the columns.

    A chord is the line ``X cos(angle) + Y sin(angle) = p`` of the laboratory frame, in which light travels towards +Y.
    It runs along ``(-sin(angle), cos(angle))``; its points are counted by the signed length t along that direction,
    zero at the foot of the perpendicular from the axis, so it enters the resin at ``-length / 2``.

    Attributes:
        p: signed distance from the axis [mm].
        angle: total deviation [rad]; it has the sign of the column where the vessel turns rays towards the axis.
        spread: change of the angle with the column [rad/mm].
        transmittance: share of the power in the bath that reaches the resin; 0 for a column that misses the resin.
        length: path in the resin [mm]; 0 for a column that misses the resin.
    """

    p: Floats
    angle: Floats
    spread: Floats
    transmittance: Floats
    length: Floats


class Vessel(Protocol):
    """What a projector asks of the thing that holds the resin."""

    @property
    def absorption(self) -> float:
        """Absorption of the resin, natural logarithm [1/mm]."""
        ...

    @property
    def printable_radius(self) -> float:
        """Radius inside which a turning target is reached by light at every pose [mm]."""
        ...

    def chords(self, u: ArrayLike) -> Chords:
        """Chords of the beam's columns at the offsets u [mm]."""
        ...

    def illuminate(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Column [mm] that lights each laboratory point [mm], and its weight."""
        ...


def as_offsets(name: str, value: ArrayLike) -> Floats:
    """Return the value as float64; raises BadInput where it is not finite."""
    array = np.asarray(value, dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise BadInput(f"{name} holds {np.count_nonzero(~np.isfinite(array))} values that are not finite; "
                       "offsets and positions are finite numbers in mm")
    return array


def require(name: str, value: float, *, zero: bool = False, unit: str = "") -> None:
    """Raise BadInput unless the value is a finite number above zero (or zero, where that is allowed)."""
    wanted = "a finite number of at least 0" if zero else "a finite number above 0"
    try:
        good = bool(np.isfinite(value)) and (value >= 0 if zero else value > 0)
    except (TypeError, ValueError):
        good = False
    if not good:
        raise BadInput(f"{name} is {value!r}; wanted {wanted}{' ' + unit if unit else ''}; correct {name}")


def absorbed_share(absorption: float, path: Floats) -> Floats:
    """Power absorbed per mm of path after the given path in resin [1/mm], or 1 where the resin absorbs nothing."""
    if absorption > 0:
        return absorption * np.exp(-absorption * path)
    return np.ones_like(path)
