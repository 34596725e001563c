"""Gray levels that give both sides of every feature the critical dose (Pritchard et al. 2019, section SI.1).

From the last slice to the first, light in the void behind a feature builds up its dose, which decays to its front.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vamgpu.backend import DeviceArray, open_device
from vamgpu.backend.device import Device
from vamgpu.curethrough.dose import Stack, blocks, lent, strips
from vamgpu.curethrough.printer import Machine
from vamgpu.curethrough.profile import Flat, Profile
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.kernels.curethrough import BITS, pack_slices
from vamgpu.kernels.levels import NEVER, correct_slices

BINS = 1024
MOST_TAIL = 1 << 16


@dataclass(frozen=True)
class Correction:
    """Settings of a correction.

    Args:
        machine: `Printer` or `LayerPrinter`.
        profile: Dose inside features.
        tail: Slices added after the last; None adds as many as the last slice's back side needs.
        threshold: Gray level from which a pixel is solid.
        platform: The first slice adheres to the platform, and nothing above it can be cured through.
        dither: Neighboring pixels aim up to half a level higher or lower.
        open_dose: Ω, a dose in critical doses, below which a void counts as open; None uses the machine's.

    Raises:
        BadInput: A value is of another type or out of range, or no correction is possible with this machine.
    """

    machine: Machine
    profile: Profile = field(default_factory=Flat)
    tail: int | None = None
    threshold: int = 128
    platform: bool = True
    dither: bool = False
    open_dose: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.threshold, (int, np.integer)) or not 1 <= self.threshold <= 255:
            raise BadInput(f"threshold is {self.threshold!r}; expected a gray level from 1 to 255")
        if self.tail is not None and not (isinstance(self.tail, (int, np.integer)) and 0 <= self.tail <= MOST_TAIL):
            raise BadInput(f"tail is {self.tail!r}; expected a whole number of slices, 0 to {MOST_TAIL:,}")
        if not isinstance(self.machine, Machine):
            raise BadInput(f"machine is {self.machine!r}; expected a Printer or a LayerPrinter")
        self.machine.targets(self.profile)

    @property
    def added(self) -> int:
        """Slices shown after the last of the part."""
        return self.machine.tail if self.tail is None else self.tail

    @property
    def spread(self) -> float:
        """Difference in Ω between the aims of neighboring pixels: one level."""
        return float(np.diff(self.machine.doses).mean()) if self.dither else 0.0

    @property
    def tolerance(self) -> float:
        """Ω by which gray levels may miss the constraint curves."""
        return self.machine.tolerance + 0.5 * self.spread + 1e-6


@dataclass(frozen=True, eq=False)
class Corrected:
    """A block of slices to show, uint8 [slice, y, x] from slice ``start`` on; overwritten by the next."""

    start: int
    table: DeviceArray
    words: DeviceArray  # ring buffer of the solid slices of block ``start`` / 32, for `Judge.add`

    @property
    def levels(self) -> np.ndarray:
        """The slices as a NumPy array."""
        return self.table.numpy()


class Corrector:
    """A correction that runs through a stack [slice, y, x] from its last block to its first."""

    correction: Correction
    shape: tuple[int, ...]  # slices, y, x of the part; ``slices`` counts those to show, tail included
    device: Device

    def __init__(self, correction: Correction, shape: tuple[int, ...], device: str | Device | None = None) -> None:
        if len(shape) != 3 or min(shape) < 1:
            raise ShapeMismatch(f"the stack has shape {shape}; expected [slices, y, x]")
        self.correction, self.shape, self.device = correction, shape, open_device(device)
        self.slices: int = shape[0] + correction.added
        machine, put = correction.machine, self.device.table
        targets = machine.targets(correction.profile)
        self._tables = {"light": put(machine.doses), "inner": put(targets.inner), "back": put(targets.back),
                        **_inverse(machine.doses, put)}  # fmt: skip
        plane = shape[1:]
        self._ring = self.device.table(np.zeros((1 + -(-targets.horizon // BITS), *plane)), "uint32")
        self._state = put(np.zeros((4, *plane), np.float32))
        self.flaws: DeviceArray = put(np.zeros((2, *plane), np.int32), "int32")
        count = strips(self.device, plane[1])
        self._counts = put(np.zeros((plane[0], count)), "int32")

    @property
    def missed(self) -> np.ndarray:
        """Number of features at every pixel whose back side did not get its dose; int32 [y, x]."""
        return self.flaws.numpy()[0]

    @property
    def closed(self) -> np.ndarray:
        """Number of voids at every pixel that stay above the dose of an open void; int32 [y, x]."""
        return self.flaws.numpy()[1]

    def run(self, stack: Stack) -> Iterator[Corrected]:
        """Blocks to show, the last first; every slice of the stack is read once. Raises `BadInput`."""
        if tuple(stack.shape) != tuple(self.shape):
            raise ShapeMismatch(f"the stack has shape {tuple(stack.shape)}; this corrector is for {tuple(self.shape)}")
        read = -(-self.slices // BITS)
        tables: dict[int, DeviceArray] = {}
        for start, stop in blocks(self.slices):
            block = start // BITS
            while read > max(0, block + 1 - self._ring.shape[0]):
                read -= 1
                self._pack(read, stack[read * BITS : min((read + 1) * BITS, self.shape[0])])
            if stop - start not in tables:
                tables[stop - start] = self.device.empty((stop - start, *self.shape[1:]), np.uint8, table=True)
            yield self._correct(block, tables[stop - start])

    def _pack(self, block: int, levels: np.ndarray) -> None:
        plane = self.shape[1:]
        if len(levels) == 0:  # beyond the part
            levels = np.zeros((1, *plane), np.uint8)
        self.device.launch(
            pack_slices, levels=lent(self.device, levels, plane), threshold=self.correction.threshold,  # type: ignore
            block=block, words=self._ring, solid=self._counts,
        )  # fmt: skip
        self.device.synchronize()

    def _correct(self, block: int, levels: DeviceArray) -> Corrected:
        correction = self.correction
        machine = correction.machine
        opened = machine.opened if correction.open_dose is None else correction.open_dose
        self.device.launch(
            correct_slices, words=self._ring, block=block, **self._tables, decay=machine.decay,
            platform=int(correction.platform), reached=machine.reached - 0.5 * correction.spread, opened=opened,
            spread=correction.spread, state=self._state, flaws=self.flaws, levels=levels, missed=self._counts,
        )  # fmt: skip
        return Corrected(block * BITS, levels, self._ring)


def correct(correction: Correction, levels: np.ndarray, device: str | Device | None = None) -> np.ndarray:
    """The slices to show for a whole stack in memory, uint8 [slice + tail, y, x]. Raises `BadInput`."""
    if not isinstance(levels, np.ndarray):
        raise BadInput(f"slices are {type(levels).__name__}; expected a NumPy array, uint8 [slice, y, x]")
    corrector = Corrector(correction, levels.shape, device)
    out = np.empty((corrector.slices, *levels.shape[1:]), np.uint8)
    for block in corrector.run(levels):
        block.table.numpy(out[block.start : block.start + block.table.shape[0]])
    return out


def _inverse(doses: np.ndarray, put: Callable[..., DeviceArray]) -> dict[str, Any]:
    """Tables for finding the level nearest to a dose."""
    edges = np.append(0.5 * (doses[1:] + doses[:-1]), NEVER)
    bins = BINS / (doses[-1] - doses[0])
    starts = doses[0] + (np.arange(BINS) - 1e-2) / bins
    first = np.searchsorted(edges, starts, side="left")
    return {"edges": put(edges), "first": put(first, "uint8"), "bins": bins}
