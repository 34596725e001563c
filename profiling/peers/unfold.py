"""Time torch's unfold with a sparse CSR product: the light of one pose at every pose of a web, and its transpose.

Forward unfolds the web into a matrix of one column a pose and multiplies it by P; back multiplies the light by the
prebuilt transpose of P and folds the result. Slice by slice, one slice's unfolded matrix at a time; ``--at-once`` all
of them. P, one slice of a web and of light, and what they should give come in a file. Prints one JSON line.
"""

from __future__ import annotations

import argparse
import resource
import warnings

import numpy as np
import scipy.sparse as sp
from machine import emit, machine, median_seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", required=True, help=".npz with r, rho, l, weight, shape, web, light, image, dose")
    parser.add_argument("--slices", type=int, default=32)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--at-once", action="store_true", help="unfold all slices before the first product")
    args = parser.parse_args()
    with np.load(args.sample) as sample:
        emit(measure(dict(sample), args.slices, args.runs, args.device, args.at_once))


class Web:
    """P and its transpose on a device, and both products of any number of slices."""

    def __init__(self, sample: dict[str, np.ndarray], device: str, at_once: bool) -> None:
        rays, self.layers, self.window = (int(n) for n in sample["shape"])
        column = sample["rho"].astype(np.int64) * self.window + sample["l"]
        shape = (rays, self.layers * self.window)
        matrix = sp.csr_matrix((sample["weight"].astype(np.float32), (sample["r"], column)), shape)
        self.device, self.at_once, self.columns = device, at_once, sample["web"].shape[0]
        self.forward_matrix, self.back_matrix = self._tensor(matrix), self._tensor(matrix.T.tocsr())
        self.nonzeros = int(matrix.nnz)

    def _tensor(self, matrix):
        import torch

        indices = [torch.from_numpy(part.astype(np.int32)) for part in (matrix.indptr, matrix.indices)]
        tensor = torch.sparse_csr_tensor(*indices, torch.from_numpy(matrix.data), size=matrix.shape)
        return tensor.to(self.device)

    def forward(self, web, out) -> None:
        """out [z, r, pose] from web [z, 1, rho, l]."""
        import torch

        kernel, padding = (self.layers, self.window), (0, self.window - 1)
        whole = torch.nn.functional.unfold(web, kernel, padding=padding) if self.at_once else None
        for z in range(web.shape[0]):
            own = torch.nn.functional.unfold(web[z : z + 1], kernel, padding=padding)[0] if whole is None else whole[z]
            out[z] = self.forward_matrix @ own

    def back(self, light, out) -> None:
        """out [z, 1, rho, l] from light [z, r, pose]."""
        import torch

        size, kernel, padding = (self.layers, self.columns), (self.layers, self.window), (0, self.window - 1)
        if self.at_once:
            spread = torch.stack([self.back_matrix @ light[z] for z in range(light.shape[0])])
            out[:] = torch.nn.functional.fold(spread, size, kernel, padding=padding)
            return
        for z in range(light.shape[0]):
            spread = (self.back_matrix @ light[z])[None]
            out[z : z + 1] = torch.nn.functional.fold(spread, size, kernel, padding=padding)


def measure(
    sample: dict[str, np.ndarray], slices: int, runs: int, device: str = "cpu", at_once: bool = False
) -> dict[str, object]:
    """Return the record: median seconds forward and back, peak memory, and how far torch is from the given results.

    "peak_mb" is the process's greatest resident memory on a processor and torch's own count on a GPU;
    "beyond_web_and_light_mb" what it grew by once web, light and matrices were there.
    """
    import torch

    warnings.filterwarnings("ignore", message="Sparse CSR tensor support")
    web_model = Web(sample, device, at_once)
    disagreement = _disagreement(web_model, sample)
    poses, rays = sample["light"].shape[:2]
    generator = torch.Generator().manual_seed(0)
    web = torch.rand((slices, 1, web_model.layers, web_model.columns), generator=generator).to(device)
    light = torch.rand((slices, rays, poses), generator=generator).to(device)
    before = _reset(device)
    forward_s, forward_all = median_seconds(lambda: _run(web_model.forward, web, light), runs)
    back_s, back_all = median_seconds(lambda: _run(web_model.back, light, web), runs)
    peak = _peak(device)
    return {
        "peer": f"torch unfold + sparse CSR, {'at once' if at_once else 'slice by slice'}, on {device}",
        "size": {"columns": web_model.columns, "layers": web_model.layers, "slices": slices, "poses": poses},
        "forward_s": round(forward_s, 6),
        "back_s": round(back_s, 6),
        "forward_runs_s": forward_all,
        "back_runs_s": back_all,
        "nonzeros": web_model.nonzeros,
        "peak_mb": round(peak / 1e6, 1),
        "beyond_web_and_light_mb": round((peak - before) / 1e6, 1),
        "unfolded_slice_mb": round(4e-6 * web_model.layers * web_model.window * poses, 1),
        "disagreement": disagreement,
        "threads": torch.get_num_threads(),
        "machine": machine("torch", "scipy", "numpy"),
    }


def _run(product, source, target) -> None:
    import torch

    product(source, target)
    if source.is_cuda:
        torch.cuda.synchronize()


def _disagreement(web: Web, sample: dict[str, np.ndarray]) -> float:
    """Greatest difference from the given light and dose, each over its maximum."""
    import torch

    film = torch.from_numpy(sample["web"]).permute(2, 1, 0)[:, None].contiguous().to(web.device)
    light = torch.from_numpy(sample["light"]).permute(2, 1, 0).contiguous().to(web.device)
    image, dose = torch.empty_like(light), torch.empty_like(film)
    web.forward(film, image)
    web.back(light, dose)
    worst = 0.0
    for found, name in ((image.permute(2, 1, 0), "image"), (dose[:, 0].permute(2, 1, 0), "dose")):
        wanted = sample[name]
        worst = max(worst, float(np.abs(found.cpu().numpy() - wanted).max() / np.abs(wanted).max()))
    return worst


def _reset(device: str) -> int:
    """Bytes taken now; the peak is measured from here where torch can."""
    import torch

    if device == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
        return torch.cuda.memory_allocated()
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def _peak(device: str) -> int:
    import torch

    if device == "cuda":
        return torch.cuda.max_memory_allocated()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main()
