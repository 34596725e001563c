"""Exposure times of prints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.geometry import positive
from vamgpu.metrics import Scores
from vamgpu.operators.dose_unit import dose_unit
from vamgpu.operators.projection import Projection
from vamgpu.schema.quantities import Dose, Irradiance, measured
from vamgpu.units import mJ_cm3, mW_cm2

USUAL = 40.0
"""Default speed of a vial [deg/s]."""


@dataclass(frozen=True)
class ExposureTimes:
    """Predicted times [s] for a projector and a resin that sums all dose."""

    # overcure_onset: until the first voxel outside is solid; later than ``complete`` if the strict window is positive.

    irradiance: float  # of a full-on pixel in air [mW/mm²]
    critical_dose: float  # least dose that makes resin solid [mJ/mm³]
    seconds: float  # until resin at the threshold gets the critical dose, when the light should go off
    complete: float  # until the last voxel of the part is solid
    overcure_onset: float
    energy: float  # light sent until ``seconds`` [mJ]

    def turns(self, speed: float = USUAL) -> float:
        """Turns of a vial that the exposure takes."""
        # speed [deg/s]
        return self.seconds * speed / 360.0

    @property
    def given(self) -> str:
        """Irradiance and critical dose in usual units."""
        return f"{self.irradiance / mW_cm2:g} mW/cm² full-on and {self.critical_dose / mJ_cm3:g} mJ/cm³"


UNITS = {"irradiance": (Irradiance, "mW_cm2", mW_cm2, "mW/mm²"), "critical_dose": (Dose, "mJ_cm3", mJ_cm3, "mJ/mm³")}
"""Kind, usual unit, its value in mW, mJ and mm, and the unit of plain numbers."""
DAY = 86_400.0
"""Longest exposure [s] that is accepted: tomographic prints take seconds to minutes."""
ODD = 10.0
"""Smallest mW/mm² and mJ/mm³ that suggest a wrong unit: 1 W/cm², 10 J/cm³."""


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
    return found


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
