"""Gray bodies by the default and by L-BFGS at equal projector evaluations, proved from 8-bit frames along traced rays.

Two slices of 40 × 40 voxels and a ball of 32 × 32 × 28, 60 angles, each with a body that asks for a dose of its own.
For each light: strict window of doses over what voxels are asked for, overlap, and the voxels of the part and of the
gray body that get another dose than asked.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, machine, write_record

import vamgpu as vam
from vamgpu.errors import DivergenceWarning

PITCH, ANGLES, BUDGETS = 0.1, 60, (40, 120, 400)


def rod(radius: float, x: float, y: float = 0.0) -> Any:
    return lambda a, b, c: np.hypot(a - x, b - y) - radius + 0.0 * c


def ball(radius: float, x: float = 0.0) -> Any:
    return lambda a, b, c: np.sqrt((a - x) ** 2 + b**2 + c**2) - radius


SCENES = {
    "square, soft core": ((40, 40, 1), [
        vam.Body(lambda a, b, c: np.maximum(np.abs(a), np.abs(b)) - 1.2 + 0.0 * c),
        vam.Body(rod(0.6, 0.2, 0.1), "gray", dose=0.85, tolerance=0.1),
    ]),
    "ring, soft rod": ((40, 40, 1), [
        vam.Body(lambda a, b, c: np.abs(np.hypot(a + 0.4, b) - 0.9) - 0.35 + 0.0 * c),
        vam.Body(rod(0.4, 1.3), "gray", dose=0.8, tolerance=0.15),
    ]),
    "ball, soft core": ((32, 32, 28), [
        vam.Body(ball(1.2)), vam.Body(ball(0.55, 0.2), "gray", dose=0.8, tolerance=0.15),
    ]),
}  # fmt: skip


def measure(shape: tuple[int, int, int], bodies: list[vam.Body], device: Any) -> dict[str, Any]:
    """Both methods at every budget."""
    target = vam.Scene(bodies).target(pitch=PITCH, shape=shape, device=device)
    beam = vam.Beam((shape[0] + (16 if shape[2] == 1 else 0), shape[2]), PITCH)
    A, found = vam.Projection(target.grid, beam, vam.Turntable(ANGLES), None, device), {}
    for budget in BUDGETS:
        for method in ("ramp", "lbfgs"):
            proof = vam.simulate(A, vam.pack(vam.optimize(A, target, method, evaluations=budget)), target)
            assert proof.independent
            found[f"{method} {budget}"] = {
                "window": round(float(proof.scores.window), 4), "iou": round(float(proof.scores.iou), 4),
                **{body.role: {"wrong": body.wrong, "of": body.voxels} for body in proof.bodies},
            }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args()
    warnings.simplefilter("ignore", DivergenceWarning)
    device = vam.open_device(args.device)
    record: dict[str, Any] = {"machine": machine(device)}
    for name, (shape, bodies) in SCENES.items():
        record[name] = measure(shape, bodies, device)
        for how, found in record[name].items():
            part, gray = (f"{found[role]['wrong']} of {found[role]['of']}" for role in ("print", "gray"))
            print(f"| {name} | {how} | {found['window']:+.3f} | {found['iou']:.3f} | {part} | {gray} |", flush=True)
    print(write_record(args.records, f"gray-{args.label}", record))


if __name__ == "__main__":
    main()
