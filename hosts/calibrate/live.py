"""The camera of watched prints: levels and noise by exposure time, and its place by single lit columns and rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vamgpu.calibration.runout import lit_lines
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate.machines import CalibrationLight, CalibrationMachines, Progress, need, part_of, silent
from vamgpu.hosts.calibrate.report import CalibrationResult
from vamgpu.hosts.calibrate.runout import single_lines
from vamgpu.live.turbidity import MeasuredTurbidity

TABLES = ("camera",)  # tables of a rig's file that it needs
SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)  # exposure times, relative to that in the rig's file
PLACE = ("rows", "columns", "matrix", "origin", "place_error_pixels")  # numbers of the camera's place
SURE = 10.0  # least rise of levels with the exposure time [standard errors]
LEVELS = 12  # greatest number of groups of pixels of similar level, of each exposure
LEAST = 0.25  # least noise of the open field [gray levels]; below it, images repeat bit for bit
WAVES = np.arange(1, 9)  # terms of the series of rounding


def live(
    machines: CalibrationMachines, *, repeats: int = 8, projector: int = 0, place: Mapping[str, Any] | None = None,
    turbidity: MeasuredTurbidity | None = None, progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure the levels of the camera and where it sees the mirrors; place: numbers of `PLACE` that it keeps."""
    if repeats < 2:
        raise BadInput(f"{repeats} images of each exposure; expected 2 or more, whose difference gives the noise")
    camera, section = need(machines.camera, "camera"), need(machines.rig.camera, "camera")
    with CalibrationLight(machines, projector) as light:
        if machines.stage is not None:
            machines.move(0.0)
        times, stacks = [], []
        for number, share in enumerate(SHARES):
            camera.expose(1e6 * share * section.exposure)
            times.append(getattr(camera, "exposure_us", None) or 1e6 * share * section.exposure)
            stacks.append(np.stack([machines.image(light) for _ in range(repeats)]).astype(np.float32))
            part_of(progress, 0, 2)((number + 1) / len(SHARES))
        if place is None:
            light.on()
            place = _place(*single_lines(machines, light, projector), machines.screen(projector).shape)
    progress(1.0)
    return _found(np.array(times), stacks, place, section.bits, turbidity)


def _place(columns: Any, rows: Any, mirrors: tuple[int, int]) -> dict[str, Any]:
    """The affine map of mirrors (row, column) to the camera's, whichever way it is turned."""
    across = max((light for _, light in columns), key=lambda light: float(light.max()))
    turned = np.ptp(np.clip(across, 0.0, None).sum(axis=0)) < np.ptp(np.clip(across, 0.0, None).sum(axis=1))
    if turned:  # the camera's rows count along the mirrors' columns
        columns, rows = ([(number, light.T) for number, light in each] for each in (columns, rows))
    shape = columns[0][1].shape
    column, pitch, lean, *errors = lit_lines("columns", columns)
    row, height, tilt, *other = lit_lines("rows", [(number, light.T) for number, light in rows])
    # row' = row + height·m + tilt·column', column' = column + pitch·n + lean·row'
    seen = np.linalg.inv([[1.0, -tilt], [-lean, 1.0]])
    matrix, origin = seen @ np.diag([height, pitch]), seen @ [row, column]
    if turned:
        shape, matrix, origin = shape[::-1], matrix[::-1], origin[::-1]
    far = 0.5 * max(shape)
    error = float(np.hypot(errors[0] + far * errors[1], other[0] + far * other[1]))
    return dict(zip(PLACE, (*shape, matrix, origin, error), strict=True)) | {"mirrors": list(mirrors)}


def _found(
    times: np.ndarray, stacks: list[np.ndarray], place: Mapping[str, Any], bits: int,
    turbidity: MeasuredTurbidity | None,
) -> CalibrationResult:  # fmt: skip
    means = np.stack([stack.mean(axis=0) for stack in stacks])
    levels = means.mean(axis=(1, 2))
    (rate, dark), spread = np.polyfit(times, levels, 1, cov=True)
    if not rate > SURE * np.sqrt(spread[0, 0]):
        raise BadInput(f"levels are {levels.min():.4g} to {levels.max():.4g} at all exposure times; expected levels in "
                       "proportion to them: turn its own light on, and its automatic settings off")  # fmt: skip
    dark, dark_error = max(float(dark), 0.0), float(np.sqrt(spread[1, 1]))
    level, variance = _by_level(stacks)
    read, gain, read_error, gain_error = _noise(level - dark, variance)
    field = np.maximum(means[-1] - dark, 0.0)
    numbers = {
        **place, "exposure_s": 1e-6 * float(times[-1]), "bits": bits, "dark": dark, "dark_error": dark_error,
        "read": read, "gain": gain, "read_error": read_error, "gain_error": gain_error,
        "open_field": float(field.mean()),
    }  # fmt: skip
    lines = [
        ("open field", f"{field.mean():.1f} gray levels, {field.min():.1f} to {field.max():.1f}"),
        ("dark", f"{dark:.2f} ± {dark_error:.2g} gray levels"),
        (
            "noise",
            f"{read:.3g} ± {read_error:.2g} gray levels in the dark, {gain:.4g} ± {gain_error:.2g} gray levels "
            "per electron",
        ),
        ("place", f"{_orientation(numbers)}, ± {numbers['place_error_pixels']:.2g} camera pixels"),
    ]
    tables: dict[str, Any] = {}
    if turbidity is not None:
        numbers |= {"turbidity": turbidity.full, "turbidity_error": turbidity.error}
        lines.append(("turbidity", f"{turbidity.full:.4g} ± {turbidity.error:.2g} 1/mm when fully cured"))
    readings = {"open_field": field.astype(np.float32), "times_us": times, "level": level, "variance": variance}
    return CalibrationResult(
        "live", numbers, readings, tuple(lines), lambda axes: _draw(axes, readings, dark, read, gain), tables
    )


def _by_level(stacks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean level, and variance from image to image, of groups of pixels; each is a level wide or more, if it can be."""
    level, variance = [], []
    for stack in stacks:
        mean, own = stack.mean(axis=0).ravel(), stack.var(axis=0, ddof=1).ravel()
        wide = np.ptp(np.quantile(mean, (0.05, 0.95)))
        for group in np.array_split(np.argsort(mean), min(max(int(wide), 1), LEVELS)):
            level.append(float(mean[group].mean()))
            variance.append(float(own[group].mean()))
    return np.array(level), _unrounded(np.array(variance))


def _unrounded(variance: np.ndarray) -> np.ndarray:
    """Variance of levels before they were rounded, of pixels whose means lie anywhere between two levels."""
    noise = np.linspace(0.0, 1.0, 1001)
    kept = np.exp(-4.0 * (np.pi * WAVES * noise[:, None]) ** 2) / (2.0 * (np.pi * WAVES) ** 2)
    rounded = noise**2 + np.sum(1.0 / (2.0 * (np.pi * WAVES) ** 2) - kept, axis=1)
    return np.where(variance < rounded[-1], np.interp(variance, rounded, noise) ** 2, variance - 1.0 / 12.0)


def _noise(level: np.ndarray, variance: np.ndarray) -> tuple[float, float, float, float]:
    """Noise in the dark, gray levels per electron, and their errors; neither is below its error. Raises `BadInput`."""
    most = float(np.sqrt(variance[np.argmax(level)]))
    if most < LEAST:
        raise BadInput(f"the noise of the open field is {most:.2g} gray levels; expected {LEAST:g} or more, because "
            f"otherwise images repeat: set more bits (with format) or more gain in [[feedback]]")  # fmt: skip
    near = 1.0 / np.maximum(variance, LEAST**2)
    (gain, floor), spread = np.polyfit(level, variance, 1, w=near, cov=True)
    gain_error, error = np.sqrt(np.diag(spread))
    floor = max(float(floor), float(error))
    read, gain = float(np.sqrt(floor)), max(float(gain), float(gain_error))
    return read, gain, float(error) / (2.0 * read), float(gain_error)


def _orientation(numbers: Mapping[str, Any]) -> str:
    from vamgpu.live.sensor import SensorView

    shape = numbers["rows"], numbers["columns"]
    view = SensorView(shape, numbers["matrix"], numbers["origin"])
    scale = float(np.sqrt(abs(np.linalg.det(np.array(view.matrix)))))
    return f"{view.orientation}, {scale:.3f} camera pixels per mirror"


def _draw(axes: Any, readings: Mapping[str, np.ndarray], dark: float, read: float, gain: float) -> None:
    level = np.sort(readings["level"])
    axes.plot(readings["level"], readings["variance"], ".", color="#2563a8", ms=4)
    axes.plot(level, read**2 + 1.0 / 12.0 + gain * np.maximum(level - dark, 0.0), color="#1f2733", lw=0.8)
    axes.set(title="Noise of the camera", xlabel="gray level", ylabel="variance [gray levels²]")
