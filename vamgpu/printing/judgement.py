"""A proof judged below the voxel: window over tolerance, surface, and sensitivity to errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import ceil, isfinite, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import ahead, beside
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.geometry import centers
from vamgpu.kernels.depth import NO_DEPTH
from vamgpu.metrics.depth import LARGEST_REACH
from vamgpu.metrics.interpolation import interpolated
from vamgpu.metrics.nearest_points import nearest
from vamgpu.metrics.surface_judgement import SurfaceJudgement, judge_surface
from vamgpu.metrics.tolerance import (
    WIDEST,
    Depth,
    ToleranceWindow,
    depth_of_fractions,
    depth_of_target,
    tolerance_window,
)
from vamgpu.printing.independent_exposure import FineSlab, IndependentExposure
from vamgpu.printing.scattered_exposure import is_traced
from vamgpu.printing.tolerances import ToleranceTable, tolerance_table
from vamgpu.reports.line import Line, length
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof

FINEST = 5  # greatest number of sampled voxels along an edge for which depths come from the part's mesh
DEEP = 2.0  # pixels from the surface beyond which wrong resin is a fault; closer, light cannot make the dose jump
_PLANES = 16  # planes along x that a thread joins
WHOLE = 2**28
"""Greatest number of fine voxels whose surface is judged; above it, the surface of the part's own voxels is judged."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """A proved print, judged by more criteria than its strict window."""

    over_tolerance: ToleranceWindow  # W up to two voxels or pixels, on voxels half as wide or less
    compared: Callable[[], SurfaceJudgement] = field(repr=False)  # waits for the thread that compares the surfaces
    pixel: float  # width of the narrowest column in the resin [mm]; a voxel of the part if there are no rays
    deep: float  # distance from the surface beyond which wrong resin is a fault [mm]: two pixels
    off: Callable[[], ToleranceTable] = field(repr=False)  # computes the table of errors
    not_judged: tuple[str, ...] = ()  # what was not judged, one sentence each

    @cached_property
    def surface(self) -> SurfaceJudgement:
        """Comparison of the print's surface with the mesh; meanwhile, `table` and pictures can be made."""
        return self.compared()

    @cached_property
    def table(self) -> ToleranceTable:
        """The same frames on machines with small errors; the first use takes five to ten projector evaluations."""
        return self.off()

    def lines(self) -> tuple[Line, ...]:
        """The windows at half a pixel, one and two pixels, if known, and the surface with its bodies."""
        found, known = [], float(self.over_tolerance.distance[-1]) * (1.0 + 1e-9)
        for number, name in ((0.5, "½ pixel"), (1.0, "1 pixel"), (2.0, "2 pixels")):
            if number * self.pixel <= known:
                value = self.over_tolerance.at(number * self.pixel)
                where = f"over all points at least {length(number * self.pixel)} from the surface, finer than a voxel"
                found.append(Line(f"process window, {name}", f"{value:+.4f}" if isfinite(value) else "–", where))
        return (*found, *self.surface.lines())


def judged(proof: Proof) -> Judgement:
    """Judge a proof by the light of its frames, exposed again on finer voxels."""
    # If a proof knows no finer dose than that of the part's own voxels, those are judged. Costs about six
    # projector evaluations for the finer dose, and some seconds of a processor for the surface.
    A, at = proof.operator, proof.scores.threshold
    radius, voxels, finer, pixel = A.grid.inscribed_radius, prod(A.grid.shape), 1, A.grid.pitch
    slabs: Iterable[FineSlab] = [FineSlab(proof.dose, *A.grid.axes(), A.grid.pitch, radius)]
    if is_traced(A):
        exposure = IndependentExposure(A)
        pixel, finer = exposure.column, exposure.halves if proof.independent else 1
    if proof.independent:
        voxels *= finer**3
        slabs = proof.fine(radius, DEEP * pixel)
    reach = max(WIDEST * A.grid.pitch, min(DEEP * pixel, (LARGEST_REACH - 3.0) * A.grid.pitch / finer))
    depth = _depth(proof, finer, reach)
    if proof.limits is not None:
        slabs, depth = map(partial(_asked, proof), slabs), _where_asked(proof, depth)
    fine: list[Any] | None = [] if proof.independent and voxels <= WHOLE else None
    slabs = slabs if fine is None else _kept(slabs, fine)
    searched = beside(lambda: proof.joined and nearest(proof.joined, 0.5 * A.grid.pitch))  # for the surface
    found = tolerance_window(slabs, depth, A.grid.pitch, radius=radius, reach=reach)
    searched()

    def off() -> ToleranceTable:
        light = proof.frames.irradiance(A.device)
        return tolerance_table(A, light, proof.target, proved=proof.dose, threshold=at, limits=proof.limits,
                               deep=DEEP * pixel)  # fmt: skip

    half_pixels = voxels if proof.independent else int(voxels * max(2.0 * A.grid.pitch / pixel, 1.0) ** 3)
    missed = [f"the surface at a finer scale than the part's voxels, because that takes {half_pixels:,} voxels and "
              f"only {WHOLE:,} fit at once"] * (fine is None and half_pixels > WHOLE)  # fmt: skip
    if isinstance(A, OxygenModel):
        missed.append("other exposures, in which oxygen diffuses otherwise: the latitude is that of the effective dose")
    deep = min(DEEP * pixel, float(found.distance[-1]))
    least, greatest = found.limits(deep)
    compared = _surface(proof, fine, pixel, (greatest, least))
    return Judgement(found, compared, pixel, deep, off, tuple(missed))


def _depth(proof: Proof, finer: int, reach: float) -> Depth:
    """Depths in the mesh, if there is one, sampled on voxels ``finer`` times as fine as the part's."""
    grid = proof.operator.grid
    if proof.joined is None or not 1 < finer <= FINEST or proof.operator.beam.flat:
        return depth_of_fractions(proof.target.numpy(), grid, proof.operator.beam.flat, reach, proof.operator.device)
    solid = proof.joined
    part = Target(grid, proof.name, proof.target, solid.radius, solid.volume, solid.height, solid)
    return depth_of_target(part, grid.pitch / finer, grid.pitch, reach, proof.operator.device)


def _surface(
    proof: Proof, slabs: list[Any] | None, pixel: float, between: tuple[float, float]
) -> Callable[[], SurfaceJudgement]:
    """The comparison of surfaces, begun in a thread if it needs no device."""
    grid, thin, dose = proof.operator.grid, proof.unjudged, np.zeros(0)
    if slabs is None:
        dose, pitch = refined(proof.parts.dose.numpy(), grid.pitch, 0.5 * pixel)
        place = [-0.5 * (count - 1) * pitch for count in dose.shape]
    else:
        place, pitch = [slabs[0].x[0], slabs[0].y[0], slabs[0].z[0]], slabs[0].pitch

    def compared() -> SurfaceJudgement:
        values = dose if slabs is None else _joined([slab.dose for slab in slabs])
        return judge_surface(values, place, pitch, proof.scores.threshold, proof.target, grid, proof.joined, thin=thin,
                             widest=2.0 * DEEP * pixel, between=between)  # fmt: skip

    # without a mesh, warnings are turned off meanwhile, for all threads
    return compared if proof.joined is None else beside(compared)


def _joined(slabs: list[np.ndarray]) -> np.ndarray:
    """Slabs along z as one volume [x, y, z]."""
    if len(slabs) == 1:
        return slabs[0]
    whole = np.empty((*slabs[0].shape[:2], sum(slab.shape[2] for slab in slabs)), slabs[0].dtype)
    some = [slice(first, first + _PLANES) for first in range(0, len(whole), _PLANES)]
    for _ in ahead(lambda x: np.concatenate([slab[x] for slab in slabs], axis=2, out=whole[x]), some):
        pass
    return whole


def refined(dose: np.ndarray, pitch: float, width: float) -> tuple[np.ndarray, float]:
    """A dose on voxels of at most a given width, by linear interpolation, because narrow holes close on wide voxels."""
    finer = pitch / width
    if finer < 1.1 or dose.size * finer**3 > WHOLE:
        return dose, pitch
    shape = [ceil(finer * size - 1e-6) for size in dose.shape]
    places = [centers(many, 1.0 / finer) + 0.5 * (size - 1) for many, size in zip(shape, dose.shape, strict=True)]
    return np.asarray(interpolated(dose, places)), width


def _asked(proof: Proof, slab: FineSlab) -> FineSlab:
    """A slab with its dose relative to the limits of the part's voxels."""
    assert proof.limits is not None
    scale = proof.limits.at(proof.limits.scale, proof.operator.grid.pitch)
    return replace(slab, dose=proof.operator.device.upload(slab.dose.numpy() * scale(slab.x, slab.y, slab.z)))


def _kept(slabs: Iterable[FineSlab], kept: list[Any]) -> Iterator[FineSlab]:
    """The slabs, each of which is also copied to the host."""
    for slab in slabs:
        yield slab
        kept.append(replace(slab, dose=slab.dose.numpy()))  # type: ignore[arg-type]


def _where_asked(proof: Proof, depth: Depth) -> Depth:
    """A depth, set to `NO_DEPTH` at points without limits."""
    assert proof.limits is not None
    judged = proof.limits.at(proof.limits.scale, proof.operator.grid.pitch)

    def asked(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> DeviceArray:
        found = depth(x, y, z)
        return found.device.upload(np.where(judged(x, y, z) > 0.0, found.numpy(), NO_DEPTH))

    return asked
