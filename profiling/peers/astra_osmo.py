"""OSMO on ASTRA's CPU projector, slice by slice: a stand-in for the speed of toolboxes built so.

Our own code for the published algorithm (object-space model optimization, doi 10.1016/j.addma.2021.102367): one
starting pair, then a void half step and a part half step per iteration, each a forward and a back projection, with the
thresholds and the Hamming start of VAMToolbox's 3-D example. It is not VAMToolbox and must not be reported as it: its
start filter and precision differ, so its dose says nothing about theirs.
One core, whole process timed by the caller. Prints one JSON line.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from machine import emit, machine, peak_gb
from part import strict_window, voxels


class SliceProjector:
    """ASTRA's 2-D `line` or `linear` CPU projector over the slices of [x, y, z] volumes, float32."""

    def __init__(self, n: int, angles: int, kind: str) -> None:
        import astra

        self.astra, self.n, self.angles = astra, n, angles
        turns = np.arange(angles) * 2.0 * np.pi / angles
        self.volume_geometry = astra.create_vol_geom(n, n)
        rays = astra.create_proj_geom("parallel", 1.0, n, turns)
        self.projector = astra.create_projector(kind, rays, self.volume_geometry)

    def forward(self, volume: np.ndarray) -> np.ndarray:
        """Return the sinogram [angle, r, z] of a volume [x, y, z]."""
        out = np.empty((self.angles, self.n, volume.shape[2]), np.float32)
        for z in range(volume.shape[2]):
            key, out[:, :, z] = self.astra.create_sino(np.ascontiguousarray(volume[:, :, z]), self.projector)
            self.astra.data2d.delete(key)
        return out

    def back(self, sinogram: np.ndarray) -> np.ndarray:
        """Return the dose [x, y, z] of a sinogram [angle, r, z]."""
        out = np.empty((self.n, self.n, sinogram.shape[2]), np.float32)
        for z in range(sinogram.shape[2]):
            rays = np.ascontiguousarray(sinogram[:, :, z])
            key, out[:, :, z] = self.astra.create_backprojection(rays, self.projector)
            self.astra.data2d.delete(key)
        return out


def osmo(projector: SliceProjector, part: np.ndarray, iterations: int, low: float, high: float) -> np.ndarray:
    """Return the dose over its maximum after `iterations` (the first one is the filtered start)."""
    n = part.shape[0]
    x = np.arange(n) - 0.5 * (n - 1)
    disk = (x[:, None] ** 2 + x[None, :] ** 2 <= (0.5 * n) ** 2)[:, :, None]
    void, solid = ~part & disk, part & disk
    model = _ramp(part.astype(np.float32)) * disk

    def expose() -> np.ndarray:
        dose = projector.back(np.maximum(projector.forward(model), 0.0)) * disk
        return dose / dose.max()

    dose = expose()
    for _ in range(iterations - 1):
        model[void] -= np.maximum(dose[void] - low, 0.0)
        dose = expose()
        model[solid] += np.maximum(high - dose[solid], 0.0)
        dose = expose()
    return dose


def _ramp(volume: np.ndarray) -> np.ndarray:
    """Multiply each slice's spectrum by |f| under a Hamming window, the filtered start."""
    n = volume.shape[0]
    f = np.fft.fftfreq(n) * 2.0
    radius = np.minimum(np.hypot(f[:, None], f[None, :]), 1.0)
    gain = radius * (0.54 + 0.46 * np.cos(np.pi * radius))
    spectrum = np.fft.fft2(volume, axes=(0, 1)) * gain[:, :, None]
    return np.fft.ifft2(spectrum, axes=(0, 1)).real.astype(np.float32)


def main() -> None:
    start = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--projector", choices=("line", "linear"), default="line")
    args = parser.parse_args()
    part = voxels(args.mesh, args.n)
    loop = time.perf_counter()
    dose = osmo(SliceProjector(args.n, args.angles, args.projector), part, args.iterations, low=0.6, high=0.85)
    emit(
        {
            "peer": f"own OSMO on ASTRA CPU '{args.projector}'",
            "size": {"n": args.n, "angles": args.angles, "iterations": args.iterations},
            "projector_pairs": 2 * args.iterations - 1,
            "loop_s": round(time.perf_counter() - loop, 2),
            "since_script_start_s": round(time.perf_counter() - start, 2),
            "peak_gb": peak_gb(),
            **strict_window(dose, part),
            "machine": machine("numpy", "astra-toolbox", "scipy", "trimesh"),
        }
    )


if __name__ == "__main__":
    main()
