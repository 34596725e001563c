"""Whether a print keeps its light while everything beside it is busy: pages, a solver, other programs, a pause.

    python profiling/realtime.py --seconds 600 --out profiling/records --label cpu

Prints 30 images a second on emulated machines that keep pace with real time, in the process that holds the light, and
meanwhile: eight processes that compute without end, a solver on all cores, 200 loads of the page, and, every
twentieth of the time, a pause of 2 s of the process that serves it, such as a collection of garbage makes. Lost is
an image that was black or not shown; late is when it was at the mirrors after its trigger, below 0 so long before.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from urllib.request import Request, urlopen

from common import machine, write_record

from vamgpu.cli.print import DEMO
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.process.watch import started, watched
from vamgpu.hosts.records.record import read_run, timing
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.jobs.demo import demo

RATE, FRAMES = 30, 120  # images a second, and a turn
BUSY = "while True: pass"
SOLVE = """
import sys
from vamgpu.jobs.demo import demo
while True:
    demo(sys.argv[1], sys.argv[2:])
"""
PAUSE = 2_000_000  # [µs]


def loads(page: Panel, wanted: int, seconds: float, over: threading.Event) -> list[float]:
    """Load the page so many times, evenly in the first 0.8 of the print; how long each took [s]."""
    took, start = list[float](), time.monotonic()
    while len(took) < wanted and not over.is_set():
        began = time.monotonic()
        for path in ("", "page.css", "page.js", "state?page", "history"):
            asked = Request(f"http://127.0.0.1:{page.port}/{path}", headers={"Authorization": f"Bearer {page.token}"})
            urlopen(asked, timeout=30).read()
        took.append(time.monotonic() - began)
        over.wait(max(0.0, start + 0.8 * seconds * len(took) / wanted - time.monotonic()))
    return took


def pauses(every: float, over: threading.Event) -> None:
    """Stop all threads of this process for a while, again and again."""
    while not over.wait(every):
        ctypes.PyDLL(None).usleep(PAUSE)


def main() -> None:
    """Measure, and write the record."""
    wish = argparse.ArgumentParser(description=__doc__)
    wish.add_argument("--seconds", type=float, default=60.0)
    wish.add_argument("--busy", type=int, default=8)
    wish.add_argument("--loads", type=int, default=200)
    wish.add_argument("--out", type=Path)
    wish.add_argument("--label", default="cpu")
    given = wish.parse_args()
    beside: list[subprocess.Popen[bytes]] = []
    over, took = threading.Event(), list[float]()
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        job = demo(place / "job", DEMO).folder
        turns = round(given.seconds * RATE / FRAMES)
        order = PrintOrder.of(
            (job,), read_rig("emulated"), place / "run", speed=360.0 * RATE / FRAMES, turns=turns, page=True
        )
        board = Board(job="profiling")
        solver = [sys.executable, "-c", SOLVE, str(place / "solved"), *DEMO]
        try:
            beside += [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(given.busy)]
            beside.append(subprocess.Popen(solver, env=os.environ | {"OMP_NUM_THREADS": str(os.cpu_count())}))
            with Panel(board) as page, started(order, board) as watch:
                watch.viewed(order.planned())
                reading = partial(loads, page, given.loads, given.seconds, over)
                threads = [
                    threading.Thread(target=lambda: took.extend(reading())),
                    threading.Thread(target=pauses, args=(given.seconds / 20, over)),
                ]
                for thread in threads:
                    thread.start()
                try:
                    end = watched(watch, lambda name, text: None, None)
                finally:
                    over.set()
                    for thread in threads:
                        thread.join()
        finally:
            for process in beside:
                process.kill()
                process.wait()
        run = read_run(order.folder)
        told = timing(run.shown)
        granted = next(event for event in run.events if event["event"] == "process")
    wanted = turns * FRAMES
    record = {
        "state": end["state"],
        "message": run.message,
        "images": wanted,
        "rate": RATE,
        "lost": told["dark"] + wanted - told["frames"],
        "late_ms": {name: round(value * 1e-6, 3) for name, value in told["late_ns"].items()},
        "granted": {name: granted[name] for name in ("schedule", "memory", "garbage")},
        "busy": given.busy,
        "page": {"loads": len(took), "longest_s": round(max(took, default=0.0), 3)},
        "resin": end.get("resin"),
    }
    print(record)
    if len(took) < given.loads:
        raise SystemExit(f"the page was loaded {len(took)} times; expected {given.loads}: give it more --seconds")
    if given.out is not None:
        write_record(given.out, f"realtime-{given.label}", {"machine": machine(), "realtime": record})


if __name__ == "__main__":
    main()
