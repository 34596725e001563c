"""Flat field of each projector: blocks of mirrors are lit one after another."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.calibration.flat import FlatReading, cuts, fit_flat
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import CalibrationMachines, Progress, over_patterns, part_of, silent
from vamgpu.hosts.calibrate.report import CalibrationResult

TABLES = ("photodiode",)  # tables of a rig's file that it needs
BLOCKS = (8, 12)


def flat(
    machines: CalibrationMachines, blocks: tuple[int, int] = BLOCKS, *, repeats: int = 4,
    progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure each projector's flat field with a photodiode that collects all of its light, with no roller in place."""
    if repeats < 2:
        raise BadInput(f"{repeats} readings of each block; expected 2 or more, to estimate their error")
    found: list[FlatReading] = []
    readings: dict[str, np.ndarray] = {}
    for projector, screen in enumerate(machines.screens):
        down, across = (cuts(length, count) for length, count in zip(screen.shape, blocks, strict=True))
        lit = (
            patterns.block(screen.shape, down[row : row + 2], across[column : column + 2])
            for row, column in np.ndindex(*blocks)
        )
        part = part_of(progress, projector, len(machines.screens))
        black = patterns.block(screen.shape, (0, 0), (0, 0))  # some light of mirrors that are off reaches the meter
        dark, read = over_patterns(
            machines, projector, lit, blocks[0] * blocks[1], machines.read, repeats, part, black=black
        )
        read = read.reshape(*blocks, repeats)
        found.append(fit_flat(read, dark, screen.shape))
        readings |= {f"dark_{projector}": dark, f"readings_{projector}": read, f"flat_{projector}": found[-1].field}
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
    axes.set(title="Light of full-on mirrors / brightest", xlabel="column", ylabel="row")
