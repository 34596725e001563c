"""Simulation of a print from nothing but the projector's frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
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
from vamgpu.operators.space import require
from vamgpu.optics.outer_resin import OuterResin, outer_resin
from vamgpu.printing.beyond_cylinder import Around, Outer, corner_of, greatest_beyond
from vamgpu.printing.black_level import check_dose
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.exposure import expose
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.proof import Proof
from vamgpu.targets.limits import Limits
from vamgpu.targets.target import Target


class ShownLight(Protocol):
    """Frames as the simulation sees them: bytes and gray curve turned into light."""

    @property
    def scale(self) -> float:
        """Light of a full-on pixel."""
        ...

    def irradiance(self, device: Device) -> DeviceArray:
        """Light of every pixel, field [angle, r, z] on a device."""
        ...


def simulate(
    A: Projection | RingProjection,
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

    The dose is not ``A``'s: frames shine on finer voxels, out to the inner wall, along rays that are traced for it and
    that turn while a frame is lit (see `IndependentExposure`), and the part's voxels take the mean. The finer voxels
    get finer until the dose agrees with itself to 1e-3. Resin above and below the grid is exposed as far
    as there is light. What ``A`` itself would say is kept beside it, as claimed. Operators other than `Projection` have
    no such rays and are judged by themselves on their own grid; the proof then says so, and its voxels never count as
    all correct.

    Args:
        A: what the frames were solved with; of one on rings, ``direct`` is asked.
        frames: e.g. `Frames`; only their bytes and gray curve are read.
        target: a `Target`, or fractions [x, y, z] as a NumPy or device array.
        irradiance: of a full-on pixel in air [mW/mm²], or text with its unit, "65 mW/cm2"; with ``critical_dose``
            times are predicted.
        critical_dose: from which resin is solid [mJ/mm³], or text with its unit, "50 mJ/cm3".
        absorption: of the resin [1/mm], needed for the times where ``A`` absorbs no light; a number or text.
        threshold: dose in units of Aᵀ(light) from which a voxel counts as printed; by default the one with the best
            overlap.
        coarse: the dose is that of ``A`` itself, sooner, on voxels three quarters of a pixel wide where the target's
            are wider, and of resin beyond the grid in cells of two voxels; nothing is proved.
        progress: is told the share of the rays' work that is done.

    Returns:
        The proof: dose, scores, and what is claimed.

    Raises:
        BadInput: a value out of its range; or an exposure of more than a day.
        NoLight: the frames are dark, or their light misses the part.
        EmptyMesh: no voxel in the judged cylinder belongs to the target.
        ShapeMismatch: frames or target of another geometry.
        DeviceError: an array of another device.

    Warns:
        OpticsWarning: some of the target lies beyond the judged cylinder, or irradiance or critical dose is a number so
            great that it was hardly meant in these units.
    """
    A = direct(A)
    assert not isinstance(A, RingProjection)
    _both_or_neither(irradiance, critical_dose)
    if threshold is not None:
        threshold = positive("threshold", threshold)
    fraction = on_device(A, target)
    check_cylinder(fraction, A.grid)
    light = _light(A, frames)
    own, limits = A.T(light), getattr(target, "limits", None)
    check_dose(light, Parts(own, fraction))
    claimed = _scores(own, fraction, limits, threshold)
    if coarse and (finer := _as_fine_as_light(A, target)) is not None:
        volume = A.grid.voxel_volume
        A, target = finer
        threshold = claimed.threshold * A.grid.voxel_volume / volume  # the exposure is that of the part's own voxels
        fraction, own = on_device(A, target), A.T(light)
        claimed = _scores(own, fraction, limits, threshold)
    rays = isinstance(A, Projection) and not coarse
    judge = IndependentExposure(A).agreed(light) if rays else _Itself(A, own)
    traced = judge if isinstance(judge, IndependentExposure) else isinstance(A, Projection) and IndependentExposure(A)
    pixel = traced.column if traced else A.grid.pitch
    dose, outer = judge.averaged(light, progress, Around(fraction.numpy(), A.grid, pixel))
    shone = Dwell(A.motion, A.device).weighted(light)
    held = judged_parts(dose, fraction, limits)
    scores = claimed if dose is own else score(held.dose, held.target, threshold=threshold)
    plain = scores if limits is None else score(dose, held.target, threshold=scores.threshold * limits.void)
    sent = light_sent(shone)
    given = {"irradiance": irradiance, "critical_dose": critical_dose, "absorption": absorption}
    return Proof(
        operator=A, frames=frames, name=getattr(target, "name", None) or "target", target=fraction, dose=dose,
        scores=scores, slices=score_slices(held.dose, held.target, scores), claimed=claimed, outer=outer,
        independent=isinstance(judge, IndependentExposure), width=judge.pitch, agrees=judge.agrees,
        solid=getattr(target, "solid", None), limits=limits,
        light_efficiency=plain.total_in / sent if sent > 0 else 0.0,
        mean_brightness=mean_brightness(shone, frames.scale),
        exposure=None if irradiance is None else expose(A, plain, sent, frames.scale, **given),  # type: ignore[arg-type]
    )  # fmt: skip


def _scores(dose: DeviceArray, fraction: DeviceArray, limits: Limits | None, threshold: float | None) -> Scores:
    """The scores of a dose, of what is judged of it."""
    held = judged_parts(dose, fraction, limits)
    return score(held.dose, held.target, threshold=threshold)


def _as_fine_as_light(A: Any, target: Any) -> tuple[Projection, Target] | None:
    """A projector on the voxels that light is found on, and the target on them; None where they are the part's own."""
    grid = fine_grid(A)
    if grid is None or grid.pitch >= A.grid.pitch or getattr(target, "limits", None) is not None:
        return None
    part = target if isinstance(target, Target) else Target.from_array(on_device(A, target).numpy(), A.grid.pitch)
    fraction = part.resampled(grid, device=A.device).numpy()
    fine = replace(Target.from_array(fraction, grid.pitch, part.name), solid=part.solid)
    return Projection(grid, A.beam, A.motion, A.vessel, A.device), fine


def _light(A: Projection, frames: ShownLight) -> DeviceArray:
    """The light of frames that are for the angles of a projection."""
    if not hasattr(frames, "irradiance"):
        raise BadInput(f"got a {type(frames).__name__} as frames; expected what pack(plan) returns")
    light = frames.irradiance(A.device)
    require(A.range, light, "the frames' light")
    motion = getattr(frames, "motion", None)
    if motion is not None and getattr(motion, "stepped", motion) != getattr(A.motion, "stepped", A.motion):
        raise BadInput(f"the frames are for {motion!r}, the projection has {A.motion!r}; expected the same angles: "
                       "simulate with the turntable that the frames were packed for")  # fmt: skip
    return light


@dataclass(frozen=True)
class _Itself:
    """An operator that judges its own light, for want of rays to trace."""

    operator: Any
    dose: DeviceArray
    agrees: float | None = None

    @property
    def pitch(self) -> float:
        """Width of the voxels that the dose is found on [mm]."""
        return self.operator.grid.pitch

    def averaged(
        self,
        light: DeviceArray,
        progress: Callable[[float], None],
        part: Around,  # noqa: ARG002
    ) -> tuple[DeviceArray, Outer | None]:
        """Its own dose, and the greatest beyond the judged cylinder."""
        # All that the light of a projector reaches, in cells. Of other operators nothing is known beyond their grid.
        dose, grid = self.dose, self.operator.grid
        if not isinstance(self.operator, Projection):
            return dose, greatest_beyond(grid, corner_of(grid), dose, grid.axes(), grid.pitch, around=part)
        found = [_greatest(each, each.T(light).numpy(), part) for each in outer_resin(self.operator)]
        return dose, max(found, key=lambda one: one.dose, default=None)


def _greatest(outer: OuterResin, dose: np.ndarray, part: Around) -> Outer:
    """The brightest of cells [angle, cell, z] that are not around a part."""
    cells, counted = outer.cells, np.ones(dose.shape, bool)
    radius, angle = np.broadcast_arrays(*cells.places)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    part.leave_out(counted, x, y, cells.z)
    dose = np.where(counted, dose, 0.0)
    at = np.unravel_index(int(np.argmax(dose)), dose.shape)
    place = (float(x[at[:2]]), float(y[at[:2]]), float(cells.z[at[2]]))
    return Outer(float(dose[at]), place, cells.pitch, cells.inner + cells.rings * cells.pitch)


def _both_or_neither(irradiance: float | str | None, critical_dose: float | str | None) -> None:
    if (irradiance is None) != (critical_dose is None):
        given, missing = ("irradiance", "critical_dose") if critical_dose is None else ("critical_dose", "irradiance")
        raise BadInput(f"got {given} without {missing}; give both for predicted times, or neither")
