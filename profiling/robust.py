"""Light for machines that are off by a little, on the Benchy: strict windows nominal and at the worst corner, proved.

n^3 voxels, straight light, nothing absorbed. The corner of the tolerance table: a point spread of 0.5 or 1 pixel, and
an axis that is a quarter of a pixel off, either side; one threshold for all, the nominal print without a spread
included. Nominal light and light with tolerances may spend the same iterations; the evaluations of the latter count
every scenario that was computed. A light counts by its 8-bit frames, exposed at every corner along rays traced for it.
With --bound, multipliers tell what no light exceeds where the point spread is the greatest; with --slab too, of so many
slices alone: what no light exceeds at some corners on some of the voxels, none exceeds at all corners on all of them.

With --parts, the ten parts of `best_light.py` instead: windows at all corners by each method's own operators, at equal
projector evaluations, those of corners counted; "nominal" is light of the default that knows no corner.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from best_light import PITCH, SIZE, parts
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


def judged(
    plan: vamgpu.Plan, A: vamgpu.Projection, target: Any, off: Tolerances, quantile: float | None
) -> dict[str, Any]:  # fmt: skip
    """A light by its own operator and by traced rays from its frames."""
    return {
        "method": repr(plan.method),
        "iterations": len(plan.history),
        "evaluations": plan.evaluations,
        "seconds": round(plan.seconds, 1),
        "claimed": told(off.doses(A, plan, target)),
        "proved": told(prove_corners(A, vamgpu.pack(plan, quantile=quantile), target, off)),
    }


def bounded(
    A: vamgpu.Projection, target: Any, off: Tolerances, slab: int, evaluations: float, seconds: float,
    at: int | None = None,
) -> dict[str, Any]:  # fmt: skip
    """What no light exceeds, on all slices or on the hardest alone."""
    deep, until = A.grid.shape[2], time.perf_counter() + seconds
    first = at if at is not None else (deep - slab) // 2 if slab else 0
    slices = (first, first + slab) if slab else (0, deep)
    steps: list[Any] = []
    found = bound(
        A, target, evaluations=evaluations, tolerances=off, slices=slices if slab else None, progress=steps.append,
        cancel=lambda: time.perf_counter() > until,
    )  # fmt: skip
    return {
        "slices": list(slices), "spread": list(off.spread or ()), "bound": round(found.value, 5), "steps": len(steps),
        "window": round(steps[-1].window, 5), "evaluations": found.evaluations,
        "seconds": round(time.perf_counter() - until + seconds, 1),
    }  # fmt: skip


def tabled(size: int, budgets: list[int], device: Any) -> dict[str, Any]:
    """Windows at all corners, and nominal ones, of ten parts; prints the table."""
    off, found = Tolerances(axis=AXIS * PITCH, spread=(SPREADS[0] * PITCH, SPREADS[1] * PITCH)), {}
    ways = [("nominal", 400, None)] + [(m, budget, off) for budget in budgets for m in ("lbfgs", "ramp")]
    print(f"| part | {' | '.join(f'{method}, {budget}' for method, budget, _ in ways)} |")
    print("|---" + "|--:" * len(ways) + "|")
    for name, (A, fractions) in parts(device, size).items():
        row = found[name] = {}
        for method, budget, tolerances in ways:
            how = "ramp" if method == "nominal" else method
            plan = vamgpu.optimize(A, fractions, how, evaluations=budget, tolerances=tolerances, progress=False)
            doses = off.doses(A, plan, fractions)
            row[f"{method} {budget}"] = {"corner": round(doses.window, 5), "nominal": round(doses.nominal, 5)}
        cells = " | ".join(f"{each['corner']:+.3f} ({each['nominal']:+.3f})" for each in row.values())
        print(f"| {name} | {cells} |", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--method", default="ramp", help="of both lights")
    parser.add_argument("--iterations", type=int, nargs="+", default=[120], help="each goes on from the one before")
    parser.add_argument("--rings", action="store_true", help="seek light on rings")
    parser.add_argument("--quantile", type=float, default=None, help="of lit pixels that full-on ones show")
    parser.add_argument("--only", choices=("nominal", "robust", "neither"), default=None)
    parser.add_argument("--bound", type=int, default=0, help="evaluations of the robust bound")
    parser.add_argument("--slab", type=int, nargs="+", default=[0], help="slices of each bound; 0 for all")
    parser.add_argument("--first", type=int, nargs="+", default=[], help="first slice of each slab; else the middle")
    parser.add_argument("--seconds", type=float, default=600.0, help="of each bound at most")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    parser.add_argument("--parts", action="store_true", help="the ten parts of best_light.py instead of the Benchy")
    parser.add_argument("--budgets", type=int, nargs="+", default=[600, 1500], help="evaluations, of --parts")
    args = parser.parse_args()
    warnings.simplefilter("ignore", ToleranceWarning)
    device = vamgpu.open_device(args.device)
    if args.parts:
        found = {"machine": machine(device), "parts": tabled(SIZE, args.budgets, device)}
        print(write_record(args.records, f"robust-parts-{args.label}", found))
        return
    target = benchy(args.mesh, args.n, device)
    pitch = target.grid.pitch
    beam, motion = vamgpu.Beam((args.n, args.n), pitch), vamgpu.Turntable(args.angles)
    A = vamgpu.Projection(target.grid, beam, motion, None, device)
    off = Tolerances(axis=AXIS * pitch, spread=(SPREADS[0] * pitch, SPREADS[1] * pitch))
    record: dict[str, Any] = {"n": args.n, "angles": args.angles, "machine": machine(device)}
    plan = None
    B = vamgpu.RingProjection.of(A) if args.rings else A
    for name, tolerances in (("nominal", None), ("robust", off)):
        plan = None
        for iterations in args.iterations if args.only in (None, name) else ():
            plan = vamgpu.optimize(
                B, target, args.method, iterations, tolerances=tolerances, resume=plan, progress=False
            )
            record[f"{name} {iterations}"] = judged(plan, A, target, off, args.quantile)
            print(name, json.dumps(record[f"{name} {iterations}"]), flush=True)
    blurred = replace(off, spread=(SPREADS[1] * pitch, SPREADS[1] * pitch))
    for k, slab in enumerate(args.slab if args.bound else ()):
        at = args.first[k] if k < len(args.first) else None
        found = bounded(A, target, blurred, slab, args.bound, args.seconds, at)
        record.setdefault("bounds", []).append(found)
        print(json.dumps(found), flush=True)
    print(write_record(args.records, f"robust-{args.n}-{args.label}", record))


if __name__ == "__main__":
    main()
