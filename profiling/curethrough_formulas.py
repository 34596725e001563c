"""Formulas of cure-through that draw its pages, and that the streamed dose is compared with."""

from __future__ import annotations

from collections.abc import Iterator
from math import log10
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.curethrough.dose import RunningDose, Stack, blocks
from vamgpu.curethrough.printer import Machine


def highest_place(upper: float, lower: float, phi_min: float, phi_max: float, eta: float) -> float:
    """ζ*, where curves ii and iii meet (S39)."""
    delta = lower - upper
    low = (1.0 - phi_min) - (1.0 - phi_max) * 10.0 ** (-delta * eta)
    return upper + log10((phi_max - phi_min) / low) / eta


def highest_dose(delta: Any, phi_min: float, phi_max: float, eta: float) -> np.ndarray:
    """Ω*, the most dose within a feature ``delta`` slices high (S42)."""
    fade = 10.0 ** (-np.asarray(delta, dtype=np.float64) * eta)
    room = (1.0 - phi_min) - (1.0 - phi_max) * fade
    return (1.0 - phi_min) * (phi_max - phi_min) / room + phi_min


def doses(
    machine: Machine, stack: Stack, device: str | Device | None = None, fraction: float = 0.0
) -> Iterator[tuple[int, np.ndarray]]:
    """(start, Ω [slice, y, x]) of every block, the last first. Raises `BadInput`."""
    exposure = RunningDose(machine, stack.shape[1:], device)  # type: ignore[arg-type]
    for start, stop in blocks(stack.shape[0]):
        yield start, exposure.step(stack[start:stop], fraction).numpy()


def closed_sum(machine: Machine, levels: Any, zeta: float) -> np.ndarray:
    """Ω(ζ) of columns of gray levels [slice, …], as the sum over slices (S13, S23 with its sign corrected, S48)."""
    column = np.asarray(levels)
    n = np.arange(len(column)).reshape(-1, *[1] * (column.ndim - 1))
    if machine.layered:
        share = np.where(n >= np.ceil(zeta), 10.0 ** (-(n - zeta) * machine.eta), 0.0)
        return (machine.doses[column] * share).sum(axis=0)
    far = 10.0 ** (-(n + 1 - zeta) * machine.eta)
    share = np.where(n >= zeta, 10.0 ** (-np.maximum(n - zeta, 0.0) * machine.eta) - far, 1.0 - far)
    return (machine.doses[column] / machine.decay * np.where(n >= np.floor(zeta), share, 0.0)).sum(axis=0)
