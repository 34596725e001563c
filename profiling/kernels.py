"""Run every declared kernel on every device from its declaration: compare with the NumPy definition, then time it.

Bytes are those of all arguments, read or written once each and twice where they are updated, so the rate is a lower
bound of what a kernel moves: projectors read their input many times over, kernels that look at little of a table less.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from common import HERE, chosen_devices, machine, timed, write_record

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.errors import OutOfMemory
from vamgpu.kernels.catalog import kernels, text_hash
from vamgpu.kernels.signature import Kernel

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from kernel_examples import bind  # noqa: E402  # pyright: ignore[reportMissingImports]

HEADER = f"{'kernel':24} {'device':18} {'error':>8} {'ms':>10} {'MB':>9} {'GB/s':>8}"


def profile(kernel: Kernel, device: Device, size: int, check: int, runs: int) -> dict[str, Any]:
    """Error at the size ``check`` and median time at ``size``."""
    reference, small = bind(vamgpu.open_device("numpy"), kernel, check), bind(device, kernel, check)
    reference.launch()
    small.launch()
    record: dict[str, Any] = {"kernel": kernel.name, "text": text_hash(kernel), "device": device.name}
    record["error"] = small.error(reference)
    try:
        bound = bind(device, kernel, size)
        record |= timed(bound.launch, device.synchronize, runs)
    except OutOfMemory as error:
        return record | {"missing": str(error)}
    return record | {"bytes": bound.nbytes, "bytes_per_s": bound.nbytes / record["median_s"]}


def line(record: dict[str, Any]) -> str:
    """A row of the printed table."""
    start = f"{record['kernel']:24} {record['device']:18} {record['error']:8.1e} "
    if "missing" in record:
        return start + record["missing"]
    rate = f"{record['bytes_per_s'] / 1e9:8.2f}"
    return start + f"{1e3 * record['median_s']:10.3f} {record['bytes'] / 1e6:9.2f} {rate}"


def main() -> None:
    """Read the command line, print the table, keep the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", nargs="+", default=["cpu", "gpu"], help="names, or cpu and gpu for all of a kind")
    parser.add_argument("--kernels", nargs="+", help="names; all by default")
    parser.add_argument("--size", type=int, default=128, help="samples along the axes when timed")
    parser.add_argument("--check", type=int, default=40, help="samples along the axes when compared")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--record", type=Path, help="file to keep the numbers in, e.g. records/kernels-cpu.json")
    options = parser.parse_args()
    devices = chosen_devices(options.devices)
    chosen = [k for k in kernels() if not options.kernels or k.name in options.kernels]
    print(HEADER)
    rows = []
    for kernel in chosen:
        for device in devices:
            rows.append(profile(kernel, device, options.size, options.check, options.runs))
            print(line(rows[-1]), flush=True)
    if options.record:
        path = options.record if options.record.is_absolute() else HERE / options.record
        what = {"size": options.size, "check": options.check, "kernels": rows}
        print(write_record(path.parent, path.stem, {"machine": machine(*devices), **what}))


if __name__ == "__main__":
    main()
