"""Time explicit diffusion and photochemistry of three species as NumPy, SciPy and a numba-parallel loop do it.

The same step as vamgpu's in float32: fluxes through six faces with no flux at the ends, then, with ``--reacting``, the
reactions. Every species starts from the same seeded noise; prints the time of all steps and a checksum as a JSON line.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from diffusing import RATES, SPREAD, start
from machine import emit, machine


def numpy_step(species: list, light: list, out: list, reacting: bool) -> None:
    for k, s in enumerate(species):
        np.copyto(out[k], s)
        for axis in range(3):
            near, far = [slice(None)] * 3, [slice(None)] * 3
            near[axis], far[axis] = slice(None, -1), slice(1, None)
            flux = SPREAD[k, axis] * np.diff(s, axis=axis)
            out[k][tuple(near)] += flux
            out[k][tuple(far)] -= flux
    if reacting:
        numpy_reaction(out, light)


def scipy_step(species: list, light: list, out: list, reacting: bool) -> None:
    from scipy.ndimage import correlate1d

    for k, s in enumerate(species):
        np.copyto(out[k], s)
        for axis in range(3):
            weights = SPREAD[k, axis] * np.array([1.0, -2.0, 1.0], np.float32)
            out[k] += correlate1d(s, weights, axis=axis, mode="nearest")
    if reacting:
        numpy_reaction(out, light)


def numpy_reaction(species: list, light: list) -> None:
    a, b, c = species
    power = light[0] + RATES[4] * light[1]
    whole = a + b
    want_a, want_b = RATES[0] * power, RATES[1] * power
    a -= want_a * a / np.maximum(whole, want_a)
    b -= want_b * b / np.maximum(whole, want_b)
    split = np.minimum(c, c * (RATES[2] * light[1]))
    paired = RATES[3] * b * b / (1 + 2 * RATES[3] * b)
    b += 2 * (split - paired)
    c += paired - split


def numba_step() -> Callable[..., None]:
    from numba import njit, prange

    @njit(parallel=True, fastmath=True, cache=False)
    def sweep(a, b, c, visible, ultraviolet, a_out, b_out, c_out, spread, rates, reacting):
        nx, ny, nz = a.shape
        for x in prange(nx):
            xl, xh = max(x - 1, 0), min(x + 1, nx - 1)
            for y in range(ny):
                yl, yh = max(y - 1, 0), min(y + 1, ny - 1)
                for s, out, k in ((a, a_out, 0), (b, b_out, 1), (c, c_out, 2)):
                    dx, dy, dz = spread[k, 0], spread[k, 1], spread[k, 2]
                    here, low, high, left, right = s[x, y], s[xl, y], s[xh, y], s[x, yl], s[x, yh]
                    row = out[x, y]
                    for z in range(1, nz - 1):
                        v = here[z]
                        row[z] = (v + dx * ((low[z] - v) + (high[z] - v)) + dy * ((left[z] - v) + (right[z] - v))
                                  + dz * ((here[z - 1] - v) + (here[z + 1] - v)))  # fmt: skip
                    for z, o in ((0, 1), (nz - 1, nz - 2)):
                        v = here[z]
                        row[z] = (v + dx * ((low[z] - v) + (high[z] - v)) + dy * ((left[z] - v) + (right[z] - v))
                                  + dz * (here[o] - v))  # fmt: skip
                if reacting:
                    ra, rb, rc, vis, uv = a_out[x, y], b_out[x, y], c_out[x, y], visible[x, y], ultraviolet[x, y]
                    for z in range(nz):
                        power = vis[z] + rates[4] * uv[z]
                        va, vb, vc = ra[z], rb[z], rc[z]
                        want_a, want_b, whole = rates[0] * power, rates[1] * power, va + vb
                        va -= want_a * va / max(whole, want_a)
                        vb -= want_b * vb / max(whole, want_b)
                        split = min(vc, vc * rates[2] * uv[z])
                        paired = rates[3] * vb * vb / (np.float32(1) + np.float32(2) * rates[3] * vb)
                        ra[z], rb[z], rc[z] = va, vb + np.float32(2) * (split - paired), vc + paired - split

    def step(species: list, light: list, out: list, reacting: bool) -> None:
        sweep(*species, *light, *out, SPREAD, RATES, reacting)

    return step


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--library", choices=("numpy", "scipy", "numba"), required=True)
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--reacting", action="store_true")
    args = parser.parse_args()
    step = {"numpy": lambda: numpy_step, "scipy": lambda: scipy_step, "numba": numba_step}[args.library]()
    seconds, sums = [], []
    for run in range(args.runs + (args.library == "numba")):
        species, light = start(args.n)
        out = [np.empty_like(s) for s in species]
        if run == 0 and args.library == "numba":
            step(species, light, out, args.reacting)  # compiles
            continue
        begin = time.perf_counter()
        for _ in range(args.steps):
            step(species, light, out, args.reacting)
            species, out = out, species
        seconds.append(time.perf_counter() - begin)
        sums = [float(np.sum(s, dtype=np.float64)) for s in species]
    version = __import__(args.library).__version__
    emit({"library": f"{args.library} {version}", "least_s": min(seconds), "runs_s": seconds, "sums": sums,
          "machine": machine()})  # fmt: skip


if __name__ == "__main__":
    main()
