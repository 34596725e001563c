"""Mirror arrays on Vialux's ALP controllers: sequences of packed bit planes, shown one per trigger."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from ctypes import byref
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from vamgpu.errors import BadInput, DeviceBusy, DeviceRefused, OutOfMemory, WrongDevice
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.alp import Alp, Progress, SynchGate
from vamgpu.hosts.drivers.cleanup import ClosedOnce, closed_on_error

log: logging.Logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SlotTiming:
    """The times of a frame [us]: period, and lit time (0: as long as possible)."""

    picture_us: int = 0
    illuminate_us: int = 0


@dataclass(frozen=True)
class SequenceLimits:
    """Limits of the device at a sequence's bit depth [us]."""

    least_picture_us: int
    greatest_picture_us: int
    on_us: int


class Dmd(ClosedOnce):
    """An array of mirrors. rising: edge of its trigger."""

    called = "the DMD"

    def __init__(self, library: Any, serial: int = 0, size: tuple[int, int] | None = None, rising: bool = True) -> None:
        self._rising = rising
        self._alp = Alp(library)
        self.device: int = self._alp.number("AlpDevAlloc", serial, alp.DEFAULT)
        with closed_on_error(self):
            self.width: int = self.inquire(alp.DISPLAY_WIDTH)
            self.height: int = self.inquire(alp.DISPLAY_HEIGHT)
            self.serial: int = self.inquire(alp.DEVICE_NUMBER)
            if size is not None and size != (self.height, self.width):
                raise WrongDevice(f"the array has {self.height} x {self.width} mirrors; expected {size[0]} x {size[1]}")
        log.info("DMD %d: %d x %d, %d planes free", self.serial, self.height, self.width, self.free_planes())

    @classmethod
    def open(cls, path: str | Path, serial: int = 0, size: tuple[int, int] | None = None, rising: bool = True) -> Self:
        """Open the device with a serial number (0: the first) through the maker's library at ``path``."""
        return cls(alp.load(path), serial, size, rising)

    @property
    def row_bytes(self) -> int:
        """Bytes of one row of a packed plane: 1920 columns are padded to 2048."""
        return 256 if self.width == 1920 else self.width // 8

    @property
    def plane_shape(self) -> tuple[int, int]:
        """Rows, and bytes per row, of a packed plane; bit 7 of a byte is the leftmost of its eight mirrors."""
        return self.height, self.row_bytes

    def call(self, name: str, *arguments: Any) -> None:
        """Call the library for this device."""
        self._alp.call(name, self.device, *arguments)

    def inquire(self, kind: int) -> int:
        return self._alp.number("AlpDevInquire", self.device, kind)

    def free_planes(self) -> int:
        """Bit planes that fit now."""
        return self.inquire(alp.AVAILABLE_MEMORY)

    def slave(self) -> None:
        """Show the next frame of the queue at each edge of the trigger, without a timeout."""
        self.call("AlpDevControl", alp.TRIGGER_EDGE, alp.EDGE_RISING if self._rising else alp.EDGE_FALLING)
        self.call("AlpDevControl", alp.TRIGGER_TIME_OUT, alp.TIME_OUT_DISABLE)
        self.call("AlpProjControl", alp.PROJECTION_MODE, alp.SLAVE)
        self.call("AlpProjControl", alp.QUEUE_MODE, alp.QUEUE_SEQUENCES)

    def pulse(self, outputs: Sequence[int], high: bool = True) -> None:
        """Pulse the gated synch outputs 1 to 3 of these numbers with every frame; the others are not driven."""
        for number in (1, 2, 3):
            gate = SynchGate(int(number in outputs), int(high), (1,))
            self.call("AlpDevControlEx", alp.GATE_BEFORE_FIRST + number, byref(gate))

    def master(self) -> None:
        """Show frames by the device's own clock, in a queue."""
        self.call("AlpProjControl", alp.PROJECTION_MODE, alp.MASTER)
        self.call("AlpProjControl", alp.QUEUE_MODE, alp.QUEUE_SEQUENCES)

    def progress(self) -> Progress:
        answer = Progress()
        self.call("AlpProjInquireEx", alp.PROGRESS, byref(answer))
        return answer

    def queue_places(self) -> int:
        """Sequences that fit in the queue now."""
        return self.number("AlpProjInquire", alp.QUEUE_AVAILABLE)

    def sequence(self, count: int, bits: int, timing: SlotTiming = SlotTiming()) -> PlaneSequence:
        """Room for ``count`` frames of ``bits`` planes; OutOfMemory with the numbers if there is none."""
        free = self.free_planes()
        if count * bits > free:
            raise OutOfMemory(
                f"{count} frames of {bits} bits are {count * bits} planes, and {free} are free; "
                "stream them through two shorter sequences, or show fewer bits"
            )
        return PlaneSequence(self, count, bits, timing)

    def number(self, name: str, *arguments: Any) -> int:
        """Call the library for this device and return its number."""
        return self._alp.number(name, self.device, *arguments)

    def halt(self) -> None:
        """Stop showing, at once; the mirrors go dark."""
        self.call("AlpProjHalt")
        self.call("AlpDevHalt")

    def off(self) -> None:
        """Turn the mirrors dark, as a switch of the light."""
        self.halt()

    def endings(self) -> tuple[Callable[[], object], ...]:
        return (
            partial(self.call, "AlpProjHalt"),
            partial(self.call, "AlpDevHalt"),
            partial(self.call, "AlpDevControl", alp.DMD_MODE, alp.DMD_FLOAT),
            partial(self.call, "AlpDevFree"),
        )


class PlaneSequence:
    """Frames in the device's memory, as packed planes, the most significant first."""

    def __init__(self, dmd: Dmd, count: int, bits: int, timing: SlotTiming) -> None:
        if not 1 <= bits <= 8 or count < 1:
            raise BadInput(f"a sequence of {count} frames of {bits} bits is impossible; give 1..8 bits and 1 or more")
        self.dmd = dmd
        self.count = count
        self.bits = bits
        self.id: int = dmd.number("AlpSeqAlloc", bits, count)
        self._control(alp.DATA_FORMAT, alp.DATA_BINARY_TOPDOWN)
        if bits == 1 and not timing.illuminate_us:
            self._control(alp.BINARY_MODE, alp.BINARY_UNINTERRUPTED)
        self.retime(timing)

    def _control(self, kind: int, value: int) -> None:
        self.dmd.call("AlpSeqControl", self.id, kind, value)

    def inquire(self, kind: int) -> int:
        return self.dmd.number("AlpSeqInquire", self.id, kind)

    def limits(self) -> SequenceLimits:
        """The device's limits for these frames, and their present lit time."""
        kinds = (alp.MIN_PICTURE_TIME, alp.MAX_PICTURE_TIME, alp.ON_TIME)
        return SequenceLimits(*(self.inquire(kind) for kind in kinds))

    def retime(self, timing: SlotTiming) -> None:
        """Set the times; DeviceRefused with the device's limits if they do not fit."""
        try:
            self.dmd.call("AlpSeqTiming", self.id, timing.illuminate_us, timing.picture_us, 0, 0, 0)
        except DeviceRefused as error:
            raise DeviceRefused(f"{timing} does not fit the device's {self.limits()}: {error}", error.code) from error

    def put(self, planes: np.ndarray, first: int = 0) -> None:
        """Upload packed frames ``[frame, plane, row, byte]`` (uint8) from frame ``first`` on, without a copy."""
        expected = (self.bits, *self.dmd.plane_shape)
        if planes.dtype != np.uint8 or planes.shape[1:] != expected or not planes.flags.c_contiguous:
            raise BadInput(
                f"packed frames are a contiguous uint8 array [frame, {expected[0]}, {expected[1]}, {expected[2]}], "
                f"not {planes.dtype}{list(planes.shape)}"
            )
        if first < 0 or first + len(planes) > self.count:
            raise BadInput(f"frames {first}..{first + len(planes) - 1} do not fit a sequence of {self.count}")
        self.dmd.call("AlpSeqPut", self.id, first, len(planes), planes.ctypes.data)

    def start(self, shown: int | None = None, forever: bool = False) -> None:
        """Put the first ``shown`` frames (None: all) at the end of the queue; `DeviceRefused` if it is full."""
        self._control(alp.LAST_FRAME, (self.count if shown is None else shown) - 1)
        try:
            self.dmd.call("AlpProjStartCont" if forever else "AlpProjStart", self.id)
        except DeviceBusy as error:  # the library has one number for this and for a device in use by another program
            raise DeviceRefused(
                f"the mirrors' queue is full ({self.dmd.queue_places()} places are free): check for free "
                "places before each start, and halt endless sequences",
                str(alp.NOT_READY),
            ) from error

    def free(self) -> None:
        self.dmd.call("AlpSeqFree", self.id)
