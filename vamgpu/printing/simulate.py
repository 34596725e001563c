"""Simulation of a print from only the projector's frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.methods.part import check_cylinder, on_device
from vamgpu.methods.surface import fine_grid
from vamgpu.metrics import Scores, mean_brightness, score, score_slices
from vamgpu.metrics.light import light_sent
from vamgpu.metrics.parts import Parts
from vamgpu.operators.defocus import direct
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.scattering_rings import ScatteringRings
from vamgpu.operators.space import require
from vamgpu.optics.outer_resin import OuterResin, outer_resin
from vamgpu.printing.beyond_cylinder import Around, Outer, corner_of, greatest_beyond
from vamgpu.printing.black_level import check_dose
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.exposure import expose, through_turns
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.proof import Proof
from vamgpu.printing.scattered_exposure import exposure_of, is_traced
from vamgpu.targets.limits import Limits
from vamgpu.targets.target import Target


class ShownLight(Protocol):
    """Frames in the form that the simulation uses: bytes and gray curve turned into light."""

    @property
    def scale(self) -> float:
        """Light of a full-on pixel."""
        ...

    def irradiance(self, device: Device) -> DeviceArray:
        """Light of every pixel, field [angle, r, z] on a device."""
        ...


def simulate(
    A: Projection | RingProjection | ScatteringRings | OxygenModel,
    frames: ShownLight,
    target: Any,
    *,
    irradiance: float | str | None = None,
    critical_dose: float | str | None = None,
    absorption: float | str | None = None,
    threshold: float | None = None,
    coarse: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Proof:
    """Expose frames and judge the dose by a target; whole arrays stay on the device of ``A``.

    The dose does not come from ``A``. Independent rays, which turn while a frame is lit, expose finer voxels out to the
    inner wall (see `IndependentExposure`); the dose of a part voxel is the mean of its fine voxels. These voxels are
    refined until the dose changes by less than 1e-3. Resin above and below the grid is exposed as far as light reaches.
    The proof also has the scores that ``A`` predicts, as ``claimed``. In a resin that scatters, photons other than
    those of ``A`` add the light that rays lose; with oxygen, the proof's own steps of diffusion and reaction on finer
    voxels give the effective dose. Other operators have no independent rays and judge themselves on their
    own grid; the proof then states this and is never all correct.

    Args:
        A: the operator that the frames were solved with; for one on rings, its ``direct``.
        frames: e.g. `Frames`; only their bytes and gray curve are read.
        target: a `Target`, or fractions [x, y, z] as a NumPy or device array.
        irradiance: irradiance of a full-on pixel in air [mW/mm²], or text with its unit, "65 mW/cm2"; with
            ``critical_dose``, times are predicted.
        critical_dose: least dose that makes resin solid [mJ/mm³], or text with its unit, "50 mJ/cm3".
        absorption: absorption of the resin [1/mm], needed for times if ``A`` absorbs no light; a number or text.
        threshold: least dose of a printed voxel, in units of Aᵀ(light); by default the one with the best overlap.
        coarse: use the dose of ``A`` itself, which is faster: on voxels of at most three quarters of a pixel, and
            beyond the grid in cells of two voxels. Nothing is proved.
        progress: a function that gets the share of the rays that are done.

    Returns:
        The proof: dose, scores, and predicted scores.

    Raises:
        BadInput: a value is out of its range, or the exposure is longer than a day.
        NoLight: the frames are dark, or their light misses the part.
        EmptyMesh: no voxel in the judged cylinder belongs to the target.
        ShapeMismatch: frames or target of another geometry.
        DeviceError: an array of another device.

    Warns:
        OpticsWarning: part of the target is beyond the judged cylinder, or irradiance or critical dose is too large
            to be in these units.
    """
    A = cast("Projection", direct(A))  # or an operator with its attributes
    if (irradiance is None) != (critical_dose is None):
        given, missing = ("irradiance", "critical_dose") if critical_dose is None else ("critical_dose", "irradiance")
        raise BadInput(f"got {given} without {missing}; give both for predicted times, or neither")
    if threshold is not None:
        threshold = positive("threshold", threshold)
    fraction = on_device(A, target)
    check_cylinder(fraction, A.grid)
    light = _light(A, frames)
    own, limits = A.T(light), getattr(target, "limits", None)
    check_dose(light, Parts(own, fraction))
    held, claimed = _scored(own, fraction, limits, threshold)
    if coarse and (finer := _as_fine_as_light(A, target)) is not None:
        volume = A.grid.voxel_volume
        A, target = finer
        threshold = claimed.threshold * A.grid.voxel_volume / volume  # for the exposure of the part's own voxels
        fraction, own = on_device(A, target), A.T(light)
        held, claimed = _scored(own, fraction, limits, threshold)
    judge = _Itself(A, own) if coarse or (rays := exposure_of(A)) is None else rays.agreed(light)
    pixel = IndependentExposure(A).column if is_traced(A) else A.grid.pitch
    dose, outer = judge.averaged(light, progress, Around(fraction.numpy(), A.grid, pixel))
    shone = Dwell(A.motion, A.beam, A.device).sent(light)
    held, scores = (held, claimed) if dose is own else _scored(dose, fraction, limits, threshold)
    plain = scores if limits is None else score(dose, held.target, threshold=scores.threshold * limits.void)
    sent = light_sent(shone)
    given: Any = {"irradiance": irradiance, "critical_dose": critical_dose, "absorption": absorption}
    times = None if irradiance is None else expose(A, plain, sent, frames.scale, **given)
    if times is not None and isinstance(A, OxygenModel):
        times = through_turns(times, A, plain, A.gel_times(light, scores.threshold), fraction.numpy() >= 0.5)
    return Proof(
        operator=A, frames=frames, name=getattr(target, "name", None) or "target", target=fraction, dose=dose,
        scores=scores, slices=score_slices(held.dose, held.target, scores), claimed=claimed, outer=outer,
        independent=isinstance(judge, IndependentExposure), width=judge.pitch, agrees=judge.agrees,
        solid=getattr(target, "solid", None), limits=limits,
        light_efficiency=plain.total_in / sent if sent > 0 else 0.0,
        mean_brightness=mean_brightness(shone, frames.scale), exposure=times,
    )  # fmt: skip


def _scored(
    dose: DeviceArray, fraction: DeviceArray, limits: Limits | None, threshold: float | None
) -> tuple[Parts, Scores]:
    """The judged parts of a dose, and its scores."""
    held = judged_parts(dose, fraction, limits)
    return held, score(held.dose, held.target, threshold=threshold)


def _as_fine_as_light(A: Any, target: Any) -> tuple[Projection, Target] | None:
    """A projector on the voxels of the optimization, and the target on them; None if they are the part's own voxels."""
    grid = fine_grid(A)
    if grid is None or grid.pitch >= A.grid.pitch or getattr(target, "limits", None) is not None:
        return None
    part = target if isinstance(target, Target) else Target.from_array(on_device(A, target).numpy(), A.grid.pitch)
    fraction = part.resampled(grid, device=A.device).numpy()
    fine = replace(Target.from_array(fraction, grid.pitch, part.name), solid=part.solid)
    return Projection(grid, A.beam, A.motion, A.vessel, A.device), fine


def _light(A: Projection, frames: ShownLight) -> DeviceArray:
    """The light of frames for the angles of a projection."""
    if not hasattr(frames, "irradiance"):
        raise BadInput(f"got a {type(frames).__name__} as frames; expected what pack(plan) returns")
    light = frames.irradiance(A.device)
    require(A.range, light, "the frames' light")
    motion = getattr(frames, "motion", None)
    if motion is not None and getattr(motion, "stepped", motion) != getattr(A.motion, "stepped", A.motion):
        raise BadInput(f"the frames are for {motion!r}, but the projection has {A.motion!r}; expected the same "
                       "angles: simulate with the turntable for which the frames were packed")  # fmt: skip
    return light


@dataclass(frozen=True)
class _Itself:
    """An operator that judges its own light, without independent rays."""

    operator: Any
    dose: DeviceArray
    agrees: float | None = None

    @property
    def pitch(self) -> float:
        """Width of the voxels of the dose [mm]."""
        return self.operator.grid.pitch

    def averaged(
        self,
        light: DeviceArray,
        progress: Callable[[float], None],
        part: Around,  # noqa: ARG002
    ) -> tuple[DeviceArray, Outer | None]:
        """The operator's own dose, and the greatest dose beyond the judged cylinder."""
        # The cells contain all resin that a projector lights. For other operators, the dose beyond the grid is unknown.
        dose, grid = self.dose, self.operator.grid
        if not isinstance(self.operator, Projection):
            return dose, greatest_beyond(grid, corner_of(grid), dose, grid.axes(), grid.pitch, around=part)
        found = [_greatest(each, each.T(light).numpy(), part) for each in outer_resin(self.operator)]
        return dose, max(found, key=lambda one: one.dose, default=None)


def _greatest(outer: OuterResin, dose: np.ndarray, part: Around) -> Outer:
    """The brightest cell [angle, cell, z] that is not around a part."""
    cells, counted = outer.cells, np.ones(dose.shape, bool)
    radius, angle = np.broadcast_arrays(*cells.places)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    part.leave_out(counted, x, y, cells.z)
    dose = np.where(counted, dose, 0.0)
    at = np.unravel_index(int(np.argmax(dose)), dose.shape)
    place = (float(x[at[:2]]), float(y[at[:2]]), float(cells.z[at[2]]))
    return Outer(float(dose[at]), place, cells.pitch, cells.inner + cells.rings * cells.pitch)
