"""How evenly full-on mirrors shine: one block of them after another is lit, of each projector."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vamgpu.calibration.flat import FlatReading, cuts, fit_flat
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrating import patterns
from vamgpu.hosts.calibrating.machines import CalibrationLight, CalibrationMachines
from vamgpu.hosts.calibrating.report import CalibrationResult

TABLES = ("photodiode",)  # what it needs of a rig's file
BLOCKS = (8, 12)


def flat(
    machines: CalibrationMachines, blocks: tuple[int, int] = BLOCKS, *, repeats: int = 4,
    progress: Callable[[float], None] = lambda share: None,
) -> CalibrationResult:  # fmt: skip
    """Measure the flat field of each projector with a photodiode that takes in all of its light, past no roller.

    blocks: of mirrors along rows and columns.  repeats: readings of each. The readings ``flat_0``, ``flat_1``, … are
    fields [row, column] that `pack` takes as its ``flat_field``.

    Raises `JobError` for a rig without photodiode, `BadInput` for too few blocks or too little light, `InterlockOpen`.
    """
    if repeats < 2:
        raise BadInput(f"{repeats} readings of each block; expected 2 or more, which tell their error")
    found: list[FlatReading] = []
    readings: dict[str, np.ndarray] = {}
    for projector, screen in enumerate(machines.screens):
        down, across = (cuts(length, count) for length, count in zip(screen.shape, blocks, strict=True))
        read = np.empty((*blocks, repeats))
        with CalibrationLight(machines, projector) as light:
            light.on()
            screen.show(patterns.block(screen.shape, (0, 0), (0, 0)))
            dark = machines.read(light, repeats)  # what mirrors that are off leave to the meter
            for number, (row, column) in enumerate(np.ndindex(*blocks)):
                screen.show(patterns.block(screen.shape, down[row : row + 2], across[column : column + 2]))
                read[row, column] = machines.read(light, repeats)
                progress((projector + (number + 1) / read[..., 0].size) / len(machines.screens))
        found.append(fit_flat(read, dark, screen.shape))
        readings |= {f"dark_{projector}": dark, f"readings_{projector}": read, f"flat_{projector}": found[-1].field}
    return _found(found, readings)


def _found(found: list[FlatReading], readings: dict[str, np.ndarray]) -> CalibrationResult:
    numbers = {
        "dimmest": [each.dimmest for each in found], "error": [each.error for each in found],
        "left": [each.left for each in found], "noise": [each.noise for each in found],
    }  # fmt: skip
    lines = tuple(
        (f"projector {number}", f"dimmest mirror {100 * each.dimmest:.2f} ± {100 * each.error:.2g} % of the brightest")
        for number, each in enumerate(found)
    )
    return CalibrationResult("flat", numbers, readings, lines, lambda axes: _draw(axes, found[0].field))


def _draw(axes: Any, field: np.ndarray) -> None:
    shown = axes.imshow(field, cmap="viridis", aspect="equal")
    axes.grid(False)
    axes.figure.colorbar(shown, ax=axes, shrink=0.7)
    axes.set(title="Light of full-on mirrors over that of the brightest", xlabel="column", ylabel="row")
