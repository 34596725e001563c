"""Time the projection of webs on devices, and torch's unfold with a sparse product beside it in the same run.

A web of 3,000 columns × 64 layers × 32 slices, a window of 300 columns and 256 rays, one column a pose, every pose that
sees any of the web. The rays cross the film straight, at slopes up to four columns a layer, and are as wide as makes
96,000 weights of it. Memory is that of the device's ledger: all arrays, and what is there beyond the web and the light.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, is_gpu, machine, peer, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.operators.web import WebProjection
from vamgpu.web import Propagation, WebGrid

PITCH = 0.0785
SLOPE, WIDTH = 4.0, 2.86
"""Columns a layer of the outermost ray, and the width of a ray in columns."""


def crossing_light(columns: int, layers: int, window: int) -> Propagation:
    """Straight rays of one width through a flat film: the share of each ray in each voxel."""
    slope = SLOPE * window / 300 * np.linspace(-1.0, 1.0, columns)[:, None]
    enter = 0.5 * window + slope * (np.arange(layers) - 0.5 * layers)
    low, high = np.minimum(enter, enter + slope) - 0.5 * WIDTH, np.maximum(enter, enter + slope) + 0.5 * WIDTH
    l = np.arange(window)  # noqa: E741 - the web's axis
    inside = np.minimum(high[..., None], l + 1.0) - np.maximum(low[..., None], l)
    r, rho, column = np.nonzero(inside > 0)
    length = np.hypot(1.0, slope) / (high - low)
    weight = 0.22 * PITCH * inside[r, rho, column] * length[r, rho]
    return Propagation.gathered((columns, layers, window), r, rho, column, weight)


def ours(A: WebProjection, runs: int) -> dict[str, Any]:
    """Forward and back times of one operator and the memory they take."""
    gc.collect()  # an operator and its transpose know each other, so the one before may still be there
    device, rng = A.device, np.random.default_rng(0)
    web = device.upload(rng.random(A.domain.shape, np.float32))
    light = device.upload(rng.random(A.range.shape, np.float32))
    fields = web.nbytes + light.nbytes
    device.ledger.reset_peak()
    forward = timed(lambda: A(web, out=light), device.synchronize, runs)
    back = timed(lambda: A.T(light, out=web), device.synchronize, runs)
    peak = device.ledger.peak
    memory = {"peak_mb": round(peak / 1e6, 1), "beyond_web_and_light_mb": round((peak - fields) / 1e6, 2)}
    return {"forward": forward, "back": back, "poses": A.motion.poses, "step": A.motion.step, **memory}


def sample(A: WebProjection, file: Path) -> None:
    """Keep the light, one slice of a web and of light, and what our operator makes of them, for the peer to check."""
    thin = WebProjection.from_light(WebGrid((*A.grid.shape[:2], 1), A.grid.pitch), A.light, device=A.device)
    rng, P = np.random.default_rng(1), A.light
    web, light = rng.random(thin.domain.shape, np.float32), rng.random(thin.range.shape, np.float32)
    parts = {"r": P.r, "rho": P.rho, "l": P.l, "weight": P.weight, "shape": np.array(P.shape)}
    parts |= {"web": web, "light": light, "image": thin(web), "dose": thin.T(light)}
    np.savez(file, **parts)  # type: ignore[arg-type] - names of arrays, not options


def beside(A: WebProjection, runs: int, gpu: bool) -> dict[str, Any]:
    """torch on the processor, slice by slice; on a GPU also all slices at once."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "web.npz"
        sample(A, file)
        shared = ("--sample", file, "--slices", A.grid.shape[2], "--runs", runs, "--device", "cuda" if gpu else "cpu")
        names: dict[str, tuple[str, ...]] = {"torch unfold + CSR, slice by slice": ()}
        if gpu:
            names["torch unfold + CSR, at once"] = ("--at-once",)
        return {name: peer("unfold.py", *shared, *more) for name, more in names.items()}


def ratios(time: dict[str, Any], peers: dict[str, Any]) -> dict[str, Any]:
    """Peer → how many times our medians and memory it takes; "beyond" counts what is not the web or the light."""
    out = {}
    for name, record in peers.items():
        if "missing" not in record:
            out[name] = {
                "forward": round(record["forward_s"] / time["forward"]["median_s"], 2),
                "back": round(record["back_s"] / time["back"]["median_s"], 2),
                "memory": round(record["peak_mb"] / time["peak_mb"], 2),
                "beyond": round(record["beyond_web_and_light_mb"] / time["beyond_web_and_light_mb"], 1),
            }
    return out


def measure(args: argparse.Namespace, devices: list[Device]) -> dict[str, Any]:
    """The record: ours on every device, then the peers of each kind."""
    light = crossing_light(args.rays, args.layers, args.window)
    grid = WebGrid((args.columns, args.layers, args.slices), PITCH)
    record: dict[str, Any] = {"size": {**vars(args), "records": None, "weights": int(light.r.size)}}
    record |= {"machine": machine(*devices), "vamgpu": {}, "peers": {}, "ratios": {}}
    for device in devices:
        record["vamgpu"][device.name] = {
            f"{step:g}": ours(WebProjection.from_light(grid, light, step, device=device), args.runs)
            for step in args.steps
        }
    for gpu in sorted({is_gpu(device) for device in devices}) if not args.no_peers else ():
        kind = [device for device in devices if is_gpu(device) == gpu]
        found = beside(WebProjection.from_light(grid, light, device=kind[0]), args.peer_runs, gpu)
        record["peers"]["gpu" if gpu else "cpu"] = found
        for device in kind:
            pairs = record["vamgpu"][device.name]
            record["ratios"][device.name] = ratios(pairs["1"], found) if "1" in pairs else {}
    return record


def show(record: dict[str, Any]) -> None:
    """Print the times and the ratios."""
    print(f"{record['size']['weights']} weights; forward / back [ms], peak memory [MB] (beyond web and light)")
    for device, steps in record["vamgpu"].items():
        for step, time in steps.items():
            cells = " / ".join(f"{1e3 * time[way]['median_s']:9.2f}" for way in ("forward", "back"))
            print(f"  {device:18} step {step:5} {cells}   {time['peak_mb']} ({time['beyond_web_and_light_mb']})")
        for name, ratio in record["ratios"].get(device, {}).items():
            print(f"      {name}: " + ", ".join(f"{what} {value:g} x" for what, value in ratio.items()))
    for records in record["peers"].values():
        for name, found in records.items():
            if "missing" in found:
                print(f"  {name}: missing: {found['missing']}")
            else:
                cells = f"{1e3 * found['forward_s']:9.2f} / {1e3 * found['back_s']:9.2f}   {found['peak_mb']}"
                print(f"  {name}: {cells} ({found['beyond_web_and_light_mb']}), off by {found['disagreement']:.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, size in (("columns", 3000), ("layers", 64), ("slices", 32), ("window", 300), ("rays", 256)):
        parser.add_argument(f"--{name}", type=int, default=size)
    parser.add_argument("--steps", type=float, nargs="+", default=[1.0, 2.0, 1.25], help="columns a pose")
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--peer-runs", type=int, default=3)
    parser.add_argument("--devices", nargs="+", default=["gpu", "cpu"], help="names, or cpu and gpu for all of a kind")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    record = measure(args, chosen_devices(args.devices))
    show(record)
    print(f"  {write_record(args.records, f'web-{args.label}', record)}", flush=True)


if __name__ == "__main__":
    main()
