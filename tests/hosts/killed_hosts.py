"""Hosts that print on a controller in another process, made by a process that has all imports: one for each line in.

A line in is ``<lane> <port> <log> <folder>``. Lines out are ``<lane> pid <pid>``, ``<lane> on`` once the light is
allowed, ``<lane> kept <frames>`` after a poll that is written down, and ``<lane> dead <ns>``.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from pathlib import Path

from doubles import White

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import PacedClock
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.machines import MirrorMachines
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import RunFolder
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned

MICROSTEPS = 100.0


class Mirrors(EmulatedAlp):
    """Mirrors on the trigger line of a controller whose log tells its edges; it is read whenever they are asked."""

    def __init__(self, clock: PacedClock, log: Path) -> None:
        super().__init__(clock, ArrayModel(height=2, width=16))
        self._edges, self._zero, self._reading = log.open(), time.monotonic_ns() - clock.now(), False
        self._edges.seek(0, os.SEEK_END)

    def advance(self, now: int) -> None:
        if not self._reading:
            self._reading = True
            for line in self._edges:
                told = json.loads(line)
                if "trigger" in told:
                    self.trigger(told["due_ns"] - self._zero)
            self._reading = False
        super().advance(now)


class Telling(Print):
    """A print that tells what it has written down."""

    lane = ""

    def tell(self, text: str) -> None:
        os.write(1, f"{self.lane} {text}\n".encode())

    def begin(self, first: int) -> bool:
        going = super().begin(first)
        self.tell("on")
        return going

    def step(self) -> bool:
        again = super().step()
        self.tell(f"kept {self.next}")
        return again


def host(lane: str, port: str, log: str, folder: str) -> None:
    """Print until killed."""
    mirrors = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=4e-3)
    schedule = turned(120, speed=40, engines=mirrors)
    controller = Controller.open(port, MICROSTEPS)
    controller.move(0.0)  # the host before it died in full motion
    while controller.status().speed:
        time.sleep(0.005)
    machines = MirrorMachines(RealClock(), controller, [Dmd(Mirrors(PacedClock(), Path(log)).library)], MICROSTEPS)
    with RunFolder.begin(folder, {}, "") as record:
        job = Telling(TriggeredPlayer(schedule, machines, [White()]), record)
        job.lane = lane
        job.run()


def main() -> None:
    """Make hosts until the input ends, and tell when each is dead."""
    living: dict[int, tuple[str, int]] = {}
    waiting = select.poll()
    waiting.register(0, select.POLLIN)
    while True:
        for ready, _ in waiting.poll():
            if ready == 0:
                line = os.read(0, 65536).decode()
                if not line:
                    return
                for lane, *given in (each.split() for each in line.splitlines()):
                    child = os.fork()
                    if not child:
                        host(lane, *given)
                        os._exit(0)
                    os.write(1, f"{lane} pid {child}\n".encode())
                    living[opened := os.pidfd_open(child)] = lane, child
                    waiting.register(opened, select.POLLIN)
            else:
                lane, child = living.pop(ready)
                os.write(1, f"{lane} dead {time.monotonic_ns()}\n".encode())
                os.waitpid(child, 0)
                waiting.unregister(ready)
                os.close(ready)


if __name__ == "__main__":
    sys.exit(main())
