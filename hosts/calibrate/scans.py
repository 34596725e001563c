"""Scans of calibrations: readings of one pattern after another, and images at one position after another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate.machines import CalibrationLight, CalibrationMachines

T = TypeVar("T")
Progress = Callable[[float], None]
Read = Callable[[CalibrationLight, int], np.ndarray]
"""Takes so many readings under a light."""


def silent(share: float) -> None:
    """Progress that nobody follows."""


def part_of(progress: Progress, number: int, count: int) -> Progress:
    """The progress of one of so many measurements that are made one after the other."""
    return lambda share: progress((number + share) / count)


def over_patterns(
    machines: CalibrationMachines, projector: int, patterns: Iterable[np.ndarray], count: int, read: Read,
    repeats: int, progress: Progress, *, darks: int | None = None, black: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Readings in the dark, or under a black pattern, and those of each of so many patterns [pattern, repeat]."""
    screen, found = machines.screen(projector), []
    with CalibrationLight(machines, projector) as light:
        if black is None:
            dark = read(light, darks or repeats)
            light.on()
        else:
            light.on()
            screen.show(black)
            dark = read(light, repeats)
        for number, pattern in enumerate(patterns):
            screen.show(pattern)
            found.append(read(light, repeats))
            progress((number + 1) / count)
    return dark, np.array(found)


def over_positions(
    machines: CalibrationMachines, projector: int, positions: Sequence[float], pattern: np.ndarray,
    act: Callable[[CalibrationLight, float], T], progress: Progress,
) -> list[T]:  # fmt: skip
    """What ``act`` returns under a lit pattern at each of the camera's positions [mm], reached in the dark."""
    screen, found = machines.screen(projector), []
    with CalibrationLight(machines, projector) as light:
        for number, position in enumerate(positions):
            light.off()
            place = machines.move(position)
            light.on()
            screen.show(pattern)
            try:
                found.append(act(light, place))
            except BadInput as error:
                raise BadInput(f"position {place:g} mm: {error}") from error
            progress((number + 1) / len(positions))
    return found
