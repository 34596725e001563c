"""Time ASTRA's CUDA parallel3d projector, forward and back, with both arrays in GPU memory. Prints one JSON line.

The arrays are torch tensors that ASTRA writes to directly through DLPack, so no bus crossing is timed; --host hands it
NumPy arrays instead (crossings included).
"""

from __future__ import annotations

import argparse
import subprocess

import numpy as np
from machine import emit, machine, median_seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=512)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--host", action="store_true", help="time host arrays, bus crossings included")
    args = parser.parse_args()
    emit(measure(args.n, args.angles, args.runs, args.host))


def measure(n: int, angles: int, runs: int, host: bool) -> dict[str, object]:
    """Return the record: median seconds of one forward and one back projection of n^3 voxels."""
    import astra
    from astra.experimental import direct_BP3D, direct_FP3D

    turns = np.arange(angles) * 2.0 * np.pi / angles
    volume_geometry = astra.create_vol_geom(n, n, n)
    rays = astra.create_proj_geom("parallel3d", 1.0, 1.0, n, n, turns)
    projector = astra.create_projector("cuda3d", rays, volume_geometry)
    volume, sinogram = _host_pair(n, angles) if host else _device_pair(n, angles)
    wait = (lambda: None) if host else _synchronize

    def forward() -> None:
        direct_FP3D(projector, volume, sinogram)
        wait()

    def back() -> None:
        direct_BP3D(projector, volume, sinogram)
        wait()

    forward_s, forward_all = median_seconds(forward, runs, warmups=2)
    checksum = float(sinogram.mean()) / float(volume.mean())  # about n: zero would mean that nothing ran
    back_s, back_all = median_seconds(back, runs, warmups=2)
    astra.projector3d.delete(projector)
    return {
        "peer": "ASTRA parallel3d on CUDA",
        "forward_checksum": checksum,
        "data": "host arrays" if host else "GPU arrays",
        "size": {"n": n, "angles": angles, "bins": n},
        "forward_s": round(forward_s, 6),
        "back_s": round(back_s, 6),
        "forward_runs_s": forward_all,
        "back_runs_s": back_all,
        "gpu": _gpu(),
        "machine": machine("astra-toolbox", "torch", "numpy"),
    }


def _host_pair(n: int, angles: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.random((n, n, n), dtype=np.float32), np.zeros((n, angles, n), np.float32)


def _device_pair(n: int, angles: int):
    """Return a volume [z, y, x] and an empty sinogram [z, angle, r] in GPU memory."""
    import torch

    torch.manual_seed(0)
    return torch.rand((n, n, n), device="cuda"), torch.zeros((n, angles, n), device="cuda")


def _synchronize() -> None:
    import torch

    torch.cuda.synchronize()


def _gpu() -> str | None:
    query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        return subprocess.run(query, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


if __name__ == "__main__":
    main()
