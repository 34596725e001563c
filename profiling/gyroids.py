"""Gyroids on a web at the roll-to-roll paper's sampling: written by a stream, and judged by the bytes of its frames.

Film and roller of the paper's designs: r_i 7.6 mm, τ 3 mm, 0.5° a pose, 1.49 in 1.33, 2.2 /cm; 753 columns, 208
layers, cells of 3 mm, pixels as large as a layer. ``--every 4`` takes every fourth layer and pixel. Slices lie evenly
over a cell. The window is that of the whole web at one threshold, (least dose in the part − greatest outside) /
greatest; contrast is the difference over the sum of the mean doses in and out.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, machine, write_record

from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.targets.lattices import SheetGyroid, SkeletalGyroid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.stream import Stream

ROLLER = Roller(7.6, Film(3.0, 1.49, 1.33, 0.22), radians(0.5))
COLUMNS, LAYERS = 753, 208
DESIGNS = {"sheet": SheetGyroid(3.0), "skeletal": SkeletalGyroid(3.0)}


def part(design: str, layers: int, slices: int) -> np.ndarray:
    """Voxels whose center is in the solid, [l, rho, z]."""
    l = (np.arange(COLUMNS) + 0.5) * ROLLER.advance  # noqa: E741 - the web's axis
    rho, z = (np.arange(layers) + 0.5) * 3.0 / layers, (np.arange(slices) + 0.25) * 3.0 / slices
    return (DESIGNS[design](l[:, None, None], rho[:, None], z) < 0.0).astype(np.float32)


def measure(design: str, args: argparse.Namespace) -> dict[str, Any]:
    """Write a web, and prove it from its folder."""
    layers = LAYERS // args.every
    edge = 3.0 / layers
    target = part(design, layers, args.slices)
    job = Stream(
        target, ROLLER, ROLLER.beam(edge, args.slices), section=(layers, args.slices),
        pitch=(ROLLER.advance, edge, edge), method=args.method, iterations=args.iterations, core=args.core,
        device=args.device,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        began = time.perf_counter()
        folder = job.write(Path(place) / "web.vam")
        seconds = time.perf_counter() - began
        proof = prove_web(folder, device=args.device)
        pieces = list(proof.pieces())
    dose, inside = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("dose", "target"))
    least, leak, mean, out = dose[inside].min(), dose[~inside].max(), dose[inside].mean(), dose[~inside].mean()
    found = {"window": (least - leak) / dose.max(), "contrast": (mean - out) / (mean + out), "solid": inside.mean()}
    return {
        "iou": round(proof.iou, 6), **{name: round(float(value), 5) for name, value in found.items()},
        "segments": [round(score.window, 5) for score in proof.segments], "voxels": list(inside.shape),
        "poses": folder.frames, "pixels": list(job.beam.pixels),
        "saturated": sum(score.saturated for score in proof.segments), "seconds": round(seconds, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", nargs="+", choices=tuple(DESIGNS), default=list(DESIGNS))
    parser.add_argument("--every", type=int, default=1, help="layers and pixels taken as one")
    parser.add_argument("--slices", type=int, default=1)
    parser.add_argument("--method", default="best")
    parser.add_argument("--iterations", type=int, default=300, help="of each segment")
    parser.add_argument("--core", type=float, default=2.1, help="of a segment, in windows of light; 2.1: all in one")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    options = {name: getattr(args, name) for name in ("every", "method", "iterations", "core")}
    record: dict[str, Any] = {**options, "machine": machine(), "designs": {}}
    for design in args.designs:
        record["designs"][design] = found = measure(design, args)
        print(f"{design}: IoU {found['iou']}, window {found['window']:+.4f}, {found['seconds']} s", flush=True)
    print(write_record(args.records, f"gyroids-{args.label}", record))


if __name__ == "__main__":
    main()
