"""The automatic-exposure recipe (its text names scikit-image) on a mesh, whole run, slice by slice.

60 % background under the part, Radon transform at 1 degree, ramp filter, clip at zero, back projection, one gain in
object space per pass (target over simulated dose), again. Diffusion pre-compensation and vial correction are left out.
The paper makes two passes; more repeat the gain. One pass costs one forward and one back projection. Prints one
JSON line.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from machine import emit, machine, peak_gb
from part import strict_window, voxels


def recipe(part: np.ndarray, angles: np.ndarray, passes: int, background: float) -> np.ndarray:
    """Return the simulated dose [x, y, z] of the last pass for a boolean part; raises nothing of its own."""
    n = part.shape[0]
    x = np.arange(n) - n // 2
    disk = x[:, None] ** 2 + x[None, :] ** 2 <= (n // 2) ** 2
    target = np.where(part, 1.0, background).astype(np.float32) * disk[:, :, None]
    return np.stack([_slice(target[:, :, z], disk, angles, passes) for z in range(part.shape[2])], axis=2)


def _slice(target: np.ndarray, disk: np.ndarray, angles: np.ndarray, passes: int) -> np.ndarray:
    from skimage.transform import iradon, radon

    wanted, dose = target, target
    for index in range(passes):
        rays = np.maximum(_ramp(radon(wanted, angles, circle=True)), 0.0)
        dose = iradon(rays, angles, filter_name=None, circle=True) * disk
        if index + 1 < passes:
            floor = 1e-3 * max(float(dose.max()), 1e-12)
            wanted = wanted * np.where(disk, target / np.maximum(dose, floor), 0.0)
    return dose.astype(np.float32)


def _ramp(sinogram: np.ndarray) -> np.ndarray:
    """Filter the rays [r, angle] by |f|, zero-padded to twice the length so that no ray wraps onto another."""
    size = 2 * sinogram.shape[0]
    gain = 2.0 * np.abs(np.fft.rfftfreq(size))[:, None]
    return np.fft.irfft(np.fft.rfft(sinogram, size, axis=0) * gain, size, axis=0)[: sinogram.shape[0]]


def main() -> None:
    start = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--passes", type=int, default=2)
    parser.add_argument("--background", type=float, default=0.6)
    args = parser.parse_args()
    part = voxels(args.mesh, args.n)
    turns = np.arange(args.angles) * 360.0 / args.angles
    loop = time.perf_counter()
    dose = recipe(part, turns, args.passes, args.background)
    emit(
        {
            "peer": "automatic-exposure recipe in scikit-image",
            "size": {"n": args.n, "angles": args.angles, "passes": args.passes},
            "loop_s": round(time.perf_counter() - loop, 2),
            "since_script_start_s": round(time.perf_counter() - start, 2),
            "peak_gb": peak_gb(),
            **strict_window(dose, part),
            "machine": machine("numpy", "scikit-image", "scipy", "trimesh"),
        }
    )


if __name__ == "__main__":
    main()
