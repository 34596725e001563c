"""The default: thresholds that ramp across the surface of the part, on voxels finer than a pixel, optimized by L-BFGS.

Pixels cannot make a dose that jumps: thresholds ramp from one pixel outside the surface to one inside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, NoLight, OutOfMemory
from vamgpu.geometry import Grid, positive
from vamgpu.kernels.depth import HALF
from vamgpu.kernels.loss import dark_loss
from vamgpu.kernels.update import multiply
from vamgpu.losses.ramp import Ramp
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.lbfgs import ByPairs
from vamgpu.methods.limit import MARGIN
from vamgpu.methods.method import Steps
from vamgpu.methods.minimize import Channel, minimize
from vamgpu.methods.part import lit_pixels
from vamgpu.methods.ramp import identity
from vamgpu.methods.state import OptimizerState
from vamgpu.metrics.depth import LARGEST_REACH, signed_depth, surrounded
from vamgpu.metrics.interpolation import interpolated
from vamgpu.operators.compose import capped
from vamgpu.operators.defocus import direct
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot, folded, parts_for, total
from vamgpu.operators.ring_projection import RingProjection, prefers_rings, unsupported_reason
from vamgpu.operators.scenarios import Scenarios
from vamgpu.optics.outer_resin import AllResin, outer_resin
from vamgpu.optics.sampling import resin_pixel
from vamgpu.targets.target import Target

FINE = 0.75
"""Ratio of the width of a voxel to that of a pixel in the resin. Voxels of half this width gain 0.01 of the window half
a pixel from the surface; voxels as wide as pixels lose 0.08 of it."""
PIXEL_DEEP = 0.5 - 1e-6  # margin of a ramped target: voxels count from one ramp width off the surface
VOLUMES, SINOGRAMS, CELLS = 10, 20, 6
"""Memory that it needs, with five pairs and on rings: fields of voxels, of light, and of cells beside the part."""
ABOVE = 2.0  # largest number of pixels above and below the part for which there are voxels
COST, AT_CORNERS = 1e-3, 1e-2
"""Mean error of the dose, over voxels of the ramp, that a greater step is worth; at corners of tolerances, which
contradict each other anyway. Three times as much costs W(½) of a large boat, a third W(1) of small parts."""


@dataclass(frozen=True)
class SurfaceRamp(ByPairs):
    """Projected L-BFGS steps with thresholds that ramp across the surface of the part.

        minimize Σ e²/2 over voxels + Σ max(0, D − dark)²/2 over cells of all other resin,
        0 ≤ g ≤ brightest · Σ g₀² / Σ g₀

    with e as in `vamgpu.losses.Ramp`, where the step of the thresholds grows up to ``steepest`` as far as the part
    allows; D = Aᵀg and g₀ the initial patterns, from filtered back projection. Cells of all
    other resin are beside the judged cylinder out to the wall of the vessel, and above and below it. `optimize` uses
    voxels three quarters of a pixel wide if the target's are wider. With tolerances, the first sum is over the voxels
    of every corner, and the second counts the cells of the nominal print once per corner.

    Args:
        outside: Greatest dose one ``width`` outside the surface, in units of the part's dose.
        inside: Least dose one ``width`` inside, in units of the part's dose.
        most: Greatest dose in the part, in units of the part's dose.
        dark: Greatest dose of resin beyond the judged cylinder, in units of the part's dose.
        width: Width of the ramp on either side of the surface [pixels in the resin].
        brightest: Greatest light of a pixel, relative to the mean of the initial patterns weighted by their own light;
            less is a shorter exposure.
        steepest: Greatest ratio by which the step from ``outside`` to ``inside`` grows, about its middle, ``most`` with
            ``inside``, ≥ 1. Bodies with doses of their own keep the step.
        history: Largest number of stored pairs of sinograms.
        history_bytes: Their memory limit; None for the device's free memory. A `MemoryNotice` reports if fewer pairs
            fit.

    Raises:
        BadInput: A value is out of its range.
    """

    outside: float = 0.75
    inside: float = 0.95
    most: float = 1.0
    dark: float = 0.65
    width: float = 1.0
    brightest: float = 2.5
    steepest: float = 2.0
    history: int = 5
    history_bytes: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("width [pixels]", self.width)
        if not positive("dark", self.dark, zero=True) < self.inside:
            raise BadInput(f"dark is {self.dark!r}; expected less than inside, {self.inside!r}: resin beside the part "
                           "must get less than the part, or it prints")  # fmt: skip
        positive("brightest", self.brightest)

    @property
    def loss(self) -> Ramp:
        """The loss of voxels, with the least step."""
        return Ramp(self.outside, self.inside, self.most, steepest=self.steepest)

    @property
    def threshold(self) -> float:
        """Dose at the surface."""
        return 0.5 * (self.outside + self.inside)

    def steps(self, state: OptimizerState) -> Steps:
        """Steps of a run, as for `Method`.

        Args:
            state: State of the run.

        Yields:
            Loss and strict window of the step, on its voxels.

        Raises:
            NoLight: The initial patterns are dark in all pixels whose rays meet the part.
        """
        memory = state.memory
        state.lit = lit = lit_pixels(state.operator, state.target)
        if "light" not in memory:
            filtered_light(state, state.volume())
        light = state.buffer("light")
        if "most" not in memory:  # given light may be too bright, or idle
            state.device.launch(multiply, x=light, y=lit, out=light)
            sent = total(light)
            if not sent > 0.0:
                raise NoLight("the initial light is dark in all pixels whose rays meet the part; expected some light "
                              "there: check its angles and its axes, or leave start out")  # fmt: skip
            memory["most"] = self.brightest * dot(light, light) / sent
        state.most = min(memory["most"], MARGIN * state.brightness * self.threshold)
        capped(light, state.most)
        loss, target = self.loss, state.target
        if state.limits is None:
            ramped = 6.0 * (total(target) - dot(target, target))  # voxels between 0 and 1: the mean of t(1 − t) is 1/6
            worth = AT_CORNERS if isinstance(state.operator, Scenarios) else COST
            loss = replace(loss, cost=worth * ramped)
        exposure = DoseObjective(state, loss, self.rule, beside=Beside.of(state.operator, self.dark))
        yield from minimize(exposure, (Channel(state, identity(state.operator)),), self.rule)


def as_fine_as_light(operator: Any, keep: bool = False) -> Projection | RingProjection | None:
    """The projector on `fine_grid`; None for operators that keep their voxels. ``keep``: for the next call, once."""
    if (grid := fine_grid(operator)) is None:
        return None
    found = _KEPT.pop(operator, None)
    if found is None:
        A = direct(operator)
        found = _on_rings(operator, Projection(grid, A.beam, A.motion, A.vessel, A.device))
    if keep:
        _KEPT[operator] = found
    return found


_KEPT: WeakKeyDictionary[Any, Projection | RingProjection] = WeakKeyDictionary()


def _on_rings(operator: Any, fine: Projection) -> Projection | RingProjection:
    """The projector on rings, if its operator is on rings, or if rings are faster and fit into memory."""
    if unsupported_reason(fine) or not (isinstance(operator, RingProjection) or prefers_rings(fine)):
        return fine
    try:
        return RingProjection.of(fine)
    except OutOfMemory:
        if isinstance(operator, RingProjection):
            raise
        return fine


def finer_voxels(method: Any, operator: Any, target: Any) -> Grid | None:
    """The voxels of `as_fine_as_light` if a method uses them; None if it keeps its operator's."""
    asks = isinstance(method, SurfaceRamp) and getattr(target, "limits", None) is None
    return fine_grid(operator) if asks else None


def fine_grid(operator: Any) -> Grid | None:
    """The voxels of `as_fine_as_light`, which contain the judged cylinder of a projector."""
    A = direct(operator)
    if not isinstance(A, Projection):
        return None
    pixel = resin_pixel(A.beam, A.vessel)
    pitch = min(A.grid.pitch, FINE * min(pixel))
    across = 2.0 * A.grid.inscribed_radius / pitch + 1.0
    along = A.grid.shape[2] * A.grid.pitch / pitch + 2.0 * ceil(ABOVE * pixel[1] / pitch)
    nx, nz = (4 * ceil(n / 4.0 - 1e-6) for n in (across, along))
    return Grid((nx, nx, A.grid.shape[2] if A.beam.flat else nz), pitch)  # a single row of pixels needs no more slices


def across(target: Any, coarse: Grid, fine: Any, width: float) -> DeviceArray:
    """clip(½ + d / 2s, 0, 1) for voxels' depths d in a part, s = width [pixels in the resin], [x, y, z]."""
    grid, beam = fine.grid, fine.beam
    width *= min(resin_pixel(beam, getattr(fine, "vessel", None)))
    if isinstance(target, Target) and target.solid is not None:
        fraction, own = target.resampled(grid, device=fine.device).numpy(), grid
    else:
        fraction, own = np.asarray(getattr(target, "numpy", lambda: target)(), np.float32), coarse
    whole = width / own.pitch + (own is coarse)
    reach = min(whole, LARGEST_REACH - 3.0)
    pad = ceil(reach) + 2
    padded = surrounded(fraction, pad, beam.flat)  # a print that is the same at every height has no ends
    depth = signed_depth(padded, reach, fine.device) if whole <= reach else _deep(padded, reach, fine.device)
    if own is coarse and grid != coarse:
        depth = interpolated(
            depth, [x / coarse.pitch + 0.5 * (n - 1) for x, n in zip(grid.axes(), depth.shape, strict=True)]
        )
    else:
        depth = depth[pad:-pad, pad:-pad, pad:-pad]
    ramp = depth * (own.pitch / (2.0 * width))
    ramp += 0.5
    return fine.device.upload(np.asarray(np.clip(ramp, 0.0, 1.0, out=ramp), np.float32))


def _deep(fraction: np.ndarray, reach: float, device: Device) -> np.ndarray:
    """Depths [voxels] as by `signed_depth` within its reach; beyond it, those of voxel centers, ± half a voxel."""
    from scipy.ndimage import distance_transform_edt

    near, inside = signed_depth(fraction, reach, device), fraction >= HALF
    far = np.add(*(np.asarray(distance_transform_edt(side)) for side in (inside, ~inside))) - 0.5
    return np.where(np.abs(near) < reach, near, np.copysign(np.maximum(far, reach), near)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Beside:
    """Resin beyond the judged cylinder, which must stay dark: cells, weights by ring, and greatest dose."""

    resin: AllResin
    cells: tuple[DeviceArray, ...]
    weights: tuple[DeviceArray, ...]
    dark: float

    @classmethod
    def of(cls, operator: Any, dark: float) -> Beside | None:
        """The resin of a projector, or of the scenarios' nominal projector, counted once per scenario; or None."""
        several = isinstance(operator, Scenarios)
        nominal, count = (operator.operators[0], len(operator)) if several else (operator, 1)
        if not isinstance(nominal, Projection | RingProjection):
            return None
        outer, device = outer_resin(nominal), operator.device
        if not outer:
            return None
        weights = (count * each.cells.volumes / nominal.grid.voxel_volume for each in outer)
        return cls(
            AllResin(operator, outer),
            tuple(device.empty(each.domain.shape) for each in outer),
            tuple(map(device.table, weights)),
            dark,
        )

    def expose(self, light: DeviceArray, dose: DeviceArray) -> None:
        """dose = Aᵀ light, and the dose of the cells."""
        self.resin.expose(light, dose, self.cells)

    def value(self) -> float:
        """The loss of the cells; its derivatives replace their doses."""
        value = 0.0
        for dose, weight in zip(self.cells, self.weights, strict=True):
            parts = parts_for(dark_loss, dose)
            dose.device.launch(dark_loss, dose=dose, weight=weight, most=self.dark, parts=parts)
            value += folded(parts)
        return value

    def project(self, gradient: DeviceArray, out: DeviceArray) -> None:
        """Derivatives by light, from those by the dose of voxels and of cells."""
        self.resin.project(gradient, self.cells, out)
