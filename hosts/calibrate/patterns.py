"""Patterns for calibrations, and mirrors or projectors that repeat one pattern."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import counts
from vamgpu.hosts.drivers.dmd import Dmd, PlaneSequence, SlotTiming
from vamgpu.hosts.drivers.projector import HdmiProjector

Shape = tuple[int, int]
SURE = 2  # video frames beyond a projector's delay for which a pattern is sent before it counts as lit


def grating(shape: Shape, half_period: int = 10) -> np.ndarray:
    """A Ronchi grating: ``half_period`` columns on, then as many off."""
    wide = counts("half period [columns]", (half_period,), 1)[0]
    if not 2 * wide <= shape[1]:
        raise BadInput(f"half a period of {wide} columns; expected at most half of the mirrors' {shape[1]}")
    return np.broadcast_to(np.arange(shape[1]) // wide % 2 == 0, shape)


def line(shape: Shape, column: int) -> np.ndarray:
    """One column on."""
    if not 0 <= column < shape[1]:
        raise BadInput(f"column {column} of {shape[1]}; expected 0 to {shape[1] - 1}")
    return np.broadcast_to(np.arange(shape[1]) == column, shape)


def slanted(shape: Shape, angle: float = 5.0) -> np.ndarray:
    """An edge through the middle, ``angle`` [deg] from the columns; its right side is lit."""
    if not 1.0 <= abs(angle) <= 40.0:
        raise BadInput(f"an edge slanted by {angle:g}°; expected 1° to 40° from the columns")
    row, column = (np.arange(length) - 0.5 * (length - 1) for length in shape)
    return column[None, :] > np.tan(np.radians(angle)) * row[:, None]


def block(shape: Shape, rows: Sequence[int] | np.ndarray, columns: Sequence[int] | np.ndarray) -> np.ndarray:
    """A block of mirrors on, between rows and between columns."""
    lit = np.zeros(shape, bool)
    lit[rows[0] : rows[1], columns[0] : columns[1]] = True
    return lit


def flat(shape: Shape, level: int) -> np.ndarray:
    """The same gray level everywhere."""
    if not 0 <= level <= 255:
        raise BadInput(f"gray level {level}; expected 0 to 255")
    return np.full(shape, level, np.uint8)


def _checked(pattern: np.ndarray, shape: Shape) -> np.ndarray:
    """The pattern, bool or uint8 [row, column]. Raises `BadInput` for another type or shape."""
    if pattern.shape != shape or pattern.dtype not in (np.bool_, np.uint8):
        raise BadInput(f"the pattern is {pattern.dtype}{list(pattern.shape)}; expected bool or uint8 of {list(shape)}")
    return pattern


class VideoScreen:
    """A projector on a video cable that repeats one pattern in all slots of its video frames; `off` turns it dark."""

    def __init__(self, projector: HdmiProjector) -> None:
        self.projector = projector
        self.shape: Shape = projector.size

    @property
    def period(self) -> float:
        """Time of a video frame [s]."""
        return 1.0 / self.projector.window.rate_hz

    def show(self, pattern: np.ndarray) -> None:
        """Show a pattern [row, column] as `PatternScreen` does, and return once it alone is lit."""
        lit = _checked(pattern, self.shape)
        level = lit if lit.dtype == np.uint8 else np.where(lit, 255, 0).astype(np.uint8)
        for _ in range(self.projector.latency + SURE):
            self.projector.show([level] * self.projector.layout.slots)

    def off(self) -> None:
        """Show black."""
        self.projector.black()


class PatternScreen:
    """An array of mirrors that repeats one pattern, with a time [s] for gray levels; `off` turns it dark."""

    def __init__(self, dmd: Dmd, pattern: float) -> None:
        self.dmd = dmd
        self.shape: tuple[int, int] = (dmd.height, dmd.width)
        self._period = ceil(pattern * 1e6 - 1e-6)
        self._sequence: PlaneSequence | None = None

    @property
    def period(self) -> float:
        """Time of a pattern of gray levels [s]."""
        return 1e-6 * self._period

    def show(self, pattern: np.ndarray) -> None:
        """Show a pattern [row, column] from now on: bool for mirrors on and off, uint8 for gray levels."""
        pattern = _checked(pattern, self.shape)
        self.off()
        bits = 1 if pattern.dtype == np.bool_ else 8
        self.dmd.master()
        self._sequence = self.dmd.sequence(1, bits, SlotTiming() if bits == 1 else SlotTiming(self._period))
        self._sequence.put(self._planes(pattern, bits))
        self._sequence.start(forever=True)

    def _planes(self, pattern: np.ndarray, bits: int) -> np.ndarray:
        planes = np.zeros((1, bits, *self.dmd.plane_shape), np.uint8)
        for plane in range(bits):
            lit = np.packbits(pattern if bits == 1 else pattern >> (7 - plane) & 1, axis=-1)
            planes[0, plane, :, : lit.shape[1]] = lit
        return planes

    def off(self) -> None:
        """Show nothing."""
        self.dmd.halt()
        sequence, self._sequence = self._sequence, None
        if sequence is not None:
            sequence.free()
