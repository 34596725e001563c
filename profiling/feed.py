"""How many pictures a second go from a device to mirrors without one late.

    python profiling/feed.py --device opencl:intel:0 --seconds 10

The mirrors are memory that is copied to and a counter that real time advances; the feed is that of a print. A rate is
sustained if no picture comes later than its trigger; the greatest is searched for by halving. The last line of each bit
depth is the greatest rate again, with its lateness and the host's share of a core.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.pictures.feed import Feed
from vamgpu.hosts.pictures.sources import FrameSource
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.moving import turned
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

ROWS, COLUMNS, ROW_BYTES, BATCH = 1080, 1920, 256, 8
LOOK = 5_000_000


@dataclass(frozen=True)
class Sustained:
    """A rate and how it went: lateness [ms], negative where early; cores: of the host's time."""

    bits: int
    rate: float
    pictures: int
    lost: int
    p50: float
    p99: float
    most: float
    cores: float

    @property
    def good(self) -> bool:
        """Whether every picture was there before its trigger."""
        return not self.lost and self.most < 0


class Memory:
    """Mirrors: two batches of room, copied to, and triggered as time goes."""

    def __init__(self, shape: tuple[int, ...], triggers: np.ndarray, clock: RealClock) -> None:
        self._memory = np.zeros((2, BATCH, *shape), np.uint8)
        self._triggers, self._clock, self._ends, self.began = triggers, clock, [0], 0

    def shown(self) -> int:
        return int(np.searchsorted(self._triggers, self._clock.now() - self.began)) if self.began else 0

    def room(self) -> bool:
        return len(self._ends) < 3 or self._ends[-2] <= self.shown()

    def put(self, pictures: np.ndarray) -> None:
        self._memory[len(self._ends) % 2, : len(pictures)] = pictures
        self._ends.append(self._ends[-1] + len(pictures))


def frames_on(device: Device, bits: int, count: int = 12) -> Frames:
    """Random pictures, more than any cache holds."""
    width = COLUMNS if bits == 8 else COLUMNS // 8
    images = np.random.default_rng(0).integers(0, 256, (count, ROWS, width), dtype=np.uint8)
    return Frames(device.upload(images, table=True), bits=bits, gray=GrayCurve.linear(), scale=1.0, columns=COLUMNS)


def trial(frames: Frames, rate: float, seconds: float) -> Sustained:
    """Run at a rate for so long."""
    count = max(int(rate * seconds), 4 * BATCH)
    mirrors = MirrorTiming(picture={8: 1e-6, 1: 1e-6})
    schedule = turned(count, speed=360.0 * rate / count, engines=mirrors, bits=frames.bits)
    source, clock = FrameSource(frames, row_bytes=ROW_BYTES, batch=BATCH), RealClock()
    memory = Memory(source.shape, schedule.trigger, clock)
    order = np.arange(count) % source.frames
    feed = Feed(source, order, memory, clock, batch=BATCH, depth=8)
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
    """The greatest rate without a picture lost, within 5 %."""
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default=None)
    parser.add_argument("--seconds", type=float, default=10.0)
    asked = parser.parse_args()
    logging.disable(logging.WARNING)  # rates that fail are what is looked for
    device = vamgpu.open_device(asked.device)
    eight = frames_on(device, 8)
    report: dict[str, object] = {"device": device.name}
    report["sustained"] = [asdict(greatest(frames_on(device, bits), asked.seconds)) for bits in (8, 1)]
    for rate in (30.56, 40.0):
        report[f"at {rate:g}"] = asdict(trial(eight, rate, asked.seconds))
    print(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
