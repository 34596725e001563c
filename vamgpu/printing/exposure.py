"""How long a print takes."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.metrics import Scores
from vamgpu.operators.projection import Projection
from vamgpu.printing.dose import dose_unit
from vamgpu.units import mJ_cm3, mW_cm2


@dataclass(frozen=True)
class Exposure:
    """Predicted times [s] for a projector and a resin that never forgets a dose.

    irradiance: of a full-on pixel in air [mW/mm²].  critical_dose: from which resin is solid [mJ/mm³].  seconds: until
    the threshold of the scores reaches the critical dose, when the light should go out.  complete: until the last voxel
    of the part is solid.  spill: until the first voxel out of it is; later than ``complete`` where the strict window is
    positive.  energy: light sent until ``seconds`` [mJ].
    """

    irradiance: float
    critical_dose: float
    seconds: float
    complete: float
    spill: float
    energy: float

    @property
    def given(self) -> str:
        """Irradiance and critical dose as laboratories write them."""
        return f"{self.irradiance / mW_cm2:g} mW/cm² full-on and {self.critical_dose / mJ_cm3:g} mJ/cm³"


def expose(
    A: Projection, scores: Scores, sent: float, full: float, *, irradiance: float, critical_dose: float,
    absorption: float | None = None,
) -> Exposure:
    """Times of a print whose poses share the exposure, evenly or by their dwell, turn after turn.

    scores: of Aᵀ(light).  sent: Σ light · time of its pose over the mean.  full: light of a full-on pixel.
    irradiance: that pixel's [mW/mm²].  critical_dose: [mJ/mm³].  absorption: as for `absorbed_dose`. Raises `BadInput`.
    """
    unit = _given("irradiance", irradiance, "mW_cm2", mW_cm2) / positive("light of a full-on pixel", full)
    wanted = _given("critical_dose", critical_dose, "mJ_cm3", mJ_cm3)
    rate = dose_unit(A, 1.0 / A.motion.angles, unit=unit, absorption=absorption)
    if scores.threshold <= 0:
        raise BadInput("the frames send no light into the part; pack a plan that does")
    seconds = wanted / (scores.threshold * rate)
    return Exposure(
        irradiance=irradiance,
        critical_dose=critical_dose,
        seconds=seconds,
        complete=_until(wanted, scores.least_in * rate),
        spill=_until(wanted, scores.greatest_out * rate),
        energy=sent * unit * A.beam.pixel_area * seconds / A.motion.angles,
    )


def _given(name: str, value: float, unit: str, factor: float) -> float:
    """``value`` if it can be used; else `BadInput` that tells it in the unit that laboratories use."""
    try:
        return positive(name, value)
    except BadInput as error:
        got = f"{value / factor:g} * {unit}" if isinstance(value, (int, float)) else repr(value)
        raise BadInput(f"{name} is {got}; expected a finite number > 0 times vamgpu.units.{unit}") from error


def _until(wanted: float, rate: float) -> float:
    return wanted / rate if rate > 0 else float("inf")
