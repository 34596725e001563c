"""Time explicit steps of three diffusing and reacting species on devices, and the loops of peers in the same run.

Bandwidth is that of vamgpu's own elementwise kernel, out = a·x + b·y, on fields as large: 12 bytes a voxel. A step
moves at least its three species in and out, 24 bytes a voxel, and 8 more of light where they react: the limit is what
that takes at the bandwidth. Steps that an item takes together move it once, so they may take less than
the limit of one.
``--print-frames`` also times frames of a dual-color print of the same size, light through what is left of C included.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, is_gpu, machine, peer, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.chemistry.concentrations import Concentrations
from vamgpu.chemistry.exposure import ColorExposure, ColorExtinction
from vamgpu.chemistry.printrun import PrintRun
from vamgpu.chemistry.transport import Box, Reaction, Transport
from vamgpu.kernels.update import linear

sys.path.insert(0, str(HERE / "peers"))
from diffusing import RATES, SPREAD, start  # noqa: E402

PITCH = (0.045, 0.045, 0.067)
BYTES = {"diffusion": 24, "reaction": 32}
PEERS = ("numba", "numpy", "scipy")


def resin(n: int, device: Device, reacting: bool) -> Transport:
    """The step that the peers take: their spread and rates for Δt = 1 s."""
    k = [float(rate) for rate in RATES]
    reaction = Reaction(k[0], k[1], k[2], k[3], order=1, initial=1.0, cross=k[4], optical=1e3, mechanical=2e3)
    diffusivities = [float(spread[0]) for spread in SPREAD]
    pitch = (1.0, 1.0, float(np.sqrt(SPREAD[0, 0] / SPREAD[0, 2])))
    return Transport(
        Box((n, n, n), pitch),
        (diffusivities[0], diffusivities[1], diffusivities[2]),
        reaction if reacting else None,
        device=device,
    )


def ours(n: int, device: Device, steps: int, runs: int, reacting: bool, gbps: float) -> dict[str, Any]:
    """Seconds of all steps from the peers' start, bytes a step, and the limit of bandwidth."""
    walk, (species, light) = resin(n, device, reacting), start(n)
    shades = [device.upload(shade) for shade in light] if reacting else [None, None]
    state = walk.start(*species)
    walk.advance(state, float(steps), steps, *shades)  # the peers' own end, once; then it goes on
    sums = [float(np.sum(state.species(name).numpy(), dtype=np.float64)) for name in "ABC"]
    seconds = timed(lambda: walk.advance(state, float(steps), steps, *shades), device.synchronize, runs, 1)
    moved = BYTES["reaction" if reacting else "diffusion"] * n**3
    limit = steps * moved / (gbps * 1e9)
    return {**seconds, "sums": sums, "bytes_a_step": moved, "limit_s": limit,
            "over_limit": round(seconds["least_s"] / limit, 3), "together": walk._fused}  # fmt: skip


def bandwidth(n: int, device: Device, runs: int) -> float:
    """GB/s of out = a·x + b·y over fields of n³ voxels, the best of some runs of ten."""
    x, y, out = (device.upload(np.ones((n, n, n), np.float32)) for _ in range(3))

    def ten() -> None:
        for _ in range(10):
            device.launch(linear, a=0.5, x=x, b=0.25, y=y, floor=0.0, out=out)

    return 120 * n**3 / timed(ten, device.synchronize, runs, 1)["least_s"] / 1e9


def print_frames(n: int, device: Device, frames: int, angles: int) -> dict[str, Any]:
    """Seconds of some frames of a print, and of three turns at that pace."""
    box = Box((n, n, n), PITCH, radius=PITCH[0] * (0.5 * n - 1))
    resin = Reaction(0.05, 0.04, 0.02, 0.05, initial=2.0, cross=0.05, optical=1.0, mechanical=3.0)
    x = np.linspace(-1.0, 1.0, n)
    visible = np.broadcast_to(np.exp(-4 * x**2)[None, :, None], (angles, n, n)).astype(np.float32)
    ultraviolet = np.broadcast_to((np.abs(x) > 0.6)[None, :, None], visible.shape).astype(np.float32)
    colors = (ColorExtinction(0.05), ColorExtinction(0.05, 0.05))
    exposure = ColorExposure(box, visible, ultraviolet, colors, device=device)
    job = PrintRun(Transport(box, (3.27e-5, 6.89e-6, 6.89e-6), resin, device=device), exposure, 36.0, 3)
    state: Concentrations = job.transport.start(1.0, 0.0, 2.0)
    job.run(state, 0, 2)
    seconds = timed(lambda: job.run(state, 2, 2 + frames), device.synchronize, 1, 0)["least_s"]
    return {"frames": frames, "seconds": seconds, "three_turns_s": seconds / frames * job.frames}


def measure(args: argparse.Namespace, devices: list[Device]) -> dict[str, Any]:
    """The record of one size: peers and devices in turns, diffusion alone and with the reactions."""
    record: dict[str, Any] = {"size": {**vars(args), "records": None}, "machine": machine(*devices), "runs": {}}
    for kind in BYTES:
        more = ["--reacting"] if kind == "reaction" else []
        rows = record["runs"][kind] = {"vamgpu": {}, "peers": {}}
        for name in PEERS if not args.no_peers else ():
            slow = 1 if name != "numba" else args.runs
            shared = ("--n", args.n, "--steps", args.steps, "--runs", slow, "--library", name)
            rows["peers"][name] = peer("transport.py", *shared, *more)
        for device in devices:
            gbps = bandwidth(args.n, device, args.runs)
            found = ours(args.n, device, args.steps, args.runs, kind == "reaction", gbps)
            rows["vamgpu"][device.name] = {"bandwidth_gbps": round(gbps, 1), **found}
    if args.print_frames:
        record["print"] = {d.name: print_frames(args.n, d, args.print_frames, args.angles) for d in devices}
    return record


def show(record: dict[str, Any]) -> None:
    """Print times, bytes and ratios."""
    for kind, rows in record["runs"].items():
        print(f"{kind}, {record['size']['n']}³ × 3 species × {record['size']['steps']} steps")
        for device, row in rows["vamgpu"].items():
            print(f"  {device:16} {row['least_s']:8.4f} s; {row['bytes_a_step'] / 1e6:.0f} MB a step at "
                  f"{row['bandwidth_gbps']} GB/s takes {row['limit_s']:.4f} s: {row['over_limit']} of that; "
                  f"{row['together']} together")  # fmt: skip
            for name, other in rows["peers"].items():
                if "missing" in other:
                    print(f"    {name}: missing, {other['missing']}")
                    continue
                apart = max(abs(a / b - 1) for a, b in zip(row["sums"], other["sums"], strict=True))
                print(f"    {name:8} {other['least_s']:8.4f} s, {other['least_s'] / row['least_s']:6.2f} times ours; "
                      f"sums apart by {apart:.1e}")  # fmt: skip
    for device, row in record.get("print", {}).items():
        print(f"print: {device:16} {1e3 * row['seconds'] / row['frames']:.2f} ms a frame, {row['three_turns_s']:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--print-frames", type=int, default=0)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--devices", nargs="+", default=["opencl:intel:0"])
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="")
    args = parser.parse_args()
    devices = chosen_devices(args.devices)
    record = measure(args, devices)
    show(record)
    kind = "gpu" if is_gpu(devices[0]) else "cpu"
    write_record(args.records, "-".join(filter(None, ("transport", str(args.n), args.label or kind))), record)


if __name__ == "__main__":
    main()
