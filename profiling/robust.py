"""Light for machines that are off by a little, on the Benchy: strict windows nominal and at the worst corner, proved.

n^3 voxels, straight light, nothing absorbed. The corner of the tolerance table: a point spread of 0.5 or 1 pixel, and an
axis that is a quarter of a pixel off, either side; one threshold for all, the nominal print without a spread included.
Nominal light and light with tolerances may spend the same iterations; the evaluations of the latter count every scenario
that was computed. A light counts by its 8-bit frames, exposed at every corner along rays traced for it. With --bound, the
prices of as many steps tell what no light exceeds.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

from common import HERE, MESH, benchy, machine, write_record

import vamgpu
from vamgpu.errors import ToleranceWarning
from vamgpu.methods import bound
from vamgpu.methods.tolerances import CornerDoses, Tolerances
from vamgpu.printing.corners import prove_corners

SPREADS, AXIS = (0.5, 1.0), 0.25
"""The corner: standard deviations of the point spread, and place of the axis [pixels]."""


def told(doses: CornerDoses) -> dict[str, Any]:
    """Windows with one threshold, nominal, and at every corner alone."""
    return {
        "corner": round(doses.window, 5),
        "nominal": round(doses.nominal, 5),
        "alone": {corner.name: round(corner.window, 5) for corner in doses.corners},
        "darkest": doses.darkest.name,
        "leakiest": doses.leakiest.name,
    }


def judged(plan: vamgpu.Plan, target: Any, off: Tolerances) -> dict[str, Any]:
    """A light by its own operator and by traced rays from its frames."""
    return {
        "method": repr(plan.method),
        "iterations": len(plan.history),
        "evaluations": plan.evaluations,
        "seconds": round(plan.seconds, 1),
        "claimed": told(off.doses(plan.operator, plan, target)),
        "proved": told(prove_corners(plan.operator, vamgpu.pack(plan), target, off)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--method", default="window", help="of both lights")
    parser.add_argument("--iterations", type=int, default=120)
    parser.add_argument("--only", choices=("nominal", "robust"), default=None)
    parser.add_argument("--bound", type=int, default=0, help="evaluations of the nominal bound, steps of the robust one")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    warnings.simplefilter("ignore", ToleranceWarning)
    device = vamgpu.open_device(args.device)
    target = benchy(args.mesh, args.n, device)
    pitch = target.grid.pitch
    beam, motion = vamgpu.Beam((args.n, args.n), pitch), vamgpu.Turntable(args.angles)
    A = vamgpu.Projection(target.grid, beam, motion, None, device)
    off = Tolerances(axis=AXIS * pitch, spread=(SPREADS[0] * pitch, SPREADS[1] * pitch))
    record: dict[str, Any] = {"n": args.n, "angles": args.angles, "machine": machine(device)}
    for name, tolerances in (("nominal", None), ("robust", off)):
        if args.only in (None, name):
            plan = vamgpu.optimize(A, target, args.method, args.iterations, tolerances=tolerances, progress=False)
            record[name] = judged(plan, target, off)
            print(name, json.dumps(record[name]), flush=True)
    if args.bound:
        record["nominal bound"] = round(bound(A, target, evaluations=args.bound).value, 5)
        plan = vamgpu.optimize(A, target, "widest", args.bound, tolerances=off, progress=False)
        record["robust bound"] = round(plan.bound.value, 5) if plan.bound is not None else None
        print({name: value for name, value in record.items() if "bound" in name}, flush=True)
    print(write_record(args.records, f"robust-{args.n}-{args.label}", record))


if __name__ == "__main__":
    main()
