"""Time projection on rings stage by stage, beside the direct operator, and what its bytes and sums would take.

Every launch is timed on its own, between two synchronizations, in the order in which a product makes them; least times
of a stage, medians and least times of products. "bytes" are
those that a stage has to read and write once, "flops" its additions and multiplications; "moved" of a whole product
are its stages' bytes over those of volume, light and table.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, MESH, benchy, machine, timed, write_record

import vamgpu
from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.polar import PolarGrid, tiles_of_vessel
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.optics.vial import Vial

VIAL = Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.473, bath_index=1.0, absorption=0.05)
SIZE = 14.8
"""Width of the grid [mm]."""
PRODUCTS = ("light_rings", "gather_rings")


def stages(device: Device, run: Callable[[], Any], runs: int) -> list[dict[str, Any]]:
    """Every launch of a call: kernel, least time [s], bytes of its fields, flops where they are counted."""
    launch, found = device.launch, []

    def watched(kernel: Any, **given: Any) -> None:
        device.synchronize()
        began = time.perf_counter()
        launch(kernel, **given)
        device.synchronize()
        seconds = time.perf_counter() - began
        arrays = [each for each in given.values() if hasattr(each, "shape") and hasattr(each, "dtype")]
        moved = {id(each): 4 * int(np.prod(each.shape)) for each in arrays}
        found[-1].append((kernel.name, seconds, sum(moved.values()), _flops(kernel.name, given)))

    device.launch = watched  # pyright: ignore[reportAttributeAccessIssue] - for the time of the measurement
    try:
        for _ in range(runs + 1):
            found.append([])
            run()
    finally:
        del device.launch
    return [
        {"stage": first[0], "s": min(each[1] for each in same), "bytes": first[2], "flops": first[3]}
        for first, *same in zip(*found, strict=True)
    ]


def _flops(kernel: str, given: dict[str, Any]) -> int:
    """Of products and transforms."""
    if kernel in PRODUCTS:
        angles, _, slices = given["light"].shape
        lit = given["lit"].numpy().astype(np.int64)
        return int(2 * 16 * lit.sum() * angles / len(lit)) * slices
    if kernel == "fourier":
        bands = given["bands"].numpy().astype(np.float64)  # as is usual, 5·n·log₂ n for n complex numbers
        return int(2.5 * given["sink"].shape[2] * (bands[:, 1] * bands[:, 2] * np.log2(bands[:, 3])).sum())
    return 0


def measured(n: int, angles: int, device: Device, runs: int, cases: list[str], tf32: bool) -> dict[str, Any]:
    """Every operator of one size on a device."""
    grid, motion, pitch = Grid((n, n, n), SIZE / n), Turntable(angles), SIZE / n
    rng = np.random.default_rng(0)
    light = device.upload(rng.random((angles, n, n), np.float32))
    found: dict[str, Any] = {}
    for name, beam, vessel in (
        ("straight", Beam((n, n), pitch, spread=0.0), None),
        ("vial", Beam((n, n), 1.5 * pitch), VIAL),
    ):
        if name not in cases:
            continue
        A = Projection(grid, beam, motion, vessel, device)
        began = time.perf_counter()
        R = RingProjection.of(A, tf32=tf32)
        made = time.perf_counter() - began
        # rings as wide as voxels, without the way to voxels
        half = -(-n // 16) * 8
        S = SpectralProjection(type(R.rings)(half, n, pitch, angles), beam, vessel, device, tf32=tf32)
        for which, operator in (("voxels", A), ("rings", R), ("cells", S)):
            volume, out = device.upload(rng.random(operator.domain.shape, np.float32)), device.empty(light.shape)
            dose = device.empty(operator.domain.shape)
            ways: dict[str, Callable[[], Any]] = {
                "forward": lambda A=operator, x=volume, y=out: A(x, out=y),
                "back": lambda A=operator, x=dose: A.T(light, out=x),
            }
            for way, run in ways.items():
                row: dict[str, Any] = timed(run, device.synchronize, runs)
                if not isinstance(operator, Projection):
                    row["stages"] = stages(device, run, 3)
                    need = 4 * int(np.prod(volume.shape) + np.prod(light.shape)) + 4 * _entries(operator)
                    row |= {"bytes_needed": need, "moved": sum(s["bytes"] for s in row["stages"]) / need}
                found[f"{name}, {which}, {way}"] = row
            del volume, out, dose
        found[f"{name}, made [s]"] = made
        del A, R, S
    return found


def printed(mesh: Path, n: int, angles: int, device: Device, iterations: int) -> dict[str, Any]:
    """Windows of the Benchy, proved from frames: light found on rings by products of float32, of TF32, and by rays."""
    target = benchy(mesh, n, device)
    A = Projection(target.grid, Beam((n, n), target.grid.pitch), Turntable(angles), None, device)
    operators = {"rays": A, "rings": RingProjection.of(A), "rings, tf32": RingProjection.of(A, tf32=True)}
    found: dict[str, Any] = {}
    for method in ("ramp", "osmo"):
        for name, operator in operators.items():
            plan = vamgpu.optimize(operator, target, method, iterations, progress=False)
            proof = vamgpu.simulate(A, vamgpu.pack(plan), target)
            row = {"window": round(proof.scores.window, 5), "iou": round(proof.scores.iou, 5)}
            row |= {"claimed": round(plan.window, 5), "seconds": round(plan.seconds, 2)}
            found[f"{method}, {name}"] = row
            print(method, name, row, flush=True)
    return found


def _entries(operator: RingProjection | SpectralProjection) -> int:
    spectral = operator._spectral if isinstance(operator, RingProjection) else operator
    return int(spectral._entries["entries"].shape[0])  # pyright: ignore[reportAttributeAccessIssue]


def show(record: dict[str, Any]) -> None:
    """Print times and stages."""
    for name, row in record["times"].items():
        if not isinstance(row, dict):
            print(f"{name:28} {row:.2f}")
            continue
        moved = f"  moved {row['moved']:.1f}" if "moved" in row else ""
        print(f"{name:28} {1e3 * row['median_s']:9.2f} ms, least {1e3 * row['least_s']:9.2f}{moved}")
        for stage in row.get("stages", ()):
            rate = f"{stage['bytes'] / stage['s'] / 1e9:8.0f} GB/s"
            rate += f"{stage['flops'] / stage['s'] / 1e12:7.2f} Tflop/s" if stage["flops"] else ""
            print(f"    {stage['stage']:24} {1e3 * stage['s']:9.3f} ms {rate}")


def _poses(rings: PolarGrid, beam: Beam, vial: Vial) -> list[np.ndarray]:
    """The light of one pose in the rings of each band, (rings, cells of a ring, columns)."""
    found, given = [], iter(tiles_of_vessel(rings, beam, vial))
    for band in rings.bands:
        tiles = []
        for _ in range(band.rings // ROWS):
            out = open_device("numpy").empty((rings.angles, band.samples * ROWS, beam.pixels[0]))
            next(given).pose(beam, out.shape[:2], out.device)(0, 1.0, out)
            tiles.append(out.numpy().reshape(rings.angles * band.samples, ROWS, -1).swapaxes(0, 1))
        found.append(np.concatenate(tiles))
    return found


def picture(path: Path) -> None:
    """Cells of rings and what one column leaves on them; the same by angular frequency; what rings change of a dose."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    vial = Vial(radius=1.55, wall=0.1, resin_index=1.5, wall_index=1.473)
    rings, beam, column = PolarGrid(48, 2, 1 / 48, 96), Beam((120, 2), 0.026), 68
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
    poses = _poses(rings, beam, vial)
    most = max(float(pose[..., column].max()) for pose in poses)
    spectrum = np.full((rings.rings, 48 * max(band.samples for band in rings.bands) + 1), np.nan)
    for band, pose in zip(rings.bands, poses, strict=True):
        count = rings.angles * band.samples
        edges = 2.0 * np.pi / count * (np.arange(count + 1) - 0.5)
        radii = np.arange(band.begin, band.stop + 1) / rings.rings
        turn, radius = np.meshgrid(edges, radii)
        left.pcolormesh(
            radius * np.cos(turn), radius * np.sin(turn), pose[..., column] / most, cmap="magma_r", vmin=0.0, vmax=1.0,
            edgecolors=(0.0, 0.0, 0.0, 0.12), linewidth=0.2,
        )  # fmt: skip
        found = np.abs(np.fft.rfft(pose[..., column], axis=1)) / count
        spectrum[band.begin : band.stop, : found.shape[1]] = found
    left.set(
        aspect="equal", xlabel="x / radius", ylabel="y / radius", title="light of one column, one angle, in a vial"
    )
    shown = middle.imshow(
        np.log10(np.maximum(spectrum / np.nanmax(spectrum), 1e-9)), origin="lower", aspect="auto", cmap="magma",
        vmin=-5, vmax=0, extent=(0, spectrum.shape[1], 0, rings.rings),
    )  # fmt: skip
    across = 2.0 * np.pi * np.arange(rings.rings + 1) / 48 / (0.026 / 1.5)
    middle.plot(across, np.arange(rings.rings + 1), lw=1, label="waves as long as a column is wide")
    middle.set(xlim=(0, spectrum.shape[1]), ylim=(0, rings.rings), xlabel="angular frequency", ylabel="ring",
               title="the same by frequency, log₁₀ of the greatest")  # fmt: skip
    middle.legend(loc="lower right")
    figure.colorbar(shown, ax=middle)
    grid, turn = Grid((64, 64, 2), 1 / 32), Turntable(120)
    A = Projection(grid, Beam((80, 8), 0.04), turn, vial, "numpy")
    light = np.random.default_rng(0).random(A.range.shape)
    wanted = np.asarray(A.T(light))
    for width, style in ((1.0, "C1"), (0.75, "C0")):
        own = PolarGrid(-(-int(32 / width + 3) // 8) * 8, 2, width * grid.pitch, 120, grid.pitch)
        R = RingProjection(grid, A.beam, turn, vial, "numpy", rings=own)
        off = np.abs(np.asarray(R.T(light)) - wanted)[grid.cylinder()] / wanted.max()
        levels = np.sort(off.ravel())[::-1]
        right.loglog(100.0 * levels, np.arange(1, levels.size + 1) / levels.size, style,
                     label=f"rings as wide as {width:g} of a voxel")  # fmt: skip
    right.set(xlabel="dose differs by more than [% of the greatest]", ylabel="share of voxels",
              title="dose of noise, against rays through voxels", xlim=(1e-3, 5), ylim=(1e-4, 1.1))  # fmt: skip
    right.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--device", default=None)
    parser.add_argument("--picture", type=Path, default=None, help="draw that of the docs there, measure nothing")
    parser.add_argument("--cases", nargs="+", default=["straight", "vial"])
    parser.add_argument("--tf32", action="store_true", help="products of eleven bits where there are units for them")
    parser.add_argument("--print", type=int, default=0, metavar="ITERATIONS", help="solve and prove the Benchy instead")
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the record's name")
    args = parser.parse_args()
    if args.picture is not None:
        picture(args.picture)
        return
    device = open_device(args.device)
    if args.print:
        found = printed(args.mesh, args.n, args.angles, device, args.print)
        record = {"n": args.n, "angles": args.angles, "machine": machine(device), "prints": found}
        print(write_record(args.records, f"rings-prints-{args.n}-{args.label}", record))
        return
    times = measured(args.n, args.angles, device, args.runs, args.cases, args.tf32)
    record = {"n": args.n, "angles": args.angles, "machine": machine(device), "times": times}
    show(record)
    print(write_record(args.records, f"rings-{args.n}-{args.label}", record))


if __name__ == "__main__":
    main()
