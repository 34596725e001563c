"""Five generations of resin x what is off x how the print is ended: overlap, window, surface and exposure, proved.

With ``--disturbed``: what no part of the loop models, in a print that shares nothing with the library.
"""

from __future__ import annotations

import argparse
import copy
import json
import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import vamgpu
from profiling.independent_print import DISTURBED, Disturbance, IndependentPrint
from vamgpu.live import LiveLoop, SensorNoise, Turbidity
from vamgpu.live.printer import GENERATIONS, CuringResin, Truth, VirtualPrinter
from vamgpu.live.record import LiveSetup
from vamgpu.methods.run import optimize
from vamgpu.metrics import score
from vamgpu.optics.vial import Vial
from vamgpu.printing.scatter import ScatterStop
from vamgpu.printing.surface import deviation, iso_surface

PLANNED, LONGEST = 16, 32
OFF = {
    "nothing else": Truth(),
    "lamp -20 %": Truth(lamp=0.8),
    "absorption +15 %": Truth(absorption=0.15),
    "axis 0.5 pixel": Truth(across=0.5),
    "gain 10 % along z": Truth(along_z=0.05),
}
POLICIES = ("timer", "scatter stop", "live")


def _gel(setup: LiveSetup, more: float) -> LiveSetup:
    resin = setup.resin
    return replace(setup, resin=replace(resin, solid=resin.induction - np.log(1.0 - more * resin.gel) / resin.rate))


def _rate(setup: LiveSetup, more: float) -> LiveSetup:
    return replace(setup, resin=replace(setup.resin, rate=more * setup.resin.rate))


def _dark(setup: LiveSetup, more: float) -> LiveSetup:
    return replace(setup, resin=replace(setup.resin, dark=more * setup.resin.dark))


def _turbidity(setup: LiveSetup, more: float) -> LiveSetup:
    told = setup.turbidity
    return replace(setup, turbidity=replace(told, extinction=[more * each for each in told.extinction]))


def _all(setup: LiveSetup, more: float) -> LiveSetup:
    return _turbidity(_dark(_rate(_gel(setup, more), more), more), more)


BELIEVED = {"gel point": _gel, "rate": _rate, "dark reaction": _dark, "turbidity": _turbidity, "all four": _all}
"""What the loop may believe to be more than it is: the conversion that is solid; the rate of curing, where the dose
that is solid was measured; the life of radicals; the extinction of cured resin."""
SHORT, FALSE = 0.005, 0.01
"""Overlap below that of the best stop, and above the true one in a prediction, that a live print may have."""
BEYOND = 4
"""Turns without a better overlap after which the best stop is known."""
KEY = ("generation", "off", "policy", "seed", "believed")
RECORD = Path(__file__).parent / "records" / "live-cpu.json"
OFTEN = 20.0
"""Seconds after which the record is written again."""

Cell = tuple[int, str, str, int, str]
"""Of `KEY`; what is believed as "gel point +10 %", "" for the truth."""


class Bench:
    """One part, its plan, and prints of it."""

    part: np.ndarray
    light: np.ndarray
    density: float
    """Of scattered light, half a turn before the plan's end in fresh resin."""
    known: dict[str, Any]
    """What takes long to find out, for other processes."""

    def __init__(self, size: int, angles: int, device: str = "", known: dict[str, Any] | None = None) -> None:
        pitch = 4.8 / size
        vial = Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=0.1)
        self.setup = LiveSetup(
            (size, size, size // 2), pitch, (2 * size, size // 2), pitch, angles, vial, replace(vial, absorption=0.0),
            800.0, SensorNoise(read=0.8, gain=0.01, bits=10), CuringResin(), Turbidity((0.0, 1.0), (0.0, 0.25)),
            1.3, PLANNED, LONGEST, device=device,
        )  # fmt: skip
        self.plan, self.camera = self.setup.projection(vial), self.setup.camera()
        self.part = maze(*np.meshgrid(*self.plan.grid.axes(), indexing="ij"), pitch)
        self.printer_like = cache(self._printer_like)
        self.known = self._calibrated() if known is None else known
        self.light, self.density = self.known["light"], self.known["density"]
        self.setup = replace(self.setup, resin=CuringResin(solid=self.known["solid"]))
        self.printer_like.cache_clear()
        self.believing = cache(self._believing)
        self._doses: dict[tuple[float, ...], np.ndarray] = {}

    def _calibrated(self) -> dict[str, Any]:
        """What a user knows of the plan printed in fresh resin: where it is solid, and what scatters at the end."""
        self.light = (np.asarray(optimize(self.plan, self.part, iterations=40).sinogram) / PLANNED).astype(np.float32)
        printer = self.printer(Truth(), 99)
        dose, stop = printer.dose(self.light), self._stop(1e30, printer)
        for turn in range(1, PLANNED + 1):
            printer.turn(dose)
            stop.see(turn, printer.aside().sum(axis=0))
        field, levels = printer.printed(), np.arange(0.8, 0.9, 0.005)
        away = [self.surface(field, level) for level in printer.resin.conversion(levels)]
        return {
            "light": self.light,
            "density": 0.5 * (stop.readings[-1].density + stop.readings[-2].density),
            "solid": float(levels[np.nanargmin(away)]),
            "fresh_um": 1e3 * float(np.nanmin(away)),
        }

    def _printer_like(self, absorption: float, across: float, along_z: float) -> VirtualPrinter:
        truth = Truth(absorption=absorption, across=across, along_z=along_z)
        return VirtualPrinter(self.plan, self.camera, self.setup.resin, self.setup.turbidity, truth)

    def printer(self, truth: Truth, seed: int) -> VirtualPrinter:
        """Before its first turn; those of the same optics share their tables."""
        printer = copy.copy(self.printer_like(truth.absorption, truth.across, truth.along_z))
        printer.truth, printer.seed, printer.state = truth, seed, np.zeros_like(printer.state)
        printer.state[0] = truth.inhibitor * printer.resin.induction
        return printer

    @property
    def loop(self) -> LiveLoop:
        """That believes the truth."""
        return self.believing("")

    def _believing(self, believed: str) -> LiveLoop:
        setup = self.setup
        if believed:
            name, share = believed[:-2].rsplit(" ", 1)
            setup = BELIEVED[name](setup, 1.0 + 0.01 * float(share))
        return setup.loop(self.part, self.light)

    def dose(self, printer: VirtualPrinter) -> np.ndarray:
        """Of a turn of the plan."""
        truth = printer.truth
        optics = truth.absorption, truth.across, truth.along_z
        if optics not in self._doses:
            self._doses[optics] = printer.dose(self.light)
        return self._doses[optics]

    def _stop(self, density: float, printer: VirtualPrinter) -> ScatterStop:
        stop = ScatterStop(float(self.part.sum()), density)
        stop.see(0.0, printer.aside().sum(axis=0))
        return stop

    def ended(self, policy: str, printer: VirtualPrinter, believed: str = "") -> float:
        """Print until a policy ends it; the light used, in turns of the plan."""
        dose, spent = self.dose(printer), 0.0
        if policy == "timer":
            for _ in range(PLANNED):
                printer.turn(dose)
            return float(PLANNED)
        if policy == "scatter stop":
            stop = self._stop(self.density, printer)
            while stop.stopped is None and printer.turns < LONGEST:
                printer.turn(dose)
                stop.see(printer.turns, printer.aside().sum(axis=0))
            return float(printer.turns)
        loop = self.believing(believed)
        state, action = loop.start(), "keep"
        while action != "stop":
            spent += float(state.light.mean() / self.light.mean())
            printer.turn(dose)
            state, decision = loop.decide(state, printer.through())
            action = decision.action
            if action == "swap":
                dose = printer.dose(state.light)
        return spent

    def surface(self, field: np.ndarray, level: float) -> float:
        """RMS distance of the surface of a field from the part's [mm]; NaN without one."""
        pitch = self.plan.grid.pitch
        target, printed = iso_surface(self.part, 0.5, pitch), iso_surface(field, level, pitch)
        if not len(printed.points):
            return float("nan")
        return max(
            float(np.sqrt(np.mean(np.square(deviation(*way))))) for way in ((printed, target), (target, printed))
        )

    def printed(self, cell: Cell) -> dict[str, Any]:
        """A print and its end: overlap, window of conversion, RMS of the surfaces [mm], turns, and light in turns."""
        generation, off, policy, seed, believed = cell
        began = time.perf_counter()
        printer = self.printer(replace(OFF[off], inhibitor=GENERATIONS[generation - 1] / GENERATIONS[0]), seed)
        spent = self.ended(policy, printer, believed)
        field, device, gel = printer.printed(), self.plan.device, self.setup.resin.gel
        scores = score(device.upload(field.astype(np.float32)), device.upload(self.part), threshold=gel)
        return dict(zip(KEY, cell, strict=True)) | {
            "iou": scores.iou, "window": scores.windows.strict, "rms_mm": self.surface(field, gel),
            "turns": printer.turns, "light": spent, "seconds": time.perf_counter() - began,
        }  # fmt: skip


class DisturbedBench:
    """A part without a mirror plane, its plan, and independent prints of it."""

    def __init__(self, size: int, angles: int, device: str = "", known: dict[str, Any] | None = None) -> None:
        bench = Bench(size, angles, device, {"light": None, "density": 0.0, "solid": CuringResin().solid})
        self.plan, self.part = bench.plan, cross(*np.meshgrid(*bench.plan.grid.axes(), indexing="ij"))
        self.setup, self.scale = bench.setup, 1.0
        self.known = self._calibrated() if known is None else known
        self.light, self.scale, self.best = (self.known[name] for name in ("light", "scale", "best"))
        unmeasured = replace(bench.setup.turbidity, error=0.2)
        self.setup = replace(bench.setup, resin=CuringResin(solid=self.known["solid"]), turbidity=unmeasured)

    def _calibrated(self) -> dict[str, Any]:
        """What a user knows of the plan printed in fresh resin: its dose, and where it is solid."""
        light = (np.asarray(optimize(self.plan, self.part, iterations=40).sinogram) / PLANNED).astype(np.float32)
        fresh, inside = self.printer(Disturbance(inhibitor=1.0)), self.part > 0.5
        dose = sum((fresh.exposed(light, angle, 0.0) for angle in range(self.setup.angles)), np.zeros(()))
        dose = dose.reshape(*(length for n in self.part.shape for length in (n, 2))).mean((1, 3, 5))[inside]
        expected = np.asarray(self.plan.T(self.plan.device.upload(light)).numpy())[inside]
        self.scale = float((expected * dose).sum() / (dose**2).sum())
        fresh, levels = self.printer(Disturbance(inhibitor=1.0)), np.arange(0.72, 1.0, 0.005)
        for _ in range(PLANNED):
            fresh.turn(light)
        found = np.array([fresh.overlap(self.part, float(CuringResin().conversion(level))) for level in levels])
        solid = float(levels[found >= found.max() - 1e-9].mean())
        return {"light": light, "scale": self.scale, "solid": solid, "fresh": float(found.max()), "best": {}}

    def printer(self, off: Disturbance, seed: int = 0) -> IndependentPrint:
        setup = self.setup
        return IndependentPrint(
            setup.shape, setup.pitch, setup.pixels[0], setup.angles, off, setup.resin, setup.turbidity.full,
            setup.open_field, setup.noise, seed, self.scale,
        )  # fmt: skip

    def planned(self, off: Disturbance) -> tuple[float, float]:
        """Overlaps of the planned light: the greatest, whenever it ends, and after the turns of the plan."""
        printer, found = self.printer(off.of_light), [0.0]
        while printer.turns < LONGEST and (
            printer.turns < PLANNED or max(found) == 0.0 or max(found) not in found[:-BEYOND]
        ):
            printer.turn(self.light)
            found.append(printer.overlap(self.part))
        return max(found), found[PLANNED]

    def printed(self, cell: tuple[str, int]) -> dict[str, Any]:
        """A live print: overlap, the greatest one of the planned light, what the loop predicted, and its alarm."""
        began, (name, seed) = time.perf_counter(), cell
        off = DISTURBED[name]
        printer, loop = self.printer(off, seed), self.setup.loop(self.part, self.light)
        state, decision = loop.start(), None
        while decision is None or (decision.action != "stop" and printer.turns < LONGEST):
            printer.turn(np.asarray(state.light))
            state, decision = loop.decide(state, printer.images())
        best, timer = self.planned(off)
        return {
            "disturbed": name, "seed": seed, "best_stop": best, "timer": timer, "iou": printer.overlap(self.part),
            "predicted": decision.iou, "turns": printer.turns, "alarm": decision.doubt,
            "turbidity": decision.parameters.get("turbidity"),
            "seconds": time.perf_counter() - began,
        }  # fmt: skip


def cross(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A tube off the axis, two fins, a post and a base, without a mirror plane; walls two voxels thick."""
    tube = np.abs(np.hypot(x - 0.55, y - 0.3) - 0.65) < 0.2
    fins = ((np.abs(y + 0.9) < 0.16) & (np.abs(x) < 1.4)) | ((np.abs(x + 1.0) < 0.16) & (np.abs(y) < 1.1))
    base = (z < -0.65) & (np.hypot(x, y) < 1.75)
    return ((tube | fins | (np.hypot(x + 0.3, y - 1.35) < 0.3) | base) & (np.abs(z) < 0.95)).astype(np.float32)


def maze(x: np.ndarray, y: np.ndarray, z: np.ndarray, pitch: float) -> np.ndarray:
    """Rings two pixels thick and two apart, with gates of two pixels on either side in turns, on a lid."""
    r = np.hypot(x, y)
    ring = np.floor((1.8 - r) / (2 * pitch)).astype(int)
    gate = (np.abs(x) < pitch) & (np.where(ring % 4 == 0, y, -y) > 0)
    walls = (ring % 2 == 0) & ~gate & (np.abs(z) < 0.85)
    lid = (z > -0.85) & (z < 2 * pitch - 0.85)
    return ((r < 1.8) & (r > 0.3) & (walls | lid)).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=48, help="voxels along an edge")
    parser.add_argument("--angles", type=int, default=90)
    parser.add_argument("--seeds", type=int, default=10, help="of the camera's noise; the timer has no camera")
    parser.add_argument("--generations", type=int, nargs="+", default=range(1, 6), choices=range(1, 6))
    parser.add_argument("--off", nargs="+", default=list(OFF), choices=list(OFF))
    parser.add_argument("--policies", nargs="+", default=list(POLICIES), choices=POLICIES)
    parser.add_argument(
        "--believed",
        type=int,
        nargs="+",
        default=[],
        metavar="PERCENT",
        help="live only, of a loop that believes kinetics or turbidity to be more and less by these",
    )
    parser.add_argument("--disturbed", nargs="*", choices=list(DISTURBED), help="live prints of these, or of all")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes, each with its share of the cores")
    parser.add_argument("--device", default="", help="of all processes, e.g. warp:cuda:0; the usual one if left out")
    parser.add_argument("--record", type=Path, help="by default live-cpu.json, or live-…-cpu.json, in records")
    parser.add_argument("--more", action="store_true", help="go on with the prints that the record does not have")
    parser.add_argument("--markdown", action="store_true", help="print the table of the record, and make no print")
    given = parser.parse_args()
    kind = "live-believed" if given.believed else "live" if given.disturbed is None else "live-disturbed"
    given.record = given.record or RECORD.with_name(f"{kind}-cpu.json")
    if given.markdown:
        print(told(json.loads(given.record.read_text())))
        return
    beliefs = [""]
    if given.believed:
        given.policies = ["live"]
        beliefs += [f"{name} {side * share:+d} %" for share in given.believed for name in BELIEVED for side in (1, -1)]
    bench = (Bench if given.disturbed is None else DisturbedBench)(given.size, given.angles, given.device)
    record = {
        "machine": {"device": bench.plan.device.name, "jobs": given.jobs, "vamgpu": vamgpu.__version__},
        "size": [given.size, given.size, given.size // 2], "angles": given.angles,
        **{name: bench.known[name] for name in ("fresh_um", "fresh", "solid") if name in bench.known},
        "seconds": 0.0, "prints": [],
    }  # fmt: skip
    if given.more and given.record.exists():
        record = json.loads(given.record.read_text())
    key = KEY if given.disturbed is None else ("disturbed", "seed")
    there: set[tuple[Any, ...]] = {tuple(p.get(name, "") for name in key) for p in record["prints"]}
    cells: list[Any] = (
        [each for each in product(given.disturbed or DISTURBED, range(given.seeds)) if each not in there]
        if given.disturbed is not None
        else [
            (generation, off, policy, seed, believed)
            for seed in range(given.seeds)
            for policy in reversed(given.policies)
            for generation in given.generations
            for off in given.off
            for believed in beliefs
            if (generation, off, policy, seed, believed) not in there and not (policy == "timer" and seed)
        ]
    )
    began = written = time.perf_counter()
    before = record["seconds"]
    for printed in prints(bench, cells, given.jobs):
        record["prints"].append(printed)
        now = time.perf_counter()
        record["seconds"] = before + now - began
        if now - written > OFTEN or len(record["prints"]) == len(there) + len(cells):
            given.record.write_text(json.dumps(record, indent=1) + "\n")
            print(f"{len(record['prints'])} prints in {record['seconds']:.0f} s", flush=True)
            written = now
    print(told(record))


_bench: Bench | DisturbedBench


def prints(bench: Bench | DisturbedBench, cells: Sequence[Any], jobs: int) -> Iterator[dict[str, Any]]:
    """All cells, in processes if there is more than one."""
    if jobs < 2:
        yield from map(bench.printed, cells)
        return
    context = multiprocessing.get_context("spawn")  # devices do not survive a fork
    turns, setup = context.Value("i", 0), bench.setup
    given = type(bench), setup.shape[0], setup.angles, setup.device, bench.known
    with context.Pool(jobs, _opened, (turns, jobs, given)) as pool:
        yield from pool.imap_unordered(_one, cells)


def _opened(turns: Any, jobs: int, given: tuple[Any, ...]) -> None:
    """A process's own bench, on its share of the cores, so that devices do not start as many threads as there are."""
    global _bench
    with turns.get_lock():
        mine, turns.value = turns.value, turns.value + 1
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, cores[mine % len(cores) :: jobs] if jobs < len(cores) else [cores[mine % len(cores)]])
    _bench = given[0](*given[1:])


def _one(cell: Any) -> dict[str, Any]:
    return _bench.printed(cell)


def told(record: dict[str, Any]) -> str:
    """A record in Markdown."""
    if record["prints"] and "disturbed" in record["prints"][0]:
        return _of_disturbed(record)
    return _of_beliefs(record) if any(p.get("believed") for p in record["prints"]) else _of_policies(record)


def _of_disturbed(record: dict[str, Any]) -> str:
    """Of each disturbance: overlap of the live print, and whether it is no less than the best stop's and predicted."""
    lines, kept, silent = ["| disturbance | timer | best stop | live | predicted | alarm |", "|---" * 6 + "|"], 0, 0
    order = list(DISTURBED)
    for p in sorted(record["prints"], key=lambda p: (order.index(p["disturbed"]), p["seed"])):
        kept += p["iou"] >= p["best_stop"] - SHORT
        silent += not p["alarm"] and p["predicted"] - p["iou"] > FALSE
        predicted = "–" if p["alarm"] else f"{p['predicted']:.3f}"
        alarm = p["alarm"].partition(":")[0] or "–"
        name = p["disturbed"].replace("-", "−")
        lines.append(f"| {name} | {p['timer']:.3f} | {p['best_stop']:.3f} | {p['iou']:.3f} | {predicted} | {alarm} |")
    count = len(record["prints"])
    return "\n".join([
        *lines, "",
        f"{kept} of {count} reach the best stop's overlap less {SHORT:g}; {silent} predict more than {FALSE:g} too "
        f"much without an alarm. {record['machine']['device']}, {record['seconds']:.0f} s.",
    ])  # fmt: skip


def _of_beliefs(record: dict[str, Any]) -> str:
    """Of each belief and cell: least overlap and window, mean RMS of the surfaces, mean light."""
    made: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for p in record["prints"]:
        made.setdefault(p["believed"], {}).setdefault(f"{p['generation']}, {p['off']}", []).append(p)
    cells = list(next(iter(made.values())))
    lines = ["| believed | " + " | ".join(cells) + " |", "|---|" + "---|" * len(cells)]
    for believed, some in made.items():
        row = [_cell(some[cell])[0] for cell in cells]
        lines.append(f"| {believed.replace('-', '−') or 'the truth'} | " + " | ".join(row) + " |")
    return "\n".join(lines)


def _cell(prints: list[dict[str, Any]]) -> tuple[str, float, float]:
    """As text; the least overlap; the mean RMS [µm]."""
    iou, window = (min(p[name] for p in prints) for name in ("iou", "window"))
    rms, light = 1e3 * float(np.mean([p["rms_mm"] for p in prints])), np.mean([p["light"] for p in prints])
    return f"{iou:.3f}, {window:.2f}, {rms:.0f}, {light:.1f}", iou, rms


def _of_policies(record: dict[str, Any]) -> str:
    """In Markdown: of each cell the least overlap and window, the mean RMS of its seeds, and the mean light."""
    made: dict[tuple[int, str, str], list[dict[str, Any]]] = {}
    for p in record["prints"]:
        made.setdefault((p["generation"], p["off"], p["policy"]), []).append(p)
    lines = ["| generation, off | " + " | ".join(POLICIES) + " |", "|---|" + "---|" * len(POLICIES)]
    half, drifting, kept, full = 0, 0, 0, 0
    for generation, off in product(range(1, len(GENERATIONS) + 1), OFF):
        cells, rms = [], {}
        for policy in POLICIES:
            some = made.get((generation, off, policy), [])
            if not some:
                cells.append("")
                continue
            text, iou, rms[policy] = _cell(some)
            cells.append(text)
            if policy == "live":
                full, kept = full + 1, kept + (iou >= 0.995)
        if off != next(iter(OFF)) and {"live", "scatter stop"} <= rms.keys():
            drifting += 1
            half += not rms["live"] > 0.5 * rms["scatter stop"]
        if any(cells):
            lines.append(f"| {generation}, {off} | " + " | ".join(cells) + " |")
    seeds = 1 + max((p["seed"] for p in record["prints"]), default=0)
    return "\n".join([
        *lines, "",
        f"Live keeps an overlap of 0.995 in {kept} of {full} cells. Its RMS is at most half the scatter stop's in "
        f"{half} of {drifting} where something drifts; in fresh resin the plan's own is {record['fresh_um']:.0f} µm. "
        f"{seeds} seeds on {record['machine']['device']}, {record['machine']['jobs']} processes, "
        f"{record['seconds']:.0f} s.",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
