"""Play a fixed pattern on a controller board and compare its recorded timing with the emulated controller's.

Usage: ``python bench.py PORT --capture FILE.csv`` or ``python bench.py --emulated``; README.md explains the wiring.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, VamError
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import ControllerRow
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import VirtualPort
from vamgpu.hosts.schedules.clock import Clock, RealClock

ROWS, PERIOD_US, DELAY_US, ON_US, LEASE_MS = 40, 20_000, 8_000, 5_000, 200
MILLI = 1_000_000
LIMITS = {
    "trigger period": (50e-6, 100e-6),
    "trigger to light": (50e-6, 50e-6),
    "light on-time": (50e-6, 100e-6),
    "lens command to trigger": (300e-6, 600e-6),
}
"""Allowed difference of the mean from the emulator's, and of the greatest from the least [s]; a lens byte takes 260 us,
and the port may send it one byte late."""
QUIET = 5e-3  # least time between two frames on the lens's line [s]
NUMBER = 1  # start number of the play


@dataclass
class Edges:
    """Recorded times [s]: rises of triggers, begin and end of light, begins of the lens's frames."""

    triggers: list[float] = field(default_factory=list)
    lights: list[tuple[float, float]] = field(default_factory=list)
    lens: list[float] = field(default_factory=list)


def play(controller: Controller, clock: Clock) -> None:
    """Play forty slots with lens, trigger and light, then steady light that the lease ends. Raises `BadInput`."""
    rows = (ControllerRow(i, PERIOD_US * (i + 1), 100 * (i % 2), DELAY_US, ON_US) for i in range(ROWS))
    controller.mode("time")
    for row in rows:
        controller.row(row)
    controller.end(ROWS)
    controller.lease(1000)
    controller.arm()
    controller.go(NUMBER)
    clock.sleep_until(clock.now() + 900 * MILLI)
    shown = controller.status()
    controller.lease(LEASE_MS)
    controller.light(1)
    clock.sleep_until(clock.now() + 2 * LEASE_MS * MILLI)
    status = controller.status()
    if shown.shown != ROWS or shown.late or status.fault != "lease" or status.light:
        raise BadInput(
            f"the controller showed {shown.shown} of {ROWS} rows, {shown.late} late, and ended in {status.fault!r}; "
            "expected all of them in time and the end of the lease: check its interlock and its firmware"
        )


def emulated() -> Edges:
    """Edges of the emulated controller."""
    clock, machine, edges = VirtualClock(), EmulatedController(), Edges()
    lit: list[float] = []

    def light(channels: int, at: int) -> None:
        if channels:
            lit.append(at * 1e-9)
        else:
            edges.lights.append((lit[-1], at * 1e-9))

    machine.on_light = light
    machine.on_trigger = lambda at: edges.triggers.append(at * 1e-9)
    machine.on_lens = lambda frame, at: edges.lens.append(at * 1e-9)
    play(Controller(Wire(VirtualPort(machine, clock), "the emulated controller")), clock)
    return edges


def recorded(path: Path, columns: Sequence[int] = (1, 2, 3)) -> Edges:
    """Read edges from columns of a CSV, whose first is the time [s]: crossings of each signal's middle level."""
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.reader(file):
            try:
                rows.append([float(row[place]) for place in (0, *columns)])
            except (ValueError, IndexError):
                continue
    if len(rows) < 2:
        raise BadInput(f"{str(path)!r} has {len(rows)} lines of numbers with columns {columns}; expected a recording")
    table = np.array(rows)
    times = table[:, 0]
    rises, falls = zip(*(_edges(times, table[:, 1 + place], name) for place, name in enumerate(LINES)), strict=True)
    ends = [falls[1][falls[1] > on] for on in rises[1]]
    lights = [(float(on), float(end[0])) for on, end in zip(rises[1], ends, strict=True) if len(end)]
    starts = falls[2]  # a serial line rests high
    starts = starts[np.diff(starts, prepend=-np.inf) > QUIET] if len(starts) else starts
    return Edges(rises[0].tolist(), lights, starts.tolist())


LINES = ("trigger", "photodiode", "lens line")


def _edges(times: np.ndarray, level: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times at which a signal rises and falls."""
    if level.min() == level.max():
        raise BadInput(f"the {name} does not change in the recording; check its clip and its column")
    change = np.diff((level > (level.min() + level.max()) / 2).astype(int))
    return times[1:][change > 0], times[1:][change < 0]


def measures(edges: Edges) -> dict[str, list[float]]:
    """Intervals to compare [s]. Raises `BadInput` if the recording lacks some."""
    found = (len(edges.triggers), len(edges.lights), len(edges.lens))
    if found != (ROWS, ROWS + 1, ROWS):
        raise BadInput(
            f"the recording has {found} triggers, pulses of light and lens commands; expected {ROWS}, {ROWS + 1}, "
            f"{ROWS}: record the whole play, at 100000 samples/s or more"
        )
    triggers, lights, lens = (np.array(each) for each in (edges.triggers, edges.lights, edges.lens))
    pulses, steady = lights[:-1], lights[-1]
    return {
        "trigger period": np.diff(triggers).tolist(),
        "trigger to light": (pulses[:, 0] - triggers).tolist(),
        "light on-time": (pulses[:, 1] - pulses[:, 0]).tolist(),
        "lens command to trigger": (triggers - lens).tolist(),
        "light until the lease ends": [float(steady[1] - steady[0])],
    }


def compared(board: Edges, model: Edges) -> list[dict[str, Any]]:
    """The table: mean and spread of both [s], and whether the board agrees with the emulator, row by row."""
    rows = []
    theirs = measures(model)
    for name, values in measures(board).items():
        mean, spread = float(np.mean(values)), float(np.ptp(values))
        right = float(np.mean(theirs[name]))
        if name in LIMITS:
            off, wide = LIMITS[name]
            good = abs(mean - right) <= off and spread <= wide
        else:  # the host's own line takes part of a lease
            good = 0 < mean <= LEASE_MS * 1e-3
        rows.append({"what": name, "board": mean, "spread": spread, "emulator": right, "good": good})
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the command line; returns 1 if the board differs from the emulator, 2 if it was not measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("port", nargs="?", help="serial port of the controller, such as /dev/ttyACM0")
    parser.add_argument("--emulated", action="store_true", help="compare the emulator with itself")
    parser.add_argument("--capture", type=Path, help="CSV of the recording, written while the pattern plays")
    parser.add_argument("--columns", type=int, nargs=3, default=(1, 2, 3), help="trigger, photodiode, lens line")
    parser.add_argument("--json", type=Path, default=Path("bench.json"), help="file for the table")
    given = parser.parse_args(arguments)
    if given.emulated == (given.port is not None) or (given.port and given.capture is None):
        parser.error("give --emulated, or a port and --capture")
    try:
        table = compared(emulated() if given.emulated else _measured(given), emulated())
        given.json.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    except (VamError, OSError, EOFError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{'':28}{'board':>12}{'spread':>12}{'emulator':>12}  [us]")
    for row in table:
        numbers = "".join(f"{1e6 * row[key]:12.1f}" for key in ("board", "spread", "emulator"))
        print(f"{row['what']:28}{numbers}  {'as emulated' if row['good'] else 'DIFFERS'}")
    return 0 if all(row["good"] for row in table) else 1


def _measured(given: argparse.Namespace) -> Edges:
    """Edges of the board; the user starts and saves the recording."""
    with Controller.open(given.port) as controller:  # open it first, so that a wrong port does not waste a recording
        input("Start the recording, then press Enter.")
        play(controller, RealClock())
    input(f"Save the recording as {given.capture}, then press Enter.")
    return recorded(given.capture, given.columns)


if __name__ == "__main__":
    sys.exit(main())
