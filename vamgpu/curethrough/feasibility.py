"""Features that can get their dose at this speed and power, and the speed and power that the other features need.

A back side cures if, and only if, h_a·log10[Φ_max / (Φ_max − 1)] or more lies between it and the last slice shown.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log10

import numpy as np

from vamgpu.curethrough.correction import Corrector
from vamgpu.curethrough.dose import Stack
from vamgpu.curethrough.printer import Printer
from vamgpu.curethrough.score import Group
from vamgpu.errors import BadInput


@dataclass(frozen=True, eq=False)
class Feasibility:
    """Maps [y, x] of a corrected stack."""

    missed: np.ndarray  # features whose back side does not get its dose
    closed: np.ndarray  # voids that stay near the critical dose
    speed: np.ndarray  # the fastest [mm/s] at which every feature of the pixel gets its dose with the same light
    power: np.ndarray  # light of level 255 [mW/mm²] that cures every feature at the present speed

    @property
    def feasible(self) -> np.ndarray:
        """Pixels where the doses of the written slices satisfy the constraint curves; bool [y, x]."""
        return (self.missed == 0) & (self.closed == 0)


def last_back_sides(stack: Stack, threshold: int = 128, block: int = 32) -> np.ndarray:
    """ζ_L of the last feature of every pixel, 0 where there is none; int32 [y, x]."""
    out = np.zeros(stack.shape[1:], np.int32)
    for start in range((stack.shape[0] - 1) // block * block, -1, -block):
        solid = stack[start : start + block] >= threshold
        here = np.where(solid.any(axis=0), start + len(solid) - np.argmax(solid[::-1], axis=0), 0)
        out = np.maximum(out, here)
        if (out > 0).all():
            break
    return out


def feasibility(corrector: Corrector, stack: Stack) -> Feasibility:
    """The maps of a corrector that has run through ``stack``; raises `BadInput` for layer-by-layer printers."""
    printer = corrector.correction.machine
    if not isinstance(printer, Printer):
        raise BadInput("speeds are those of continuous printers; for layers, see `LayerPrinter.least_cure_through`")
    last = last_back_sides(stack, corrector.correction.threshold)
    behind = (corrector.slices - last) * printer.slice_height
    with np.errstate(divide="ignore"):
        share = np.where(last > 0, 1.0 - 10.0 ** (-behind / printer.absorption_height), np.inf)
        speed = np.where(last > 0, printer.phi_max * printer.speed * share, np.inf)
        power = np.where(last > 0, printer.light[-1] / (printer.phi_max * share), 0.0)
    return Feasibility(corrector.missed, corrector.closed, speed, power)


def least_void(printer: Printer, open_dose: float | None = None) -> float:
    """Slices of the shortest void between features in which Ω falls to ``open_dose`` and rises to 1, inf if none."""
    needed = printer.opened if open_dose is None else open_dose
    if needed >= 1.0:
        return 1.0
    if not printer.phi_min < needed < printer.phi_max or printer.phi_max <= 1.0:
        return float("inf")
    fall = log10((1.0 - printer.phi_min) / (needed - printer.phi_min)) / printer.eta
    rise = log10((printer.phi_max - needed) / (printer.phi_max - 1.0)) / printer.eta
    return float(ceil(fall - 1e-9) + ceil(rise - 1e-9))


def fastest(printer: Printer, feature: Group, shown: int, open_dose: float | None = None) -> float:
    """Fastest speed [mm/s] for a feature and the void behind it in ``shown`` slices, tail included; 0 if none."""
    speed = printer.fastest((shown - feature.back) * printer.slice_height)
    if feature.last or least_void(printer.at_speed(speed), open_dose) <= feature.behind:
        return speed
    # slower printing builds up dose faster, but level 0 adds more: the void is shortest at a speed in between
    choices = [printer.at_speed(s) for s in np.geomspace(1e-3 * speed, speed, 400)]
    able = [one.speed for one in choices if least_void(one, open_dose) <= feature.behind]
    return max(able, default=0.0)
