"""Mirrors that show one picture for as long as is wanted, by their own clock."""

from __future__ import annotations

from math import ceil

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.dmd import Dmd, Sequence, SlotTiming


class Screen:
    """One picture at a time on an array of mirrors, again and again. picture: time of one of gray levels [s].

    It is a switch too: `off` lets the mirrors go dark.
    """

    def __init__(self, dmd: Dmd, picture: float) -> None:
        self.dmd = dmd
        self.shape = (dmd.height, dmd.width)
        self._period = ceil(picture * 1e6 - 1e-6)
        self._sequence: Sequence | None = None

    @property
    def period(self) -> float:
        """Time of a picture of gray levels [s]."""
        return 1e-6 * self._period

    def show(self, picture: np.ndarray) -> None:
        """Show a picture [row, column] from now on: bool for mirrors on and off, uint8 for gray levels."""
        if picture.shape != self.shape or picture.dtype not in (np.bool_, np.uint8):
            raise BadInput(
                f"the picture is {picture.dtype}{list(picture.shape)}; wanted bool or uint8 of {list(self.shape)}"
            )
        self.off()
        bits = 1 if picture.dtype == np.bool_ else 8
        self.dmd.master()
        self._sequence = self.dmd.sequence(1, bits, SlotTiming() if bits == 1 else SlotTiming(self._period))
        self._sequence.put(self._planes(picture, bits))
        self._sequence.start(forever=True)

    def _planes(self, picture: np.ndarray, bits: int) -> np.ndarray:
        planes = np.zeros((1, bits, *self.dmd.plane_shape), np.uint8)
        for plane in range(bits):
            lit = np.packbits(picture if bits == 1 else picture >> (7 - plane) & 1, axis=-1)
            planes[0, plane, :, : lit.shape[1]] = lit
        return planes

    def off(self) -> None:
        """Show nothing."""
        self.dmd.halt()
        sequence, self._sequence = self._sequence, None
        if sequence is not None:
            sequence.free()
