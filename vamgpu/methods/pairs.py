"""The history of a limited-memory quasi-Newton method, as long as the device's memory allows."""

from __future__ import annotations

import warnings

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import MemoryNotice, OutOfMemory
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import dot, dots


class Pairs:
    """Differences of light and of gradient with 1 / their product, oldest first; the open pair has previous values."""

    state: OptimizerState
    most: int
    most_bytes: int | None
    step: DeviceArray
    change: DeviceArray

    def __init__(self, state: OptimizerState, most: int, most_bytes: int | None) -> None:
        self.state, self.most, self.most_bytes = state, most, most_bytes
        self.kept: list[tuple[DeviceArray, DeviceArray, float]] = state.memory.setdefault("pairs kept", [])
        self.used: int = 0
        self.step = self.change = state.buffer("light")  # until open()
        self._spare: list[DeviceArray] = []

    def direct(self, out: DeviceArray) -> None:
        """out = the quasi-Newton direction of descent; dark light is held."""
        state = self.state
        state.scale(1.0, state.buffer("gradient"), out)
        state.apply_penalty(state.buffer("light"), out)
        self.used = len(self.kept)
        shares = []
        for step, change, inverse in reversed(self.kept):
            shares.append(inverse * dot(step, out))
            combine(1.0, out, -shares[-1], change, out)
        if self.kept:
            _, change, inverse = self.kept[-1]
            state.scale(1.0 / (inverse * dot(change, change)), out, out)
        for (step, change, inverse), share in zip(self.kept, reversed(shares), strict=True):
            combine(1.0, out, share - inverse * dot(change, out), step, out)
        state.scale(-1.0, out, out)

    def open(self) -> None:
        """Make space for the next pair: new arrays, or those of the oldest pair."""
        if not self._spare and len(self.kept) < self.most:
            self._allocate()
        if not self._spare:
            self._spare = list(self.kept.pop(0)[:2])
        self.step, self.change = self._spare

    def _allocate(self) -> None:
        count = len(self.kept) + 1
        need = 2 * count * self.state.buffer("light").nbytes
        try:
            if self.most_bytes is not None and need > self.most_bytes and self.kept:
                raise OutOfMemory(f"{count} pairs need {need} bytes; {self.most_bytes} are allowed")
            self._spare = [self.state.sinogram(), self.state.sinogram()]
        except OutOfMemory as error:
            self._spare = []
            if not self.kept:
                raise
            self.most = len(self.kept)
            warnings.warn(f"the history stops at {self.most} pairs: {error}", MemoryNotice, stacklevel=2)

    def close(self, light: DeviceArray, gradient: DeviceArray) -> None:
        """Complete the pair with the light and gradient after the step; keep it if its curvature is positive."""
        combine(1.0, light, -1.0, self.step, self.step)
        combine(1.0, gradient, -1.0, self.change, self.change)
        step, change = self.step, self.change
        product, of_step, of_change = dots((step, change), (step, step), (change, change))
        if product > 1e-10 * (of_step * of_change) ** 0.5:
            self.kept.append((self.step, self.change, 1.0 / product))
            self._spare = []

    def forget(self) -> None:
        """Drop the history, but keep the arrays of the current pair."""
        self.kept.clear()
