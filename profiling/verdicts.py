"""Verdicts of proofs beside those of a judge apart: parts × methods × evaluations.

Parts, vial, light and judge are those of `profiling.below_voxel`. The judge exposes the same 8-bit frames on voxels of
its own, for the seconds that the proof tells. It says whether bodies and cavities of mesh and print are the same, one
for one; whether anything prints wrong two pixels or more from the surface or the surface is off by more than a pixel in
95 %; and whether resin beyond the judged cylinder prints, a pixel or more from the part. A verdict agrees where all
three are what the proof's faults say.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import vamgpu
from profiling.below_voxel import LAMP, PARTS, Judge, Posed, found, part, posed
from profiling.common import HERE, machine, write_record
from vamgpu.errors import DivergenceWarning, OpticsWarning
from vamgpu.printing.proof import Proof

METHODS = ("ramp", "lbfgs", "osmo")
BUDGETS = (40, 120)
SIZE = 14
FINE = 4
"""The judge's voxels along a pixel: with 2 the dose where two bodies come closest is missed by up to 1 %."""
SPECK = 8
"""Voxels of the judge below which a piece of the part or its print is what sampling breaks off a sharp edge."""


def judged(job: Posed, judge: Judge, proof: Proof) -> dict[str, bool]:
    """What is right, by the judge's dose at the proof's exposure."""
    light, motion, inner = proof.frames.irradiance(job.A.device).numpy(), job.A.motion, judge.cylinder
    dose = judge.dose(light, motion)
    assert proof.seconds is not None
    frame = LAMP["irradiance"] / proof.frames.scale * proof.seconds / motion.angles
    at = LAMP["critical_dose"] / frame
    values, depth = dose[inner], judge.depth[inner]
    wrong = np.abs(depth[(values >= at) != (depth > 0.0)])
    off = np.abs(judge._off(dose, at))
    return {
        "bodies": same_pieces(dose >= at, judge.bodies, inner),
        "surface": bool(wrong.max(initial=0.0) < 2.0 and off.size and np.quantile(off, 0.95) <= 1.0),
        "stray": judge.beside(dose, light, motion) < at,
    }


def same_pieces(printed: np.ndarray, bodies: np.ndarray, judged: np.ndarray) -> bool:
    """Whether bodies in the judged cylinder, and cavities, are the part's, one for one, half of each in place."""
    # bodies hang together by faces, voids by corners too; those that come to the end of the cylinder are open there
    corners, print_ = np.ones((3, 3, 3)), printed & judged
    return _one_for_one(_pieces(print_), bodies) and _one_for_one(
        _pieces(~print_, corners), _pieces(bodies == 0, corners)
    )


def _pieces(mask: np.ndarray, sides: Any = None) -> np.ndarray:
    from scipy.ndimage import label

    return label(mask, sides)[0]  # type: ignore[index]


def _one_for_one(printed: np.ndarray, own: np.ndarray) -> bool:
    """Whether pieces overlap one for one; specks that sampling breaks off the part or its print do not count."""
    both = (own > 0) & (printed > 0)
    pairs, shared = np.unique(np.stack([own[both], printed[both]]), axis=1, return_counts=True)
    size, found = (np.bincount(each.ravel()) for each in (own, printed))
    size[0] = found[0] = 0
    wanted, other = (each >= max(min(SPECK, 1e-4 * each.max()), 1) for each in (size, found))
    other |= (found > 0) & ~np.isin(np.arange(found.size), pairs[1])  # loose ones do
    (one, two), shared = (each[..., wanted[pairs[0]] & other[pairs[1]]] for each in (pairs, shared))
    counts = {int(wanted.sum()), int(other.sum()), np.unique(one).size, np.unique(two).size, one.size}
    return len(counts) == 1 and bool((shared >= 0.5 * size[one]).all())


def proved(proof: Proof) -> dict[str, bool]:
    """The same of the proof's verdict."""
    changes, said = proof.judgement.surface.changes, [fault.said for fault in proof.verdict.faults]
    kinds = ("bodies_lost", "bodies_merged", "bodies_broken", "bodies_extra", "cavities_filled", "cavities_extra")
    return {  # holes are the verdict's alone: the judge counts none
        "bodies": not any(getattr(changes, kind) for kind in kinds),
        "surface": not any("from the surface prints" in each or "5 % of the" in each for each in said),
        "stray": not any("beyond the judged cylinder prints" in each for each in said),
    }


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m profiling.verdicts", description=__doc__)
    parser.add_argument("--parts", nargs="+", default=list(PARTS))
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    parser.add_argument("--budgets", nargs="+", type=int, default=list(BUDGETS), help="projector evaluations")
    parser.add_argument("--size", type=float, default=SIZE, help="pixels in the resin that make a part's radius")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args(arguments)
    for kind in (DivergenceWarning, OpticsWarning):
        warnings.simplefilter("ignore", kind)
    device = vamgpu.open_device(args.device)
    cases: list[dict[str, Any]] = []
    for name in args.parts:
        job = posed(part(name), args.size, device)
        judge = Judge.of(job, FINE)
        for method in args.methods:
            for budget in args.budgets:
                began = time.perf_counter()
                plan = found(job, method, budget)
                proof = vamgpu.simulate(job.A, vamgpu.pack(plan), job.target, **LAMP)
                case = {"part": name, "method": method, "evaluations": budget, "judged": judged(job, judge, proof),
                        "proved": proved(proof), "verdict": proof.verdict.sentence,
                        "seconds": round(time.perf_counter() - began, 1)}  # fmt: skip
                cases.append(case | {"agrees": case["judged"] == case["proved"]})
                print(name, method, budget, case["judged"], case["proved"], f"{case['seconds']:.1f} s", flush=True)
        agree = sum(case["agrees"] for case in cases)
        print(f"{agree} of {len(cases)} verdicts agree", flush=True)
        record = {"size": args.size, "machine": machine(device), "agree": agree, "of": len(cases), "cases": cases}
        write_record(args.records, f"verdicts-{args.label}", record)


if __name__ == "__main__":
    main()
