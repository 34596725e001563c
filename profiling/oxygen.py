"""Prints in resin whose oxygen diffuses: patterns that ignore it, and patterns that follow it.

python profiling/oxygen.py slice                a wheel in two dimensions, air-saturated resin
python profiling/oxygen.py slice --uneven       an older print took 40 % of the oxygen nearby
python profiling/oxygen.py tower                oxygen that rises from 40 to 100 % along z
python profiling/oxygen.py proof                patterns of the model, and what the proof finds
python profiling/oxygen.py time --size 128      a gradient beside a pair of products
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

import vamgpu as vam
from vamgpu.chemistry.oxygen import Oxygen, OxygenModel
from vamgpu.chemistry.transport import Box, Reaction, Transport
from vamgpu.methods import LBFGS
from vamgpu.operators.pose_runs import PoseRuns

PITCH, TURNS, PERIOD, JUDGE = 0.1, 5, 9.0, 60
SOLID = 1.05
"""Effective dose from which resin is solid."""


def scene(size: int, slices: int, device: Any, angles: int = 120) -> vam.Projection:
    """Resin 8 mm across, in focus everywhere."""
    vat = vam.Vat(8.0, radius=4.0, absorption=0.05)
    beam, motion = vam.Beam((size, slices), PITCH, spread=0.5 * PITCH), vam.Turntable(angles, lit_share=0.0)
    return vam.Projection(vam.Grid((size, size, slices), PITCH), beam, motion, vat, device)


def wheel(A: vam.Projection, scale: float = 1.0) -> np.ndarray:
    """A wheel with teeth, two holes and a slit, and what is judged of the voxels around it."""
    x, y, _ = (values / scale for values in np.meshgrid(*A.grid.axes(), indexing="ij"))
    part = np.hypot(x, y) < 2.3 + 0.4 * np.sign(np.cos(8.0 * np.arctan2(y, x)))
    part &= (np.hypot(x - 1.1, y) >= 0.45) & (np.hypot(x + 1.1, y) >= 0.3)
    return (part & ((np.abs(x) >= 0.2) | (np.abs(y) >= 1.5))).astype(np.float64)


def transported(model: OxygenModel, light: np.ndarray) -> np.ndarray:
    """Effective dose by the explicit steps of `Transport`: shorter runs, no floor."""
    A, oxygen = model.operator, model.oxygen
    count = min(JUDGE, A.motion.angles)
    walk = Transport(Box(A.grid.shape, (PITCH,) * 3), (oxygen.diffusivity,) * 3, Reaction(1.0, 0.0, 0.0, 0.0),
                     device=A.device)  # fmt: skip
    state, seconds = walk.start(a=1.0 - np.broadcast_to(oxygen.used, A.grid.shape)), PERIOD / count
    runs, parts = PoseRuns(A, count), [A.device.empty(A.grid.shape) for _ in range(count)]
    for run, part in enumerate(parts):
        runs.expose(run, A.device.upload(light / (TURNS * seconds)), part)
    for _ in range(TURNS):
        for part in parts:
            walk.advance(state, seconds, max(3, walk.steps(seconds)), visible=part)
    found = state.numpy()
    return 1.0 + found["dose"] - found["a"]


def judged(name: str, model: OxygenModel, light: np.ndarray, part: np.ndarray) -> None:
    """Print the scores at the exposure with the best overlap, by `Transport` and by the model with shorter steps."""
    short = OxygenModel(model.operator, replace(model.oxygen, runs=min(JUDGE, model.motion.angles), steps=2))
    x, y, _ = np.meshgrid(*model.grid.axes(), indexing="ij")
    near = np.hypot(x, y) < model.grid.inscribed_radius - 0.5 * PITCH
    inside, outside = near & (part > 0.5), near & (part < 0.5)
    judges = {
        "Transport": lambda light: transported(model, light),
        "short steps": lambda light: np.asarray(short.T(light)),
    }
    for judge, exposed in judges.items():
        best = (0.0, 0.0, 0, 0.0)
        for power in np.arange(0.9, 1.13, 0.02):
            dose = exposed(power * light)
            printed, window = dose >= SOLID, (dose[inside].min() - dose[outside].max()) / dose[near].max()
            iou = (printed & inside).sum() / ((printed & near) | inside).sum()
            best = max(best, (float(iou), float(window), int((printed != (part > 0.5))[near].sum()), float(power)))
        iou, window, wrong, power = best
        print(f"{name}, by {judge}: {wrong} of {near.sum()} voxels wrong, IoU {iou:.4f}, window {window:+.4f} at "
              f"{power:.2f} of the light", flush=True)  # fmt: skip
    gaps = {judge: np.abs(np.asarray(model.T(light)) - exposed(light))[near] for judge, exposed in judges.items()}
    most = float(np.asarray(model.T(light)).max())
    said = (
        f"{judge} {gap.max() / most:.4f} at most, {np.sqrt((gap**2).mean()) / most:.4f} rms"
        for judge, gap in gaps.items()
    )
    print(f"{name}, planned − judged dose: {'; '.join(said)}", flush=True)


def compare(A: vam.Projection, part: np.ndarray, used: Any, options: Any) -> None:
    """Patterns of the plain dose, and of the model from there, judged alike."""
    model = OxygenModel(A, Oxygen(options.diffusivity, TURNS, PERIOD, used))
    method = LBFGS(outside=0.85, inside=1.25, most=1.5)
    plain = vam.optimize(A, part, method, options.iterations, progress=False)
    judged("ignored", model, plain.sinogram.numpy(), part)
    began = time.perf_counter()
    plan = vam.optimize(model, part, iterations=options.iterations, start=plain, progress=False)
    print(f"{plan.evaluations:g} evaluations, {time.perf_counter() - began:.0f} s, planned {plan.window:+.4f}")
    light = plan.sinogram.numpy()
    judged("followed", model, light, part)
    if options.save:
        np.savez(options.save, part=part, plain=plain.sinogram.numpy(), followed=light)


def proofs(options: Any) -> None:
    """A slice, and a tower in resin above and below: window and dose as planned, and as the proof finds them."""
    room = ceil(Oxygen(options.diffusivity, TURNS, PERIOD).reach / PITCH)
    for name, A in (("slice", scene(64, 1, options.device)), ("tower", scene(32, 16 + 2 * room, options.device, 72))):
        slices = A.grid.shape[2]
        part, used = wheel(A, A.grid.shape[0] / 64), 0.0
        if slices > 1:
            part[:, :, :room] = part[:, :, -room:] = 0.0
            used = np.linspace(0.6, 0.0, slices)
        model = OxygenModel(A, Oxygen(options.diffusivity, TURNS, PERIOD, used))
        plan = vam.optimize(model, part, iterations=options.iterations, progress=False)
        worked = time.process_time()
        proof = vam.simulate(model, vam.pack(plan, bits=8), part)
        gap = np.abs(np.asarray(model.T(proof.frames.irradiance(A.device))) - proof.dose.numpy()) / proof.scores.peak
        x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
        near = np.hypot(x, y) < 0.8 * A.grid.inscribed_radius
        print(f"{name}, {A.grid.shape} voxels, D = {options.diffusivity:g}: window planned "
              f"{proof.claimed.windows.strict:+.4f}, proved {proof.scores.windows.strict:+.4f}, IoU "
              f"{proof.scores.iou:.4f}; dose planned − proved {proof.difference:.4f} of the peak at most, "
              f"{gap[near].max():.4f} up to 0.8 of the radius, {np.sqrt((gap[near] ** 2).mean()):.4f} rms; "
              f"{time.process_time() - worked:.0f} s of processors", flush=True)  # fmt: skip


def times(options: Any) -> None:
    """Seconds of an effective dose with its gradient, and of the processors: the shortest of four."""
    size, pixels = options.size, (options.size, options.size)
    vial = vam.Vial(5.0, 0.5, resin_index=1.5, wall_index=1.473, absorption=0.05)
    motion = vam.Turntable(360)
    A = vam.Projection(vam.Grid((size,) * 3, 0.05), vam.Beam(pixels, 0.05), motion, vial, options.device)
    model = OxygenModel(A, Oxygen(options.diffusivity, TURNS, PERIOD))
    light = A.device.upload(np.random.default_rng(0).random(A.range.shape, np.float32))
    light = A.device.upload(light.numpy() * np.float32(1.6 / A.T(light).numpy().max()))
    for name, operator in (("plain", A), ("oxygen", model)):
        took = []
        for _ in range(5):
            began, worked = time.perf_counter(), time.process_time()
            operator(operator.T(light))
            A.device.synchronize()
            took.append((time.perf_counter() - began, time.process_time() - worked))
        wall, work = np.min(took[1:], axis=0)
        print(f"{name}: {wall:.2f} s, {work:.2f} s of processors", flush=True)


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("slice", "tower", "proof", "time"))
    parser.add_argument("--diffusivity", type=float, default=2e-3, help="mm²/s")
    parser.add_argument("--uneven", action="store_true")
    parser.add_argument("--iterations", type=int, default=250)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--save", help="NPZ file of the patterns")
    parser.add_argument("--device")
    options = parser.parse_args()
    if options.what in ("proof", "time"):
        return proofs(options) if options.what == "proof" else times(options)
    if options.what == "tower":
        A = scene(32, 16, options.device, 72)
        return compare(A, wheel(A, 0.5), np.linspace(0.6, 0.0, 16), options)
    A = scene(64, 2, options.device)
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    used = 0.4 * np.exp(-((x - 1.2) ** 2 + y**2) / 1.5**2) if options.uneven else 0.0
    return compare(A, wheel(A), used, options)


if __name__ == "__main__":
    main()
