"""Focus of the lens: a camera steps along the light, and at each position the lens steps through its powers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vamgpu.calibration.focus import LEAST_POWERS, FocusLine, Peak, fit_peak, focus_line, tenengrad
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import CalibrationLight, CalibrationMachines, Progress, over_positions, silent
from vamgpu.hosts.calibrate.report import CalibrationResult

TABLES = ("lens", "camera", "camera_stage")  # tables of a rig's file that it needs


def steps(reach: float, step: float) -> tuple[float, ...]:
    """Positions [mm] from −reach to reach, ``step`` apart."""
    if not (step > 0 and reach >= step):
        raise BadInput(f"steps of {step:g} mm from {-reach:g} to {reach:g} mm; expected 2 steps or more, each > 0")
    count = int(reach / step + 1e-9)
    return tuple(round(step * number, 9) for number in range(-count, count + 1))


def sweep(low: float, high: float, count: int) -> tuple[float, ...]:
    """Equally spaced lens powers [dpt] from low to high."""
    if not (low < high and count >= LEAST_POWERS):
        raise BadInput(f"{count} powers from {low:g} to {high:g} dpt; expected {LEAST_POWERS} or more, rising")
    return tuple(np.linspace(low, high, count).tolist())


def focus(
    machines: CalibrationMachines, positions: Sequence[float], powers: Sequence[float], *, half_period: int = 10,
    projector: int = 0, progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure the line of focus against lens powers [dpt] at camera positions [mm] with a Ronchi grating."""

    def swept(light: CalibrationLight, place: float) -> tuple[Peak, float, np.ndarray, np.ndarray, np.ndarray]:
        true, sharp, best = [], [], np.zeros((0, 0))
        for power in powers:
            true.append(machines.focus(power, light))
            image = machines.image(light)
            sharp.append(float(tenengrad(image)))
            if sharp[-1] == max(sharp):
                best = image
        return fit_peak(np.array(true), np.array(sharp)), place, np.array(true), np.array(sharp), best

    pattern = patterns.grating(machines.screen(projector).shape, half_period)
    peaks, *rows = zip(*over_positions(machines, projector, positions, pattern, swept, progress), strict=True)
    names = ("positions", "powers", "sharpness", "images")
    readings = {name: np.array(part) for name, part in zip(names, rows, strict=True)}
    line = focus_line(readings["positions"], peaks)
    center = float(line.power(0.0))
    numbers = {
        "slope_mm_dpt": line.slope, "slope_error_mm_dpt": line.error, "intercept_mm": line.intercept,
        "axis_dpt": center, "positions_mm": line.positions, "powers_dpt": [peak.power for peak in line.peaks],
        "errors_dpt": [peak.error for peak in line.peaks], "widths_dpt": [peak.width for peak in line.peaks],
    }  # fmt: skip
    lines = (
        ("slope of focus", f"{line.slope:.3f} ± {line.error:.2g} mm/dpt"),
        ("power at the middle", f"{center:.4f} dpt"),
        ("depth at half sharpness", f"{2 * abs(line.slope) * float(np.mean(numbers['widths_dpt'])):.3g} mm"),
        ("for the rig's file", f"[lens] axis = {center:.4f}, slope = {line.slope:.3f}"),
    )
    return CalibrationResult("focus", numbers, readings, lines, lambda axes: _draw(axes, line))


def _draw(axes: Any, line: FocusLine) -> None:
    power = np.array([peak.power for peak in line.peaks])
    axes.errorbar(power, line.positions, xerr=[peak.error for peak in line.peaks], fmt="o", color="#2563a8", ms=4)
    axes.plot(power, line.slope * power + line.intercept, color="#1f2733", lw=1)
    axes.set(title=f"Focus: {line.slope:.2f} mm/dpt", xlabel="lens power [dpt]", ylabel="camera [mm]")
