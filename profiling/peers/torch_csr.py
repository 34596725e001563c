"""Time torch's sparse CSR product with the prebuilt straight projector matrix: the fastest peer seen on a CPU.

Forward is A @ volume and back is A^T @ sinogram, A^T prebuilt as a CSR matrix of its own; z is the dense dimension.
Building is not counted in the two times and is reported beside them. Prints one JSON line.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
import scipy.sparse as sp
from joseph import joseph_matrix
from machine import emit, machine, median_seconds, peak_gb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=256, help="voxels per side and bins per angle")
    parser.add_argument("--nz", type=int, default=None, help="slices (default: n)")
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--threads", type=int, default=None, help="default: torch's own choice")
    parser.add_argument("--matrix", default=None, help="a CSR matrix saved by SciPy, not the straight one")
    args = parser.parse_args()
    emit(measure(args.n, args.nz or args.n, args.angles, args.runs, args.threads, args.matrix))


def measure(
    n: int, nz: int, angles: int, runs: int, threads: int | None = None, file: str | None = None
) -> dict[str, object]:
    """Return the record: median seconds forward and back, build or load seconds, matrix bytes and two checks.

    file: rows (angle, column) and columns (x, y), saved with scipy.sparse.save_npz; None builds the straight one.
    Raises ValueError for a matrix of another size.
    """
    import torch

    warnings.filterwarnings("ignore", message="Sparse CSR tensor support")
    if threads:
        torch.set_num_threads(threads)
    start = time.perf_counter()
    matrix = joseph_matrix(n, angles) if file is None else sp.load_npz(file).tocsr()
    if matrix.shape != (angles * n, n * n):
        raise ValueError(f"the matrix has shape {matrix.shape}; expected {(angles * n, n * n)}")
    forward, back = _tensor(matrix), _tensor(matrix.T.tocsr())
    built = time.perf_counter() - start
    rng = np.random.default_rng(0)
    volume = torch.from_numpy(rng.standard_normal((n * n, nz), dtype=np.float32))
    sinogram = torch.from_numpy(rng.standard_normal((angles * n, nz), dtype=np.float32))
    forward_s, forward_all = median_seconds(lambda: forward @ volume, runs)
    back_s, back_all = median_seconds(lambda: back @ sinogram, runs)
    bytes_each = matrix.nnz * (4 + forward.col_indices().element_size())
    return {
        "peer": f"torch sparse CSR, prebuilt {'Joseph' if file is None else 'given'} matrix",
        "size": {"n": n, "nz": nz, "angles": angles, "bins": n},
        "forward_s": round(forward_s, 5),
        "back_s": round(back_s, 5),
        "forward_runs_s": forward_all,
        "back_runs_s": back_all,
        "build_s": round(built, 2),
        "nonzeros": int(matrix.nnz),
        "matrix_and_transpose_gb": round(2 * bytes_each / 1e9, 3),
        "peak_gb": peak_gb(),
        "adjoint_error": _adjoint_error(forward, back, volume, sinogram),
        "threads": torch.get_num_threads(),
        "machine": machine("torch", "scipy", "numpy"),
    }


def _tensor(matrix):
    """Wrap a SciPy CSR matrix; torch's fast CPU product wants 32-bit indices, as MKL does."""
    import torch

    indices = [torch.from_numpy(part.astype(np.int32)) for part in (matrix.indptr, matrix.indices)]
    return torch.sparse_csr_tensor(*indices, torch.from_numpy(matrix.data), size=matrix.shape, check_invariants=False)


def _adjoint_error(forward, back, volume, sinogram) -> float:
    """Return |<Ax, y> - <x, A'y>| / (|Ax| |y|) with float64 sums."""
    ax, aty = (forward @ volume).double(), (back @ sinogram).double()
    x, y = volume.double(), sinogram.double()
    return float(abs((ax * y).sum() - (x * aty).sum()) / (ax.norm() * y.norm()))


if __name__ == "__main__":
    main()
