"""Limits of machines: lenses on a serial line, mirrors with a trigger or a video cable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil

from vamgpu.errors import BadInput
from vamgpu.geometry import counts
from vamgpu.hosts.schedules.timing import SECOND, Number, every, exact, nanoseconds, numeric, whole


def powers(power: float | Sequence[float], engines: int | None = None) -> tuple[float, ...]:
    """Powers of the engines' light, 0 to 1; one number applies to all. Raises `BadInput`."""
    given = (power,) * (engines or 1) if numeric(power) else every("power", power)
    found = tuple(float(exact("power", value, zero=True)) for value in given)
    if engines is not None and len(found) != engines:
        raise BadInput(f"got {engines} engines and {len(found)} powers; expected the same number")
    if not found or max(found) > 1:
        raise BadInput(f"power is {power!r}; expected 0 to 1 for each engine")
    return found


PATTERNS = {1: 24, 2: 12, 3: 8, 4: 6, 6: 4, 7: 3, 8: 2}  # bits → frames in the 24 bits of one video frame


@dataclass(frozen=True)
class LensTiming:
    """A tunable lens and the line that sets its power. Raises `BadInput`."""

    settle: Number = 5e-3  # settling time from one focus plane to another [s]
    frame_bytes: int = 10  # bytes of one command
    baud: int = 38400  # bits per second, ten per byte
    latency: Number = 0  # response delay of the driver [s]

    def __post_init__(self) -> None:
        whole("frame_bytes", self.frame_bytes)
        whole("baud", self.baud)
        nanoseconds("latency [s]", self.latency)
        nanoseconds("settle [s]", self.settle)

    @property
    def wire(self) -> int:
        """Time from the first bit of a command until the driver has executed it [ns]."""
        line = Fraction(10 * int(self.frame_bytes) * SECOND, int(self.baud))
        return ceil(line) + nanoseconds("latency [s]", self.latency)

    @property
    def settling(self) -> int:
        """Time from one plane to another [ns]."""
        return nanoseconds("settle [s]", self.settle)


@dataclass(frozen=True)
class MirrorTiming:
    """Mirrors that show a frame at each trigger; by default 1080p at 266 Hz and 8 bits. Raises `BadInput`."""

    frame: Mapping[int, Number] = field(default_factory=lambda: {8: 1 / 266, 1: 1 / 17900})
    pixels: tuple[int, int] = (1920, 1080)  # columns, rows
    row_bytes: int | None = 256  # bytes of a packed row in their memory; None for those of the columns
    dark: Number = 0  # least time without light after a frame [s]
    memory: int = 31069  # bit planes that fit in memory

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", counts("pixels", self.pixels, 2))
        if not isinstance(self.frame, Mapping) or not self.frame:
            raise BadInput(f"frame is {self.frame!r}; expected {{bits: least seconds}}, such as {{8: 1 / 266}}")
        for bits, value in self.frame.items():
            exact(f"frame time of {whole('bits of a frame', bits)} bits [s]", value)
        whole("memory [bit planes]", self.memory, 0)
        if self.row_bytes is not None:
            object.__setattr__(self, "row_bytes", whole("row_bytes", self.row_bytes))
        nanoseconds("dark [s]", self.dark)

    def least(self, bits: int) -> int:
        """Least time of a frame [ns]. Raises `BadInput` for a bit depth that the device lacks."""
        if bits not in self.frame:
            raise BadInput(f"frames have {bits} bits; the device shows {', '.join(map(str, self.frame))}")
        return nanoseconds("frame [s]", self.frame[bits])

    @property
    def pause(self) -> int:
        """Least darkness after a frame [ns]."""
        return nanoseconds("dark [s]", self.dark)

    def nbytes(self, bits: int) -> int:
        """Bytes of a frame for upload: packed planes."""
        columns, rows = self.pixels
        return bits * rows * (self.row_bytes or -(-columns // 8))


@dataclass(frozen=True)
class HdmiTiming:
    """Mirrors on a video cable, with several frames in each video frame. Raises `BadInput`."""

    refresh: Number = 60  # video frames per second
    bits: int = 8  # bits of a frame; 8 gives two per video frame, 7 three, 1 twenty-four
    exposures: tuple[Number, ...] = (250e-6, 700e-6, 1.6e-3, 1.7e-3, 2e-3, 2.5e-3, 4.5e-3, Fraction(1, 120))
    dark: Number = 0  # seconds without light in every slot
    latency: int = 1  # video frames from cable to mirrors
    pixels: tuple[int, int] = (912, 1140)  # columns, rows
    slots: int | None = None  # frames per video frame, if fewer than its bits allow

    def __post_init__(self) -> None:
        exact("refresh [1/s]", self.refresh)
        object.__setattr__(self, "pixels", counts("pixels", self.pixels, 2))
        object.__setattr__(self, "bits", whole("bits", self.bits))
        object.__setattr__(self, "latency", whole("latency [video frames]", self.latency, 0))
        if len(every("exposures", self.exposures)) < max(PATTERNS):
            raise BadInput(f"exposures is {self.exposures!r}; expected least seconds for each of 1 to 8 bits")
        if self.bits not in PATTERNS:
            raise BadInput(f"bits is {self.bits!r}; a video frame of 24 bits holds frames of {list(PATTERNS)} bits")
        least = exact("exposure [s]", self.exposures[self.bits - 1]) + exact("dark [s]", self.dark, zero=True)
        if least * self.slot_rate > 1:
            raise BadInput(
                f"{self.patterns} frames of {self.bits} bits per video frame at {float(self.refresh):g} Hz last "
                f"{1e3 / float(self.slot_rate):.4g} ms; they need {1e3 * float(least):.4g} ms: use fewer bits"
            )

    @property
    def patterns(self) -> int:
        """Frames in a video frame."""
        return PATTERNS[self.bits] if self.slots is None else whole("slots", self.slots)

    @property
    def slot_rate(self) -> Fraction:
        return exact("refresh [1/s]", self.refresh) * self.patterns
