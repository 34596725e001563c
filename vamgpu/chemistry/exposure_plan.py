"""The light of a turn in both colors, the effect of small errors on its dose, and the time to send it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.printability import TurnDoses
from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.kernels.update import linear
from vamgpu.operators.blur import Blur, gaussian
from vamgpu.operators.compose import NO_FLOOR, same_device
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import extent, total
from vamgpu.operators.shifts import Wobbled
from vamgpu.operators.space import require
from vamgpu.operators.wobble import Wobble
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Place, Thickness
from vamgpu.travel import at_rest

PER_CM2 = 100.0
"""Number of mm² in a cm²."""


@dataclass(frozen=True)
class Disturbance:
    """Errors of a print. Raises `BadInput`."""

    visible: NonNegative = 1.0  # factor on the dose of visible light
    ultraviolet: NonNegative = 1.0
    axis: Place = 0.0  # across the light [mm]
    blur: Thickness = 0.0  # full width at half maximum [mm] of one pixel's light, the same at every depth

    def __post_init__(self) -> None:
        check(self)


def disturbances(dose: float = 0.0, axis: float = 0.0, blur: float = 0.0) -> tuple[Disturbance, ...]:
    """Every corner: either color's dose ± a share, the axis ± mm, and the focus unchanged or blurred [mm]."""
    dose, axis = positive("dose", dose, zero=True), positive("axis [mm]", axis, zero=True)
    if dose >= 1.0:
        raise BadInput(f"tolerance of the dose is {dose:g}; expected a share below 1")
    shares = (1.0,) if dose == 0.0 else (1.0 - dose, 1.0 + dose)
    offsets = (0.0,) if axis == 0.0 else (-axis, 0.0, axis)
    widths = (0.0,) if blur == 0.0 else (0.0, blur)
    return tuple(Disturbance(*case) for case in product(shares, shares, offsets, widths))


@dataclass(frozen=True, eq=False)
class TurnLight:
    """The light of one turn in one or two colors, and its operators. Raises `BadInput`, `ShapeMismatch`."""

    visible: Projection
    light: DeviceArray  # [angle, r, z] ≥ 0 on the device, fluence in air of every angle [mJ/mm²]
    ultraviolet: Projection | None = None
    ultraviolet_light: DeviceArray | None = None
    strength: float = 1.0  # visible dose that a unit of ultraviolet dose undoes, the linear model's k

    def __post_init__(self) -> None:
        require(self.visible.range, self.light, "the visible light")
        for operator in (self.visible, self.ultraviolet or self.visible):
            at_rest("the light of a turn", operator.motion)
            if operator.motion.dwell is not None:
                raise BadInput(f"the motion is {operator.motion}; expected angles that divide a turn evenly: solve "
                    f"with a Turntable without dwell")  # fmt: skip
        if (self.ultraviolet is None) != (self.ultraviolet_light is None):
            raise BadInput("ultraviolet light needs its operator, and the operator its light; give both or neither")
        if self.ultraviolet is not None:
            require(self.ultraviolet.range, self.ultraviolet_light, "the ultraviolet light")
            same_device(self.visible, self.ultraviolet)
        positive("strength", self.strength, zero=True)

    def dose(self, off: Disturbance = Disturbance()) -> DeviceArray:
        """Visible dose − strength·ultraviolet dose [x, y, z] of a turn [mJ/mm³, or mJ/mm² if nothing absorbs]."""
        return self._mixed(self._seen(off.axis, off.blur), off)

    def doses(self, target: DeviceArray, cases: Sequence[Disturbance] = ()) -> tuple[TurnDoses, ...]:
        """Extremes of a turn's dose in the cylinder for each case; target: fractions [x, y, z]. Raises `EmptyMesh`."""
        grid, seen, found = self.visible.grid, {}, []
        require(self.visible.domain, target, "the target")
        for off in cases or (Disturbance(),):
            key = (off.axis, off.blur)
            if key not in seen:
                seen = {key: self._seen(*key)} if len(seen) > 4 else {**seen, key: self._seen(*key)}
            reach = grid.inscribed_radius / grid.pitch * (1.0 + 1e-6)
            found.append(TurnDoses.of(self._mixed(seen[key], off), target, reach))
        return tuple(found)

    def _seen(self, axis: float, blur: float) -> tuple[DeviceArray, ...]:
        pairs = ((self.visible, self.light), (self.ultraviolet, self.ultraviolet_light))
        return tuple(_exposed(A, light, axis, blur) for A, light in pairs if A is not None and light is not None)

    def _mixed(self, seen: tuple[DeviceArray, ...], off: Disturbance) -> DeviceArray:
        device, out = self.visible.device, self.visible.device.empty(self.visible.domain.shape)
        a, b = off.visible * _unit(self.visible), 0.0
        if self.ultraviolet is not None:
            b = -self.strength * off.ultraviolet * _unit(self.ultraviolet)
        device.launch(linear, a=a, x=seen[0], b=b, y=seen[-1], floor=NO_FLOOR, out=out)
        return out


@dataclass(frozen=True)
class ExposurePlan:
    """Times and irradiances of a print."""

    turns: int
    power: float  # factor on the light of a turn
    period: float  # of a turn [s]
    seconds: float  # of the print
    frame: float  # of an angle [s]
    visible_peak: float  # irradiance in air of the brightest pixel at its brightest angle [mW/cm²]
    visible_mean: float  # mean over all pixels and angles [mW/cm²]
    ultraviolet_peak: float
    ultraviolet_mean: float
    visible_energy: float  # total energy sent [mJ]
    ultraviolet_energy: float  # total energy sent [mJ]


def plan_exposure(
    turn: TurnLight, turns: int, power: float, *, period: float | None = None, visible_limit: float | None = None,
    ultraviolet_limit: float | None = None,
) -> ExposurePlan:  # fmt: skip
    """Find times and irradiances for a number of turns at a power; the angles divide a turn evenly.

    Args:
        turn: The light of a turn.
        turns: Number of turns.
        power: Factor by which the light of a turn is multiplied.
        period: Time of a turn [s]; by default the shortest that the limits allow.
        visible_limit, ultraviolet_limit: Irradiance of a full-on pixel in air [mW/cm²].

    Returns:
        Times [s] and irradiances [mW/cm²].

    Raises:
        BadInput: The period is too short for a limit, or neither a period nor the limit of a used color is given.
    """
    turns, power = counts("turns", (turns,), 1)[0], positive("power", power)
    angles = turn.visible.motion.angles
    colors = {"visible": _sent(turn.light), "ultraviolet": _sent(turn.ultraviolet_light)}
    limits = {"visible": visible_limit, "ultraviolet": ultraviolet_limit}
    given = {name: positive(f"{name}_limit [mW/cm²]", limit) for name, limit in limits.items() if limit is not None}
    needed = {name: angles * power * colors[name][0] * PER_CM2 / limit for name, limit in given.items()}
    if period is None:
        dark = [name for name, (peak, _) in colors.items() if peak > 0.0 and name not in needed]
        if dark or not needed:
            raise BadInput(f"no period and no limit for {' and '.join(dark) or 'any color'}; give period= [s], or the "
                           "irradiance of a full-on pixel of every color [mW/cm²]")  # fmt: skip
        period = max(needed.values())
    period = positive("period [s]", period)
    for name, least in needed.items():
        if period < least * (1.0 - 1e-9):
            raise BadInput(f"a turn of {period:.4g} s needs more than {given[name]:g} mW/cm² of {name} light; take at "
                           f"least {least:.4g} s, or less power over more turns")  # fmt: skip
    frame = period / angles
    rates = [power * value / frame * PER_CM2 for name in colors for value in colors[name]]
    areas = (turn.visible, turn.ultraviolet or turn.visible)
    energies = [turns * power * mean * np.prod(A.range.shape) * A.beam.pixel_area
                for (_, mean), A in zip(colors.values(), areas, strict=True)]  # fmt: skip
    return ExposurePlan(turns, power, period, turns * period, frame, *map(float, rates), *map(float, energies))


def _sent(light: DeviceArray | None) -> tuple[float, float]:
    """Greatest and mean fluence of an angle [mJ/mm²]."""
    if light is None:
        return 0.0, 0.0
    return extent(light)[1], total(light) / float(np.prod(light.shape))


def _unit(A: Projection) -> float:
    """Factor that turns Aᵀ of a fluence [mJ/mm²] into a dose [mJ/mm³], or a fluence if nothing is absorbed."""
    return A.beam.pixel_area / A.grid.voxel_volume


def _exposed(A: Projection, light: DeviceArray, axis: float, blur: float) -> DeviceArray:
    """Aᵀ of blurred light, about an axis that is off center."""
    if blur > 0.0:
        taps = gaussian(blur / A.beam.pitch)
        light = Blur(A.range, A.device, taps, taps)(light)
    return (Wobbled(A, Wobble(across=axis)) if axis else A).T(light)
