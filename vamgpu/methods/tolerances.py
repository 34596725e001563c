"""Tolerances of a machine and a resin, and the dose of patterns at all their corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import hypot, inf, sqrt
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.calibration.pointspread import PointSpread
from vamgpu.calibration.runout import Runout
from vamgpu.errors import BadInput, ToleranceError
from vamgpu.methods.part import LOST, fractions_of, limited, reach_of
from vamgpu.operators.compose import Composed, Sum
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import window
from vamgpu.operators.ring_projection import RingProjection, unsupported_reason
from vamgpu.operators.scattering_rings import ScatteringRings
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.shifts import Tiles, Wobbled
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.beams import Misaligned
from vamgpu.quantity import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Deviation, Quantity, Thickness

Judged = Literal["worst", "mean + spread"]
Widths = tuple[Thickness, Thickness]
QUARTERS = 4  # directions in which a vial may be off its axis


@dataclass(frozen=True)
class Corner:
    """One combination of extreme tolerances; all zero is nominal."""

    axis: float = 0.0  # displacement of the axis of rotation, towards +r [mm]
    spread: float | None = None  # standard deviation of the point spread [mm]; None for the beam's own
    absorption: float = 0.0  # relative increase of the resin's absorption
    index: float = 0.0  # increase of the resin's refractive index
    wobble: tuple[float, float] = (0.0, 0.0)  # displacement of the vial from its axis, along x and y [mm]
    dose: float = 0.0  # relative increase of every dose

    @property
    def optics(self) -> Corner:
        """The corner at its nominal dose."""
        return replace(self, dose=0.0)

    def __str__(self) -> str:
        named = {
            "axis": f"{1e3 * self.axis:+.4g} µm" if self.axis else "",
            "spread": "" if self.spread is None else f"{1e3 * self.spread:.4g} µm",
            "absorption": f"{100 * self.absorption:+.3g} %" if self.absorption else "",
            "index": f"{self.index:+.3g}" if self.index else "",
            "wobble": "{:+.4g} {:+.4g} µm".format(*(1e3 * part for part in self.wobble)) if any(self.wobble) else "",
            "dose": f"{100 * self.dose:+.3g} %" if self.dose else "",
        }
        return ", ".join(f"{name} {value}" for name, value in named.items() if value) or "nominal"


@dataclass(frozen=True)
class CornerDose:
    """Least dose inside, greatest outside and greatest anywhere of one light at a corner, in units of the light."""

    name: str
    least: float
    leak: float
    greatest: float

    @property
    def window(self) -> float:
        """Strict process window at only this corner, with its own threshold; −1 if it is dark."""
        return (self.least - max(self.leak, 0.0)) / self.greatest if self.greatest > 0.0 else -1.0


@dataclass(frozen=True)
class CornerDoses:
    """Doses of one light at every corner, the nominal one first."""

    corners: tuple[CornerDose, ...]

    @property
    def nominal(self) -> float:
        """Strict process window of the nominal print."""
        return self.corners[0].window

    @property
    def darkest(self) -> CornerDose:
        """The corner whose part has the least dose."""
        return min(self.corners, key=lambda corner: corner.least)

    @property
    def leakiest(self) -> CornerDose:
        """The corner whose voids have the greatest dose."""
        return max(self.corners, key=lambda corner: corner.leak)

    @property
    def window(self) -> float:
        """Strict process window with one threshold for all corners, a share of the greatest dose of any."""
        greatest = max(corner.greatest for corner in self.corners)
        return (self.darkest.least - max(self.leakiest.leak, 0.0)) / greatest if greatest > 0.0 else -1.0

    def statement(self) -> str:
        """The window in a sentence, with the two corners that limit it."""
        return (
            f"strict window {self.window:+.3f} with one threshold for {len(self.corners)} corners, {self.nominal:+.3f} "
            f"nominal; least dose in the part at {self.darkest.name}, most outside at {self.leakiest.name}"
        )


@dataclass(frozen=True)
class Tolerances:
    """How far a machine and its resin may deviate: the method finds patterns that print everywhere in this range.

    One threshold must hold for all scenarios: the corners, which combine both ends of every tolerance, the middles of
    the faces between them, and the nominal print. Patterns for only the corners have a narrower window elsewhere in the
    box. Each scenario has its own operator with its beam, vessel or axis. Images are shifted by linear interpolation
    for a wobble, and for an axis error unless the operator is a `Projection` of a round vessel or air.

    Args:
        axis: Position error of the axis of rotation across the light, ± [mm].
        spread: Least and greatest standard deviation of the point spread [mm]; None for only the beam's own.
        absorption: Absorption of the resin, ± a share of it: 0.05 in Python, "5 %" in a file.
        dose: Dose of the whole exposure, ± a share of it.
        index: Refractive index of the resin, ±.
        wobble: Distance of the vial from the axis, in any direction [mm]; four directions are evaluated.
        judged: "worst" judges the least and the greatest dose of all corners. "mean + spread" divides each corner's
            deviation from their mean dose by √(number of tolerances): the standard deviation if all tolerances have
            equal effects.

    Raises:
        ToleranceError: The least point spread exceeds the greatest.
        BadInput: A value is out of its range.
    """

    axis: Thickness = 0.0
    spread: Widths | None = None
    absorption: Deviation = 0.0
    dose: Deviation = 0.0
    index: Annotated[float, Quantity(least=0.0, most=1.0, hint="± a refractive index, 0 to 1")] = 0.0
    wobble: Thickness = 0.0
    judged: Judged = "worst"

    def __post_init__(self) -> None:
        check(self)
        if self.judged not in ("worst", "mean + spread"):
            raise BadInput(f"Tolerances judged is {self.judged!r}; expected 'worst' or 'mean + spread'")
        if self.spread is not None:
            if not isinstance(self.spread, (tuple, list)) or len(self.spread) != 2:
                raise BadInput(f"Tolerances spread is {self.spread!r}; expected the least and the greatest one [mm]")
            least, greatest = (Quantity("a length", least=0.0).check("Tolerances spread [mm]", w) for w in self.spread)
            if least > greatest:
                raise ToleranceError(
                    "spread", f"goes from {least:g} to {greatest:g} mm; expected the least one first: swap them"
                )
            object.__setattr__(self, "spread", (least, greatest))

    @classmethod
    def from_calibration(
        cls, pitch: float, *, mtf: str | Path | None = None, runout: Runout | str | Path | None = None,
        fill: float = 1.0, reach: float = inf, followed: bool = True, sure: float = 2.0, **more: Any,
    ) -> Tolerances:  # fmt: skip
        """Tolerances from the results of `vam calibrate`.

        Args:
            pitch: Edge of the projector's pixel at the axis [mm].
            mtf: Result of ``vam calibrate mtf``: the least and the greatest point spread along the light.
            runout: Result of ``vam calibrate runout``: the tolerance of the axis is its standard error plus the
                bearing's error; that of the vial is its eccentricity.
            fill: Share of a pixel's area that is lit.
            reach: Extent of the part before and behind the axis [mm]; spreads measured farther away are ignored.
            followed: Whether frames follow the measured runout, as in `vam print`; then only its error remains.
            sure: Number of standard errors that a tolerance spans [1].
            more: Further tolerances, by name.

        Returns:
            The tolerances.

        Raises:
            StorageError: A result cannot be read.
            BadInput: A result is of another kind, or a number is out of its range.
        """
        pitch, sure = positive("pitch [mm]", pitch), positive("sure", sure)
        given: dict[str, Any] = {}
        if mtf is not None:
            given["spread"] = PointSpread.between(mtf, pitch, fill, reach)
        if runout is not None:
            seen = runout if isinstance(runout, Runout) else Runout.load(runout)
            given["axis"] = sure * hypot(seen.axis_error, seen.left) * pitch
            given["wobble"] = (sure * seen.across_error + (0.0 if followed else seen.eccentricity)) * pitch
        return cls(**{**given, **more})

    @property
    def count(self) -> int:
        """Number of tolerances."""
        given = (self.axis, self.spread is not None, self.absorption, self.dose, self.index, self.wobble)
        return sum(map(bool, given))

    def corners(self) -> tuple[Corner, ...]:
        """The nominal print, every combination of ends, and the middles of the faces between them.

        A middle has one tolerance of the optics at an end and the others halfway; without other tolerances, there are
        no middles. Doses scale linearly; their tolerance is therefore always at an end.

        Returns:
            Corners, the nominal one first.
        """

        def ends(most: float) -> tuple[float, ...]:
            return (-most, most) if most else (0.0,)

        turns = [0.5 * np.pi * quarter for quarter in range(QUARTERS)]
        off = [(round(np.cos(t)) * self.wobble, round(np.sin(t)) * self.wobble) for t in turns]
        spreads: tuple[float | None, ...] = (None,) if self.spread is None else tuple(dict.fromkeys(self.spread))
        optics = (
            ends(self.axis), spreads, ends(self.absorption), ends(self.index), off if self.wobble else [(0.0, 0.0)],
        )  # fmt: skip
        middle = (0.0, None if self.spread is None else 0.5 * sum(self.spread), 0.0, 0.0, (0.0, 0.0))
        faces = [
            (*middle[:number], end, *middle[number + 1 :])
            for number, several in enumerate(optics)
            if len(several) > 1
            for end in several
        ]
        every = [*product(*optics), *(faces if sum(len(several) > 1 for several in optics) > 1 else ())]
        found = (Corner(*one, dose=dose) for one in every for dose in ends(self.dose))
        return tuple(dict.fromkeys((Corner(), *found)))

    def scenarios(self, operator: Any, *, judged: Judged | None = None) -> Scenarios:
        """The operators of all corners, joined in one.

        Args:
            operator: The nominal projector.
            judged: As for the class; None takes the tolerances' own.

        Returns:
            The operators, in the order of `corners`.

        Raises:
            ToleranceError: A tolerance contradicts the operator, or does not apply to it.
        """
        corners = self.corners()
        optics = list(dict.fromkeys(corner.optics for corner in corners))
        operators = [at(operator, corner) for corner in optics]
        mix = np.zeros((len(corners), len(optics)))
        for row, corner in zip(mix, corners, strict=True):
            row[optics.index(corner.optics)] = 1.0 + corner.dose
        if (judged or self.judged) == "mean + spread" and len(corners) > 1:
            mean = mix[1:].mean(axis=0)
            mix = mean + (mix - mean) / sqrt(self.count)
        return Scenarios(operators, mix)

    def doses(self, operator: Any, light: Any, target: Any) -> CornerDoses:
        """Doses of light at every corner, by the operators themselves.

        Args:
            operator: The nominal projector.
            light: Patterns [angle, r, z] ≥ 0, or a plan.
            target: A `Target`, or fractions [x, y, z].

        Returns:
            The doses.

        Raises:
            ToleranceError: As for `scenarios`.
            BadInput: The target does not fit the operator.
        """
        limits = getattr(target, "limits", None)
        asked = operator if limits is None else limited(operator, limits)
        light = getattr(light, "sinogram", light)
        light = light if isinstance(light, DeviceArray) else operator.device.upload(np.asarray(light, np.float32))
        return doses_of(self.scenarios(asked, judged="worst"), self, light, fractions_of(operator, target))


def corner_doses(tolerances: Tolerances, measure: Callable[[Corner], tuple[float, float, float]]) -> CornerDoses:
    """Doses at all corners; ``measure`` returns least dose inside, greatest outside and greatest, at a nominal dose."""
    found: dict[Corner, tuple[float, float, float]] = {}
    doses = []
    for corner in tolerances.corners():
        if corner.optics not in found:
            found[corner.optics] = measure(corner.optics)
        least, leak, greatest = (value * (1.0 + corner.dose) for value in found[corner.optics])
        doses.append(CornerDose(str(corner), least, leak if leak > -inf else 0.0, greatest))
    return CornerDoses(tuple(doses))


def doses_of(scenarios: Scenarios, tolerances: Tolerances, light: DeviceArray, target: DeviceArray) -> CornerDoses:
    """The doses of light at the corners of tolerances, for the target of one scenario."""
    optics = dict.fromkeys(corner.optics for corner in tolerances.corners())
    operators = dict(zip(optics, scenarios.operators, strict=True))
    dose, reach = target.device.empty(target.shape), reach_of(scenarios.each)
    return corner_doses(tolerances, lambda corner: window(operators[corner].T(light, out=dose), target, reach))


def check_tolerances(tolerances: Any) -> None:
    """Raise `BadInput` unless the argument is Tolerances or None."""
    if tolerances is not None and not isinstance(tolerances, Tolerances):
        raise BadInput(f"tolerances are {tolerances!r}; expected Tolerances(axis=…, spread=…, …), or None")


def check_lit(scenarios: Scenarios, tolerances: Tolerances, target: DeviceArray) -> None:
    """Raise `ToleranceError` if uniform light leaves a voxel of the part dark at a corner."""
    light = target.device.upload(np.ones(scenarios.range.shape, np.float32))
    at_corners = doses_of(scenarios, tolerances, light, target)
    for corner, found in zip(tolerances.corners(), at_corners.corners, strict=True):
        if not found.least >= LOST * found.greatest:
            blamed = next((name for name in BLAMED if getattr(corner, name) not in (0.0, None, (0.0, 0.0))), "axis")
            raise ToleranceError(
                blamed,
                f"leaves part of the target dark ({corner}): uniform light gives its darkest voxel "
                f"{found.least / max(found.greatest, 1e-30):.2g} of the greatest dose; use a smaller tolerance or a "
                "beam of more pixels",
            )


BLAMED = ("wobble", "axis", "index", "absorption")  # tolerances that can leave a part dark, the most likely first


def at(operator: Any, corner: Corner) -> Any:
    """The operator at a corner, except for the dose. Raises `ToleranceError`."""
    if corner.optics == Corner():
        return operator
    changed = _rebuilt(operator, replace(corner, wobble=(0.0, 0.0), dose=0.0))
    if not any(corner.wobble):
        return changed
    x, y = corner.wobble
    poses = operator.motion.poses
    return _moved(changed, y * np.cos(poses) - x * np.sin(poses), "wobble")


def _rebuilt(operator: Any, corner: Corner) -> Any:
    if corner == Corner():
        return operator
    if isinstance(operator, Projection):
        return _projected(operator, corner)
    if isinstance(operator, RingProjection):
        changed = _projected(operator.direct, corner)
        return changed if unsupported_reason(changed) else RingProjection.of(changed)
    if isinstance(operator, ScatteringRings):
        A, resin = _projected(operator.operator, replace(corner, axis=0.0)), operator.scattering
        if A is not operator.operator:
            operator = ScatteringRings(A, resin, operator.tolerance, operator.photons, operator.seed)
        return _moved(operator, corner.axis)
    if isinstance(operator, Composed):
        return Composed(_rebuilt(operator.outer, corner), operator.inner)
    if isinstance(operator, Wobbled):
        return Wobbled(_rebuilt(operator.operator, corner), operator.wobble)
    if isinstance(operator, Tiles):
        return Tiles(_rebuilt(operator.operator, corner), operator.range.beam.pixels[1], centers=operator.centers)
    if isinstance(operator, Sum):
        return Sum([_rebuilt(term, corner) for term in operator.terms], operator.weights)
    for name in ("spread", "absorption", "index"):
        if getattr(corner, name):
            raise ToleranceError(
                name, f"does not apply to {operator!r}; expected a Projection, or one composed, wobbled or tiled: "
                "leave it out"
            )  # fmt: skip
    return _moved(operator, corner.axis)


def _projected(A: Projection, corner: Corner) -> Any:
    beam, vessel, moved = A.beam, A.vessel, corner.axis
    half = 0.5 * beam.pixels[0] * beam.pitch
    if abs(moved) >= half:
        raise ToleranceError("axis", f"is {abs(moved):g} mm, beyond the beam of {half:g} mm either side; expected "
                             "less: check its unit, mm")  # fmt: skip
    if corner.spread is not None:
        beam = replace(beam, spread=corner.spread)
    if corner.absorption or corner.index:
        vessel = _resin(vessel, corner)
    if moved:
        try:
            given = isinstance(vessel, Misaligned) and type(vessel) is Misaligned
            vessel = replace(vessel, offset=vessel.offset + moved) if given else Misaligned(vessel, offset=moved)  # type: ignore[union-attr]
            moved = 0.0
        except BadInput:  # not a round vessel: the image moves as a whole
            pass
    built = A
    if (beam, vessel) != (A.beam, A.vessel):
        built = Projection(A.grid, beam, A.motion, vessel, A.device)
    return _moved(built, moved)


def _moved(operator: Any, axis: float | np.ndarray, name: str = "axis") -> Any:
    if not np.any(axis):
        return operator
    try:
        return Wobbled(operator, Wobble(axis))
    except BadInput as error:
        raise ToleranceError(name, f"does not fit the print: {error}") from error


def _resin(vessel: Any, corner: Corner) -> Any:
    """The vessel with another resin."""
    inner = getattr(vessel, "vessel", None)
    if inner is not None and hasattr(vessel, "inner"):
        return replace(vessel, vessel=_resin(inner, corner))
    given: dict[str, float] = {}
    if corner.absorption:
        absorption = float(getattr(vessel, "absorption", 0.0))
        if not absorption:
            raise ToleranceError("absorption", f"is given, but {vessel!r} absorbs nothing: leave it out, or give the "
                                 "vessel's resin an absorption")  # fmt: skip
        given["absorption"] = absorption * (1.0 + corner.absorption)
    if corner.index:
        index = getattr(vessel, "resin_index", None)
        if index is None:
            raise ToleranceError("index", f"is given, but {vessel!r} has no resin of one index: leave it out")
        given["resin_index"] = float(index) + corner.index
    try:
        return replace(vessel, **given)
    except (BadInput, TypeError) as error:
        raise ToleranceError("index" if corner.index else "absorption", f"does not fit the print: {error}") from error
