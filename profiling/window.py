"""Strict process window against projector evaluations, every method on the Benchy at equal thresholds: plot and record.

128^3 x 360, straight light, nothing absorbed. Every voxel of the inscribed cylinder counts, in the part where its
fraction is at least 0.5, else out of it. All methods ask for the same two thresholds (`vamgpu.methods.compare`) and
may spend the same projector evaluations, warm starts included; what each returns is its best light. The curves are the
best window of the light held up to there. The marked points and the table are the plan's light: claimed, its dose
computed by the float64 reference, and proved, what `simulate` makes of its frames as `pack` writes them by default.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, MESH, benchy, machine, write_record

import vamgpu
from vamgpu.methods.compare import INSIDE, LABELS, OUTSIDE, compared
from vamgpu.metrics import score

BUDGETS = (40, 120)
"""Projector evaluations at which methods are judged."""


class Judge:
    """Scores light by the reference."""

    def __init__(self, A: vamgpu.Projection, target: Any, reference: bool) -> None:
        self.A, self.target, self.reference = A, target, reference
        name = "numpy" if reference else A.device
        self.exact = vamgpu.Projection(A.grid, A.beam, A.motion, A.vessel, name)
        self.fraction = self.exact.device.upload(target.numpy()) if reference else target.on(A.device)

    def scores(self, light: Any) -> dict[str, Any]:
        """Window, IoU and VER of light on the device of the operator."""
        start = time.perf_counter()
        there = self.exact.device.upload(light.numpy()) if self.reference else light
        found = score(self.exact.T(there), self.fraction)
        return {
            "dose": "float64 reference" if self.reference else f"float32 on {self.A.device.name}",
            "seconds_of_judging": round(time.perf_counter() - start, 2),
            **brief(found),
        }

    def plan(self, plan: Any) -> dict[str, Any]:
        """Scores of a plan's light, and of its frames as they are packed by default."""
        out = {"pairs": plan.evaluations, "seconds": round(plan.seconds, 3), "best_iteration": plan.best_iteration}
        proof = vamgpu.simulate(self.A, vamgpu.pack(plan), self.target)
        light = {"light_efficiency": round(proof.light_efficiency, 5)}
        return out | {"claimed": self.scores(plan.sinogram), "proved": brief(proof.scores) | light}


def brief(found: Any) -> dict[str, float]:
    """The scores that are reported."""
    return {
        "window": found.window,
        "window_p0.1_p99.9": found.windows.fine,
        "window_p1_p99": found.windows.trimmed,
        "iou": found.iou,
        "error_rate": found.error_rate,
    }


def line(found: dict[str, Any]) -> str:
    """A judged point in words."""
    claimed, proved = found["claimed"], found["proved"]
    window = f"window {claimed['window']:+.4f} claimed, {proved['window']:+.4f} proved"
    return f"{window}  IoU {proved['iou']:.6f}  VER {proved['error_rate']:.2e}"


def curve(plan: Any) -> dict[str, list[float]]:
    """The best window up to each number of evaluations."""
    best = np.maximum.accumulate([step.window for step in plan.history])
    return {"pairs": [step.evaluations for step in plan.history], "window": [round(float(value), 5) for value in best]}


def measure(A: vamgpu.Projection, target: Any, args: argparse.Namespace) -> dict[str, Any]:
    """Curves and judged points of every method asked for."""
    out: dict[str, Any] = {}
    for method in args.methods:
        judge = Judge(A, target, args.reference == "all" or (args.reference == "default" and method == "window"))
        plan: Any = None
        points: list[dict[str, Any]] = []
        for budget in sorted({min(b, args.evaluations) for b in BUDGETS}):
            # a line search that a budget cuts short is not what it would have been: that method begins anew
            before = None if method == "lbfgs" else plan
            plan = compared(A, target, method, budget, thresholds=tuple(args.thresholds), resume=before)
            points.append(judge.plan(plan))
            found = points[-1]
            print(
                f"{LABELS[method]:26} {plan.evaluations:5.0f} evaluations {plan.seconds:6.2f} s  {line(found)}",
                flush=True,
            )
        out[method] = {"settings": repr(plan.method), "curve": curve(plan), "points": points}
    return out


def plot(record: dict[str, Any], path: Path) -> None:
    """Window against evaluations, every method in one picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.5, 5.2), layout="constrained")
    for method, found in record["methods"].items():
        thick = 2.6 if method == "window" else 1.3
        (line,) = axes.plot(found["curve"]["pairs"], found["curve"]["window"], lw=thick, label=LABELS[method])
        for point in found["points"]:
            axes.plot(point["pairs"], point["proved"]["window"], "o", color=line.get_color(), ms=6)
    axes.axhline(0.0, color="0.3", lw=0.8)
    axes.set(
        xlabel="projector evaluations", ylabel="strict process window; points: proved from the frames", xlim=(0, None)
    )
    ends = [point["proved"]["window"] for found in record["methods"].values() for point in found["points"]]
    axes.set_ylim(bottom=min(ends) - 0.05)
    size = f"{record['n']}³ × {record['angles']}"
    axes.set_title(f"Benchy, {size}, straight light; above zero one threshold prints every voxel right", fontsize=10)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8, loc="center right", bbox_to_anchor=(1.0, 0.27), ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--evaluations", type=int, default=120)
    parser.add_argument("--thresholds", type=float, nargs=2, default=(OUTSIDE, INSIDE), metavar=("OUTSIDE", "INSIDE"))
    parser.add_argument("--methods", nargs="+", choices=tuple(LABELS), default=[*LABELS][1:])
    parser.add_argument("--device", default=None, help="where the methods run; the best one here by default")
    parser.add_argument("--reference", choices=("all", "default", "none"), default="all",
                        help="whose light the float64 reference judges: about 15 s each at full size")  # fmt: skip
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--plot", type=Path, default=HERE.parent / "docs" / "window.png")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    device = vamgpu.open_device(args.device)
    target = benchy(args.mesh, args.n, device)
    beam, motion = vamgpu.Beam((args.n, args.n), target.grid.pitch), vamgpu.Turntable(args.angles)
    A = vamgpu.Projection(target.grid, beam, motion, None, device)
    record = {
        "n": args.n,
        "angles": args.angles,
        "thresholds": list(args.thresholds),
        "in_voxels": int(np.count_nonzero(target.numpy() >= 0.5)),
        "machine": machine(device),
        "methods": measure(A, target, args),
    }
    plot(record, args.plot)
    print(args.plot, write_record(args.records, f"window-{args.n}-{args.label}", record))


if __name__ == "__main__":
    main()
