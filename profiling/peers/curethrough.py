"""Time the dose of a stack of slices and its correction as vectorized NumPy and a numba-parallel loop do them.

The stack is the block with spherical voids that vamgpu's script makes. Dose: gray level to light through a table of
256, the recursion from the last slice to the first in float32, only what is carried (``carry``) or doses of all slices
written to one block of 32 that is used again (``doses``). Correction: the same targets as vamgpu's, found by vectorized
steps over whole slices; distances to the edges ahead are counted first. Prints seconds and checksums as a JSON line.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from machine import emit, machine

BLOCK = 32


def part(slices: int, rows: int, columns: int, period: int = 160) -> np.ndarray:
    """A block with spherical voids on a lattice; uint8 [slice, y, x]."""
    out = np.empty((slices, rows, columns), np.uint8)
    y, x = (np.arange(n) % period - period / 2 for n in (rows, columns))
    plane = y[:, None] ** 2 + x[None, :] ** 2
    rim = np.ones((rows, columns), bool)
    rim[rows // 16 : -(rows // 16), columns // 16 : -(columns // 16)] = False
    for n in range(slices):
        z = n % period - period / 2
        np.multiply((plane + z * z > (0.42 * period) ** 2) & ~rim, 255, out=out[n], casting="unsafe")
    return out


def numpy_dose(stack: np.ndarray, light: np.ndarray, decay: float, doses: np.ndarray | None) -> np.ndarray:
    fade = np.float32(1.0 - decay)
    dose = np.zeros(stack.shape[1:], np.float32)
    shown = np.empty_like(dose)
    for n in range(len(stack) - 1, -1, -1):
        np.take(light, stack[n], out=shown, mode="clip")
        dose *= fade
        dose += shown
        if doses is not None:
            doses[n % BLOCK] = dose
    return dose


def numba_dose(write: bool) -> Callable:
    from numba import njit, prange

    @njit(parallel=True, fastmath=True, cache=False)
    def run(stack, light, fade, dose, doses):
        slices, rows, columns = stack.shape
        for y in prange(rows):
            own = dose[y]
            own[:] = np.float32(0)
            for n in range(slices - 1, -1, -1):
                line = stack[n, y]
                if write:
                    out = doses[n % BLOCK, y]
                    for x in range(columns):
                        own[x] = own[x] * fade + light[line[x]]
                        out[x] = own[x]
                else:
                    for x in range(columns):
                        own[x] = own[x] * fade + light[line[x]]

    def dose(stack: np.ndarray, light: np.ndarray, decay: float, doses: np.ndarray | None) -> np.ndarray:
        out = np.zeros(stack.shape[1:], np.float32)
        run(stack, light, np.float32(1.0 - decay), out, np.empty((1, 1, 1), np.float32) if doses is None else doses)
        return out

    return dose


def numpy_correction(stack, light, decay, front, back, out):  # type: ignore
    """Levels in ``out``; runs ahead counted forward in uint16, then steps backward."""
    shape = stack.shape[1:]
    fade = np.float32(1.0 - decay)
    slope = 255.0 / (light[-1] - light[0])
    runs = np.empty(stack.shape, np.uint16)
    before, run = stack[0] >= 128, np.full(shape, 60000, np.uint16)
    runs[0] = run
    for n in range(1, len(stack)):
        solid = stack[n] >= 128
        run += 1
        run[solid != before] = 0
        np.minimum(run, 60000, out=run)
        runs[n], before = run, solid
    dose = np.zeros(shape, np.float32)
    for n in range(len(stack) - 1, -1, -1):
        run = runs[n]
        inside = front[np.minimum(run, len(front) - 1)]
        behind = back[np.minimum(run, len(back) - 1)]
        wanted = np.where(stack[n] >= 128, inside, behind)
        wanted -= dose * fade
        level = np.rint(np.clip((wanted - light[0]) * slope, 0, 255)).astype(np.uint8)
        out[n] = level
        dose *= fade
        dose += light[level]
    return dose


def least(run: Callable[[], object], runs: int) -> tuple[float, list[float], float]:
    """Least and all seconds by the clock, and the least of the processors; those tell less of what else runs."""
    seconds, busy = [], []
    for _ in range(runs):
        begin, used = time.perf_counter(), time.process_time()
        run()
        seconds.append(time.perf_counter() - begin)
        busy.append(time.process_time() - used)
    return min(seconds), seconds, min(busy)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", choices=("carry", "doses", "correct"), required=True)
    parser.add_argument("--library", choices=("numpy", "numba"), default="numpy")
    parser.add_argument("--shape", type=int, nargs=3, default=(1000, 800, 1280))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--phi", type=float, nargs=2, default=(0.0625, 6.25))
    parser.add_argument("--eta", type=float, default=0.025)
    args = parser.parse_args()
    stack, decay = part(*args.shape), 1.0 - 10.0**-args.eta
    light = (np.linspace(*args.phi, 256) * decay).astype(np.float32)
    if args.task == "correct":
        low, high = args.phi
        away = np.arange(1.0 / args.eta + 4)
        front = np.minimum(low + (1 - low) * 10.0 ** (away * args.eta), 2 * high).astype(np.float32)
        behind = high - (high - 1.0) * 10.0 ** (away * args.eta)
        behind = np.append(np.where(behind > 0, behind, -1e30), -1e30).astype(np.float32)
        out = np.empty_like(stack)
        work = lambda: numpy_correction(stack, light, decay, front, behind, out)  # noqa: E731
    else:
        doses = np.empty((BLOCK, *stack.shape[1:]), np.float32) if args.task == "doses" else None
        dose = numpy_dose if args.library == "numpy" else numba_dose(args.task == "doses")
        if args.library == "numba":
            dose(stack[:2], light, decay, doses)  # compiles
        work = lambda: dose(stack, light, decay, doses)  # noqa: E731
    best, seconds, busy = least(work, args.runs)
    sums = {"out": int(out.sum(dtype=np.int64))} if args.task == "correct" else {"dose": float(work().sum(dtype=float))}
    version = __import__(args.library).__version__
    emit({"library": f"{args.library} {version}", "task": args.task, "least_s": best, "least_cpu_s": busy,
          "runs_s": seconds, "sums": sums, "machine": machine()})  # fmt: skip


if __name__ == "__main__":
    main()
