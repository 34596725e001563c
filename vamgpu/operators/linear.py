"""Linear operators: two spaces, a device, an action and its exact transpose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property, partial
from inspect import signature
from math import isfinite, prod
from numbers import Real
from threading import local
from typing import Any, Self, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.card import card, drawable
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.space import SinogramSpace, Space, VolumeSpace, require, require_kinds
from vamgpu.schema.noun import GIVEN, given
from vamgpu.schema.registry import name_of


class LinearOperator(ABC):
    """Maps ``domain`` to ``range`` on a device. NumPy in → NumPy out; device array in → device array out."""

    domain: Space
    range: Space
    device: Device
    _transpose: LinearOperator | None = None
    _made: tuple[Any, ...] | None = None
    """A function and its arguments that make this operator from another one; None for one made by its constructor."""

    def _set_spaces(self, domain: Space, range: Space, device: Device) -> None:
        self.domain, self.range, self.device = domain, range, device

    @abstractmethod
    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        """Compute out = A x, both on the device.

        Args:
            x: The operand, [domain.shape].
            out: Receives the result, [range.shape].
        """

    @abstractmethod
    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        """Compute out = Aᵀ y, both on the device.

        Args:
            y: The operand, [range.shape].
            out: Receives the result, [domain.shape].
        """

    @property
    def T(self) -> LinearOperator:  # noqa: N802 - the mathematician's name
        """The plain ℓ² transpose; ``A.T.T is A``."""
        if self._transpose is None:
            self._transpose = Transposed(self)
        return self._transpose

    @final
    def __call__(self, x: Any, out: DeviceArray | None = None) -> Any:
        """Apply the operator.

        Args:
            x: The operand, [domain.shape]: NumPy, on the device, or any array that its `Device.field` takes.
            out: Receives the result on the device, [range.shape]; None for a new array.

        Returns:
            A x, [range.shape]: NumPy for a NumPy operand without ``out`` (float16 for float16), else on the device.

        Raises:
            ShapeMismatch: An array has another shape.
            BadInput: Values are not finite, have another type than the device's, or are too great for float16.
            DeviceError: An array is on another device.
        """
        require(self.domain, x, "the operand")
        source = self.device.field(x)
        target = out if out is not None else self.device.empty(self.range.shape)
        require(self.range, target, "out")
        self.forward(source, target)
        if not isinstance(x, np.ndarray) or out is not None:
            return target
        return _halved(target.numpy()) if x.dtype == np.float16 else target.numpy()

    @cached_property
    def _held(self) -> local:
        """Work fields of each thread."""
        return local()

    def _work(self, name: str, shape: tuple[int, ...]) -> DeviceArray:
        """A work field, kept for the next product: new memory takes longer than a pass over it."""
        held = vars(self._held)
        if name not in held:
            held[name] = self.device.empty(shape)
        return held[name]

    def __copy__(self) -> Self:
        """An operator that shares its tables, but is not a transpose."""
        other = object.__new__(type(self))
        vars(other).update(vars(self), _transpose=None)
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the constructor's arguments, if the registry or ``described`` gives them; else the state."""
        if self._made is not None:
            return self._made
        cls = type(self)
        if hasattr(self, "described") or name_of(cls) is not None:
            fields = given(self) | {name: self.device for name in GIVEN if name in signature(cls).parameters}
            return partial(cls, **fields), ()
        state = {name: value for name, value in vars(self).items() if name != "_held"}
        return object.__new__, (cls,), state | {"_transpose": None}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the matrix: elements of the range, and of the domain."""
        return prod(self.range.shape), prod(self.domain.shape)

    @property
    def dtype(self) -> np.dtype:
        """Type of the matrix's numbers."""
        return self.device.real

    def matvec(self, x: np.ndarray) -> np.ndarray:
        """A x for a flat vector, (columns,) or (columns, 1), as of SciPy's linear operators."""
        return np.asarray(self(np.reshape(x, self.domain.shape))).reshape(-1, *np.shape(x)[1:])

    def rmatvec(self, y: np.ndarray) -> np.ndarray:
        """Aᵀ y for a flat vector, (rows,) or (rows, 1)."""
        return self.T.matvec(y)

    def vjp(self, x: Any) -> tuple[Any, LinearOperator]:
        """A x, and the transpose, which maps ∂f/∂(A x) to ∂f/∂x; for differentiation by hand."""
        return self(x), self.T

    def __matmul__(self, other: Any) -> Any:
        # avoids a circular import, here and below: sums and products are operators
        from vamgpu.operators.compose import Composed

        if isinstance(other, LinearOperator):
            return Composed(self, other)
        is_flat = isinstance(other, np.ndarray) and other.shape in ((self.shape[1],), (self.shape[1], 1))
        return self.matvec(other) if is_flat else self(other)

    def __add__(self, other: LinearOperator) -> LinearOperator:
        from vamgpu.operators.compose import Sum

        return Sum((self, other)) if isinstance(other, LinearOperator) else NotImplemented

    def __sub__(self, other: LinearOperator) -> LinearOperator:
        from vamgpu.operators.compose import Sum

        return Sum((self, other), (1.0, -1.0)) if isinstance(other, LinearOperator) else NotImplemented

    def __mul__(self, factor: float) -> LinearOperator:
        from vamgpu.operators.compose import Sum

        if not isinstance(factor, Real):
            return NotImplemented
        if not isfinite(factor):
            raise BadInput(f"got the factor {factor} of an operator; expected a finite number")
        return Sum((self,), (float(factor),))

    __rmul__ = __mul__
    __array_ufunc__ = None
    """Let NumPy's numbers multiply the operator."""

    def __truediv__(self, factor: float) -> LinearOperator:
        if not isinstance(factor, Real):
            return NotImplemented
        if factor == 0:
            raise BadInput("an operator is divided by 0; expected another number")
        return self * (1.0 / float(factor))

    def __neg__(self) -> LinearOperator:
        return self * -1.0

    def _repr_html_(self) -> str:
        numbers = {
            **{f"{verb} [{', '.join(space.axes)}]": " × ".join(f"{n:,}" for n in space.shape)
               for verb, space in (("takes", self.domain), ("gives", self.range))},
            "on": self.device.name,
            "made by": repr(self),
        }  # fmt: skip
        lit = None
        if drawable(self.domain.shape) and drawable(self.range.shape):
            light = np.zeros(self.range.shape, np.float32)
            light[(0, *(n // 2 for n in light.shape[1:]))] = 1.0
            lit = np.asarray(self.T(light)).max(axis=-1)
        return card(type(self).__name__, numbers, {"what one pixel of the first pose lights": lit})

    @final
    def dense(self) -> np.ndarray:
        """The matrix itself (range size, domain size), for tiny geometries."""
        columns = np.prod(self.domain.shape)
        unit = np.zeros(self.domain.shape)
        matrix = np.empty((int(np.prod(self.range.shape)), int(columns)))
        for j in range(int(columns)):
            unit.flat[j] = 1.0
            matrix[:, j] = np.asarray(self(unit)).ravel()
            unit.flat[j] = 0.0
        return matrix

    @final
    def dot_test(self, seed: int = 0) -> float:
        """Gap of the transpose: |⟨Ax, y⟩ − ⟨x, Aᵀy⟩| / (‖Ax‖‖y‖) for signed normals x and y, sums in float64."""
        rng = np.random.default_rng(seed)
        x = rng.standard_normal(self.domain.shape).astype(np.float32)
        y = rng.standard_normal(self.range.shape).astype(np.float32)
        image, back = np.asarray(self(x), np.float64), np.asarray(self.T(y), np.float64)
        gap = abs(np.vdot(image, y.astype(np.float64)) - np.vdot(x.astype(np.float64), back))
        return float(gap / (np.linalg.norm(image) * np.linalg.norm(y.astype(np.float64))))


class VoxelProjector(LinearOperator):
    """A projector of voxels that a turntable turns."""

    domain: VolumeSpace  # pyright: ignore[reportIncompatibleVariableOverride]
    range: SinogramSpace  # pyright: ignore[reportIncompatibleVariableOverride]
    grid: Grid
    beam: Beam
    motion: Turntable

    def _set_geometry(self, grid: Grid, beam: Beam, motion: Turntable, device: str | Device | None) -> None:
        """Check the types of a geometry, and set it with its spaces and its device. Raises `BadInput`."""
        require_kinds(f"{type(self).__name__}(grid, beam, motion, …)", (grid, Grid), (beam, Beam), (motion, Turntable))
        self.grid, self.beam, self.motion = grid, beam, motion
        self._set_spaces(VolumeSpace(grid), SinogramSpace(beam, motion), open_device(device))

    def __repr__(self) -> str:
        vessel = getattr(self, "vessel", None)
        given = ", ".join(map(repr, (self.grid, self.beam, self.motion, *([] if vessel is None else [vessel]))))
        return f"{type(self).__name__}({given}, device={self.device.name!r})"


@final
class Transposed(LinearOperator):
    """The transpose of an operator; shares its tables."""

    def __init__(self, operator: LinearOperator) -> None:
        self._operator = self._transpose = operator
        self._set_spaces(operator.range, operator.domain, operator.device)

    def __reduce__(self) -> tuple[Any, ...]:
        return getattr, (self._operator, "T")

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._operator.transposed(x, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._operator.forward(y, out)


def _halved(values: np.ndarray) -> np.ndarray:
    """A result in float16. Raises `BadInput` if it is too great."""
    most = float(np.abs(values).max(initial=0.0))
    if most > float(np.finfo(np.float16).max):
        raise BadInput(f"the result reaches {most:.4g}; float16 holds 65504 at most: scale the operand, or use float32")
    return values.astype(np.float16)
