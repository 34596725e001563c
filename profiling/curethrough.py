"""Time the dose of a stack of slices and its correction beside NumPy and a numba-parallel loop, turn by turn.

The stack is in memory: a block with spherical voids on a lattice, uint8 [1000, 800, 1280]. ``carry`` keeps the running
dose only, ``doses`` writes those of every slice, ``correct`` writes corrected slices to the device; ``correct_out``
also copies them to one array in memory. Peers run after each device; ratios are of the least times. Beside seconds by
the clock stand those of the processors, which tell less of what else runs.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, machine, peer, timed, write_record

from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import RunningDose, blocks
from vamgpu.curethrough.printer import Printer, levels_of

PRINTER = Printer(2.0, 0.576, 0.05, 1000 / 3600, levels_of(1.0, 0.01))

TASKS = ("carry", "doses", "correct", "correct_out")


def part(shape: tuple[int, ...]) -> np.ndarray:
    """The stack of the peers' script."""
    sys.path.insert(0, str(HERE / "peers"))
    spec = importlib.util.spec_from_file_location("peer_curethrough", HERE / "peers" / "curethrough.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.part(*shape)


def measure(device: Any, stack: np.ndarray, task: str, runs: int) -> dict[str, Any]:
    """Times of one task on one device, its set-up counted."""
    out = np.zeros((len(stack) + PRINTER.tail, *stack.shape[1:]), np.uint8) if task == "correct_out" else None

    def expose() -> None:
        exposure = RunningDose(PRINTER, stack.shape[1:], device)  # type: ignore[arg-type]
        for start, stop in blocks(len(stack)):
            exposure.step(stack[start:stop], keep=1 if task == "carry" else None)

    def correct() -> None:
        for block in Corrector(Correction(PRINTER), stack.shape, device).run(stack):
            if out is not None:
                block.table.numpy(out[block.start : block.start + block.table.shape[0]])

    run, busy = correct if task.startswith("correct") else expose, []

    def counted() -> None:
        used = time.process_time()
        run()
        device.synchronize()
        busy.append(time.process_time() - used)

    return timed(counted, device.synchronize, runs, warmups=1) | {"least_cpu_s": min(busy)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", nargs="+", default=["cpu"])
    parser.add_argument("--shape", type=int, nargs=3, default=(1000, 800, 1280))
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--label", default="here")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    args = parser.parse_args()
    devices = chosen_devices(args.devices)
    record: dict[str, Any] = {"machine": machine(*devices), "shape": list(args.shape), "tasks": {}}
    stack = part(args.shape)
    for task in args.tasks:
        rows = {device.name: measure(device, stack, task, args.runs) for device in devices}
        name = task.removesuffix("_out")
        for library in ("numpy",) if name == "correct" else ("numpy", "numba"):
            rows[library] = peer("curethrough.py", "--task", name, "--library", library, "--runs", args.runs,
                                 "--shape", *args.shape)  # fmt: skip
        record["tasks"][task] = rows
        for who, row in rows.items():
            print(f"{task:12} {who:18} {row.get('least_s', row.get('missing'))} {row.get('least_cpu_s')}")
    write_record(args.records, f"curethrough-{args.label}", record)


if __name__ == "__main__":
    main()
