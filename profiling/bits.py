"""What frames of few bits leave of the process window: planned, proved of the light itself, and from its frames.

A cross and a plate of holes, one slice of 64 × 64 voxels of 0.1 mm, and a boat 4.4 mm long, all in a vial; 60
evaluations of two thresholds by L-BFGS, 60 of the default.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from common import HERE, machine, write_record

import vamgpu as vam
from vamgpu.errors import PackWarning
from vamgpu.targets import shapes

PITCH, ACROSS = 0.1, 64
VIAL = vam.Vial(radius=8.0, wall=0.5, resin_index=1.5, wall_index=1.47, absorption=0.05)
METHODS = {"lbfgs": 60, "ramp": 60}
WAYS: dict[str, dict[str, Any]] = {"8 bits": {"bits": 8}, "1 bit, round": {"bits": 1}} | {
    f"1 bit, {how}": {"bits": 1, "dither": how} for how in ("error-diffusion", "fit")
}


@dataclass(frozen=True)
class Unrounded:
    """The light of a plan, for a proof beside those of frames."""

    sinogram: Any
    scale: float
    motion: Any = None

    def irradiance(self, device: Any) -> Any:
        return self.sinogram


def parts(device: str) -> Iterator[tuple[str, vam.Grid, Any, tuple[str, ...]]]:
    """Name, grid, target and methods of each part."""
    x, y = np.meshgrid(*2 * [np.arange(ACROSS) - 0.5 * (ACROSS - 1)], indexing="ij")
    near, grid = np.hypot(x, y) < 26, vam.Grid((ACROSS, ACROSS, 1), PITCH)
    holes = near & ~((abs(abs(x) - 11) < 4) & (abs(abs(y) - 11) < 4))
    for name, part in (("cross", near & ((abs(x) < 6) | (abs(y) < 6))), ("holes", holes)):
        yield name, grid, part[:, :, None].astype(np.float32), tuple(METHODS)
    boat = vam.Target.from_mesh(shapes.build("boat"), height=4.4, pitch=PITCH, device=device)
    yield "boat", boat.grid, boat, tuple(METHODS)


def rows(device: str, angles: list[int]) -> Iterator[dict[str, Any]]:
    """A row for each part, number of angles and method."""
    for name, grid, target, methods in parts(device):
        for count in angles:
            beam = vam.Beam((int(1.5 * grid.shape[0]), grid.shape[2]), PITCH)
            A = vam.Projection(grid, beam, vam.Turntable(count), VIAL, device)
            for method in methods:
                plan = vam.optimize(A, target, method, evaluations=METHODS[method], progress=False)
                row: dict[str, Any] = {"part": name, "angles": count, "method": method, "planned": plan.window}
                row["unrounded"] = vam.simulate(A, cast(Any, Unrounded(plan.sinogram, 1.0)), target).scores.window
                for way, how in WAYS.items():
                    began = time.perf_counter()
                    frames = vam.pack(plan, **how)
                    row["seconds"] = time.perf_counter() - began
                    row[way] = vam.simulate(A, frames, target).scores.window
                yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--angles", type=int, nargs="+", default=[60, 180, 360])
    parser.add_argument("--device", default="opencl:intel:0")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu")
    given = parser.parse_args()
    warnings.simplefilter("ignore", PackWarning)
    names = ["part", "angles", "method", "planned", "unrounded", *WAYS, "fit takes"]
    print("| " + " | ".join(names) + " |\n|" + "---|" * len(names))
    found = []
    for row in rows(given.device, given.angles):
        found.append(row)
        windows = (f"{row[name]:+.3f}" for name in names[3:-1])
        cells = row["part"], str(row["angles"]), row["method"], *windows, f"{row['seconds']:.1f} s"
        print("|", " | ".join(cells), "|", flush=True)
    device = vam.open_device(given.device)
    write_record(given.records, f"bits-{given.label}", {"machine": machine(device), "rows": found})


if __name__ == "__main__":
    main()
