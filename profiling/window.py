"""Strict process window against projector pairs, for every method on the Benchy: a plot and a record.

128^3 x 360, straight light, nothing absorbed. Every voxel of the inscribed cylinder counts, in the part where its
fraction is at least 0.5, else out of it. The curves are what the methods see on their way (float32, on the device;
accelerated ones look ahead of the light they hold). The marked points and the table are the light at the end, its dose
computed by the float64 reference; beside them what frames of 8 bits make of it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, MESH, benchy, machine, write_record

import vamgpu
from vamgpu.errors import Cancelled
from vamgpu.metrics import score
from vamgpu.optimize.run import METHODS

BUDGETS = (40, 120)
"""Projector pairs at which the default method is judged."""
LABELS = {
    "window": "process window (default)",
    "recipe": "recipe",
    "fbp": "filtered back projection",
    "cal": "CAL gradient descent",
    "osmo": "OSMO",
    "penalty": "penalty minimization",
    "bclp": "BCLP",
    "lbfgs": "L-BFGS, two thresholds",
}


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
        """Scores of a plan and, by the device's dose, of its frames of 8 bits."""
        out = {"pairs": plan.pairs, "seconds": round(plan.seconds, 3), "float": self.scores(plan.sinogram)}
        for quantile in (1.0, 0.9999):
            proof = vamgpu.simulate(self.A, vamgpu.pack(plan, quantile=quantile), self.target)
            light = {"light_efficiency": round(proof.light_efficiency, 5)}
            out[f"8 bits, full-on at quantile {quantile:g}"] = brief(proof.scores) | light
        return out


def brief(found: Any) -> dict[str, float]:
    """The scores that are reported."""
    return {
        "window": found.window,
        "window_p0.1_p99.9": found.windows.fine,
        "window_p1_p99": found.windows.trimmed,
        "iou": found.iou,
        "error_rate": found.error_rate,
    }


def run(A: vamgpu.Projection, target: Any, method: str, pairs: int, resume: Any = None) -> Any:
    """A plan of at most ``pairs`` projector pairs, a step more where a step costs several."""
    spent = resume.pairs if resume is not None else 0.0

    def told(step: Any) -> None:
        nonlocal spent
        spent = step.pairs

    limit = 1 if method == "fbp" else pairs
    try:
        return vamgpu.optimize(
            A, target, method, iterations=limit, progress=told, cancel=lambda: spent >= pairs, resume=resume
        )
    except Cancelled as stop:
        return stop.plan


def line(found: dict[str, Any]) -> str:
    """A judged point in words."""
    exact, eight = found["float"], found["8 bits, full-on at quantile 1"]
    window = f"window {exact['window']:+.4f} ({eight['window']:+.4f} at 8 bits)"
    return f"{window}  IoU {exact['iou']:.6f}  VER {exact['error_rate']:.2e}"


def curve(plan: Any) -> dict[str, list[float]]:
    """What a run saw: window against pairs."""
    return {"pairs": [s.pairs for s in plan.history], "window": [round(s.window, 5) for s in plan.history]}


def measure(A: vamgpu.Projection, target: Any, args: argparse.Namespace) -> dict[str, Any]:
    """Curves and judged points of every method asked for."""
    out: dict[str, Any] = {}
    for method in args.methods:
        judge = Judge(A, target, args.reference == "all" or (args.reference == "default" and method == "window"))
        plan: Any = None
        points: list[dict[str, Any]] = []
        for budget in sorted({min(b, args.pairs) for b in BUDGETS}) if method == "window" else (args.pairs,):
            plan = run(A, target, method, budget, plan)
            points.append(judge.plan(plan))
            found = points[-1]
            print(f"{LABELS[method]:26} {plan.pairs:5.0f} pairs {plan.seconds:6.2f} s  {line(found)}", flush=True)
        out[method] = {"settings": repr(plan.method), "curve": curve(plan), "points": points}
    return out


def plot(record: dict[str, Any], path: Path) -> None:
    """Window against pairs, every method in one picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.5, 5.2), layout="constrained")
    for method, found in record["methods"].items():
        thick = 2.6 if method == "window" else 1.3
        (line,) = axes.plot(found["curve"]["pairs"], found["curve"]["window"], lw=thick, label=LABELS[method])
        for point in found["points"]:
            axes.plot(point["pairs"], point["float"]["window"], "o", color=line.get_color(), ms=6)
    axes.axhline(0.0, color="0.3", lw=0.8)
    axes.set(xlabel="projector pairs", ylabel="strict process window over the greatest dose", xlim=(0, None))
    ends = [point["float"]["window"] for found in record["methods"].values() for point in found["points"]]
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
    parser.add_argument("--pairs", type=int, default=120)
    parser.add_argument("--methods", nargs="+", choices=tuple(LABELS), default=list(LABELS))
    parser.add_argument("--device", default=None, help="where the methods run; the best one here by default")
    parser.add_argument("--reference", choices=("all", "default", "none"), default="all",
                        help="whose light the float64 reference judges: about 15 s each at full size")  # fmt: skip
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--plot", type=Path, default=HERE.parent / "docs" / "window.png")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    if missing := set(METHODS) - set(LABELS) - {"default"}:
        print(f"not plotted: {', '.join(sorted(missing))}")
    device = vamgpu.open_device(args.device)
    target = benchy(args.mesh, args.n, device)
    beam, motion = vamgpu.Beam((args.n, args.n), target.grid.pitch), vamgpu.Turntable(args.angles)
    A = vamgpu.Projection(target.grid, beam, motion, None, device)
    record = {
        "n": args.n,
        "angles": args.angles,
        "in_voxels": int(np.count_nonzero(target.numpy() >= 0.5)),
        "machine": machine(device),
        "methods": measure(A, target, args),
    }
    plot(record, args.plot)
    print(args.plot, write_record(args.records, f"window-{args.n}-{args.label}", record))


if __name__ == "__main__":
    main()
