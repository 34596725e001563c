"""How long a print takes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

from vamgpu.deprecated import Renamed
from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.geometry import positive
from vamgpu.metrics import Scores
from vamgpu.operators.projection import Projection
from vamgpu.printing.dose import dose_unit
from vamgpu.quantity import parse
from vamgpu.units import mJ_cm3, mW_cm2


@dataclass(frozen=True)
class ExposureTimes:
    """Predicted times [s] for a projector and a resin that never forgets a dose.

    irradiance: of a full-on pixel in air [mW/mm²].  critical_dose: from which resin is solid [mJ/mm³].  seconds: until
    the threshold of the scores reaches the critical dose, when the light should go out.  complete: until the last voxel
    of the part is solid.  overcure_onset: until the first voxel out of it is; later than ``complete`` where the strict
    window is positive.  energy: light sent until ``seconds`` [mJ].
    """

    irradiance: float
    critical_dose: float
    seconds: float
    complete: float
    overcure_onset: float
    energy: float
    spill: ClassVar[Renamed] = Renamed("overcure_onset")

    @property
    def given(self) -> str:
        """Irradiance and critical dose as laboratories write them."""
        return f"{self.irradiance / mW_cm2:g} mW/cm² full-on and {self.critical_dose / mJ_cm3:g} mJ/cm³"


UNITS = {
    "irradiance": ("an irradiance", "mW_cm2", mW_cm2, "mW/mm²"),
    "critical_dose": ("a dose", "mJ_cm3", mJ_cm3, "mJ/mm³"),
}
"""What each is, its usual unit and that in mW, mJ and mm, and the unit of numbers without any."""
ODD = 10.0
"""mW/mm² and mJ/mm³ from which on a number was hardly meant so: 1 W/cm², 10 J/cm³."""


def expose(
    A: Projection,
    scores: Scores,
    sent: float,
    full: float,
    *,
    irradiance: float | str,
    critical_dose: float | str,
    absorption: float | None = None,
) -> ExposureTimes:
    """Times of a print whose angles share the exposure, evenly or by their dwell, turn after turn.

    scores: of Aᵀ(light).  sent: Σ light · time of its angle over the mean.  full: light of a full-on pixel.
    irradiance: that pixel's [mW/mm²].  critical_dose: [mJ/mm³]; both also as text with units.  absorption: as for
    `absorbed_dose`. Raises `BadInput`.
    """
    irradiance, wanted = _given("irradiance", irradiance), _given("critical_dose", critical_dose)
    unit = irradiance / positive("light of a full-on pixel", full)
    rate = dose_unit(A, 1.0 / A.motion.angles, unit=unit, absorption=absorption)
    if scores.threshold <= 0:
        raise BadInput("the frames send no light into the part; pack a plan that does")
    seconds = wanted / (scores.threshold * rate)
    return ExposureTimes(
        irradiance=irradiance,
        critical_dose=wanted,
        seconds=seconds,
        complete=_until(wanted, scores.least_in * rate),
        overcure_onset=_until(wanted, scores.greatest_out * rate),
        energy=sent * unit * A.beam.pixel_area * seconds / A.motion.angles,
    )


def _given(name: str, value: float | str) -> float:
    """``value``, or what text with its unit says; else `BadInput` that tells it in the unit that laboratories use.

    Warns:
        OpticsWarning: a number so great that it was hardly meant in mW/mm² or mJ/mm³.
    """
    kind, unit, factor, own = UNITS[name]
    usual = unit.replace("_", "/")
    if isinstance(value, str):
        try:
            return parse(value, kind)
        except ValueError as error:
            raise BadInput(f"{name}: got {value!r}; {error}") from error
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


def _until(wanted: float, rate: float) -> float:
    return wanted / rate if rate > 0 else float("inf")
