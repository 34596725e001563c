"""Media whose refractive index varies from place to place: formulas, grids and functions, and where they end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.kernels.index_field import formula_at, plane_at, volume_at
from vamgpu.optics.inputs import Floats
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Place

FAR = 1e30  # stands for "no border"; devices cannot handle infinity
EVERYWHERE = (-FAR, -FAR, -FAR)
EXTRAPOLATE = np.array([[10.0, -20.0, 15.0, -4.0], [4.0, -6.0, 4.0, -1.0]])
"""Two samples before the first four, from the cubic through them."""


@dataclass(frozen=True)
class Region:
    """Region in which rays are marched: a·x² + b·y² + c·z² ≤ radius², and inside a box.

    weights: a, b, c.  radius: [mm].  low, high: corners of the box [mm].
    """

    weights: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: Length = 1.0
    low: tuple[Place, Place, Place] = EVERYWHERE
    high: tuple[Place, Place, Place] = (FAR, FAR, FAR)

    def __post_init__(self) -> None:
        check(self)
        if len(self.low) != 3 or len(self.high) != 3 or any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise BadInput(
                f"the box of a region runs from {self.low} to {self.high}; expected low < high on three axes"
            )

    @classmethod
    def ball(cls, radius: float) -> Region:
        """Inside a sphere about the origin."""
        return cls((1.0, 1.0, 1.0), radius)

    @classmethod
    def cylinder(cls, radius: float) -> Region:
        """Inside a cylinder about the z axis."""
        return cls((1.0, 1.0, 0.0), radius)

    @classmethod
    def box(cls, low: Sequence[float], high: Sequence[float]) -> Region:
        """Between two corners, in x and y or in x, y and z."""
        below, above = [*low, -FAR][:3], [*high, FAR][:3]
        return cls(low=(below[0], below[1], below[2]), high=(above[0], above[1], above[2]))

    @property
    def table(self) -> Floats:
        """The arguments of `march_formula`, (10,)."""
        return np.array([*self.weights, self.radius**2, *self.low, *self.high])

    @property
    def extents(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest x, y and z [mm]; ±`FAR` if there is no border."""
        out = []
        for weight, low, high in zip(self.weights, self.low, self.high, strict=True):
            reach = self.radius / np.sqrt(weight) if weight > 0 else FAR
            out.append((max(low, -reach), min(high, reach)))
        return tuple(out)

    @property
    def size(self) -> float:
        """Longest bounded extent [mm]; 0 for a region without borders."""
        return max((high - low for low, high in self.extents if high - low < FAR), default=0.0)


@runtime_checkable
class IndexField(Protocol):
    """A medium of varying refractive index."""

    @property
    def region(self) -> Region:
        """Region in which rays are marched."""
        ...

    def evaluate(self, place: Floats) -> tuple[Floats, Floats]:
        """½∇n² [1/mm], (points, 3), and n², (points,), at positions [mm], (points, 3); in float64."""
        ...


@dataclass(frozen=True)
class FormulaField:
    """n² = P(s)/Q(s) with s = a·x² + b·y² + c·z², P and Q at most cubic; lengths in mm.

    weights: a, b, c.  above, below: coefficients of P and Q from the constant up.
    region: region in which it is evaluated.  Raises `BadInput`.
    """

    weights: tuple[float, float, float]
    above: tuple[float, ...]
    below: tuple[float, ...] = (1.0,)
    region: Region = Region()

    def __post_init__(self) -> None:
        for name, values in (("above", self.above), ("below", self.below)):
            if not 1 <= len(values) <= 4 or not np.isfinite(values).all():
                raise BadInput(f"FormulaField {name} is {values}; expected 1 to 4 finite coefficients")

    @cached_property
    def table(self) -> Floats:
        """The table of `march_formula`, (12,)."""
        table = np.zeros(12)
        table[:3], table[3 : 3 + len(self.above)], table[7 : 7 + len(self.below)] = self.weights, self.above, self.below
        return table

    def evaluate(self, place: Floats) -> tuple[Floats, Floats]:
        return formula_at(self.table, place)


def fish_eye(radius: float, index: float = 2.0, *, cylinder: bool = False) -> FormulaField:
    """Maxwell's fish-eye n = index/(1 + r²/radius²), without a border: every ray is a circle."""
    scale = 1.0 / positive("fish-eye radius [mm]", radius) ** 2
    return FormulaField((1.0, 1.0, 0.0 if cylinder else 1.0), (index**2,), (1.0, 2.0 * scale, scale**2))


def parabolic(index: float, slope: float, half_width: float | None = None) -> FormulaField:
    """n² = index²·(1 − slope²·x²), slope in 1/mm; a ray through x = 0 at the angle θ repeats after 2π·cosθ/slope."""
    region = Region() if half_width is None else Region(low=(-half_width, -FAR, -FAR), high=(half_width, FAR, FAR))
    return FormulaField((1.0, 0.0, 0.0), (index**2, -((index * slope) ** 2)), region=region)


@dataclass(frozen=True, eq=False)
class GridField:
    """n² by cubic B-splines on a grid in x and y, or in x, y and z; made in Python, stored in job folders.

    ∇n² is exactly the gradient of n².

    Args:
        coefficients: Coefficients of the splines, (nx + 2, ny + 2) or (nx + 2, ny + 2, nz + 2): one more on every side
            than samples.
        corner: Position of the first sample [mm].
        pitch: Pitch of the samples [mm].
        region: Region in which the field is valid.
    """

    coefficients: Floats
    corner: tuple[float, float, float]
    pitch: float
    region: Region

    @classmethod
    def from_array(cls, index: ArrayLike, pitch: float, region: Region | None = None) -> GridField:
        """Samples of n, (nx, ny) or (nx, ny, nz), ``pitch`` [mm] apart and centered on the origin.

        The spline coefficients are quasi-interpolants (each sample minus a sixth of its second difference); cubics are
        therefore exact, and the error falls with the fourth power of the pitch. Raises `BadInput`.
        """
        square = np.asarray(index, np.float64) ** 2
        if square.ndim not in (2, 3) or min(square.shape) < 4 or not np.isfinite(square).all():
            raise BadInput(f"an index field of shape {square.shape}; expected finite samples, 4 or more on 2 or 3 axes")
        if square.min() < 1e-6:
            raise BadInput(f"the index falls to {np.sqrt(square.min()):g}; expected indices above 0")
        for axis in range(square.ndim):
            square = np.moveaxis(_extended(np.moveaxis(square, axis, 0)), 0, axis)
        return cls._of(square, pitch, region)

    @classmethod
    def from_function(
        cls, function: Callable[..., Floats], shape: Sequence[int], pitch: float, region: Region | None = None
    ) -> GridField:
        """Samples of n(x, y) or n(x, y, z) [mm] on a grid of ``shape``, centered on the origin. Raises `BadInput`."""
        shape = counts("index field shape", shape, len(shape))
        axes = [(np.arange(-2, n + 2) - 0.5 * (n - 1)) * positive("pitch [mm]", pitch) for n in shape]
        index = np.broadcast_to(function(*np.meshgrid(*axes, indexing="ij")), [n + 4 for n in shape])
        if len(shape) not in (2, 3) or min(shape) < 4 or not np.isfinite(index).all():
            raise BadInput(f"an index field of shape {shape}; expected finite samples, 4 or more on 2 or 3 axes")
        return cls._of(np.asarray(index, np.float64) ** 2, pitch, region)

    @classmethod
    def _of(cls, square: Floats, pitch: float, region: Region | None) -> GridField:
        """Build from n² with two additional samples on every side."""
        pitch = positive("pitch [mm]", pitch)
        half = [0.5 * (n - 5) * pitch for n in square.shape]
        for axis in range(square.ndim):
            values = np.moveaxis(square, axis, 0)
            square = np.moveaxis((8.0 * values[1:-1] - values[:-2] - values[2:]) / 6.0, 0, axis)
        corner = [-h for h in half] + [0.0]
        box = Region.box([-h for h in half], half)
        return cls(square, (corner[0], corner[1], corner[2]), pitch, region or box)

    @property
    def place(self) -> Floats:
        """The arguments of `march_plane`, (4,): first sample, and samples per mm."""
        return np.array([*self.corner, 1.0 / self.pitch])

    def evaluate(self, place: Floats) -> tuple[Floats, Floats]:
        at = plane_at if self.coefficients.ndim == 2 else volume_at
        return at(self.coefficients, self.place, place)


def _extended(values: Floats) -> Floats:
    before = np.tensordot(EXTRAPOLATE, values[:4], 1)
    after = np.tensordot(EXTRAPOLATE, values[:-5:-1], 1)[::-1]
    return np.concatenate([before, values, after])


@dataclass(frozen=True, eq=False)
class FunctionField:
    """Any n(x, y) or n(x, y, z) of arrays [mm]; NumPy marches it directly, other devices sample it on a grid.

    region: bounded along the axes of the function. axes: 2 or 3. samples: along the longest of them.
    """

    function: Callable[..., Floats]
    region: Region
    axes: int = 2
    samples: int = 256

    def __post_init__(self) -> None:
        if self.axes not in (2, 3) or any(b - a >= FAR for a, b in self.region.extents[: self.axes]):
            raise BadInput(f"a function of {self.axes} axes over {self.region}; expected 2 or 3 axes, all with borders")

    def evaluate(self, place: Floats) -> tuple[Floats, Floats]:
        """The gradient, from central differences of fourth order over a thousandth of the region."""
        delta, pull = 1e-3 * self.region.size, np.zeros_like(place)
        for axis in range(self.axes):
            near, far = (self._square(place, axis, d) - self._square(place, axis, -d) for d in (delta, 2.0 * delta))
            pull[:, axis] = (8.0 * near - far) / (24.0 * delta)
        return pull, self._square(place, 0, 0.0)

    def _square(self, place: Floats, axis: int, shift: float) -> Floats:
        moved = [place[:, k] + (shift if k == axis else 0.0) for k in range(self.axes)]
        return np.broadcast_to(np.asarray(self.function(*moved), np.float64) ** 2, len(place)).copy()

    @cached_property
    def sampled(self) -> GridField:
        """The function on a grid a few samples wider than the region."""
        extents = self.region.extents[: self.axes]
        middle = [0.5 * (a + b) for a, b in extents]
        pitch = max(b - a for a, b in extents) / (self.samples - 5)
        shape = [int(np.ceil((b - a) / pitch - 1e-9)) + 5 for a, b in extents]
        shifted = GridField.from_function(
            lambda *at: self.function(*(x + m for x, m in zip(at, middle, strict=True))), shape, pitch, self.region
        )
        corner = [c + m for c, m in zip(shifted.corner, [*middle, 0.0], strict=False)]
        return replace(shifted, corner=(corner[0], corner[1], corner[2]))
