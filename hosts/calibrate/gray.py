"""Gray curve of each projector: all mirrors show the levels one after another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vamgpu.calibration.gray import TOP, GrayReading, fit_gray
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import (
    CalibrationLight,
    CalibrationMachines,
    Progress,
    need,
    over_patterns,
    part_of,
    silent,
)
from vamgpu.hosts.calibrate.report import CalibrationResult
from vamgpu.printing.gray import GrayCurve


def levels(every: int) -> tuple[int, ...]:
    """Levels from 0 to 255, ``every`` apart, with both ends."""
    if not 1 <= every <= TOP:
        raise BadInput(f"every is {every}; expected 1 to {TOP}")
    return tuple(sorted({*range(0, TOP + 1, every), TOP}))


def gray(
    machines: CalibrationMachines, steps: Sequence[int], *, repeats: int = 4, camera: bool = False,
    progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure the gray curve of each projector's light, with the photodiode or the camera's mean."""
    if repeats < 2:
        raise BadInput(f"{repeats} readings of each level; expected 2 or more, to estimate their error")
    curves, readings = [], {"levels": np.asarray(steps)}

    def mean(light: CalibrationLight, count: int) -> np.ndarray:
        return np.array([float(machines.image(light).mean()) for _ in range(count)])

    for projector, screen in enumerate(machines.screens):
        if camera:  # for a whole number of frames, because planes make a level one after another
            frames = max(1, round(need(machines.rig.camera, "camera").exposure / screen.period))
            need(machines.camera, "camera").expose(1e6 * frames * screen.period)
        lit = (patterns.flat(screen.shape, level) for level in (TOP, *steps))
        part = part_of(progress, projector, len(machines.screens))
        dark, (before, *read) = over_patterns(
            machines, projector, lit, len(steps) + 1, mean if camera else machines.read, repeats, part
        )
        drift = float((read[-1].mean() - dark.mean()) / (before.mean() - dark.mean()) - 1.0)  # share of full light
        curves.append((fit_gray(steps, np.array(read), dark), drift))
        readings |= {f"dark_{projector}": dark, f"readings_{projector}": np.array(read), f"before_{projector}": before}
    return _found(curves, readings)


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
        half = float(np.interp(0.5, kept.intensity, kept.levels))
        lines += [
            (f"projector {number}", f"black {100 * kept.black:.3f} %, half of the light at level {half:.1f}"),
            ("  error, drift", f"{100 * max(curve.error) / curve.intensity[-1]:.2g} %, {100 * drift:+.2g} %"),
        ]
    lines.append(("for the job", '[frames] gray = "result.toml"'))
    return CalibrationResult("gray", numbers, readings, tuple(lines), lambda axes: _draw(axes, curves), tables)


def _draw(axes: Any, curves: list[tuple[GrayReading, float]]) -> None:
    for number, (curve, _) in enumerate(curves):
        light = np.array(curve.intensity) / curve.intensity[-1]
        axes.plot(curve.levels, light, ".-", lw=0.8, ms=4, label=f"projector {number}")
    axes.plot([0, TOP], [0, 1], color="#9aa5b4", lw=0.8, ls=":")
    axes.legend(frameon=False)
    axes.set(title="Light against gray level", xlabel="level", ylabel="light / light of level 255")
