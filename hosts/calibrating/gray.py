"""What gray levels are worth in light: all mirrors show one level after another, of each projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from vamgpu.calibration.gray import TOP, GrayReading, fit_gray
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrating import patterns
from vamgpu.hosts.calibrating.machines import CalibrationLight, CalibrationMachines, need
from vamgpu.hosts.calibrating.report import CalibrationResult
from vamgpu.printing.gray import GrayCurve

PHOTODIODE, CAMERA = ("photodiode",), ("camera",)  # what it needs of a rig's file, by what reads the light


def levels(every: int) -> tuple[int, ...]:
    """Levels from 0 to 255, ``every`` apart, both ends among them."""
    if not 1 <= every <= TOP:
        raise BadInput(f"every is {every}; expected 1 to {TOP}")
    return tuple(sorted({*range(0, TOP + 1, every), TOP}))


def gray(
    machines: CalibrationMachines, steps: Sequence[int], *, repeats: int = 4, camera: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> CalibrationResult:  # fmt: skip
    """Measure the gray curve of each projector's light.

    steps: levels, rising from 0 to 255.  repeats: readings of each.  camera: read the camera's mean instead of the
    photodiode, exposed for whole frames; its rounding hides what is below half a level. The table ``gray`` of the
    result, and ``gray_1``, … of further projectors, are curves that `pack` takes.

    Raises `JobError` for a rig without photodiode or camera, `BadInput` for too little light or light that saturates,
    `InterlockOpen`.
    """
    if repeats < 2:
        raise BadInput(f"{repeats} readings of each level; expected 2 or more, which tell their error")
    curves, readings = [], {"levels": np.asarray(steps)}
    for projector in range(len(machines.screens)):
        part = lambda share, number=projector: progress((number + share) / len(machines.screens))  # noqa: E731
        dark, read, before = _scan(machines, projector, steps, repeats, camera, part)
        curves.append((fit_gray(steps, read, dark), _drift(read[-1], before, dark)))
        readings |= {f"dark_{projector}": dark, f"readings_{projector}": read, f"before_{projector}": before}
    return _found(curves, readings)


def _scan(
    machines: CalibrationMachines,
    projector: int,
    steps: Sequence[int],
    repeats: int,
    camera: bool,
    progress: Callable[[float], None],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings in the dark, of the levels, and of full light before them, for the drift."""
    screen, read = machines.screen(projector), []

    def one(light: CalibrationLight) -> np.ndarray:
        if camera:
            return np.array([float(machines.image(light).mean()) for _ in range(repeats)])
        return machines.read(light, repeats)

    if camera:
        whole_frames(machines, projector)
    with CalibrationLight(machines, projector) as light:
        dark = one(light)
        light.on()
        screen.show(patterns.flat(screen.shape, TOP))
        before = one(light)
        for number, level in enumerate(steps):
            screen.show(patterns.flat(screen.shape, level))
            read.append(one(light))
            progress((number + 1) / len(steps))
    return dark, np.array(read), before


def whole_frames(machines: CalibrationMachines, projector: int) -> float:
    """Expose the camera for a whole number of frames [s], as levels are made of planes one after the other."""
    section, frame = need(machines.rig.camera, "camera"), machines.screen(projector).period
    exposure = max(1, round(section.exposure / frame)) * frame
    need(machines.camera, "camera").expose(1e6 * exposure)
    return exposure


def _drift(last: np.ndarray, before: np.ndarray, dark: np.ndarray) -> float:
    """Share by which full light changed from before the levels to their end."""
    return float((last.mean() - dark.mean()) / (before.mean() - dark.mean()) - 1.0)


def _found(curves: list[tuple[GrayReading, float]], readings: dict[str, np.ndarray]) -> CalibrationResult:
    numbers = {
        "black": [curve.black for curve, _ in curves], "full": [curve.intensity[-1] for curve, _ in curves],
        "error": [max(curve.error) / curve.intensity[-1] for curve, _ in curves],
        "moved": [curve.moved / curve.intensity[-1] for curve, _ in curves], "drift": [drift for _, drift in curves],
    }  # fmt: skip
    tables, lines = {}, []
    for number, (curve, drift) in enumerate(curves):
        kept = GrayCurve(curve.levels, curve.intensity)
        tables["gray" if number == 0 else f"gray_{number}"] = kept.describe()
        lines += [
            (f"projector {number}", f"black {100 * kept.black:.3f} %, half of the light at level {_half(kept):.1f}"),
            ("  error, drift", f"{100 * max(curve.error) / curve.intensity[-1]:.2g} %, {100 * drift:+.2g} %"),
        ]
    lines.append(("for the job", '[frames] gray = "result.toml"'))
    return CalibrationResult("gray", numbers, readings, tuple(lines), lambda axes: _draw(axes, curves), tables)


def _half(curve: GrayCurve) -> float:
    return float(np.interp(0.5, curve.intensity, curve.levels))


def _draw(axes: Any, curves: list[tuple[GrayReading, float]]) -> None:
    for number, (curve, _) in enumerate(curves):
        light = np.array(curve.intensity) / curve.intensity[-1]
        axes.plot(curve.levels, light, ".-", lw=0.8, ms=4, label=f"projector {number}")
    axes.plot([0, TOP], [0, 1], color="#9aa5b4", lw=0.8, ls=":")
    axes.legend(frameon=False)
    axes.set(title="Light over gray level", xlabel="level", ylabel="light over that of 255")
