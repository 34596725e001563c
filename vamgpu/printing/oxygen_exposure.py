"""Exposure of frames in a resin whose oxygen inhibits curing, by other steps and on another grid than the solver's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from hashlib import sha256
from math import ceil, isfinite
from weakref import WeakKeyDictionary

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.oxygen import Oxygen, OxygenModel
from vamgpu.chemistry.transport import Boundary, Box, Transport
from vamgpu.geometry import Grid, resin_radius
from vamgpu.kernels.inhibition import consume_oxygen, take_poses
from vamgpu.metrics.interpolation import interpolated
from vamgpu.operators.compose import combine
from vamgpu.printing.beyond_cylinder import Around, Outer, corner_of, greatest_beyond
from vamgpu.printing.independent_exposure import FineSlab, IndependentExposure
from vamgpu.targets.resampling import along

RUNS = 60
"""Greatest number of runs of angles per turn; the light of a run is constant in time. Where 180 angles light a ring
from one side, the dose is right to 0.15 % of the greatest; with 10 runs, to 1.1 %."""
STEPS = 3  # least number of steps within a run; diffusion is explicit and may need more
HALVES = 2  # fine voxels along the height of a part voxel, if light varies with the height


class OxygenExposure(IndependentExposure):
    """Effective dose of frames: light of traced rays, explicit diffusion and implicit reactions on fine voxels."""

    # resin goes on beyond the grid, as far as oxygen comes from, along axes without a face in air

    def __init__(self, A: OxygenModel) -> None:
        super().__init__(A.operator)  # type: ignore[arg-type] - a Projection
        self.oxygen: Oxygen = A.oxygen
        self._model = A

    def averaged(
        self, light: DeviceArray, progress: Callable[[float], None] = lambda share: None, part: Around | None = None
    ) -> tuple[DeviceArray, Outer | None]:
        plain, outer = super().averaged(light, part=part)
        more = self._kept(light, progress)
        if outer is not None:
            outer = replace(outer, dose=outer.dose + more.at(*np.array(outer.place)[:, None]).item())
        dose = combine(1.0, plain, 1.0, self.device.upload(more.mean(self.grid)), plain)
        return dose, greatest_beyond(self.grid, corner_of(self.grid), dose, self.grid.axes(), self.grid.pitch, outer,
                                     part)  # fmt: skip

    def fine(self, light: DeviceArray, reach: float | None = None, above: float = 0.0) -> Iterator[FineSlab]:
        more = self._kept(light)
        for slab in super().fine(light, reach, above):
            own = self.device.upload(more.at(slab.x, slab.y, slab.z))
            yield replace(slab, dose=combine(1.0, slab.dose, 1.0, own, own))

    def _kept(self, light: DeviceArray, progress: Callable[[float], None] = lambda share: None) -> _More:
        """`_more`, followed once for the same light in the same resin."""
        key, found = (sha256(light.numpy().tobytes()).digest(), self.finer), _LAST.get(self._model)
        if found is None or found[0] != key:
            found = _LAST[self._model] = key, self._more(light, progress)
        return found[1]

    def _more(self, light: DeviceArray, progress: Callable[[float], None]) -> _More:
        """Effective dose − dose of the light, on fine voxels of all resin that exchanges oxygen with the grid."""
        oxygen, box, f = self.oxygen, self._box, (self.finer, self.finer, 1 if self.beam.flat else HALVES)
        x, y, z = (self.grid.pitch / k for k in f)
        edges, air = (x, y, z), Boundary.fixed(1.0, *self.oxygen.air)
        beside = [((w - n) // 2,) * 2 for w, n in zip(box.grid.shape, self.grid.shape, strict=True)]
        used = np.pad(np.broadcast_to(oxygen.used, self.grid.shape), beside, mode="edge").astype(np.float32)
        used = np.kron(used, np.ones(f, np.float32))
        if not oxygen.diffusivity:
            return _More(used, edges)
        wall, D = resin_radius(self.vessel), float(oxygen.diffusivity)
        walk = Transport(Box(used.shape, edges, wall if isfinite(wall) else None), (D, D, D), None,
                         (air, Boundary(), Boundary()), self.device)  # fmt: skip
        state, dose, total = walk.start(a=1.0 - used), *(self.device.upload(np.zeros_like(used)) for _ in range(2))
        runs = np.array_split(np.arange(self.motion.angles), min(RUNS, self.motion.angles))  # the longest first
        each = oxygen.period / self.motion.angles
        steps = max(walk.steps(each * runs[0].size), STEPS)
        given = {"gain": 1.0 / (oxygen.turns * steps), "floor": oxygen.floor}
        for number, run in enumerate(oxygen.turns * runs):
            _of_run(box, light, run, dose)
            for _ in range(steps):
                self.device.launch(consume_oxygen, dose=dose, **given, a=state.a, x=state.dose)
                walk.advance(state, each * run.size / steps, 1)
            combine(1.0, total, 1.0 / oxygen.turns, dose, total)
            progress((number + 1) / (oxygen.turns * len(runs)))
        return _More(1.0 + state.dose.numpy() - state.a.numpy() - total.numpy(), edges)

    @property
    def _box(self) -> IndependentExposure:
        """The exposure of that resin, on voxels of the fine width."""
        box, grid, oxygen, wall = copy(self), self.grid, self.oxygen, resin_radius(self.vessel)
        reach = oxygen.reach / grid.pitch
        most = [max(wall / grid.pitch - 0.5 * n, 0.0) for n in grid.shape[:2]]
        more = (0 if any(face[0] == axis for face in oxygen.air) else ceil(min(reach, room))
                for axis, room in zip("xyz", (*most, 0 if self.beam.flat else reach), strict=True))  # fmt: skip
        nx, ny, nz = (n + 2 * m for n, m in zip(grid.shape, more, strict=True))
        box.grid, box.finer, box._discs = Grid((nx, ny, nz), grid.pitch), 1, {}
        box.corner = corner_of(box.grid)
        box.radius = min(wall, box.corner)
        box.__dict__.pop("_tables", None)
        box._near = box._disc(self.pitch, box.radius)
        return box


_LAST = WeakKeyDictionary[OxygenModel, tuple[tuple[bytes, int], "_More"]]()
"""Per model: a digest of the light that was exposed last, the fine voxels along a part voxel, and the difference."""


@dataclass(frozen=True)
class _More:
    """The difference that oxygen makes to the dose."""

    values: np.ndarray  # [x, y, z], centered like the grid
    edges: tuple[float, float, float]  # of voxels [mm]

    def mean(self, grid: Grid) -> np.ndarray:
        """The mean over the voxels of a grid."""
        means = self.values
        for axis, edge in enumerate(self.edges):
            means = along(means, Grid(means.shape, edge), grid, axis)
        return np.ascontiguousarray(means)

    def at(self, *places: np.ndarray) -> np.ndarray:
        """Values at places [mm] along each axis, linear in between."""
        return interpolated(self.values, [place / edge + 0.5 * (n - 1) for place, edge, n in
                                          zip(places, self.edges, self.values.shape, strict=True)])  # fmt: skip


def _of_run(box: IndependentExposure, light: DeviceArray, run: np.ndarray, dose: DeviceArray) -> None:
    """dose = that of the light of some neighboring angles."""
    piece, part = copy(box), light.device.empty((run.size, *light.shape[1:]))
    piece.motion = box.motion.chosen(run.tolist())
    piece.__dict__.pop("_tables", None)
    light.device.launch(take_poses, light=light, first=int(run[0]), part=part)
    for _ in piece.onto(part, dose):
        pass
