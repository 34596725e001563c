"""Dr.TVAM's benchmark job on the Benchy, so that our optimizer can be put beside it.

The part is 8 mm long in a vial of inner radius 6 mm and outer radius 7 mm, glass 1.54, resin 1.347, extinction 0.08/mm,
no scattering; 400 patterns of 400 x 400 pixels of 25 um, collimated; 256^3 voxels over 8.5 mm. "index-matched" is the
same without refraction.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import vamgpu
from vamgpu.metrics import mean_brightness, score
from vamgpu.targets.mesh import load_mesh

SIDE = 8.5
LENGTH = 8.0
BEAM = 10.0
THEIRS = {
    "index-matched": {"iou": 0.9962, "light_efficiency": 0.0142, "loop_s": 20.0},
    "cylindrical": {"iou": 0.9950, "light_efficiency": 0.0167, "loop_s": 20.0},
}
"""Dr.TVAM after 40 L-BFGS steps on an H200 (loops of 20 to 22 s), measured before; not measured in this run."""
QUANTILES = (1.0, 0.9999, 0.999, 0.997, 0.99)


def job(
    mesh: Path, device: Any, n: int, iterations: int | None, efficiency: float | None, *, rings: bool
) -> dict[str, Any]:
    """Both variants, on rings or by rays; n scales patterns and pixels along with the voxels."""
    solid = load_mesh(mesh)
    length = float(max(solid.vertices.max(axis=0) - solid.vertices.min(axis=0)))
    shape = (n, n, n)
    target = vamgpu.Target.from_mesh(
        solid, factor=LENGTH / length, pitch=SIDE / n, margin=0, shape=shape, device=device
    )
    out: dict[str, Any] = {}
    for name in THEIRS:
        A: Any = projection(name, n, device)
        A = vamgpu.RingProjection.of(A) if rings else A
        out[name] = solved(A, target, method(iterations, efficiency), THEIRS[name])
    return out


def projection(name: str, n: int, device: Any) -> vamgpu.Projection:
    """The job's operator at n voxels along each axis."""
    pixels = round(400 * n / 256)
    index = {"resin_index": 1.347, "wall_index": 1.54, "bath_index": 1.0}
    if name == "index-matched":
        index = dict.fromkeys(index, 1.347)
    vial = vamgpu.Vial(radius=7.0, wall=1.0, absorption=0.08, **index)
    beam = vamgpu.Beam((pixels, pixels), BEAM / pixels)
    return vamgpu.Projection(vamgpu.Grid((n, n, n), SIDE / n), beam, vamgpu.Turntable(pixels), vial, device)


def method(iterations: int | None, efficiency: float | None) -> tuple[Any, int]:
    """L-BFGS where light has a price (0.03 unless said), the default method for a price of 0; and how long it runs."""
    if efficiency == 0.0:
        return vamgpu.SurfaceRamp(), iterations or 40
    return vamgpu.LBFGS(efficiency=0.03 if efficiency is None else efficiency), iterations or 26


def solved(A: Any, target: Any, how: tuple[Any, int], theirs: dict[str, float]) -> dict[str, Any]:
    """The loop once with compilation, once without; the plan's quality in floats, and of its frames."""
    chosen, iterations = how
    start = time.perf_counter()
    first = vamgpu.optimize(A, target, chosen, iterations=2)
    A.device.synchronize()
    compiling = time.perf_counter() - start
    del first
    A.device.ledger.reset_peak()
    plan = vamgpu.optimize(A, target, chosen, iterations=iterations)
    scores = score(plan.dose(), target.on(A.device))
    result: dict[str, Any] = {
        "method": repr(chosen),
        "iterations": iterations,
        "pairs": plan.evaluations,
        "two_iterations_with_compilation_s": round(compiling, 3),
        "loop_s": round(plan.seconds, 4),
        "peak_device_mb": round(A.device.ledger.peak / 1e6, 1),
        "float": {
            "iou": round(scores.iou, 6),
            "window": round(scores.window, 4),
            "error_rate": scores.error_rate,
            "light_efficiency": round(mean_brightness(plan.sinogram), 5),
        },
    }
    for quantile in QUANTILES:
        proof = vamgpu.simulate(A, vamgpu.pack(plan, quantile=quantile), target)
        result[f"8 bits, full-on at quantile {quantile:g}"] = {
            "iou": round(proof.scores.iou, 6),
            "window": round(proof.scores.window, 4),
            "error_rate": proof.scores.error_rate,
            "light_efficiency": round(proof.mean_brightness, 5),
            "outside_over_inside": round(proof.outside_over_inside, 4),
            "efficiency_over_theirs": round(proof.mean_brightness / theirs["light_efficiency"], 2),
        }
    result["theirs, measured before"] = theirs
    return result
