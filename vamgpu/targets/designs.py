"""Test patterns of the papers: dots, bars, gray wedges and blocks of compartments, with exactly covered pixels.

Slices are squares whose diagonal is the volume's diameter (B. Wang et al., Figs 9 to 11); bars follow MIL-STD-150A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import centers, counts, positive
from vamgpu.targets.target import Target

Plane = npt.NDArray[np.float64]

DIAMETER = 30.0  # diameter of the paper's curing volume [mm]
PIXELS = 1500  # pixels across the paper's designs
_ASPECT = 5.0  # ratio of length to width of a bar of a resolution target; three bars and two spaces make a square


def covered(n: int, pitch: float, low: npt.ArrayLike, high: npt.ArrayLike) -> Plane:
    """Share of each of ``n`` pixels of ``pitch`` [mm], centered about zero, in disjoint intervals low..high [mm]."""
    left = centers(n, pitch) - 0.5 * pitch
    lows, highs = np.atleast_1d(low)[:, None], np.atleast_1d(high)[:, None]
    share = np.minimum(highs, left + pitch) - np.maximum(lows, left)
    return np.clip(np.maximum(share, 0.0).sum(axis=0) / pitch, 0.0, 1.0)


def side(diameter: float = DIAMETER) -> float:
    """Edge [mm] of the square whose diagonal is ``diameter`` [mm]."""
    return positive("diameter [mm]", diameter) / sqrt(2.0)


def dot_array(count: int, pixels: int = PIXELS, diameter: float = DIAMETER, duty: float = 0.5) -> Target:
    """Square dots on a square raster, as a single slice."""
    (count,), (n,) = counts("count", (count,), 1), counts("pixels", (pixels,), 1)
    if not 0.0 < duty < 1.0:
        raise BadInput(f"duty is {duty!r}; expected a number between 0 and 1, the edge of a dot over the period")
    edge, period = side(diameter), diameter / count
    half = int(0.5 * edge / period)
    middle = np.arange(-half, half + 1) * period
    middle = middle[np.abs(middle) + 0.5 * duty * period <= 0.5 * edge]
    line = covered(n, edge / n, middle - 0.5 * duty * period, middle + 0.5 * duty * period)
    return _slice(np.outer(line, line), edge / n, f"dots_{count}")


@dataclass(frozen=True)
class Bars:
    """One element of a resolution target: three upright and three lying bars."""

    group: int
    element: int
    frequency: float  # line pairs per mm, at the drawn scale
    upright: tuple[float, float]  # lower left corner of a square, 5 bar widths wide [mm]
    lying: tuple[float, float]

    @property
    def width(self) -> float:
        """Width of a bar and of a space [mm]."""
        return 0.5 / self.frequency

    def boxes(self) -> tuple[tuple[float, float, float, float], ...]:
        """The six bars: x low, x high, y low, y high [mm]."""
        w, (a, b), (c, d) = self.width, self.upright, self.lying
        length = _ASPECT * w
        return (*((a + 2 * k * w, a + (2 * k + 1) * w, b, b + length) for k in range(3)),
                *((c, c + length, d + 2 * k * w, d + (2 * k + 1) * w) for k in range(3)))  # fmt: skip


def usaf_bars(
    groups: Sequence[int] = (-2, -1, 0, 1), diameter: float = DIAMETER, fill: float = 0.92
) -> tuple[Bars, ...]:
    """Elements of a 1951 resolution target, as large as ``fill`` of the slice's square allows. Raises `BadInput`."""
    # f = 2^(group + (element − 1)/6) line pairs per mm, times a common scale; the first group is on the left
    chosen = tuple(sorted({int(g) for g in groups}))
    if not chosen or not 0.0 < fill <= 1.0:
        raise BadInput(f"groups {groups!r}, fill {fill!r}; expected at least one group and 0 < fill ≤ 1")
    raw, right, top = [], 0.0, 0.0
    for place, group in enumerate(chosen):
        left, y = (0.0, 0.0) if place == 0 else (right, top)
        for element in range(1, 7):
            frequency = 2.0 ** (group + (element - 1) / 6.0)
            w = 0.5 / frequency
            y -= _ASPECT * w
            raw.append((group, element, frequency, (left, y), (left + (_ASPECT + 1.5) * w, y)))
            y -= 1.5 * w
        if place == 0:
            right = (2 * _ASPECT + 1.5 + 2.0) * 0.5 / 2.0**group
        else:
            top = y - 2.0 * 0.5 / 2.0**group
    return _fitted([Bars(*values) for values in raw], fill * side(diameter))


def _fitted(bars: list[Bars], edge: float) -> tuple[Bars, ...]:
    """Scaled and centered into a square of ``edge`` [mm]."""
    boxes = np.array([box for bar in bars for box in bar.boxes()])
    low, high = boxes[:, ::2].min(axis=0), boxes[:, 1::2].max(axis=0)
    scale, middle = edge / float((high - low).max()), 0.5 * (low + high)

    def moved(point: tuple[float, float]) -> tuple[float, float]:
        x, y = scale * (np.array(point) - middle)
        return float(x), float(y)

    return tuple(Bars(b.group, b.element, b.frequency / scale, moved(b.upright), moved(b.lying)) for b in bars)


def usaf(groups: Sequence[int] = (-2, -1, 0, 1), pixels: int = PIXELS, diameter: float = DIAMETER) -> Target:
    """A 1951 resolution target as a single slice; `usaf_bars` gives the positions of its elements.

    Args:
        groups: Numbers of the groups.
        pixels: Pixels along an edge of the slice.
        diameter: Diameter of the circle around the slice [mm].

    Returns:
        The target.

    Raises:
        BadInput: There is no group, or a value is out of its range.
    """
    (n,), pitch = counts("pixels", (pixels,), 1), side(diameter) / pixels
    plane = np.zeros((n, n))
    for bars in usaf_bars(groups, diameter):
        for x0, x1, y0, y1 in bars.boxes():
            plane += np.outer(covered(n, pitch, x0, x1), covered(n, pitch, y0, y1))
    return _slice(plane, pitch, "usaf")


def gray_wedges(steps: int = 8, pixels: int = PIXELS, diameter: float = DIAMETER, fill: float = 0.9) -> Target:
    """Sectors of a disk with gray 1/steps … 1, counterclockwise from +x, as a single slice.

    Args:
        steps: Number of sectors.
        pixels: Pixels along an edge of the slice.
        diameter: Diameter of the circle around the slice [mm].
        fill: Diameter of the disk relative to the edge of the slice. Pixels at edges have 4 × 4 samples.

    Returns:
        The target.

    Raises:
        BadInput: A value is out of its range.
    """
    (steps,), (n,) = counts("steps", (steps,), 1), counts("pixels", (pixels,), 1)
    if not 0.0 < fill <= 1.0:
        raise BadInput(f"fill is {fill!r}; expected 0 < fill ≤ 1")
    edge = side(diameter)
    place = centers(n, edge / n)
    plane = np.zeros((n, n))
    for dx in centers(4, 0.25 * edge / n):
        for dy in centers(4, 0.25 * edge / n):
            x, y = place[:, None] + dx, place[None, :] + dy
            sector = np.floor(np.mod(np.arctan2(y, x), 2 * pi) / (2 * pi) * steps).clip(0, steps - 1)
            plane += np.where(x**2 + y**2 <= (0.5 * fill * edge) ** 2, (sector + 1) / steps, 0.0) / 16.0
    return _slice(plane, edge / n, f"wedges_{steps}")


@dataclass(frozen=True)
class Block:
    """A block of cubic compartments between struts."""

    cells: tuple[int, int, int]  # compartments along x, y, z
    strut: float  # width of positive features [mm]
    void: float  # width of negative features [mm]

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", counts("Block cells", self.cells, 3))
        for name in ("strut", "void"):
            object.__setattr__(self, name, positive(f"Block {name} [mm]", getattr(self, name)))

    @property
    def size(self) -> tuple[float, float, float]:
        """Edges [mm]."""
        x, y, z = (n * (self.strut + self.void) + self.strut for n in self.cells)
        return x, y, z

    def _struts(self, axis: int, n: int, pitch: float) -> Plane:
        low = np.arange(self.cells[axis] + 1) * (self.strut + self.void) - 0.5 * self.size[axis]
        return covered(n, pitch, low, low + self.strut)

    def target(self, pitch: float, margin: int = 2) -> Target:
        """The block on voxels of ``pitch`` [mm], exact fractions: full where two of three coordinates are in struts."""
        pitch = positive("pitch [mm]", pitch)
        wide = float(np.hypot(*self.size[:2]))
        n = 4 * -(-int(np.ceil(wide / pitch + 2 * margin + 1)) // 4)
        nz = 4 * -(-int(np.ceil(self.size[2] / pitch - 1e-6)) // 4)
        within = [covered(m, pitch, -0.5 * s, 0.5 * s) for m, s in zip((n, n, nz), self.size, strict=True)]
        a, b, c = (self._struts(k, m, pitch) for k, m in enumerate((n, n, nz)))
        u, v, w = within
        a, b, c = a[:, None, None], b[None, :, None], c[None, None, :]
        u, v, w = u[:, None, None], v[None, :, None], w[None, None, :]
        # a·b, b·c and a·c overlap where all three coordinates are in struts; each of them counts this region
        fraction = a * b * w + b * c * u + a * c * v - 2.0 * a * b * c
        return Target.from_array(np.clip(fraction, 0.0, 1.0), pitch, name="block_" + "x".join(map(str, self.cells)))

    def level(self, pixels: int = PIXELS, diameter: float = DIAMETER) -> Target:
        """A plane through the middles of compartments as a single slice: the posts along z."""
        pitch = side(diameter) / pixels
        a, b = (self._struts(k, pixels, pitch) for k in (0, 1))
        return _slice(np.outer(a, b), pitch, "posts_" + "x".join(map(str, self.cells)))


BLOCKS = {
    "W1": Block((13, 13, 12), 0.375, 0.75),
    "W2": Block((13, 13, 12), 0.425, 0.85),
    "W3": Block((5, 5, 6), 0.45, 0.9),
    "W4": Block((5, 5, 6), 0.45, 0.9),
    "W5": Block((5, 5, 6), 0.45, 0.9),
}
"""The five workpieces of Fig. 11; W3 to W5 share their design."""


def _slice(plane: Plane, pitch: float, name: str) -> Target:
    return Target.from_array(np.clip(plane, 0.0, 1.0)[:, :, None], pitch, name=name)
