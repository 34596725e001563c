"""Dose of a print from its slices: whole stacks in blocks on a device, single columns at any height in float64."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from vamgpu.backend import DeviceArray, open_device
from vamgpu.backend.device import Device
from vamgpu.curethrough.printer import Machine
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.kernels.curethrough import BITS, expose_slices, judge_slices, pack_slices

STRIP = 320  # number of pixels of a row that an item of a processor computes


class Stack(Protocol):
    """Slices that can be read in any order: ``stack[a:b]`` is uint8 [slice, y, x]; NumPy arrays are stacks too."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Slices, y, x."""
        ...

    def __getitem__(self, key: slice, /) -> np.ndarray: ...


def blocks(slices: int) -> Iterator[tuple[int, int]]:
    """(start, stop) of the blocks of a stack, the last first; they start at multiples of 32."""
    for start in range((slices - 1) // BITS * BITS, -1, -BITS):
        yield start, min(start + BITS, slices)


def strips(device: Device, width: int) -> int:
    """Number of items that divide a row: one per pixel on GPUs."""
    gpu = "cuda" in device.name or bool(getattr(device, "is_gpu", False))
    return width if gpu else max(1, round(width / STRIP))


def checked(levels: Any, shape: tuple[int, int]) -> np.ndarray:
    """A checked block of slices; raises `BadInput` or `ShapeMismatch`."""
    block = np.asarray(levels)
    if block.dtype != np.uint8:
        raise BadInput(f"slices hold {block.dtype}; expected 8-bit gray levels (uint8)")
    if block.ndim != 3 or block.shape[1:] != shape or not 1 <= len(block) <= BITS:
        raise ShapeMismatch(f"a block has shape {block.shape}; expected [1 to {BITS} slices, {shape[0]}, {shape[1]}]")
    return block


def lent(device: Device, levels: Any, shape: tuple[int, int]) -> DeviceArray:
    """A block of slices on the device, copied if necessary; raises `BadInput` for an invalid block."""
    return levels if isinstance(levels, DeviceArray) else device.borrow(np.ascontiguousarray(checked(levels, shape)))


class RunningDose:
    """The running dose of a stack that passes block by block, the last block first."""

    machine: Machine
    shape: tuple[int, int]  # pixels (y, x)
    device: Device

    def __init__(self, machine: Machine, shape: tuple[int, int], device: str | Device | None = None) -> None:
        self.machine, self.shape, self.device = machine, shape, open_device(device)
        self.light: DeviceArray = self.device.table(machine.doses)
        self.state: DeviceArray = self.device.table(np.zeros((2, *shape), np.float32))
        self._peaks = self.device.table(np.zeros((shape[0], strips(self.device, shape[1]))))
        self._doses: DeviceArray | None = None

    def step(self, levels: Any, fraction: float = 0.0, keep: int | None = None) -> DeviceArray:
        """Ω [slice, y, x] of the next block, uint8 of at most 32 slices; overwritten by the next. Raises `BadInput`."""
        block = lent(self.device, levels, self.shape)
        part, fade = self.machine.between(fraction)
        kept = block.shape[0] if keep is None else max(1, min(keep, block.shape[0]))
        if self._doses is None or self._doses.shape[0] != kept:
            self._doses = self.device.empty((kept, *self.shape), self.device.real, table=True)
        self.device.launch(
            expose_slices, levels=block, light=self.light, decay=self.machine.decay, part=part, fade=fade,
            state=self.state, doses=self._doses, peaks=self._peaks,
        )  # fmt: skip
        self.device.synchronize()  # the caller may reuse the block's memory
        return self._doses

    def dose(self) -> np.ndarray:
        """Ω at the border where the last block begins; [y, x]."""
        return self.state.numpy()[0]


class Judge:
    """Cured height of the void and uncured height of the part, summed over a stack in reverse order of blocks."""

    machine: Machine
    shape: tuple[int, int]
    device: Device
    state: DeviceArray
    heights: DeviceArray

    def __init__(self, machine: Machine, shape: tuple[int, int], device: str | Device | None = None) -> None:
        self.machine, self.shape, self.device = machine, shape, open_device(device)
        self.light: DeviceArray = self.device.table(machine.doses)
        self.state, self.heights = (self.device.table(np.zeros((2, *shape), np.float32)) for _ in range(2))
        count = strips(self.device, shape[1])
        self._peaks = self.device.table(np.zeros((shape[0], count)))
        self._solid = self.device.table(np.zeros((shape[0], count)), "int32")
        self._words = self.device.table(np.zeros((1, *shape)), "uint32")

    def step(self, levels: Any, target: Any, threshold: int = 128) -> None:
        """Add a block: the slices shown, and those of the part, solid from ``threshold`` on; uint8 [slice, y, x]."""
        pictures = [lent(self.device, part, self.shape) for part in (levels, target)]
        self.device.launch(
            pack_slices, levels=pictures[1], threshold=threshold, block=0, words=self._words, solid=self._solid
        )
        self.add(pictures[0], self._words, 0)
        self.device.synchronize()

    def add(self, levels: DeviceArray, words: DeviceArray, block: int) -> None:
        """Add a block whose part is already packed in a ring buffer on the device."""
        machine = self.machine
        self.device.launch(
            judge_slices, levels=levels, words=words, block=block, light=self.light, decay=machine.decay,
            scale=machine.fade_scale, layered=int(machine.layered), critical=1.0, state=self.state,
            heights=self.heights, peaks=self._peaks,
        )  # fmt: skip

    def over(self) -> np.ndarray:
        """Cured height of the void [mm] at every pixel; [y, x]."""
        return self.heights.numpy()[0] * self.machine.slice_height

    def under(self) -> np.ndarray:
        """Uncured height of the part [mm] at every pixel; [y, x]."""
        return self.heights.numpy()[1] * self.machine.slice_height


def column_doses(machine: Machine, levels: Any) -> np.ndarray:
    """Ω at the borders ζ = 0, 1, … N + 1 of columns of gray levels [slice, …], by recursion in float64 (S14, S48)."""
    added = machine.doses[np.asarray(levels)]
    out = np.zeros((len(added) + 1, *added.shape[1:]))
    for n in range(len(added) - 1, -1, -1):
        out[n] = out[n + 1] + (added[n] - machine.decay * out[n + 1])
    return out


def column_dose(machine: Machine, levels: Any, zeta: Any) -> np.ndarray:
    """Ω(ζ) of one column of gray levels [slice] at any real ζ from 0 to N + 1 (S22, S48), float64."""
    places, borders = np.asarray(zeta, dtype=np.float64), column_doses(machine, np.asarray(levels))
    last = len(borders) - 2
    if machine.layered:
        n = np.clip(np.ceil(places), 0, last + 1).astype(int)
        return borders[n] * 10.0 ** (-(n - places) * machine.eta)
    n = np.clip(np.floor(places), 0, last).astype(int)
    phi = machine.doses[np.asarray(levels)] / machine.decay
    fade = 10.0 ** (-(n + 1 - places) * machine.eta)
    return phi[n] + (borders[n + 1] - phi[n]) * fade
