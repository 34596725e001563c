"""A dose judged by the limits of single voxels, and the dose of every body of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Grid
from vamgpu.kernels.update import multiply
from vamgpu.metrics.parts import Parts
from vamgpu.reports.line import Line
from vamgpu.targets.limits import BodyRequirement, Limits

PRINTED = ("print", "gray")


@dataclass(frozen=True)
class BodyDose:
    """The dose of a body."""

    name: str
    role: str
    asked: str  # its required dose, in words
    voxels: int
    least: float
    mean: float
    greatest: float  # dose over the threshold of the print
    wrong: int  # voxels that get the wrong dose

    def __str__(self) -> str:
        dose = f"dose {self.least:.3f} … {self.mean:.3f} … {self.greatest:.3f} of the threshold"
        return f"{self.name} ({self.role}): {self.asked}; {dose}; {self.wrong:,} of {self.voxels:,} voxels wrong"

    def line(self) -> Line:
        """The dose as a row of a report."""
        value = f"{self.least:.3f} … {self.greatest:.3f}, {self.wrong:,} wrong"
        return Line(f"{self.role} {self.name!r}", value, f"{self.asked}; least and greatest dose / threshold")


def judged_parts(dose: DeviceArray, fraction: DeviceArray, limits: Limits | None) -> Parts:
    """A dose relative to the limits of its voxels, and the classes of the voxels: the input of scores."""
    # dose [x, y, z]; fraction [x, y, z]
    if limits is None:
        return Parts(dose, fraction)
    scaled = dose.device.upload(limits.scale)
    dose.device.launch(multiply, x=dose, y=scaled, out=scaled)
    return Parts(scaled, dose.device.upload(limits.classes(fraction.numpy())))


def body_doses(
    dose: np.ndarray, fraction: np.ndarray, limits: Limits, threshold: float, grid: Grid
) -> tuple[BodyDose, ...]:
    """The doses of all bodies with requirements."""
    # dose [x, y, z]; fraction [x, y, z]
    judged = limits.judged & grid.cylinder()[:, :, None]
    inside = fraction >= 0.5
    doses = {k: dose[judged & (limits.body == k)] / (threshold or 1.0) for k in range(len(limits.bodies))}
    made = [doses[k] / body.dose for k, body in enumerate(limits.bodies) if body.role in PRINTED]
    plain = dose[judged & inside & (limits.dose == 1.0)] / (threshold or 1.0)
    usual = float(plain.mean() if plain.size else np.concatenate(made).mean())
    found = []
    for k, body in enumerate(limits.bodies):
        if doses[k].size:
            wrong, asked = _judged(body, doses[k], usual)
            least, mean, greatest = (float(end(doses[k])) for end in (np.min, np.mean, np.max))
            found.append(BodyDose(body.name, body.role, asked, doses[k].size, least, mean, greatest, wrong))
    return tuple(found)


def _judged(body: BodyRequirement, dose: np.ndarray, usual: float) -> tuple[int, str]:
    """Number of wrong voxels, and the required dose in words; dose: over the threshold.  usual: mean printed dose."""
    if body.role == "print":
        return int((dose < 1.0).sum()), "at least the threshold"
    if body.role == "keep out":
        return int((dose >= body.dose).sum()), f"below {body.dose:g} of the threshold"
    middle = body.dose * usual
    wrong = (np.abs(dose - middle) > body.tolerance * middle) | (dose < body.dose)
    return int(wrong.sum()), f"{body.dose:g} of the part's mean dose, within {100 * body.tolerance:g} %"
