"""Run VAMToolbox's OSMO on a mesh, 128^3 and 360 angles by default. The caller times the whole process:

    time .peers/bin/python profiling/peers/vamtoolbox_osmo.py benchy.stl

VAMToolbox is not on a package index; point install.sh's VAMTOOLBOX at a checkout. Without one this script exits with
code 2. Prints one JSON line.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from machine import emit, machine, peak_gb
from part import strict_window, voxels


def main() -> None:
    start = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--cuda", action="store_true")
    parser.add_argument("--own-voxels", action="store_true", help="use its voxelizer (needs OpenGL), not trimesh's")
    args = parser.parse_args()
    try:
        import vamtoolbox as vam
    except ImportError as error:
        sys.exit(_missing(error))
    if args.own_voxels:
        target = vam.geometry.TargetGeometry(stlfilename=args.mesh, resolution=args.n)
    else:
        target = vam.geometry.TargetGeometry(target=voxels(args.mesh, args.n).astype(float))
        target.zero_dose = None  # its constructor sets this for files only, its projector reads it always
    turns = np.arange(args.angles) * 360.0 / args.angles
    rays = vam.geometry.ProjectionGeometry(turns, ray_type="parallel", CUDA=args.cuda)
    options = vam.optimize.Options(method="OSMO", n_iter=args.iterations, d_h=0.85, d_l=0.6, filter="hamming")
    loop = time.perf_counter()
    _, dose, _ = vam.optimize.optimize(target, rays, options)
    emit(
        {
            "peer": "VAMToolbox OSMO",
            "size": {"shape": list(target.array.shape), "angles": args.angles, "iterations": args.iterations},
            "loop_s": round(time.perf_counter() - loop, 2),
            "since_script_start_s": round(time.perf_counter() - start, 2),
            "peak_gb": peak_gb(),
            **strict_window(np.asarray(dose.array), target.array > 0.5),
            "machine": machine("numpy", "astra-toolbox", "scipy", "trimesh"),
        }
    )


def _missing(error: ImportError) -> int:
    print(f"VAMToolbox cannot be imported ({error}); run install.sh with VAMTOOLBOX=<checkout>", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
