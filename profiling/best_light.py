"""Strict process window of every method on ten small parts at equal projector evaluations, beside its bound.

Five slices of 40 × 40 voxels and 60 angles, and five bundled shapes and lattices of some 32 voxels across and 60
angles. Every method asks for the same two thresholds (`vamgpu.methods.compare`) and may spend the same projector
evaluations, warm starts included. A light counts by its dose on the float64 reference, and by its 8-bit frames along
traced rays: window, time until the threshold is solid (65 mW/cm² and 50 mJ/cm³, 0.1 of the light absorbed a
millimeter), mean dose outside over the mean in the part. The bound is that of 1000 evaluations: no light whatever has a
wider window.

With --mesh, a solid of so many voxels and angles in place of the ten parts.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, benchy, machine, write_record
from slices import ANGLES, PITCH, SIDE, WIDE, slices

import vamgpu
from vamgpu.errors import Diverged, DivergenceWarning
from vamgpu.methods import bound
from vamgpu.methods.compare import LABELS, compared
from vamgpu.metrics import score
from vamgpu.targets import shapes
from vamgpu.units import mJ_cm3, mW_cm2

LAMP: dict[str, Any] = {"irradiance": 65 * mW_cm2, "critical_dose": 50 * mJ_cm3, "absorption": 0.1}
BUDGETS = (10, 40, 120, 400)
SIZE = 32
REFERENCED = 100_000
"""Voxels up to which the float64 reference exposes light; of more the proved window alone counts."""
SHAPES = ("boat", "gyroid_sphere", "cubic_lattice", "crossing_channels", "gear_base")


def parts(device: Any, size: int) -> dict[str, tuple[vamgpu.Projection, np.ndarray]]:
    """Operators and fractions of all ten."""
    found = {}
    for name, fractions in slices().items():
        grid, beam = vamgpu.Grid((SIDE, SIDE, 1), PITCH), vamgpu.Beam((WIDE, 1), PITCH)
        found[name] = (vamgpu.Projection(grid, beam, vamgpu.Turntable(ANGLES), None, device), fractions)
    for name in SHAPES:
        solid = shapes.build(name)
        factor = 0.5 * 0.9 * size * PITCH / solid.radius
        target = vamgpu.Target.from_mesh(solid, factor=factor, pitch=PITCH, device=device)
        columns, rows = target.grid.shape[0], target.grid.shape[2]
        beam = vamgpu.Beam((columns, rows), PITCH)
        found[name] = (vamgpu.Projection(target.grid, beam, vamgpu.Turntable(ANGLES), None, device), target.numpy())
    return found


def meshed(mesh: Path, size: int, angles: int, device: Any) -> dict[str, tuple[vamgpu.Projection, np.ndarray]]:
    """Operator and fractions of a mesh."""
    target = benchy(mesh, size, device, PITCH)
    A = vamgpu.Projection(target.grid, vamgpu.Beam((size, size), PITCH), vamgpu.Turntable(angles), None, device)
    return {mesh.stem: (A, target.numpy())}


def judged(A: vamgpu.Projection, fractions: np.ndarray, plan: vamgpu.Plan) -> dict[str, float]:
    """A light by the float64 reference, and proved from its frames."""
    proof = vamgpu.simulate(A, vamgpu.pack(plan), fractions, **LAMP)
    assert proof.independent and proof.seconds is not None
    window = proof.scores.window
    if fractions.size <= REFERENCED:
        exact = vamgpu.Projection(A.grid, A.beam, A.motion, A.vessel, "numpy")
        dose = exact.T(exact.device.upload(plan.sinogram.numpy()))
        window = score(dose, exact.device.upload(fractions)).window
    return {
        "window": round(float(window), 5),
        "proved": round(float(proof.scores.window), 5),
        "seconds": round(proof.seconds, 3),
        "outside": round(proof.outside_over_inside, 4),
    }


def measure(A: vamgpu.Projection, fractions: np.ndarray, methods: list[str], evaluations: int) -> dict[str, Any]:
    """Every method at every budget, and the bound."""
    out: dict[str, Any] = {}
    for method in methods:
        out[method] = {}
        plan: Any = None
        for budget in BUDGETS:
            # a line search that a budget cuts short is not what it would have been
            before = None if method in ("lbfgs", "ramp") else plan
            try:
                plan = compared(A, fractions, method, budget, resume=before)
            except Diverged as error:  # the light of before counts
                if error.plan is None:
                    raise
                plan = error.plan
            found = judged(A, fractions, plan)
            out[method][str(budget)] = {
                **found, "claimed": round(plan.window, 5), "evaluations": plan.evaluations,
                "solved_s": round(plan.seconds, 2),
            }  # fmt: skip
        print(method, json.dumps(out[method]), flush=True)
    limit = bound(A, fractions, evaluations=evaluations)
    return {"voxels": list(A.grid.shape), "bound": round(limit.value, 5), "methods": out}


def added(before: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    """A record with the methods and the machine of another added; the lower bound counts."""
    for name, part in before["parts"].items():
        part["methods"] |= record["parts"][name]["methods"]
        part["bound"] = min(part["bound"], record["parts"][name]["bound"])
    before["order"] += [method for method in record["order"] if method not in before["order"]]
    return before | {"machine": record["machine"]}


def table(record: dict[str, Any]) -> str:
    """In Markdown: windows, a row for a part and a budget, the greatest in bold; then, after the most evaluations, the
    proved window, the exposure time, and mean dose outside over that inside."""
    methods = record["order"]
    lines = [f"| part | bound | evaluations | {' | '.join(methods)} |", "|---" * 2 + "|--:" * (len(methods) + 1) + "|"]
    for name, part in record["parts"].items():
        for budget in BUDGETS:
            found = [part["methods"][method][str(budget)]["window"] for method in methods]
            cells = [f"**{w:+.3f}**" if w == max(found) else f"{w:+.3f}" for w in found]
            begins = f"{name} | {part['bound']:+.3f}" if budget == BUDGETS[0] else " | "
            lines.append(f"| {begins} | {budget} | {' | '.join(cells)} |")
    last = str(BUDGETS[-1])
    lines += ["", f"| part | {' | '.join(methods)} |", "|---" + "|--:" * len(methods) + "|"]
    for name, part in record["parts"].items():
        found = [part["methods"][method][last] for method in methods]
        told = [f"{each['proved']:+.3f}, {each['seconds']:.3g} s, {each['outside']:.2f}" for each in found]
        lines.append(f"| {name} | {' | '.join(told)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=tuple(LABELS), default=[*LABELS])
    parser.add_argument("--parts", nargs="+", default=None, help="some of the ten")
    parser.add_argument("--size", type=int, default=SIZE, help="voxels across of shapes and lattices, or of the mesh")
    parser.add_argument("--mesh", type=Path, default=None, help="a solid in place of the ten parts")
    parser.add_argument("--angles", type=int, default=360, help="of the mesh")
    parser.add_argument("--evaluations", type=int, default=1000, help="of the bound")
    parser.add_argument("--add", action="store_true", help="add the methods to the record that stands")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args()
    warnings.simplefilter("ignore", DivergenceWarning)
    device = vamgpu.open_device(args.device)
    record: dict[str, Any] = {
        "angles": ANGLES if args.mesh is None else args.angles,
        "order": args.methods,
        "machine": machine(device),
        "parts": {},
    }
    posed = parts(device, args.size) if args.mesh is None else meshed(args.mesh, args.size, args.angles, device)
    for name, (A, fractions) in posed.items():
        if args.parts is None or name in args.parts:
            record["parts"][name] = measure(A, fractions, args.methods, args.evaluations)
            print(name, "done", flush=True)
    if args.add:
        record = added(json.loads((args.records / f"best-light-{args.label}.json").read_text("utf-8")), record)
    print(table(record))
    print(write_record(args.records, f"best-light-{args.label}", record))


if __name__ == "__main__":
    main()
