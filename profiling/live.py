"""How long each stage of a live decision takes: a vial is seen late in its print, and the rest is planned anew."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import vamgpu
from vamgpu.live import CuringResin, LiveLoop, LiveSetup, LiveState, SensorNoise, Turbidity
from vamgpu.optics.vial import Vial

PLANNED, SHOWN = 16, 12
OFF = np.array([0.85, 1.1, 0.05, 0.0, 0.04, 0.0])
"""What the machine does to the dose; of `vamgpu.live.estimate.NAMES`."""
STAGES = ("see", "estimate", "replan")


def case(n: int, angles: int, device: str, iterations: int, evaluations: float) -> tuple[LiveLoop, LiveState, Any]:
    """A loop, its state before turn `SHOWN`, and the images of one or two turns later."""
    pitch = 9.6 / n
    vial, red = (Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=each) for each in (0.1, 0.0))
    setup = LiveSetup(
        (n, n, n), pitch, (2 * n, n), pitch, angles, vial, red, 800.0, SensorNoise(8.0, 0.0, 10), CuringResin(),
        Turbidity((0.0, 1.0), (0.0, 0.25)), 2.0, PLANNED, 2 * PLANNED, iterations, evaluations, device, 1,
    )  # fmt: skip
    A = setup.projection(vial)
    x, y, z = np.meshgrid(*A.grid.axes(), indexing="ij", sparse=True)
    part = ((np.hypot(x, y) < 3.0) & (np.hypot(x - 1.0, y) > 1.2) & (np.abs(z) < 4.0)).astype(np.float32)
    light = np.asarray(A(part))
    light *= 1.1 / PLANNED / np.asarray(A.T(light))[part > 0].mean()
    loop = setup.loop(part, light)
    camera, even = setup.camera(), np.asarray(loop.estimator.delivering(OFF).T(light))

    def frames(turns: int) -> np.ndarray:
        conversion = setup.resin.conversion(turns * even + 0.2 * setup.resin.induction)
        light = camera.transmitted(setup.turbidity.extinction_at(conversion).astype(np.float32))
        return camera.noise.expose(light, turns)

    state = replace(loop.start(), turn=SHOWN - 1, shown=(SHOWN - 1) * light, turns=PLANNED - SHOWN)
    return loop, state, frames


def measured(n: int, angles: int, device: str, iterations: int, evaluations: float) -> dict[str, Any]:
    """One decision after another that is not counted: seconds by stage, and evaluations in a second of replanning."""
    loop, state, frames = case(n, angles, device, iterations, evaluations)
    images = [frames(turns) for turns in (SHOWN, SHOWN + 1)]
    state, first = loop.decide(state, images[0])
    began = time.perf_counter()
    _, decision = loop.decide(state, images[1])
    seconds = time.perf_counter() - began
    assert decision.parameters, (first.reason, decision.reason)
    return {
        "device": device, "size": n, "angles": angles, **decision.stages, "decision": seconds,
        "first": sum(first.stages.values()), "rate": evaluations / decision.stages["replan"],
        "found": decision.parameters, "reason": decision.reason,
    }  # fmt: skip


def table(rows: Sequence[dict[str, Any]], markdown: bool) -> str:
    """Rows as text, or as a table of Markdown."""
    head = ["device", "voxels × angles", *(f"{name} [s]" for name in STAGES), "decision [s]", "evaluations a second"]
    cells = [
        [row["device"], f"{row['size']}³ × {row['angles']}", *(f"{row[name]:.2f}" for name in (*STAGES, "decision")),
         f"{row['rate']:.1f}"]
        for row in rows
    ]  # fmt: skip
    if markdown:
        return "\n".join("| " + " | ".join(each) + " |" for each in [head, ["---"] * len(head), *cells])
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    return "\n".join("  ".join(f"{c:{w}}" for c, w in zip(each, widths, strict=True)) for each in [head, *cells])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256], help="voxels along an edge")
    parser.add_argument("--angles", type=int, default=180)
    parser.add_argument("--iterations", type=int, default=8, help="pairs of projections to see with")
    parser.add_argument("--evaluations", type=float, default=8.0, help="projector evaluations to replan with")
    parser.add_argument("--device", nargs="+", help="names; all here but numpy by default")
    parser.add_argument("--markdown", action="store_true", help="a table of Markdown")
    given = parser.parse_args()
    devices = given.device or [name for name in vamgpu.devices() if name != "numpy"]
    load, rows = os.getloadavg()[0], []
    for device in devices:
        for n in given.sizes:
            rows.append(measured(n, given.angles, device, given.iterations, given.evaluations))
            found = ", ".join(f"{name} {v:.3g} ± {s:.2g}" for name, (v, s) in rows[-1]["found"].items())
            print(f"{device}, {n}³: first {rows[-1]['first']:.2f} s, {found}; {rows[-1]['reason']}", flush=True)
    print(f"load {load:.1f} before\n{table(rows, given.markdown)}")


if __name__ == "__main__":
    main()
