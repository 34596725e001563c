"""Limit of the brightness of pixels that allows a print to finish in time."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.operators.dose_unit import dose_unit
from vamgpu.operators.reductions import extent
from vamgpu.quantity import counted
from vamgpu.schema.quantities import Absorption, Dose, ExposureTime, Irradiance, measured

MARGIN = 0.99  # share of the allowed brightness that steps use, because the threshold moves until the run ends


@dataclass(frozen=True)
class ExposureLimit:
    """Time limit of a print: of the brightest pixel over the dose midway between part and void. Raises `BadInput`."""

    seconds: float  # longest exposure [s]
    irradiance: float  # irradiance of a full-on pixel in air [mW/mm²]
    critical_dose: float  # least dose that makes resin solid [mJ/mm³]
    absorption: float | None = None  # absorption of the resin [1/mm], if the operator absorbs no light

    @classmethod
    def of(
        cls, exposure_limit: Any, irradiance: Any, critical_dose: Any, absorption: Any = None
    ) -> ExposureLimit | None:
        """Make a limit from numbers in s, mW, mJ and mm, or text with units, or None. Raises `BadInput`."""
        if exposure_limit is None:
            if irradiance is not None or critical_dose is not None:
                raise BadInput(
                    "got an irradiance or a critical dose without exposure_limit; leave them out, or give the "
                    "longest exposure"
                )
            return None
        if irradiance is None or critical_dose is None:
            lacking = "irradiance" if irradiance is None else "critical_dose"
            raise BadInput(
                f"got an exposure_limit without {lacking}; time depends on lamp and resin: give both irradiance and "
                "critical_dose"
            )
        return cls(
            measured("exposure_limit", exposure_limit, ExposureTime),
            measured("irradiance", irradiance, Irradiance),
            measured("critical_dose", critical_dose, Dose),
            None if absorption is None else measured("absorption", absorption, Absorption),
        )

    def brightness(self, operator: Any) -> float:
        """Greatest light of a pixel divided by the dose at the threshold, in 1/mm. Raises `BadInput`."""
        return self.seconds / self._time(operator)

    def seconds_of(self, operator: Any, light: DeviceArray, threshold: float) -> float:
        """Time [s] after which the dose ``threshold`` of light [angle, r, z] is solid; infinite for a dose of 0."""
        return self._time(operator) * extent(light)[1] / threshold if threshold > 0.0 else inf

    def check(self, operator: Any, even: float) -> None:
        """Reject a time that is too short for full-on pixels; light of 1 gives the part a dose of ``even``."""
        least = self._time(operator) / even if even > 0.0 else inf
        if least > self.seconds:
            raise BadInput(
                f"the exposure limit of {self.seconds:.4g} s is too short: with all pixels full-on at "
                f"{self.irradiance:g} mW/mm² the darkest voxel of the part takes {least:.4g} s to "
                f"{self.critical_dose:g} mJ/mm³; expected more time, a brighter lamp, or a resin of a lower critical "
                "dose"
            )

    def check_turns(self, turns: int, least: float) -> None:
        """Reject turns in which full-on pixels give the darkest voxel of the part an effective dose below 1."""
        if least < 1.0:
            raise BadInput(
                f"with all pixels full-on at {self.irradiance:g} mW/mm², the darkest voxel of the part gets an "
                f"effective dose of {least:.3g} in {counted(turns, 'turn')}; expected 1 or more: use more turns, a "
                "brighter lamp, or a resin of a lower critical dose"
            )

    def _time(self, operator: Any) -> float:
        """Time [s] for light whose brightest pixel, divided by the dose at the threshold, is 1 [1/mm]."""
        known = all(hasattr(operator, name) for name in ("beam", "grid", "motion"))
        if not known or not hasattr(operator.motion, "angles"):
            raise BadInput(
                f"got exposure_limit with {operator!r}; expected a projection, whose turns and pixels determine times"
            )
        share = 1.0 / operator.motion.angles
        return self.critical_dose / dose_unit(operator, share, unit=self.irradiance, absorption=self.absorption)
