"""How many frames a second go from a device to mirrors without one late, and whole prints in real time.

    python profiling/feed.py --devices opencl:intel:0 --seconds 10 --print 600 --out profiling/records/feed-cpu.json

The greatest rate is searched for by halving, with mirrors that are memory copied to and a counter that real time
advances; a rate is sustained if no frame comes later than its trigger. A whole print is that of `vam print`, on
emulated machines that keep pace with real time. Late is when a frame was at the mirrors after its trigger; below 0,
so long before. cores: of the host's time.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from fractions import Fraction
from math import pi
from pathlib import Path

import numpy as np
from common import chosen_devices, machine, write_record

from vamgpu.backend.device import Device
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import PacedClock
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.packer import DevicePacker
from vamgpu.hosts.frames.sources import MirrorArray, VialFrames, WebFrames
from vamgpu.hosts.frames.upload import BUFFERS, FrameMemory, UploadQueue, length
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import RunFolder, read_run, timing
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

ROWS, COLUMNS, ROW_BYTES = 1080, 1920, 256
LOOK = 5_000_000
ADVANCE, FOCUS = 9.0 * pi / 360, (0.0, 0.7, 1.4)


@dataclass(frozen=True)
class Sustained:
    """A rate and how it went: lateness [ms], negative where early; cores: of the host's time."""

    bits: int
    rate: float
    frames: int
    lost: int
    p50: float
    p99: float
    most: float
    cores: float

    @property
    def good(self) -> bool:
        """Whether every frame was there before its trigger."""
        return not self.lost and self.most < 0


class Memory(FrameMemory):
    """Mirrors: two sequences of room, copied to, and triggered as time goes."""

    def __init__(self, length: int, shape: tuple[int, ...], triggers: np.ndarray, clock: RealClock) -> None:
        self._memory = np.ones((2, length, *shape), np.uint8)
        self._triggers, self._clock, self._ends, self.began = triggers, clock, [0], 0

    def shown(self) -> int:
        return int(np.searchsorted(self._triggers, self._clock.now() - self.began)) if self.began else 0

    def room(self, frames: int = 2, name: bytes | None = None) -> bool:
        return len(self._ends) < 3 or self._ends[-2] <= self.shown()

    def put(self, planes: np.ndarray, name: bytes | None = None) -> None:
        self._memory[len(self._ends) % 2, : len(planes)] = planes
        self._ends.append(self._ends[-1] + len(planes))


def frames_on(device: Device, bits: int, count: int = 12) -> Frames:
    """Random frames, more than any cache holds."""
    width = COLUMNS if bits == 8 else COLUMNS // 8
    images = np.random.default_rng(0).integers(0, 256, (count, ROWS, width), dtype=np.uint8)
    return Frames(device.upload(images, table=True), bits=bits, gray=GrayCurve.linear(), scale=1.0, columns=COLUMNS)


def trial(frames: Frames, rate: float, seconds: float) -> Sustained:
    """Run at a rate for so long."""
    batch = length(rate, frames.bits * ROWS * ROW_BYTES)
    count = max(int(rate * seconds), 4 * batch)
    mirrors = MirrorTiming(frame={8: 1e-6, 1: 1e-6})
    schedule = turned(count, speed=360 * Fraction(rate) / count, engines=mirrors, bits=frames.bits)
    source, clock = DevicePacker.of(frames, row_bytes=ROW_BYTES, batch=batch), RealClock()
    memory = Memory(batch, source.shape, schedule.trigger, clock)
    order = np.arange(count) % source.frames
    feed = UploadQueue(source, order, memory, clock, batch=batch, depth=BUFFERS)
    feed.start()
    while not feed.primed:
        clock.sleep_until(clock.now() + LOOK)
    before, memory.began = time.process_time(), clock.now()
    while memory.shown() < count:
        feed.check()
        clock.sleep_until(clock.now() + LOOK)
    spent = time.process_time() - before
    feed.stop()
    late = 1e-6 * (np.where(feed.arrived < 0, clock.now(), feed.arrived) - memory.began - schedule.trigger)
    passed = 1e-9 * (clock.now() - memory.began)
    p50, p99, most = np.percentile(late, [50, 99, 100])
    return Sustained(frames.bits, rate, count, int((late > 0).sum()), p50, p99, most, spent / passed)


def greatest(frames: Frames, seconds: float) -> Sustained:
    """The greatest rate without a frame lost, within 5 %."""
    low, high = 0.0, 50.0
    while trial(frames, high, 0.3 * seconds).good and high < 50_000:
        low, high = high, 2 * high
    while high - low > 0.05 * high:
        middle = 0.5 * (low + high)
        good = trial(frames, middle, 0.3 * seconds).good
        low, high = (middle, high) if good else (low, middle)
    while not (found := trial(frames, low, seconds)).good and low > 1:
        low *= 0.9
    return found


def printed(device: Device, kind: str, seconds: float) -> dict[str, object]:
    """A whole print in real time: guard, lease, controller, record and all, on emulated mirrors of 1080p.

    kind: a web at 48 mm/min through three foci, or a vial at 40 deg/s of 360 angles. What resin would see is left out;
    the emulated machines' work counts as the host's.
    """
    mirrors = MirrorTiming(dark=1e-3)
    if kind == "web":
        poses = max(int(seconds * 0.8 / ADVANCE), 4)
        schedule = web(poses, advance=ADVANCE, speed=0.8, engines=mirrors, lens=LensTiming(), focus=FOCUS)
        base = np.random.default_rng(1).integers(0, 256, (8, ROWS, COLUMNS), dtype=np.uint8)
        masks = np.arange(3)[:, None] == np.arange(COLUMNS) * 3 // COLUMNS
        array = MirrorArray(ROWS, COLUMNS, ROW_BYTES)
        frames = WebFrames(lambda low, high: base[np.arange(low, high) % 8], poses, array, masks, device)
    else:
        schedule = turned(360, speed=40.0, engines=mirrors, turns=max(round(seconds / 9.0), 1))
        frames = VialFrames(frames_on(device, 8, 360), MirrorArray(ROWS, COLUMNS, ROW_BYTES))
    emulated = EmulatedMirrorRig(1000, ArrayModel(), powers=FOCUS if kind == "web" else (), clock=PacedClock())
    emulated.alps[0].on_shown = None
    with tempfile.TemporaryDirectory() as place, RunFolder.begin(Path(place) / "run", {}, "") as folder:
        job = Print(TriggeredPlayer(schedule, emulated.machines(1000 / float(schedule.advance)), [frames]), folder)
        before, began = time.process_time(), time.monotonic()
        state = job.run()
        spent, passed = time.process_time() - before, time.monotonic() - began
        run = timing(read_run(folder.path).shown)
    late = {name: 1e-6 * value for name, value in run["late_ns"].items()}
    return {"state": state, "rate": schedule.rate, "seconds": passed, "frames": run["frames"], "dark": run["dark"],
            "late_ms": late, "cores": spent / passed}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", nargs="+", default=["cpu"])
    parser.add_argument("--seconds", type=float, default=10.0, help="of each rate that is tried")
    parser.add_argument("--print", type=float, default=20.0, dest="printing", help="seconds of each whole print")
    parser.add_argument("--out", type=Path, default=None, help="the record to write")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)  # rates that fail are what is looked for
    devices = chosen_devices(asked.devices)
    record: dict[str, object] = {"machine": machine(*devices)}
    for device in devices:
        found: dict[str, object] = {kind: printed(device, kind, asked.printing) for kind in ("web", "vial")}
        for bits in (8, 1):
            found[f"greatest rate of {bits} bits"] = asdict(greatest(frames_on(device, bits), asked.seconds))
        record[device.name] = found
        print(device.name, json.dumps(found, indent=1))
    if asked.out is not None:
        write_record(asked.out.parent, asked.out.stem, record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
