"""The widest window by linear programming on ten slices, beside what PDHG finds and what its multipliers tell.

40 × 40 voxels, 60 angles, straight light. The matrix is read off the operator, pixel by pixel, in a volume whose slices
lie so far apart that none lights another; the optimum counts the voxels that windows are judged on.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from common import HERE, machine, write_record
from slices import ANGLES, PITCH, SIDE, WIDE, entries, more, optimum, slices

import vamgpu
from vamgpu.methods import bound
from vamgpu.methods.pdhg import PDHG

BUDGETS, BOUNDS = (40, 120, 400, 1500), (120, 400, 1500)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args()
    device, matrix = vamgpu.open_device(args.device), entries()
    grid, beam = vamgpu.Grid((SIDE, SIDE, 1), PITCH), vamgpu.Beam((WIDE, 1), PITCH)
    A = vamgpu.Projection(grid, beam, vamgpu.Turntable(ANGLES), None, device)
    record: dict[str, Any] = {"machine": machine(device), "parts": {}}
    for name, part in {**slices(), **more()}.items():
        top = optimum(matrix / matrix.max(), part[:, :, 0] >= 0.5, grid.cylinder())
        plans = {n: vamgpu.optimize(A, part, PDHG(), evaluations=n, progress=False) for n in BUDGETS}
        row = record["parts"][name] = {
            "optimum": round(top, 5),
            "window": {n: round(plan.window / top, 4) for n, plan in plans.items()},
            "bound": {n: round(bound(A, part, evaluations=n).value / top, 4) for n in BOUNDS},
        }
        print(name, json.dumps(row), flush=True)
    print(write_record(args.records, f"optimum-{args.label}", record))


if __name__ == "__main__":
    main()
