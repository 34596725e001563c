"""Runout of a vial: a camera follows the shadow of a pin on the turntable over one turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.calibration.runout import LEAST_POSES, CameraMap, Runout, find_pin, fit_runout
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import CalibrationLight, CalibrationMachines, Progress, need, silent
from vamgpu.hosts.calibrate.report import CalibrationResult

TABLES = ("camera", "camera_stage", "motion")  # tables of a rig's file that it needs
LINES = 24  # single columns and rows of mirrors that are lit, to find them in the camera's images


def runout(
    machines: CalibrationMachines, *, poses: int = 24, repeats: int = 2, speed: float = 30.0, projector: int = 0,
    progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure the runout of a pin on the turntable over one turn, and the axis."""
    if poses < LEAST_POSES or repeats < 1 or not speed > 0:
        raise BadInput(
            f"{poses} angles, {repeats} images of each, at {speed:g} deg/s; expected {LEAST_POSES} angles or more, an "
            "image or more, and a speed above 0"
        )
    screen = machines.screen(projector)
    with CalibrationLight(machines, projector) as light:
        machines.move(0.0)
        light.on()
        place = CameraMap.of(*single_lines(machines, light, projector))  # without the lines that the pin hides
        angles, images = np.empty(poses), []
        start = need(machines.turntable, "motion").position()
        for number in range(poses):
            light.off()
            angles[number] = machines.turn(start + 360.0 * number / poses, speed)
            light.on()
            screen.show(patterns.block(screen.shape, (0, screen.shape[0]), (0, screen.shape[1])))
            images.append(np.mean([machines.shown(light) for _ in range(repeats)], axis=0))
            progress((number + 1) / poses)
    inside = place.inside(screen.shape, images[0].shape)
    found = []
    for angle, image in zip(angles, images, strict=True):
        try:
            pin = find_pin(image[inside], (inside[0].start, inside[1].start))
        except BadInput as error:
            raise BadInput(f"angle {angle:.1f}°: {error}") from error
        found.append(place.on_mirrors(pin, screen.shape))
    columns, slopes = np.array(found).T
    readings = {"angles": angles, "columns": columns, "slopes": slopes, "images": np.stack(images)}
    return _found(fit_runout(np.radians(angles), columns, slopes, place), readings, screen.shape, projector)


def single_lines(
    machines: CalibrationMachines, light: CalibrationLight, projector: int
) -> tuple[list[tuple[float, np.ndarray]], list[tuple[float, np.ndarray]]]:
    """Numbers of single columns of mirrors, and of rows, with the camera's image of each when it alone is lit."""
    screen = machines.screen(projector)
    rows, columns = screen.shape
    screen.show(patterns.block(screen.shape, (0, 0), (0, 0)))
    dark = machines.shown(light).astype(float)
    seen: list[list[tuple[float, np.ndarray]]] = [[], []]
    for axis, length in ((0, columns), (1, rows)):
        for number in np.linspace(0.1 * length, 0.9 * length, LINES).astype(int).tolist():
            own = (number, number + 1)
            down, across = ((0, rows), own) if axis == 0 else (own, (0, columns))
            screen.show(patterns.block(screen.shape, down, across))
            seen[axis].append((number, machines.shown(light) - dark))
    return seen[0], seen[1]


def _found(
    found: Runout, readings: dict[str, np.ndarray], shape: tuple[int, int], projector: int
) -> CalibrationResult:  # fmt: skip
    numbers = {
        "column": found.axis, "error_columns": found.axis_error, "lean": found.lean, "lean_error": found.lean_error,
        "across": found.across, "across_error": found.across_error, "tilt": found.tilt, "tilt_error": found.tilt_error,
        "left": found.left, "rows": shape[0], "columns": shape[1], "projector": projector,
    }  # fmt: skip
    edge = 0.5 * shape[0]
    lines = (
        ("axis", f"column {found.axis:.3f} ± {found.axis_error:.2g} at the middle row"),
        ("lean of the axis", f"{edge * found.lean:+.3f} ± {edge * found.lean_error:.2g} columns at the last row"),
        ("eccentricity", f"{found.eccentricity:.3f} ± {found.across_error:.2g} columns"),
        ("wobble", f"{edge * found.wobble:.3f} ± {edge * found.tilt_error:.2g} columns at the last row"),
        ("left", f"{found.left:.2g} columns, deviation from the sine"),
    )
    return CalibrationResult(
        "runout", numbers, readings, lines,
        lambda axes: _draw(axes, found, readings["angles"], readings["columns"]),
    )  # fmt: skip


def _draw(axes: Any, found: Runout, angles: np.ndarray, columns: np.ndarray) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(angles % 360.0, columns, ".", color="#2563a8", ms=4)
    axes.plot(np.degrees(turn), found.axis + found.columns(turn, 1)[:, 0], color="#1f2733", lw=0.8)
    axes.axhline(found.axis, color="#9aa5b4", lw=0.8, ls=":")
    axes.set(title=f"Runout of the pin: {found.eccentricity:.2f} columns", xlabel="angle [deg]", ylabel="column")
