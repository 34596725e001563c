"""Time projector evaluations on devices, and the peers beside them in the same run.

All weigh light by exact footprints. "straight": light of full pixels through a perfect lens, in air. The others: a vial
in air that also absorbs, columns 1.5 voxels apart in air and so one voxel apart in the resin, where they cover the
grid's inscribed disc. "refracted" is a perfect lens and "blurred" the usual point spread of half a pixel, both with one
row of light a slice, as a sparse matrix has; "vial" is the whole operator of the latter, which also spreads the pixels'
rows over slices. "straight on rings" and "vial on rings" are the same light by `RingProjection`, with how long its
tables take to make. Peers: torch's CSR product with a prebuilt matrix of the same operator where a processor is timed,
ASTRA's CUDA projector where a GPU is.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, is_gpu, machine, peer, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.footprint import back_footprint, forward_footprint
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.optics.vial import Vial

VIAL = Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.473, bath_index=1.0, absorption=0.05)
WIDTH = 14.8
"""Of the grid [mm]: its inscribed disc lies inside the printable radius of 8.27 mm."""

ON_RINGS = " on rings"
MATRICES = ("straight", "refracted", "blurred")
"""What is timed slice by slice, as a sparse matrix works."""

Pair = tuple[Callable[[], Any], Callable[[], Any]]


class Bench:
    """Arrays and operators of one size on one device."""

    def __init__(self, n: int, angles: int, device: Device) -> None:
        self.device, pitch, motion = device, WIDTH / n, Turntable(angles)
        grid = Grid((n, n, n), pitch)
        rng = np.random.default_rng(0)
        self.volume = device.upload(rng.random(grid.shape, np.float32))
        self.light = device.upload(rng.random((angles, n, n), np.float32))
        self.shadow, self.dose = device.empty(self.light.shape), device.empty(self.volume.shape)
        self.operators = {
            "straight": Projection(grid, Beam((n, n), pitch, spread=0.0), motion, None, device),
            "refracted": Projection(grid, Beam((n, n), 1.5 * pitch, spread=0.0), motion, VIAL, device),
            "blurred": Projection(grid, Beam((n, n), 1.5 * pitch), motion, VIAL, device),
        }

    def pairs(self) -> Iterator[tuple[str, Pair, float]]:
        """Name, forward and back projection without arguments, and how long a table of rings takes to make [s]."""
        for name in MATRICES:
            yield name, self.slices(name), 0.0
        yield "vial", self.whole(self.operators["blurred"]), 0.0
        for name, of in (("straight", "straight"), ("vial", "blurred")):
            began = time.perf_counter()
            rings = RingProjection.of(self.operators[of])
            yield f"{name}{ON_RINGS}", self.whole(rings), time.perf_counter() - began

    def whole(self, A: Projection | RingProjection) -> Pair:
        """An operator with all that belongs to it."""
        return lambda: A(self.volume, out=self.shadow), lambda: A.T(self.light, out=self.dose)

    def slices(self, name: str) -> Pair:
        """The kernels of an operator alone, one row of light a slice."""
        A, launch = self.operators[name], self.device.launch
        shared = {"directions": A._directions[0], **A._light}

        def forward() -> None:
            launch(forward_footprint, volume=self.volume, sinogram=self.shadow, **shared, **A._gather)

        def back() -> None:
            launch(back_footprint, sinogram=self.light, volume=self.dose, **shared)

        return forward, back

    def matrix(self, name: str) -> Any:
        """What the kernels of an operator do to one slice, in CSR."""
        from footprint_matrix import footprint_matrix  # SciPy, wanted nowhere else

        A = self.operators[name]
        light = {**A._light, "light": A._light["light"].numpy()}
        return footprint_matrix(A.grid.shape[0], A.beam.pixels[0], A._directions[0].numpy(), light)


def ours(n: int, angles: int, device: Device, runs: int) -> dict[str, Any]:
    """Forward and back times of every operator on a device."""
    bench = Bench(n, angles, device)
    out: dict[str, Any] = {}
    for name, (forward, back), made in bench.pairs():
        out[name] = {"forward": timed(forward, device.synchronize, runs), "back": timed(back, device.synchronize, runs)}
        if name.endswith(ON_RINGS):
            beside = out[name.removesuffix(ON_RINGS)]
            times = [beside[way]["median_s"] / out[name][way]["median_s"] for way in ("forward", "back")]
            out[name] |= {"made_s": made, "times_as_fast": [round(ratio, 2) for ratio in times]}
    return out


def csr_peers(n: int, angles: int, runs: int, device: Device) -> dict[str, Any]:
    """torch's CSR product with the matrices of the operators timed here.

    "disagreement" is how far one slice of the matrix product is from the operator on ``device``, over the maximum.
    """
    from footprint_matrix import save_matrix

    found: dict[str, Any] = {}
    for name in MATRICES:
        with tempfile.TemporaryDirectory() as folder:
            bench, file = Bench(n, angles, device), Path(folder) / "matrix.npz"
            matrix = bench.matrix(name)
            error = _disagreement(bench, name, matrix)
            save_matrix(file, matrix)
            del bench, matrix
            size = ("--n", n, "--angles", angles, "--runs", runs, "--matrix", file)
            found[name] = peer("torch_csr.py", *size) | {"disagreement": error}
    return {"torch CSR": {**found, "vial": found["blurred"]}}


def _disagreement(bench: Bench, name: str, matrix: Any) -> float:
    forward, _ = bench.slices(name)
    forward()
    found = bench.shadow.numpy()[:, :, 0]
    wanted = (matrix @ bench.volume.numpy()[:, :, 0].astype(np.float64).ravel()).reshape(found.shape)
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def astra_peer(n: int, angles: int, runs: int) -> dict[str, Any]:
    """ASTRA's CUDA projector: straight rays only, so it stands beside every operator."""
    record = peer("astra_cuda.py", "--n", n, "--angles", angles, "--runs", runs)
    return {"ASTRA CUDA": dict.fromkeys((*MATRICES, "vial"), record)}


def ratios(times: dict[str, Any], peers: dict[str, Any], least: bool = False) -> dict[str, Any]:
    """device → operator → peer → (forward, back): the peer's seconds over ours, medians or least times."""
    out: dict[str, Any] = {}
    for device, operators in times.items():
        for name, pair in operators.items():
            for who, records in peers.items():
                record = records[name.removesuffix(ON_RINGS)]
                if "missing" in record:
                    continue
                both = [_ratio(record, pair[way], way, least) for way in ("forward", "back")]
                out.setdefault(device, {}).setdefault(name, {})[who] = [round(ratio, 2) for ratio in both]
    return out


def _ratio(record: dict[str, Any], time: dict[str, Any], way: str, least: bool) -> float:
    return min(record[f"{way}_runs_s"]) / time["least_s"] if least else record[f"{way}_s"] / time["median_s"]


def show(record: dict[str, Any]) -> None:
    """Print the times and the ratios."""
    print(f"{record['n']}^3 x {record['angles']}: forward / back [ms], medians of {record['runs']}")
    for device, operators in record["vamgpu"].items():
        for name, pair in operators.items():
            cells = " / ".join(f"{1e3 * pair[way]['median_s']:9.3f}" for way in ("forward", "back"))
            beside = record["ratios"].get(device, {}).get(name, {})
            least = record["ratios_of_least"].get(device, {}).get(name, {})
            own = pair.get("times_as_fast")
            print(f"  {device:18} {name:17} {cells}", f"{own[0]} / {own[1]} x voxels" if own else "", end="  ")
            times = "  ".join(
                f"{f:g} / {b:g} x {who} (least times {least[who][0]:g} / {least[who][1]:g})"
                for who, (f, b) in beside.items()
            )
            print(times)
    for who, records in record["peers"].items():
        for name in MATRICES:
            found = records[name]
            if "missing" in found:
                print(f"  {who:18} {name:10} missing: {found['missing']}")
            else:
                error = f"   off by {found['disagreement']:.1e} of ours" if "disagreement" in found else ""
                print(f"  {who:18} {name:10} {1e3 * found['forward_s']:9.3f} / {1e3 * found['back_s']:9.3f}{error}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, nargs="+", default=[256], help="voxels along each axis, columns and rows")
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--devices", nargs="+", default=["gpu", "cpu"], help="names, or cpu and gpu for all of a kind")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    devices = chosen_devices(args.devices)
    for n in args.n:
        record = measure(n, args.angles, args.runs, devices, not args.no_peers)
        show(record)
        print(f"  {write_record(args.records, f'projectors-{n}-{args.label}', record)}", flush=True)


def measure(n: int, angles: int, runs: int, devices: list[Device], beside: bool) -> dict[str, Any]:
    """The record of one size: ours, then the peers, on an otherwise idle machine."""
    before = machine(*devices)
    times = {device.name: ours(n, angles, device, runs) for device in devices}
    peers: dict[str, Any] = {}
    if beside and any(not is_gpu(device) for device in devices):
        processor = next(device for device in devices if not is_gpu(device))
        peers |= csr_peers(n, angles, runs, processor)
    if beside and any(is_gpu(device) for device in devices):
        peers |= astra_peer(n, angles, runs)
    shared = {"n": n, "angles": angles, "runs": runs, "machine": before}
    return {
        **shared,
        "vamgpu": times,
        "peers": peers,
        "ratios": ratios(times, peers),
        "ratios_of_least": ratios(times, peers, least=True),
    }


if __name__ == "__main__":
    main()
