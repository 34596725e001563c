"""Verdicts of proofs beside those of a judge apart: parts × methods × evaluations.

Parts, vial, light and judge are those of `profiling.below_voxel`. The judge exposes the same 8-bit frames on voxels of
its own, at the exposure that the proof tells. It says whether bodies and voids of mesh and print are the same, one for
one; whether anything prints wrong two pixels or more from the surface or the surface is off by more than a pixel in
95 %; and whether resin beyond the judged cylinder prints. A verdict agrees where all three are what the proof's faults
say.
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
SPECK = 8
"""Voxels of the judge below which a body of the part is what sampling breaks off a sharp edge."""


def judged(job: Posed, judge: Judge, proof: Proof) -> dict[str, bool]:
    """What is right, by the judge's dose at the proof's exposure."""
    dose, inner = judge.dose(proof.frames.irradiance(job.A.device).numpy(), job.A.motion), judge.cylinder
    part, own = judge.filled >= 0.5, proof.target.numpy() >= 0.5
    at = proof.scores.threshold * dose[part & inner].mean() / proof.dose.numpy()[own].mean()
    values, depth = dose[inner], judge.depth[inner]
    wrong = np.abs(depth[(values >= at) != (depth > 0.0)])
    off = np.abs(judge._off(dose, at))
    return {
        "bodies": same_pieces(dose >= at, judge.depth > 0.0, inner),
        "surface": bool(wrong.max(initial=0.0) < 2.0 and off.size and np.quantile(off, 0.95) <= 1.0),
        "stray": bool(dose[judge.beyond].max(initial=0.0) < at),
    }


def same_pieces(printed: np.ndarray, part: np.ndarray, judged: np.ndarray) -> bool:
    """Whether bodies and voids in the judged cylinder are the part's, one for one, at least half of each in place."""
    faces, all_sides = None, np.ones((3, 3, 3))  # bodies hang together by faces, voids by corners too
    return _one_for_one(printed & judged, part & judged, faces) and _one_for_one(
        ~printed & judged, ~part & judged, all_sides
    )


def _one_for_one(printed: np.ndarray, part: np.ndarray, sides: Any) -> bool:
    """Whether pieces overlap one for one; those of the part that are specks of its sampling do not count."""
    from scipy.ndimage import label

    (own, count), (other, others) = label(part, sides), label(printed, sides)  # type: ignore[misc]
    size = np.bincount(own.ravel(), minlength=count + 1)[1:]
    wanted = np.flatnonzero(size >= min(SPECK, 1e-4 * size.max(initial=0))) + 1
    both = np.isin(own, wanted) & (other > 0)
    pairs, shared = np.unique(np.stack([own[both], other[both]]), axis=1, return_counts=True)
    most = np.zeros(count + 1, int)
    np.maximum.at(most, pairs[0], shared)
    return len(wanted) == others == len(pairs[0]) and bool((most[wanted] >= 0.5 * size[wanted - 1]).all())


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
        judge = Judge.of(job)
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
