"""How long each stage of a live decision takes: a vial is seen late in its print, and the rest is planned anew."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import machine, write_record

import vamgpu
from vamgpu.kernels.camera import draw_noise
from vamgpu.live import LiveLoop, LiveSetup, SensorNoise, Turbidity
from vamgpu.live.loop import LiveState
from vamgpu.live.printer import CuringResin
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import dot
from vamgpu.optics.vial import Vial

PLANNED, SHOWN = 16, 12
OPEN, NOISE = 800.0, SensorNoise(8.0, 0.0, 10)
OFF = np.array([0.85, 1.1, 0.05, 0.0, 0.04, 0.0, 0.0])
"""What the machine does to the dose; of `vamgpu.live.estimate.NAMES`."""
STAGES = ("see", "estimate", "replan")
BY = {"fastest": None, "rays": False, "rings": True}


def case(
    n: int, angles: int, device: str, iterations: int, evaluations: float, columns: float, rings: bool | None = None
) -> tuple[LiveLoop, LiveState, Callable[[int], np.ndarray]]:
    """A loop, its state before turn `SHOWN`, and the images of one or two turns later."""
    pitch, pixel = 9.6 / n, max(1.5 / columns, 1.0) * 9.6 / n
    vial, red = (Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=each) for each in (0.1, 0.0))
    setup = LiveSetup(
        (n, n, n), pitch, (round(columns * n), n), pixel, angles, vial, red, OPEN, NOISE, CuringResin(),
        Turbidity((0.0, 1.0), (0.0, 0.25)), 2.0, PLANNED, 2 * PLANNED, iterations, evaluations, device, 1,
        rings=rings,
    )  # fmt: skip
    A = setup.projection(vial)
    x, y, z = A.grid.axes()
    across = (np.hypot(x[:, None], y) < 3.0) & (np.hypot(x[:, None] - 1.0, y) > 1.2)
    part = (across[..., None] & (np.abs(z) < 4.0)).astype(np.float32)
    shone = A(A.device.upload(part))
    combine(1.1 / PLANNED * float(part.sum()) / dot(shone, shone), shone, 0.0, shone, shone)  # (A p)·(A p) = p·(Aᵀ A p)
    light = shone.numpy()
    loop = setup.loop(part, light)
    camera, even = loop.tomograph.camera, loop.estimator.calibrated(OFF).T(light)
    noise, known = (camera.projection.device.empty(camera.projection.range.shape) for _ in range(2))
    combine(0.0, noise, 0.0, noise, known, floor=NOISE.read**-2)
    rows = camera.projection.device.table(np.arange(n), "int32")

    def frames(turns: int) -> np.ndarray:
        def cured(even: np.ndarray) -> np.ndarray:
            conversion = setup.resin.conversion(turns * even + 0.2 * setup.resin.induction)
            return setup.turbidity.extinction_at(conversion).astype(np.float32)

        def levels(light: np.ndarray) -> np.ndarray:
            return np.clip(np.rint(light), 0, NOISE.brightest).astype(np.uint16).swapaxes(1, 2)

        dark = camera.darkened(cured(even))
        noise.device.launch(draw_noise, weight=known, slices=rows, seed=turns, noise=noise)
        combine(-OPEN, dark, 1.0, noise, dark)
        return levels(OPEN + dark.numpy())

    state = replace(loop.start(), turn=SHOWN - 1, shown=(SHOWN - 1) * light, turns=PLANNED - SHOWN)
    return loop, state, frames


def measured(
    n: int, angles: int, device: str, iterations: int, evaluations: float, columns: float, rings: bool | None = None
) -> dict[str, Any]:
    """One decision after another that is not counted: seconds by stage, and evaluations in a second of replanning."""
    began = time.perf_counter()
    loop, state, frames = case(n, angles, device, iterations, evaluations, columns, rings)
    images = [frames(turns) for turns in (SHOWN, SHOWN + 1)]
    made = time.perf_counter() - began
    state, first = loop.decide(state, images[0])
    began, busy = time.perf_counter(), time.process_time()
    _, decision = loop.decide(state, images[1])
    seconds, busy = time.perf_counter() - began, time.process_time() - busy
    assert decision.parameters, (first.reason, decision.reason)
    return {
        "device": device, "size": n, "angles": angles, "columns": round(columns * n), **decision.stages,
        "decision": seconds, "processor": busy / len(os.sched_getaffinity(0)),
        "rings": loop.estimator.quick is not None,
        "iterations": iterations, "evaluations": evaluations,
        "made": made, "first": sum(first.stages.values()), "rate": evaluations / decision.stages["replan"],
        "found": decision.parameters, "reason": decision.reason,
    }  # fmt: skip


def table(rows: Sequence[dict[str, Any]], markdown: bool) -> str:
    """Rows as text, or as a table of Markdown."""
    head = [
        "device", "voxels × angles × columns", "by", *(f"{name} [s]" for name in STAGES), "decision [s]",
        "processors' time, over the cores [s]", "evaluations a second",
    ]  # fmt: skip
    cells = [
        [row["device"], f"{row['size']}³ × {row['angles']} × {row['columns']}", "rings" if row["rings"] else "rays",
         *(f"{row[name]:.2f}" for name in (*STAGES, "decision", "processor")), f"{row['rate']:.1f}"]
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
    parser.add_argument("--columns", type=float, default=2.0, help="of beam and camera, over voxels across")
    parser.add_argument("--iterations", type=int, default=8, help="pairs of projections to see with")
    parser.add_argument("--evaluations", type=float, default=8.0, help="projector evaluations to replan with")
    parser.add_argument("--by", nargs="+", default=["fastest"], choices=list(BY), help="what sees and plans")
    parser.add_argument("--records", type=Path, help="folder of a record, such as profiling/records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    parser.add_argument("--device", nargs="+", help="names; all here but numpy by default")
    parser.add_argument("--markdown", action="store_true", help="a table of Markdown")
    given = parser.parse_args()
    devices = given.device or [name for name in vamgpu.devices() if name != "numpy"]
    load, rows = os.getloadavg()[0], []
    for device, n, by in ((device, n, by) for device in devices for n in given.sizes for by in given.by):
        row = measured(n, given.angles, device, given.iterations, given.evaluations, given.columns, BY[by])
        rows.append(row)
        found = ", ".join(f"{name} {v:.3g} ± {s:.2g}" for name, (v, s) in row["found"].items())
        made = f"made in {row['made']:.1f} s, first {row['first']:.2f} s"
        print(f"{device}, {n}³: {made}, {found}; {row['reason']}", flush=True)
    if given.records:
        told = {"machine": machine(*map(vamgpu.open_device, devices)), "load": load, "decisions": rows}
        print(write_record(given.records, f"live-decision-{given.label}", told))
    print(f"load {load:.1f} before\n{table(rows, given.markdown)}")


if __name__ == "__main__":
    main()
