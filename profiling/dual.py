"""Two colors at size: least squares over two sinograms of a volume, and every rule on slices of 1500 × 1500 pixels.

    python profiling/dual.py opencl:intel:0 --volume 128 --pixels 300

Prints seconds, projector evaluations and contrast; the second run of a volume is timed, the first compiles.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from profiling.color_contrast import Contrast
from profiling.gallery.dualcolor import slice_colors
from vamgpu import Beam, Projection, Turntable, Vat, open_device
from vamgpu.backend.device import Device
from vamgpu.methods.dual import Colors, DualColor, LeastSquares, superpose
from vamgpu.targets.designs import Block, dot_array, gray_wedges, usaf
from vamgpu.targets.target import Target

BLOCK = Block((5, 5, 6), 0.45, 0.9)


def volume(device: Device, n: int, angles: int, iterations: int) -> None:
    """The block of 5 × 5 × 6 compartments on n³ voxels, μR = 1 and 0.5."""
    pitch = float(np.hypot(*BLOCK.size[:2])) / (n - 6)
    small = BLOCK.target(pitch)
    room = [(n - have) // 2 for have in small.grid.shape]
    edges = [(r, n - have - r) for r, have in zip(room, small.grid.shape, strict=True)]
    fraction = np.pad(small.numpy(), edges)
    target = Target.from_array(fraction, pitch, "block")
    radius = target.grid.inscribed_radius * 1.001
    beam, motion = Beam((n, n), pitch), Turntable(angles)
    vats = (Vat(2.1 * radius, radius=radius, absorption=mu / radius) for mu in (1.0, 0.5))
    visible, uv = (Projection(target.grid, beam, motion, vat, device) for vat in vats)
    colors, cylinder = Colors(visible, uv), target.grid.cylinder()[:, :, None]
    superpose(colors, target, LeastSquares(2))
    plan = superpose(colors, target, LeastSquares(iterations))
    last, found = plan.history[-1], Contrast.of(plan.dose(), fraction, cylinder)
    print(f"{n}³ × {angles} angles: {iterations} iterations, {last.evaluations:g} pairs, {plan.seconds:.2f} s, error "
          f"{plan.history[0].error:.4f} → {last.error:.4f} (under {last.undersupply:.4f}, over {last.oversupply:.4f}), "
          f"window {found.window:+.3f}, IoU {found.half:.4f}, peak {device.ledger.peak / 1e9:.2f} GB")  # fmt: skip


def slices(device: Device, n: int, angles: int) -> None:
    """Every rule on single slices whose diagonal is Ø30 mm."""
    rules = {"SC": "sc", "SC2": "sc2", "DC": "dc", "DC kept": DualColor(recompute=False), "LSQ": LeastSquares(60)}
    for target in (dot_array(80, n), dot_array(800, n), usaf(pixels=n), gray_wedges(8, n), BLOCK.level(n)):
        colors, design = slice_colors(target, angles, device, (1.0, 1.0)), target.numpy()
        for name, rule in rules.items():
            started = time.perf_counter()
            plan = superpose(colors, target, rule)
            device.synchronize()
            found = Contrast.of(plan.dose(), design)
            print(f"{n}², {angles} angles, {target.name:14s} {name:8s} {time.perf_counter() - started:6.2f} s  in ≥ "
                  f"{found.in_least:+.3f}, out {found.out_least:+.3f}…{found.out_most:+.3f}, window "
                  f"{found.window:+.3f}, mean {found.mean:.3f}, IoU {found.half:.3f} {found.three_quarters:.3f}, "
                  f"under {found.undersupply:.4f}, over {found.oversupply:.4f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("device")
    parser.add_argument("--volume", type=int, default=128)
    parser.add_argument("--pixels", type=int, default=300)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--iterations", type=int, default=60)
    given = parser.parse_args()
    place = open_device(given.device)
    volume(place, given.volume, given.angles, given.iterations)
    slices(place, given.pixels, given.angles)
