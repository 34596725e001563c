"""Calibrations of emulated optics compared with their truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vamgpu.hosts.calibrate.machines import CalibrationMachines
from vamgpu.hosts.calibrate.report import CalibrationResult

HIGHEST = 100.0  # greatest frequency of the truth [1/mm]
USUAL: dict[str, dict[str, float]] = {
    "flat": {"radius": 0.0, "tilt": 0.03, "falloff": 0.1}, "runout": {"radius": 0.0, "pin": 9.0},
    "live": {"radius": 0.0, "back": 3.0e6},
}  # fmt: skip
"""Kind of a calibration → optics that show its effect, if the usual ones do not."""
Truth = tuple[dict[str, Any], str]  # from emulated optics: numbers of a result's table, and a line to show


def compared(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> CalibrationResult:
    """Add the truth of emulated optics to a result: a table ``emulated``, and a line."""
    truth, line = TRUTHS[found.kind](found, optics, machines)
    return replace(found, lines=(*found.lines, ("emulated", line)), tables={**found.tables, "emulated": truth})


def _focus(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    power = -optics.middle / optics.slope
    truth = {"slope_mm_dpt": optics.slope, "axis_dpt": power}
    return truth, f"{optics.slope:.3f} mm/dpt, {power:.4f} dpt at the middle"


def _axis(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    truth = {"column": optics.axis, "radius_columns": optics.radius}
    return truth, f"column {optics.axis:.3f}, radius {optics.radius:.3f} columns"


def _gray(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    lit, curve = round(1e6 * machines.screens[0].period), found.tables["gray"]
    light = np.array([optics.gray(level, lit) for level in curve["levels"]])
    off = float(np.abs(light / light[-1] - np.array(curve["intensity"])).max())
    truth = {"black": float(light[0] / light[-1]), "largest_error": off}
    return truth, f"black {100 * truth['black']:.3f} %, largest error of a level {100 * off:.2g} %"


def _flat(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    true = optics.flat() / optics.flat().max()
    off = float(np.abs(found.readings["flat_0"] - true).max())
    truth = {"dimmest": float(true.min()), "largest_error": off}
    return truth, f"dimmest {100 * true.min():.2f} %, largest error of a mirror {100 * off:.2g} %"


def _runout(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    truth = {"column": optics.axis, "lean": optics.lean, "across": optics.across, "tilt": optics.wobble}
    out, wobble = (float(np.hypot(*each)) for each in (optics.across, optics.wobble))
    edge = 0.5 * optics.mirrors[0]
    return truth, f"column {optics.axis:.3f}, pin {out:.3f}, wobble {edge * wobble:.3f} columns"


def _turn(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    return {"ratio": optics}, f"{optics:.6f} deg of the vial"


def _mtf(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    frequency = np.linspace(0.0, HIGHEST, 20001)
    places, pixel = found.numbers["positions_mm"], found.numbers["pixel_mm"]
    powers = found.numbers["powers_dpt"] or [0.0] * len(places)
    half = [
        float(frequency[np.argmax(optics.modulation(frequency, place, power, pixel) < 0.5)])
        for place, power in zip(places, powers, strict=True)
    ]
    return {"mtf50_per_mm": half}, ", ".join(f"{each:.3g}" for each in half) + " cycles/mm"


def _live(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    camera: Any = machines.camera
    sensor, exposure = camera.sensor, 1e-6 * camera.exposure_us
    top, rate = 2**sensor.bits - 1, optics.back * exposure / sensor.full_well
    truth = {"open_field": top * rate * float(optics.backlight().mean()), "dark": float(sensor.offset),
             "gain": top / sensor.full_well, "read": top * sensor.read_noise / sensor.full_well,
             "pixels_per_mirror": optics.pitch / camera.pixel}  # fmt: skip
    return truth, ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in truth.items())


TRUTHS: dict[str, Callable[[CalibrationResult, Any, CalibrationMachines], Truth]] = {
    "focus": _focus, "axis": _axis, "gray": _gray, "mtf": _mtf, "flat": _flat, "runout": _runout,
    "turn": _turn, "live": _live,
}  # fmt: skip
