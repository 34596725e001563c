"""The beam lattice extension of 3MF, with its balls: round beams between corners of a mesh, as solids."""

from __future__ import annotations

from math import ceil, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from manifold3d import Manifold

from vamgpu.errors import MeshError
from vamgpu.storage.memory import afford
from vamgpu.targets.shapes import csg

CAPS = ("sphere", "hemisphere", "butt")
MODES: dict[str, tuple[str, ...]] = {"clipping": ("none",), "ball": ("none", "mixed", "all")}
FACET = 0.002  # largest distance [mm] of facets from a round surface, unless that takes more than 64 sides
WORK = 400_000  # bytes of memory that a beam takes while all are joined
REMEDY = "turn the lattice into triangles and export again"


class BeamLattice:
    """A lattice element of a file; ``vertices`` are those of its mesh, ``scale`` [mm] is their unit."""

    def __init__(self, element: Any, vertices: npt.NDArray[np.float64], scale: float, name: str) -> None:
        self.element: Any = element
        self.vertices: npt.NDArray[np.float64] = vertices
        self.scale: float = scale
        self.name: str = name
        self.said: dict[str, str] = {str(key).rpartition("}")[2]: value for key, value in element.attrib.items()}

    def bodies(self) -> list[Manifold]:
        """Beams, their ends and balls, which overlap. Raises `MeshError`."""
        for what, modes in MODES.items():
            if (mode := self.said.get(f"{what}mode", "none")) not in modes:
                raise MeshError(f"{self.name!r} has a beam lattice with the {what} mode {mode!r}, which is not "
                                f"supported; expected {' or '.join(map(repr, modes))}: {REMEDY}")  # fmt: skip
        beams = list(self.element.iterfind("{*}beams/{*}beam"))
        afford(WORK * len(beams), f"{self.name!r} with {len(beams):,} beams", MeshError)
        found: list[Manifold] = []
        round_ends: set[tuple[int, float]] = set()
        corners: set[int] = set()
        for beam in beams:
            ends = [self._corner(beam, key) for key in ("v1", "v2")]
            start, end = self.vertices[ends]
            length = float(np.linalg.norm(end - start))
            if not length > 0.0 or length < (1.0 - 1e-9) * float(self.said.get("minlength", 0.0)):
                continue
            way = (end - start) / length
            first = self._radius(beam, "r1", "radius")
            radii = [first, self._radius(beam, "r2", "radius") if "r2" in beam.attrib else first]
            found.append(csg.rod(start, end, radii[0], radii[1], self._sides(max(radii))))
            corners.update(ends)
            for corner, radius, key, out in zip(ends, radii, ("cap1", "cap2"), (-way, way), strict=True):
                cap = beam.get(key, self.said.get("cap", CAPS[0]))
                if cap not in CAPS:
                    raise MeshError(f"{self.name!r} has a beam with the end {cap!r}; expected {', '.join(CAPS)}: "
                                    f"{REMEDY}")  # fmt: skip
                if cap == "sphere":
                    round_ends.add((corner, radius))
                elif cap == "hemisphere":
                    found.append(self._ball(corner, radius).trim_by_plane(out, float(out @ self.vertices[corner])))
        return [*found, *(self._ball(*each) for each in sorted(round_ends | self._balls(corners)))]

    def _balls(self, corners: set[int]) -> set[tuple[int, float]]:
        """Corner and radius of its balls; they stand at ends of beams."""
        mode, own = self.said.get("ballmode", "none"), self.element.iterfind("{*}balls/{*}ball")
        if mode == "none":
            return set()
        usual = {each: self._radius({}, "r", "ballradius") for each in corners} if mode == "all" else {}
        usual |= {self._corner(each, "vindex"): self._radius(each, "r", "ballradius") for each in own}
        return set(usual.items())

    def _ball(self, corner: int, radius: float) -> Manifold:
        return Manifold.sphere(radius, self._sides(radius)).translate(self.vertices[corner])

    def _corner(self, element: Any, key: str) -> int:
        found = int(element.get(key, -1))
        if not 0 <= found < len(self.vertices):
            raise MeshError(f"{self.name!r} has beams of corners that do not exist; it is damaged: export again")
        return found

    def _radius(self, element: Any, key: str, usual: str) -> float:
        given = element.get(key, self.said.get(usual))
        if given is None:
            raise MeshError(f"{self.name!r} has a beam or ball without {key}, and its lattice has no {usual}; expected "
                            "a radius above 0: export again")  # fmt: skip
        if not 0.0 < (found := float(given)) < np.inf:
            raise MeshError(f"{self.name!r} has a beam or ball of radius {found:g}; expected one above 0: export again")
        return found

    def _sides(self, radius: float) -> int:
        """Sides of a round beam: a multiple of 4, as its ends have."""
        return 4 * min(max(ceil(0.25 * pi / sqrt(2.0 * FACET / (radius * self.scale))), 2), 16)
