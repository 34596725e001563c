"""What the script of every entry shares: the case it solves, its iterations for a time, and what it writes.

A script is run as ``script.py CASE OUT --method NAME [--iterations N | --seconds S]``. It writes ``OUT/frames/*.png``
and ``OUT/run.json``. It needs NumPy, SciPy and Pillow, and its own program.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from profiling.leaderboard.judge import Setup, write_frames

TRIED = 2, 6
"""Iterations whose times tell how many iterations fit into a given time."""


@dataclass(frozen=True)
class Case:
    """A part, a vial, a projector, and the frames' shape."""

    folder: Path
    setup: Setup
    shape: tuple[int, int, int]  # angles, columns, rows
    longest: float = 0.0  # exposure [s] that an entry may take; 0: any

    @classmethod
    def load(cls, folder: Path, longest: float = 0.0) -> Case:
        facts = json.loads((folder / "frames.json").read_text(encoding="utf-8"))
        return cls(
            folder, Setup.load(folder / "judge.toml"), (facts["angles"], facts["columns"], facts["rows"]), longest
        )

    def voxels(self) -> np.ndarray:
        """The part on a voxel for each column, column and row of the frames, [x, y, z] bool."""
        return np.load(self.folder / "voxels.npy")


@dataclass(frozen=True)
class Found:
    """Light [angle, column, row] of an entry, and what its record says of it."""

    light: np.ndarray
    facts: dict[str, Any]


Solve = Callable[[Case, str, int], Found]


def enter(program: str, version: str, solve: Solve, usual: dict[str, int]) -> None:
    """Run an entry from the command line.

    Args:
        program, version: Of the entry.
        solve: Finds light for a case, by a method, with a number of iterations.
        usual: Iterations of each method in the program's documents.
    """
    parser = argparse.ArgumentParser(description=program)
    parser.add_argument("case", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--method", choices=list(usual), default=next(iter(usual)))
    parser.add_argument("--iterations", type=int, default=0, help="as in the program's documents, if left out")
    parser.add_argument("--seconds", type=float, default=0.0, help="processor seconds, in place of iterations")
    parser.add_argument("--longest", type=float, default=0.0, help="exposure [s] that the print may take")
    args = parser.parse_args()
    case, iterations = Case.load(args.case, args.longest), args.iterations or usual[args.method]
    if args.seconds:
        iterations = _fitting(lambda count: solve(case, args.method, count), args.seconds)
    start = time.process_time()
    found = solve(case, args.method, iterations)
    facts = {"program": program, "version": version, "method": args.method, "iterations": iterations,
            "processor_s": round(time.process_time() - start, 2), "memory_gb": _memory_gb(), **found.facts}  # fmt: skip
    write_frames(args.out / "frames", np.maximum(found.light, 0.0))
    (args.out / "run.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def _memory_gb() -> float:
    """Most memory of this process since it was started; what `wait4` reports includes that of the starting process."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return round(int(status.split("VmHWM:")[1].split()[0]) / 1e6, 2)


def _fitting(run: Callable[[int], Any], seconds: float) -> int:
    """Iterations that fit into processor seconds; what only the first run needs does not count."""
    run(TRIED[0])
    took = []
    for count in TRIED:
        start = time.process_time()
        run(count)
        took.append(time.process_time() - start)
    each = max((took[1] - took[0]) / (TRIED[1] - TRIED[0]), 1e-3)
    return max(TRIED[0], int(TRIED[0] + (seconds - took[0]) / each))
