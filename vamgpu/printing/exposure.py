"""Exposure times of prints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np

from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.geometry import positive
from vamgpu.metrics import Scores
from vamgpu.operators.dose_unit import dose_unit
from vamgpu.operators.projection import Projection
from vamgpu.quantity import counted
from vamgpu.schema.quantities import Dose, Irradiance, measured
from vamgpu.travel import Travel
from vamgpu.units import mJ_cm3, mW_cm2

USUAL = 40.0  # default speed of a vial [deg/s]


@dataclass(frozen=True)
class ExposureTimes:
    """Predicted times [s] for a projector and a resin that sums all dose."""

    # overcure_onset: until the first voxel outside is solid; later than ``complete`` if the strict window is positive.

    irradiance: float  # of a full-on pixel in air [mW/mm²]
    critical_dose: float  # least dose that makes resin solid [mJ/mm³]
    seconds: float  # until resin at the threshold gets the critical dose, when the light should go off
    complete: float | None  # until the last voxel of the part is solid; None if voxels are lit in turns of their own
    overcure_onset: float | None
    energy: float  # light sent until ``seconds`` [mJ]
    period: float | None = None  # time of a turn [s] of a print whose turns are fixed
    lamp: float | None = None  # irradiance of the given lamp [mW/mm²], if the turns of a path need another
    enough_turns: int = 0  # if the given lamp is too dim for the turns of a path: the least number that it needs

    @property
    def turning(self) -> str:
        """The turns of the exposure, in words: those that are fixed, else those at the default speed."""
        if self.period is not None:
            return f"{counted(round(self.seconds / self.period), 'turn')} of {self.period:.4g} s"
        return f"{counted(self.seconds * USUAL / 360.0, 'turn', '.3g')} at {USUAL:g} deg/s"

    def along(self, travel: Travel) -> ExposureTimes:
        """The same dose in the turns of a path: with the irradiance that they need, or in the time that they take."""
        seconds = self.seconds if travel.period is None else travel.turns * travel.period
        longer, even = seconds / self.seconds, travel.follow and travel.rows is None
        enough = ceil(travel.turns / longer - 1e-9)
        ends = [longer * each if even and each is not None else None for each in (self.complete, self.overcure_onset)]
        return replace(self, irradiance=self.irradiance / longer, seconds=seconds, period=seconds / travel.turns,
                       lamp=self.irradiance, complete=ends[0], overcure_onset=ends[1],
                       enough_turns=enough if enough > travel.turns else 0)  # fmt: skip

    @property
    def given(self) -> str:
        """Irradiance and critical dose in usual units."""
        return f"{self.irradiance / mW_cm2:g} mW/cm² full-on and {self.critical_dose / mJ_cm3:g} mJ/cm³"


def through_turns(found: ExposureTimes, A: OxygenModel, scores: Scores, gel_times: np.ndarray, part: np.ndarray,
                  ) -> ExposureTimes:  # fmt: skip
    """Times of a print whose turns are fixed, with the irradiance that they need; ``part``: booleans [x, y, z]."""
    # Without diffusion, an effective dose of 1 is the critical dose.
    seconds, judged = A.oxygen.seconds, np.broadcast_to(A.grid.cylinder()[:, :, None], part.shape)
    lamp = found.irradiance * found.seconds * scores.threshold / seconds
    complete, onset = gel_times[part & judged].max(initial=0.0), gel_times[~part & judged].min(initial=inf)
    return replace(found, irradiance=lamp, seconds=seconds, complete=float(complete), overcure_onset=float(onset),
                   energy=found.energy * scores.threshold, period=A.period)  # fmt: skip


UNITS = {"irradiance": (Irradiance, "mW_cm2", mW_cm2, "mW/mm²"), "critical_dose": (Dose, "mJ_cm3", mJ_cm3, "mJ/mm³")}
"""Kind, usual unit, its value in mW, mJ and mm, and the unit of plain numbers."""
DAY = 86_400.0  # longest exposure [s] that is accepted: tomographic prints take seconds to minutes
ODD = 10.0  # smallest mW/mm² and mJ/mm³ that suggest a wrong unit: 1 W/cm², 10 J/cm³


def expose(
    A: Projection,
    scores: Scores,
    sent: float,
    full: float,
    *,
    irradiance: float | str,
    critical_dose: float | str,
    absorption: float | str | None = None,
) -> ExposureTimes:
    """Times of a print whose angles share the exposure, evenly or by their dwell, turn after turn."""
    # scores: of Aᵀ(light). sent: Σ light · (time of its angle / mean time). full: light of a full-on pixel. irradiance:
    # that pixel's [mW/mm²]. critical_dose: [mJ/mm³]; both also as text with units. absorption: as for `dose_unit`.
    irradiance, critical = _given("irradiance", irradiance), _given("critical_dose", critical_dose)
    unit = irradiance / positive("light of a full-on pixel", full)
    rate = dose_unit(A, 1.0 / A.motion.angles, unit=unit, absorption=absorption)
    if scores.threshold <= 0:
        raise BadInput("the frames send no light into the part; pack another plan")
    seconds = critical / (scores.threshold * rate)
    found = ExposureTimes(
        irradiance=irradiance,
        critical_dose=critical,
        seconds=seconds,
        complete=_until(critical, scores.least_in * rate),
        overcure_onset=_until(critical, scores.greatest_out * rate),
        energy=sent * unit * A.beam.pixel_area * seconds / A.motion.angles,
    )
    if seconds > DAY:
        raise BadInput(
            f"the exposure would take {seconds:.3g} s, {seconds / DAY:.3g} days, at {found.given}; expected at most a "
            'day: check both values and their units, or send the part more light (8-bit frames, or dither="fit")'
        )
    travel = getattr(A.motion, "travel", None)
    return found if travel is None else found.along(travel)


def _given(name: str, value: float | str) -> float:
    """``value`` as a number, or parsed from text with a unit. Raises `BadInput` with the value in the usual unit."""
    kind, unit, factor, own = UNITS[name]
    usual = unit.replace("_", "/")
    if isinstance(value, str):
        return measured(name, value, kind)
    try:
        number = positive(name, value)
    except BadInput as error:
        got = f"{value / factor:g} * {unit}" if isinstance(value, (int, float)) else repr(value)
        raise BadInput(f"{name} is {got}; expected a finite number > 0 times vamgpu.units.{unit}") from error
    if number >= ODD:
        warnings.warn(
            f"{name} is {number:g} without a unit: that is {number:g} {own}, or {number / factor:g} {usual}; "
            f'if {number:g} {usual} was meant, write {number:g} * vamgpu.units.{unit} or "{number:g} {usual}"',
            OpticsWarning,
            stacklevel=4,
        )
    return number


def _until(critical: float, rate: float) -> float:
    return critical / rate if rate > 0 else float("inf")
