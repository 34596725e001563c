"""What lies beyond the faces of a box of resin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive

FACES = ("x low", "x high", "y low", "y high", "z low", "z high")


@dataclass(frozen=True)
class Fixed:
    """A face held at a concentration [mol/m³, or normalized like the field]. Raises `BadInput` below zero."""

    value: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", positive("the value of a fixed face", self.value, zero=True))


Face = Fixed | None


@dataclass(frozen=True)
class Boundary:
    """One entry a face of a species' box, in the order of `FACES`: None where no flux passes, or `Fixed`."""

    faces: tuple[Face, Face, Face, Face, Face, Face] = (None, None, None, None, None, None)

    def __post_init__(self) -> None:
        known = isinstance(self.faces, (tuple, list)) and len(self.faces) == 6
        if not known or not all(face is None or isinstance(face, Fixed) for face in self.faces):
            raise BadInput(f"faces are {self.faces!r}; wanted six of None or Fixed: {', '.join(FACES)}")

    @classmethod
    def fixed(cls, value: float, *names: str) -> Boundary:
        """The faces of those names (see `FACES`) held at a value, no flux elsewhere. Raises `BadInput`."""
        unknown = sorted(set(names) - set(FACES))
        if unknown:
            raise BadInput(f"no face is named {unknown[0]!r}; the faces are {', '.join(FACES)}")
        faces = [Fixed(value) if name in names else None for name in FACES]
        return cls((faces[0], faces[1], faces[2], faces[3], faces[4], faces[5]))

    def ghosts(self) -> np.ndarray:
        """g0 and g1 of each face, shape (6, 2): the voxel beyond holds g0 + g1·c, so that the face holds its value."""
        return np.array([(0.0, 1.0) if face is None else (2.0 * face.value, -1.0) for face in self.faces])

    def holds(self, axis: int) -> int:
        """How many faces across an axis are fixed."""
        return sum(face is not None for face in self.faces[2 * axis : 2 * axis + 2])
