"""Thin walls that oxygen would blur away, and the dose that restores them."""

from __future__ import annotations

from typing import Any

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Diffusion, Spread
from vamgpu.chemistry.materials import Resin
from vamgpu.chemistry.precompensate import PAPERS, Compensated, precompensate, stream
from vamgpu.geometry import Grid
from vamgpu.reports import style


def precompensation(
    device: Device,
    quick: bool = False,
    pitch: float = 0.045,
    voxels: int = 64,
    blur: float = 1.0,
    background: float = 0.6,
) -> Picture:
    """A gyroid whose walls become thinner; blur: standard deviation of the diffused dose in voxels."""
    n = 32 if quick else int(voxels)
    part, grid = _walls(n), Grid((n, n, n // 2), pitch)
    diffusion = Diffusion((blur * pitch) ** 2 / 60.0, 60.0)
    found = precompensate(part, grid, diffusion, background=background, device=device)
    spread = Spread(grid, diffusion, device)
    plain, made_up = spread(part), (spread(found.dose.numpy() - background)) / (1.0 - background)
    wrong = [int(((image >= 0.5) != (part >= 0.5)).sum()) for image in (plain, made_up)]
    slabs = np.array_split(part, 5, axis=2)
    streamed = np.concatenate(list(stream(slabs, grid, diffusion, background=background, block=n // 4,
                                          device=device)), axis=2)  # fmt: skip
    apart = float(np.abs(streamed - found.dose.numpy()).max())
    real = Resin.load("dudma-pegda").diffusivity("oxygen", temperature=293.15, molar_mass=500.0)
    facts = (
        Fact(f"factor by which the RMS error falls, with a blur of {blur:g} voxels", found.factor, "", 3),
        Fact(f"the same at {2 * blur:g} voxels", _factor(part, grid, 2 * blur, background, device), "", 3),
        Fact(
            f"the same at {blur:g} voxels, edges sharp to the voxel",
            _factor(_sharp(part), grid, blur, background, device),
            "",
            3,
        ),
        Fact(
            f"the same at {2 * blur:g} voxels, edges sharp to the voxel",
            _factor(_sharp(part), grid, 2 * blur, background, device),
            "",
            3,
        ),
        Fact("voxels on the wrong side of one half, plain", wrong[0], ""),
        Fact("the same, compensated", wrong[1], ""),
        Fact("smallest target dose", float(found.dose.numpy().min()), "", 3, 0.0, "never negative", "≥"),
        Fact("greatest target dose", found.greatest, "", 3),
        Fact("streamed in blocks against all at once, worst voxel", apart, "", 2, 1e-3 * found.greatest, "bound", "≤"),
        Fact("blur of the automatic exposure resin, 56.8 s", 1e3 * Diffusion(real, 56.8).deviation, "µm", 2),
    )
    caption = (
        "Oxygen diffuses into regions that the light has depleted, so thin walls cure late. The blur is the mean of "
        "heat kernels over the exposure. The target dose is deconvolved; a small weight penalizes its distance from "
        f"the plain target, and it never falls below zero. A background of {100 * background:g} % lets it dip beside "
        "an edge. The table shows the effect of the background. This part's edges are smooth over more than a voxel, "
        "which flatters the numbers: sharp edges and wider blurs leave less to gain. All numbers describe the target "
        "dose, not a print: light cannot be negative and may not reach it. The last number is a Wilke–Chang estimate "
        "that assumes 293 K and 500 g/mol, which the paper does not give."
    )
    table = _table(part, grid, diffusion, device)
    return Picture(_drawn(part, plain, found, made_up), caption, facts, table, PAPERS)


def _sharp(part: np.ndarray) -> np.ndarray:
    return (part >= 0.5).astype(np.float32)


def _factor(part: np.ndarray, grid: Grid, blur: float, background: float, device: Device) -> float:
    diffusion = Diffusion((blur * grid.pitch) ** 2 / 60.0, 60.0)
    return precompensate(part, grid, diffusion, background=background, device=device).factor


def _walls(n: int) -> np.ndarray:
    """Sheets of a gyroid that thin out along x."""
    x, y, z = (np.arange(k) - 0.5 * (k - 1) for k in (n, n, n // 2))
    x, y, z = x[:, None, None], y[None, :, None], z[None, None, :]
    w = 2 * np.pi / 20.0
    wave = np.sin(w * x) * np.cos(w * y) + np.sin(w * y) * np.cos(w * z) + np.sin(w * z) * np.cos(w * x)
    thick = 0.55 - 0.4 * (x / n + 0.5)
    steep = np.clip(0.5 + (thick - np.abs(wave)) / (1.3 * w), 0.0, 1.0)
    inside = (np.hypot(x, y) < 0.45 * n) & (np.abs(z) < 0.15 * n)
    return (steep * inside).astype(np.float32)


def _table(part: np.ndarray, grid: Grid, diffusion: Diffusion, device: Device) -> Table:
    rows = []
    for background in (0.0, 0.2, 0.4, 0.6, 0.8):
        found = precompensate(part, grid, diffusion, background=background, device=device)
        rows.append((f"{100 * background:.0f} %", (found.factor, found.greatest)))
    return Table(("background", "error falls by a factor of", "greatest dose"), (".2f", ".2f"), tuple(rows))


def _drawn(part: np.ndarray, plain: np.ndarray, found: Compensated, made_up: np.ndarray) -> Any:
    figure, axes = style.sheet("abcd", 2.9)
    middle = part.shape[2] // 2
    doses = {"vmin": 0.0, "vmax": 1.1}
    style.shown(axes["a"], part[:, :, middle], "Target", **doses)
    drawn = style.shown(axes["b"], plain[:, :, middle], "Diffused, plain", **doses)
    style.shown(axes["c"], found.dose.numpy()[:, :, middle], "Required dose", vmin=0.0, vmax=found.greatest)
    style.shown(axes["d"], made_up[:, :, middle], "Diffused, compensated", **doses)
    style.bar(drawn, [axes["d"]], "over the background")
    for letter, image in (("b", plain), ("d", made_up)):
        if (image[:, :, middle] > 0.5).any():
            axes[letter].contour(image[:, :, middle].T, [0.5], colors=style.BLUE, linewidths=0.6)
    return figure
