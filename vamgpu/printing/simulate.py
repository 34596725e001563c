"""What a projector's frames would print, computed from nothing but the frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.methods.part import check_cylinder, on_device
from vamgpu.metrics import light_efficiency, score, score_slices
from vamgpu.metrics.light import light_sent
from vamgpu.metrics.parts import Parts
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection, direct
from vamgpu.operators.space import require
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.dark import check_dose
from vamgpu.printing.exposure import expose
from vamgpu.printing.independent import IndependentExposure
from vamgpu.printing.outer import Outer, corner_of, greatest_beyond
from vamgpu.printing.proof import Proof


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
    absorption: float | None = None,
    threshold: float | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Proof:
    """Expose frames and judge the dose by a target; whole arrays stay on the device of ``A``.

    The dose is not ``A``'s: frames shine on voxels half as wide, shifted by a quarter, out to the inner wall, along
    rays that are traced for it (see `IndependentExposure`), and the part's voxels take the mean. Resin above and below
    the grid is exposed as far as there is light. What ``A`` itself would say is kept beside it, as claimed. Operators
    other than `Projection` have no such rays and are judged by themselves on their own grid; the proof then says so,
    and its voxels never count as all correct.

    Args:
        A: what the frames were solved with; of one on rings, ``direct`` is asked.
        frames: e.g. `Frames`; only their bytes and gray curve are read.
        target: a `Target`, or fractions [x, y, z] as a NumPy or device array.
        irradiance: of a full-on pixel in air [mW/mm²], or text with its unit, "65 mW/cm2"; with ``critical_dose``
            times are predicted.
        critical_dose: from which resin is solid [mJ/mm³], or text with its unit, "50 mJ/cm3".
        absorption: of the resin [1/mm], needed for the times where ``A`` absorbs no light.
        threshold: dose in units of Aᵀ(light) from which a voxel counts as printed; by default the one with the best
            overlap.
        progress: is told the share of the rays' work that is done.

    Returns:
        The proof: dose, scores, and what is claimed.

    Raises:
        BadInput: a value out of its range.
        NoLight: the frames are dark, or their light misses the part.
        EmptyMesh: no voxel in the judged cylinder belongs to the target.
        ShapeMismatch: frames or target of another geometry.
        DeviceError: an array of another device.

    Warns:
        OpticsWarning: some of the target lies beyond the judged cylinder, or irradiance or critical dose is a number so
            great that it was hardly meant in these units.
    """
    A = direct(A)
    _both_or_neither(irradiance, critical_dose)
    if threshold is not None:
        threshold = positive("threshold", threshold)
    fraction = on_device(A, target)
    check_cylinder(fraction, A.grid)
    if not hasattr(frames, "irradiance"):
        raise BadInput(f"got a {type(frames).__name__} as frames; expected what pack(plan) returns")
    light = frames.irradiance(A.device)
    require(A.range, light, "the frames' light")
    _same_poses(A, frames)
    own, limits = A.T(light), getattr(target, "limits", None)
    check_dose(light, Parts(own, fraction))
    held = judged_parts(own, fraction, limits)
    claimed = score(held.dose, held.target, threshold=threshold)
    judge = IndependentExposure(A) if isinstance(A, Projection) else _Itself(A)
    dose, outer = judge.averaged(light, progress)
    shone = Dwell(A.motion, A.device).weighted(light)
    held = judged_parts(dose, fraction, limits)
    scores = score(held.dose, held.target, threshold=threshold)
    plain = scores if limits is None else score(dose, held.target, threshold=scores.threshold * limits.void)
    sent = light_sent(shone)
    given = {"irradiance": irradiance, "critical_dose": critical_dose, "absorption": absorption}
    return Proof(
        operator=A,
        frames=frames,
        name=getattr(target, "name", None) or "target",
        target=fraction,
        dose=dose,
        scores=scores,
        slices=score_slices(held.dose, held.target, scores),
        claimed=claimed,
        outer=outer,
        independent=isinstance(judge, IndependentExposure),
        solid=getattr(target, "solid", None),
        limits=limits,
        light_efficiency=light_efficiency(shone, frames.scale),
        part_share=plain.total_in / sent if sent > 0 else 0.0,
        exposure=None if irradiance is None else expose(A, plain, sent, frames.scale, **given),  # type: ignore[arg-type]
    )


def _same_poses(A: Projection, frames: ShownLight) -> None:
    motion = getattr(frames, "motion", None)
    if motion is not None and motion != A.motion:
        raise BadInput(f"the frames are for {motion!r}, the projection has {A.motion!r}; expected the same angles: "
                       "simulate with the turntable that the frames were packed for")  # fmt: skip


@dataclass(frozen=True)
class _Itself:
    """An operator that judges its own light, for want of rays to trace."""

    operator: Any

    def averaged(self, light: DeviceArray, progress: Callable[[float], None]) -> tuple[DeviceArray, Outer | None]:  # noqa: ARG002
        """Its own dose, and the greatest beyond the judged cylinder of its grid; nothing about what is farther."""
        dose, grid = self.operator.T(light), self.operator.grid
        return dose, greatest_beyond(grid, corner_of(grid), dose, grid.axes(), grid.pitch)


def _both_or_neither(irradiance: float | str | None, critical_dose: float | str | None) -> None:
    if (irradiance is None) != (critical_dose is None):
        given, missing = ("irradiance", "critical_dose") if critical_dose is None else ("critical_dose", "irradiance")
        raise BadInput(f"got {given} without {missing}; give both for predicted times, or neither")
