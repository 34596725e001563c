"""Prints in resin that scatters: patterns that ignore it, and patterns of `ScatteringRings`, both proved with it.

python profiling/scattering.py gear --turbid 3          a gear in two dimensions
python profiling/scattering.py boat --turbid 1 --size 48
python profiling/scattering.py time --size 128          a pair of products beside that of a clear resin
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import vamgpu as vam
from vamgpu.targets import shapes

RADIUS, ABSORPTION, ANISOTROPY = 5.0, 0.06, 0.9


def gear(size: int = 64, pitch: float = 0.12) -> np.ndarray:
    """Nine teeth, two holes of different sizes and a slit, (size, size, 2)."""
    at = (np.arange(size) - 0.5 * (size - 1)) * pitch
    x, y = np.meshgrid(at, at, indexing="ij")
    part = np.hypot(x, y) < 2.85 + 0.45 * np.sign(np.cos(9.0 * np.arctan2(y, x)))
    part &= (np.hypot(x - 1.3, y) >= 0.55) & (np.hypot(x + 1.3, y) >= 0.4)
    part &= (np.abs(x) >= 0.25) | (np.abs(y) >= 1.9)
    return np.repeat(part[:, :, None], 2, axis=2).astype(np.float32)


def flat_scene(device: Any) -> tuple[vam.Projection, Any]:
    """The gear in resin of the index of its vial."""
    vial = vam.Vial(RADIUS, 0.0, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=ABSORPTION)
    part, motion = gear(), vam.Turntable(120, lit_share=0.0)
    return vam.Projection(vam.Grid((64, 64, 2), 0.12), vam.Beam((64, 1), 0.12), motion, vial, device), part


def boat_scene(size: int, angles: int, device: Any) -> tuple[vam.Projection, Any]:
    """The boat in a vial in air, with pixels that are a voxel wide in the resin."""
    vial = vam.Vial(RADIUS + 0.5, 0.5, resin_index=1.5, wall_index=1.473, absorption=ABSORPTION)
    pitch = 4.2 / size
    target = vam.Target.from_mesh(shapes.build("boat"), height=4.2, pitch=pitch)
    across = 2 * int(target.radius * 1.5 / (1.5 * pitch) / 2 + 4) * 2
    beam = vam.Beam((across, int(target.grid.shape[2] / 1.5) + 2), 1.5 * pitch)
    return vam.Projection(target.grid, beam, vam.Turntable(angles), vial, device), target


def compare(A: vam.Projection, target: Any, options: Any) -> None:
    """Patterns without and with scattering, proved with it."""
    began = time.perf_counter()
    S = vam.ScatteringRings(A, vam.Scattering(options.turbid / RADIUS, ANISOTROPY), options.tolerance, options.photons)
    print(f"{A.grid}; {S.terms} terms, table {time.perf_counter() - began:.1f} s", flush=True)
    for name, operator in (("ignored", vam.RingProjection.of(A)), ("scattering", S)):
        began = time.perf_counter()
        plan = vam.optimize(operator, target, method=options.method, evaluations=options.evaluations,
                            iterations=options.evaluations, progress=False)  # fmt: skip
        solved, began = time.perf_counter() - began, time.perf_counter()
        proof = vam.simulate(S, vam.pack(plan, bits=8), target)
        own, found = plan.window, proof.scores
        print(f"{name}: planned {own:+.4f}, claimed {proof.claimed.windows.strict:+.4f}, proved "
              f"{found.windows.strict:+.4f}, IoU {found.iou:.4f}; {solved:.1f} s, proof "
              f"{time.perf_counter() - began:.1f} s", flush=True)  # fmt: skip


def times(A: vam.Projection, options: Any) -> None:
    """Seconds of products, the shortest of three."""
    S = vam.ScatteringRings(A, vam.Scattering(options.turbid / RADIUS, ANISOTROPY), options.tolerance, options.photons)
    light = A.device.upload(np.ones(A.range.shape, np.float32))
    for name, operator in (("clear", vam.RingProjection.of(A)), ("scattering", S)):
        took = []
        for _ in range(4):
            began = time.perf_counter()
            dose = operator.T(light)
            A.device.synchronize()
            middle = time.perf_counter()
            operator(dose)
            A.device.synchronize()
            took.append((time.perf_counter() - middle, middle - began))
        forward, back = np.min(took[1:], axis=0)
        print(f"{name}: forward {1e3 * forward:.0f} ms, back {1e3 * back:.0f} ms", flush=True)
    print(f"{S.terms} terms", flush=True)


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gear", "boat", "time"))
    parser.add_argument("--turbid", type=float, default=3.0, help="scattering events per radius of the resin")
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--angles", type=int, default=180)
    parser.add_argument("--photons", type=int, default=4_000_000)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--evaluations", type=int, default=200)
    parser.add_argument("--method", default="lbfgs")
    parser.add_argument("--device")
    options = parser.parse_args()
    if options.what == "gear":
        return compare(*flat_scene(options.device), options)
    A, target = boat_scene(options.size, options.angles, options.device)
    return times(A, options) if options.what == "time" else compare(A, target, options)


if __name__ == "__main__":
    main()
