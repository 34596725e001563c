"""Declarations of kernels, made only once: by the annotations of the NumPy definition."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np

from vamgpu.errors import ShapeMismatch


class Moved:
    """Whether a kernel reads or writes the bytes of an array."""

    writes: bool
    updates: bool
    """Whether it also reads the old contents before it writes."""

    @property
    def reads(self) -> bool:
        """Whether the contents of the array before a launch matter."""
        return self.updates or not self.writes


@dataclass(frozen=True)
class Field(Moved):
    """A float32 array ``[major, minor, z]`` in the device's lane layout."""

    axes: tuple[str, str, str]
    writes: bool = False
    updates: bool = False
    dtype = "float32"


@dataclass(frozen=True)
class Table(Moved):
    """An array in plain C order; axes given as digits have that length."""

    dtype: str
    axes: tuple[str, ...]
    writes: bool = False
    updates: bool = False


@dataclass(frozen=True)
class Scalar:
    """A number passed by value. Fixed numbers other than 0 are also constants in OpenCL, named in capitals."""

    dtype: str
    fixed: bool = False


Volume = Annotated[np.ndarray, Field(("x", "y", "z"))]
VolumeOut = Annotated[np.ndarray, Field(("x", "y", "z"), writes=True)]
VolumeInOut = Annotated[np.ndarray, Field(("x", "y", "z"), writes=True, updates=True)]
Sinogram = Annotated[np.ndarray, Field(("angle", "r", "z"))]
SinogramOut = Annotated[np.ndarray, Field(("angle", "r", "z"), writes=True)]
SinogramInOut = Annotated[np.ndarray, Field(("angle", "r", "z"), writes=True, updates=True)]
Array = Annotated[np.ndarray, Field(("i", "j", "z"))]
ArrayOut = Annotated[np.ndarray, Field(("i", "j", "z"), writes=True)]
ArrayInOut = Annotated[np.ndarray, Field(("i", "j", "z"), writes=True, updates=True)]
Real = Annotated[float, Scalar("float32")]
Integer = Annotated[int, Scalar("int32")]
Fixed = Annotated[int, Scalar("int32", fixed=True)]


@dataclass(frozen=True)
class Tiling:
    """What one work item computes: ``major`` × ``minor`` samples (0: all) of ``slabs`` slabs; see README.md."""

    major: int = 1
    minor: int = 1
    slabs: int = 1
    group: tuple[int, ...] = (256, 1)
    registers: int = 0


@dataclass(frozen=True, eq=False)
class Kernel:
    """A kernel: its definition, arguments, and the field whose samples its work items divide; see README.md."""

    definition: Callable[..., None]
    over: str
    reach: str = ""
    cpu: Tiling = Tiling()
    gpu: Tiling = Tiling()
    nvidia: Tiling | None = None
    constants: dict[str, dict[str, int]] = field(default_factory=dict)
    pointwise: bool = False
    """Whether `vamgpu.kernels.pointwise` writes its OpenCL and Warp versions."""

    @property
    def name(self) -> str:
        return self.definition.__name__

    @property
    def concept(self) -> str:
        """Name of the file the kernel lives in, without its ending."""
        return self.definition.__module__.rsplit(".", 1)[-1]

    @property
    def source(self) -> Path:
        """The OpenCL sibling."""
        return Path(inspect.getfile(self.definition)).with_suffix(".cl")

    @cached_property
    def arguments(self) -> dict[str, Field | Table | Scalar]:
        """Declared arguments in order."""
        hints = get_type_hints(self.definition, include_extras=True)
        names = inspect.signature(self.definition).parameters
        return {name: hints[name].__metadata__[0] for name in names}

    @cached_property
    def fixed(self) -> tuple[str, ...]:
        """Declared arguments whose numbers are compiled in."""
        return tuple(name for name, spec in self.arguments.items() if isinstance(spec, Scalar) and spec.fixed)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Named axes in order of first appearance; their sizes follow the declared arguments on devices."""
        seen: dict[str, None] = {}
        for spec in self.arguments.values():
            for axis in getattr(spec, "axes", ()):
                if not axis.isdigit():
                    seen[axis] = None
        return tuple(seen)

    def sizes(self, shapes: dict[str, tuple[int, ...]]) -> dict[str, int]:
        """Axis sizes implied by argument shapes; raises `ShapeMismatch` if two arguments disagree."""
        return dict(_sizes(self, tuple(shapes.items())))  # the cached one stays as it is


@lru_cache(maxsize=4096)
def _sizes(kernel: Kernel, shapes: tuple[tuple[str, tuple[int, ...]], ...]) -> dict[str, int]:
    sizes: dict[str, int] = {}
    owner: dict[str, str] = {}
    for name, shape in shapes:
        axes = kernel.arguments[name].axes  # type: ignore[union-attr]
        if len(axes) != len(shape):
            raise ShapeMismatch(f"{kernel.name}: {name} has shape {shape}; expected axes [{', '.join(axes)}]")
        for axis, size in zip(axes, shape, strict=True):
            expected = int(axis) if axis.isdigit() else sizes.setdefault(axis, size)
            owner.setdefault(axis, name)
            if size != expected:
                raise ShapeMismatch(
                    f"{kernel.name}: axis {axis} of {name} is {size}; {owner[axis]} has {expected}; make them equal"
                )
    return sizes


def kernel(over: str, **options: Any) -> Callable[[Callable[..., None]], Kernel]:
    """Declare the decorated NumPy definition as a `Kernel` with these fields."""
    return lambda definition: Kernel(definition, over, **options)
