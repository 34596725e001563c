"""Dose of bit planes: a projector shows the bits of a frame one after the other while the container turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import PlaneTime, Turntable
from vamgpu.metrics import score
from vamgpu.operators.projection import Projection
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.reports.line import Line

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof


@dataclass(frozen=True)
class PlaneDose:
    """The print by bit planes, each at the angles at which it is lit."""

    window: float  # the strict one
    off: float  # greatest difference from the dose of frames that are lit evenly, over the peak

    def line(self) -> Line:
        """The window as a line of a proof."""
        how = "each plane of the frames at the angles at which the rig shows it"
        return Line(
            "window, bit planes", f"{self.window:+.4f}", f"{how}; dose differs by up to {self.off:.2g} of the peak"
        )


@dataclass(frozen=True)
class _Lit:
    """The arcs of all planes: place, length and time of each, as a `Turntable` has them."""

    poses: np.ndarray
    arcs: np.ndarray
    times: np.ndarray

    @property
    def angles(self) -> int:
        return len(self.poses)


def prove_planes(proof: Proof, planes: Sequence[PlaneTime]) -> PlaneDose:
    """Expose the frames of a proof again, plane by plane."""
    A, frames = proof.operator, proof.frames
    if not isinstance(A, Projection) or not isinstance(frames, Frames) or frames.bits != 8:
        raise BadInput(f"got a proof of {frames!r} by {type(A).__name__}; expected packed frames of 8 bits for a "
                       "Projection: frames of one bit have a single plane, as in the proof")  # fmt: skip
    if {plane.bit for plane in planes} != set(range(8)) or min(plane.width for plane in planes) <= 0.0:
        raise BadInput(f"got planes {[(plane.bit, plane.width) for plane in planes]}; expected each of the bits 0 to "
                       "7, lit for longer than 0")  # fmt: skip
    light = A.device.upload(_light(frames, A, planes))
    finer = None if proof.width is None else round(proof.operator.grid.pitch / proof.width)
    judge = IndependentExposure(A, motion=_arcs(A.motion, planes), finer=finer)
    dose = A.device.empty(A.grid.shape)
    for _ in judge.onto(light, dose):
        pass
    held = judged_parts(dose, proof.target, proof.limits)
    scores = score(held.dose, held.target, threshold=proof.scores.threshold)
    off = np.abs(dose.numpy() - proof.dose.numpy())[A.grid.cylinder()].max() / (proof.scores.peak or 1.0)
    return PlaneDose(scores.window, float(off))


def _arcs(motion: Turntable, planes: Sequence[PlaneTime]) -> Any:
    """The arcs of every plane of every frame, [plane, angle] in a row."""
    steps = motion.steps
    at = np.concatenate([motion.poses + steps * (plane.begin + 0.5 * plane.width) for plane in planes])
    return _Lit(at, np.concatenate([steps * plane.width for plane in planes]), np.tile(motion.times, len(planes)))


def _light(frames: Frames, A: Projection, planes: Sequence[PlaneTime]) -> np.ndarray:
    """Light [plane and angle, r, z] of every plane: the share of the frame's light that this bit contributes."""
    whole, levels = frames.irradiance(A.device).numpy(), frames.images.numpy()
    parts: dict[int, np.ndarray] = {}
    for bit in range(8):
        some = A.device.upload(levels & np.uint8(1 << bit), table=True)
        parts[bit] = replace(frames, images=some, gray=GrayCurve.linear(), packed=None).irradiance(A.device).numpy()
    total = np.sum(list(parts.values()), axis=0)
    share = np.divide(whole, total, out=np.zeros_like(whole), where=total > 0)
    dark = np.where(total > 0, 0.0, whole)  # mirrors never close completely
    time = {bit: sum(plane.width for plane in planes if plane.bit == bit) for bit in range(8)}
    every = sum(time.values())
    return np.concatenate([
        (parts[plane.bit] * share) * (plane.width / time[plane.bit]) + dark * (plane.width / every) for plane in planes
    ])  # fmt: skip
