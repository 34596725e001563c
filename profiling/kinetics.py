"""Time photoinhibition kinetics of many items on devices: frames of a print, and whole inductions in one interval.

Every induction is also compared with SciPy's `solve_ivp` (LSODA at rtol 1e-6) run item by item on a few of them, for
time, and at rtol 1e-10 for error up to the event.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, is_gpu, machine, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.kernels.kinetics import inhibit

RESIN = (1.0 / 30.0, 0.02, 0.008, 0.05, 1.0, 5.0, 0.0, 0.0)
CASES = {"frames": (60, 0.05), "induction": (1, 200.0)}


def launches(device: Device, items: int, case: str) -> tuple[Any, dict[str, Any]]:
    """A launch of a case, and its arguments."""
    count, seconds = CASES[case]
    before = np.tile([1.0, 0.0, 5.0, 0.0], (items, 1))
    light = np.random.default_rng(0).uniform(0.5, 1.5, (min(items, 1 << 16), count, 2))
    bound = {"before": device.table(before), "rates": device.table(np.array([RESIN])), "light": device.table(light)}
    bound |= {"lengths": device.table(np.full(count, seconds))}
    for name, shape in (("after", (items, 4)), ("path", (items, 1, 4)), ("times", (items,))):
        bound[name] = device.empty(shape, device.real, table=True)
    numbers = {"first": 0, "count": count, "every": count, "tolerance": 1e-6}
    return (lambda: device.launch(inhibit, **bound, **numbers)), {**bound, "shine": light}


def scipy_items(light: np.ndarray, few: int) -> dict[str, Any]:
    """Seconds per item, and event times of the first few by a fine integration."""
    from scipy.integrate import solve_ivp

    k_a, k_b, k_c, k_2, _, supply = RESIN[:6]

    def change(_: float, y: np.ndarray, visible: float, uv: float) -> list[float]:
        whole, made, paired = max(y[0] + y[1], 1e-12), k_c * uv * y[2] / supply, k_2 * y[1] ** 2
        return [-k_a * visible * y[0] / whole, -k_b * visible * y[1] / whole + 2 * (made - paired), paired - made]

    def gone(_: float, y: np.ndarray, *__: float) -> float:
        return y[0] + y[1] - 1e-6

    gone.terminal = True  # type: ignore[attr-defined]
    span, start = (0.0, CASES["induction"][1]), (1.0, 0.0, 5.0)
    begin = time.perf_counter()
    for row in light[:few, 0]:
        solve_ivp(change, span, start, "LSODA", args=tuple(row), events=gone, rtol=1e-6, atol=1e-8)
    each = (time.perf_counter() - begin) / few
    fine = [solve_ivp(change, span, start, "Radau", args=tuple(row), events=gone, rtol=1e-10, atol=1e-13).t_events[0]
            for row in light[:few, 0]]  # fmt: skip
    return {"seconds_an_item": each, "events": [float(t[0]) if t.size else -1.0 for t in fine]}


def measure(device: Device, items: int, runs: int, few: int) -> dict[str, Any]:
    """Both cases on a device."""
    rows: dict[str, Any] = {}
    for case, (count, _) in CASES.items():
        run, bound = launches(device, items, case)
        rows[case] = timed(run, device.synchronize, runs, 1)
        rows[case]["item_intervals_a_second"] = items * count / rows[case]["least_s"]
        if case == "induction":
            other = scipy_items(bound["shine"], few)
            found, wanted = bound["times"].numpy()[:few], np.array(other["events"])
            rows[case]["event_error"] = float(np.abs(found - wanted).max() / np.abs(wanted).max())
            rows[case]["scipy_s"] = other["seconds_an_item"] * items
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--items", type=int, default=1 << 18)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--few", type=int, default=20)
    parser.add_argument("--devices", nargs="+", default=["opencl:intel:0", "opencl:pocl:0", "warp:cpu"])
    parser.add_argument("--records", type=Path, default=HERE / "records")
    args = parser.parse_args()
    devices = chosen_devices(args.devices)
    record = {"items": args.items, "machine": machine(*devices), "devices": {}}
    for device in devices:
        rows = record["devices"][device.name] = measure(device, args.items, args.runs, args.few)
        for case, row in rows.items():
            rate = row["item_intervals_a_second"] / 1e6
            print(f"{device.name:16} {case:10} {row['least_s']:.4f} s, {rate:.2f} million intervals a second", end="")
            print(f"; SciPy {row['scipy_s']:.0f} s, events {row['event_error']:.0e} apart" if "scipy_s" in row else "")
    write_record(args.records, f"kinetics-{args.items}-{'gpu' if is_gpu(devices[0]) else 'cpu'}", record)


if __name__ == "__main__":
    main()
