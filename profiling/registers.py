"""What NVIDIA's assembler makes of OpenCL kernels, without a GPU: registers, spills and local memory of each.

Wants clang, libclc, and ptxas, as in the package nvidia-cuda-nvcc-cu12. NVIDIA's own OpenCL compiler schedules in
another way, but what spills here, or takes more local memory than a group may have, is to be looked at before a run.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from vamgpu.backend.opencl import FULL_SLAB
from vamgpu.kernels.catalog import kernels
from vamgpu.kernels.pointwise import opencl
from vamgpu.kernels.signature import Kernel
from vamgpu.kernels.spectrum import factors

MOST_LOCAL = 48 * 1024
"""Bytes of local memory that a group may declare."""
WIDTH = 4
TRANSFORM = 384
"""Samples of the transforms of fixed factors, of which all lanes are held at once."""
LIBRARY = Path("/usr/lib/clc/nvptx64--nvidiacl.bc")
"""OpenCL's functions, as the package libclc installs them."""


def assembled(kernel: Kernel, lanes: int, ptxas: str, architecture: str, library: Path, folder: Path) -> str:
    """What the assembler tells of a kernel compiled for fields of so many lanes; else what failed."""
    kind = "nvidia" if kernel.nvidia and lanes == FULL_SLAB else "gpu"
    tiling, code = getattr(kernel, kind), folder / "kernel.ptx"
    defined = {
        "LANES": lanes, "WIDTH": WIDTH, "THREADS": lanes // WIDTH, "VECTORS": 1, "TILE_MAJOR": tiling.major,
        "TILE_MINOR": tiling.minor, "TILE_SLABS": tiling.slabs, **kernel.constants.get(kind, {}),
    }  # fmt: skip
    defined |= dict(zip(map(str.upper, kernel.fixed), factors(TRANSFORM), strict=True)) if kernel.fixed else {}
    flags = [f"-D{name}={value}" for name, value in defined.items()] + ["-DGPU", f"-DCOMPILE_{kernel.name}"]
    flags += ["-DMATRIX_UNITS"] if kind == "nvidia" else []
    included = [f"-I{kernel.source.parent}", "-Xclang", "-finclude-default-header"]
    included += ["-Xclang", "-mlink-builtin-bitcode", "-Xclang", str(library)]
    target = ["-target", "nvptx64--nvidiacl", "-Xclang", "-target-cpu", "-Xclang", "sm_80"]
    target += ["-Xclang", "-target-feature", "-Xclang", "+ptx70", "-x", "cl", "-cl-std=CL1.2", "-cl-mad-enable", "-O3"]
    source = folder / "kernel.cl"
    source.write_text(opencl(kernel))
    compiled = ["clang", *target, *included, *flags, "-S", str(source), "-o", str(code)]
    limit = [f"-maxrregcount={tiling.registers}"] if tiling.registers else []
    for command in (compiled, [ptxas, f"-arch={architecture}", "-v", *limit, "-c", str(code), "-o", str(folder / "o")]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            return "FAILED " + (done.stderr.strip().splitlines() or ["without a word"])[0]
    used = re.search(r"Used (\d+) registers.*", done.stderr)
    frame = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores", done.stderr)
    local = sum(map(int, re.findall(r"\.shared [^[]*\[(\d+)\]", code.read_text())))
    told = f"{used[1] if used else '?'} registers, {frame[1] if frame else '?'} B of private arrays, "
    told += f"{frame[2] if frame else '?'} B spilled, {local:,} B local"
    return told + (" TOO MUCH" if local > MOST_LOCAL else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kernels", nargs="*", help="names; all by default")
    parser.add_argument("--lanes", type=int, nargs="+", default=[4, 8, 16, 32])
    parser.add_argument("--ptxas", default="ptxas")
    parser.add_argument("--architecture", default="sm_90")
    parser.add_argument("--library", type=Path, default=LIBRARY, help="OpenCL's functions as bitcode")
    given = parser.parse_args()
    known = {kernel.name: kernel for kernel in kernels()}
    if unknown := set(given.kernels) - set(known):
        sys.exit(f"there are no kernels {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as place:
        for name in given.kernels or known:
            for lanes in given.lanes:
                found = assembled(known[name], lanes, given.ptxas, given.architecture, given.library, Path(place))
                print(f"{name:20} {lanes:2} lanes: {found}", flush=True)


if __name__ == "__main__":
    main()
