"""The widest window by linear programming on ten slices, beside what "widest" finds and what its prices tell.

40 × 40 voxels, 60 angles, straight light. The matrix is read off the operator, pixel by pixel, in a volume whose slices
lie so far apart that none lights another; the optimum counts the voxels that windows are judged on.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from best_light import ANGLES, PITCH, slices
from common import HERE, machine, write_record
from scipy import sparse
from scipy.optimize import linprog

import vamgpu
from vamgpu.methods import bound

SIZE, COLUMNS, APART = 40, 58, 7
BUDGETS, BOUNDS = (10, 40, 120, 400), (120, 400, 1000)


def more() -> dict[str, np.ndarray]:
    """Fractions [x, y, 1] of five further parts."""
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    r, t = np.hypot(x, y), np.arctan2(y, x)
    parts = {
        "star": r < 8 + 5 * np.cos(5 * t),
        "frame": (np.maximum(abs(x), abs(y)) < 12) & (np.maximum(abs(x), abs(y)) > 9),
        "two discs": (np.hypot(x - 6, y) < 5) | (np.hypot(x + 6, y) < 5),
        "comb": (abs(x) < 12) & (abs(y) < 12) & ((y < -6) | (np.mod(x + 12, 6) < 3)),
        "broken ring": (r < 14) & (r > 10) & (abs(t) > 0.6),
    }
    return {name: part[:, :, None].astype(np.float32) for name, part in parts.items()}


def entries() -> sparse.csr_matrix:
    """Dose of each voxel by light of each pixel, (voxels, pixels)."""
    deep = APART * COLUMNS
    grid, beam = vamgpu.Grid((SIZE, SIZE, deep), PITCH), vamgpu.Beam((COLUMNS, deep), PITCH)
    A, columns = vamgpu.Projection(grid, beam, vamgpu.Turntable(ANGLES)), []
    one = vamgpu.Projection(vamgpu.Grid((SIZE, SIZE, 1), PITCH), vamgpu.Beam((COLUMNS, 1), PITCH), A.motion)
    share = float(one.row_weights[0, 0])  # what a single slice keeps of its row
    for angle in range(ANGLES):
        light = np.zeros(A.range.shape, np.float32)
        light[angle, np.arange(COLUMNS), APART * np.arange(COLUMNS) + APART // 2] = share
        dose = np.asarray(A.T(light)).reshape(SIZE, SIZE, COLUMNS, APART).sum(axis=3, dtype=np.float64)
        columns.append(sparse.csc_matrix(dose.reshape(SIZE**2, COLUMNS)))
    return sparse.hstack(columns).tocsr()


def optimum(matrix: sparse.csr_matrix, part: np.ndarray, near: np.ndarray) -> float:
    """Greatest a − b of light ≥ 0 whose dose is a to 1 in the part, and at most b elsewhere."""
    inside, void = (matrix[(where & near).ravel()] for where in (part, ~part))
    k, rest, lit = inside.shape[0], void.shape[0], matrix.shape[1]
    limits = sparse.vstack([
        sparse.hstack([-inside, np.ones((k, 1)), np.zeros((k, 1))]),
        sparse.hstack([void, np.zeros((rest, 1)), -np.ones((rest, 1))]),
        sparse.hstack([inside, np.zeros((k, 2))]),
    ]).tocsr()  # fmt: skip
    cost = np.r_[np.zeros(lit), -1.0, 1.0]
    found = linprog(cost, limits, np.r_[np.zeros(k + rest), np.ones(k)], bounds=(0, None), method="highs-ipm")
    assert found.fun is not None, found.message
    return -float(found.fun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args()
    device, matrix = vamgpu.open_device(args.device), entries()
    grid, beam = vamgpu.Grid((SIZE, SIZE, 1), PITCH), vamgpu.Beam((COLUMNS, 1), PITCH)
    A = vamgpu.Projection(grid, beam, vamgpu.Turntable(ANGLES), None, device)
    record: dict[str, Any] = {"machine": machine(device), "parts": {}}
    for name, part in {**slices(), **more()}.items():
        top = optimum(matrix / matrix.max(), part[:, :, 0] >= 0.5, grid.cylinder())
        plans = {n: vamgpu.optimize(A, part, "widest", evaluations=n, progress=False) for n in BUDGETS}
        row = record["parts"][name] = {
            "optimum": round(top, 5),
            "window": {n: round(plan.window / top, 4) for n, plan in plans.items()},
            "bound": {n: round(bound(A, part, evaluations=n).value / top, 4) for n in BOUNDS},
        }
        print(name, json.dumps(row), flush=True)
    print(write_record(args.records, f"optimum-{args.label}", record))


if __name__ == "__main__":
    main()
