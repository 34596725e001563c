"""Dots, bars, gray wedges and posts as single slices, in one color and in two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.color_contrast import Contrast
from profiling.gallery.dualcolor import slice_colors, verdict
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.species import PAPER
from vamgpu.methods.dual import DualColor, LeastSquares, superpose
from vamgpu.reports import style
from vamgpu.targets.designs import BLOCKS, PIXELS, dot_array, gray_wedges, usaf, usaf_bars
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RULES = {
    "SC": "sc",
    "SC2": "sc2",
    "DC (text)": "dc",
    "DC (adding up)": DualColor(recompute=False),
    "DC (least squares)": LeastSquares(40),
}


def designs(device: Device, quick: bool = False, pixels: int = 300, angles: int = 360) -> Picture:
    """Every design by every rule; the paper's slices are 1500 pixels wide (``pixels=1500``), μR = 1 for both colors."""
    n, turn = (72, 24) if quick else (int(pixels), int(angles))
    rules = dict(list(RULES.items())[:3]) if quick else RULES
    targets = made(n)
    letters = [[f"{row}{column}" for column in range(len(rules) + 1)] for row in range(len(targets))]
    figure, axes = style.sheet(letters, 2.1 * len(targets) + 0.4)
    rows, windows = [], {}
    for row, target in enumerate(targets):
        design = target.numpy()
        style.shown(axes[f"{row}0"], design[:, :, 0], target.name, cmap="gray", vmin=0, vmax=1)
        colors = slice_colors(target, turn, device, (1.0, 1.0))
        for column, (label, rule) in enumerate(rules.items(), start=1):
            dose = superpose(colors, target, rule).dose().numpy()
            found = Contrast.of(dose, design)
            windows[target.name, label] = found.window
            numbers = (found.in_least, found.out_most, found.window, found.mean, found.half)
            rows.append((f"{target.name}, {label}", (*numbers, found.undersupply, found.oversupply)))
            _show(axes[f"{row}{column}"], dose, design, target, label if row == 0 else "")
    header = ("design, rule", "D in, least", "D out, greatest", "window", "mean in − out", "IoU at 0.5", "undersupply",
              "oversupply")  # fmt: skip
    facts = tuple(Fact(f"window of {target.name}, {label}", windows[target.name, label], "D_in,max", 3)
                  for target in targets for label in (list(rules)[0], list(rules)[-1]))  # fmt: skip
    thinnest = usaf_bars()[-1].width
    caption = (
        f"Single slices of {n} × {n} pixels with a diagonal of 30 mm; {turn} angles. Left: the design. Then: the "
        "voxels with at least half of D_in,max; correct in black, missing in blue, excess in red. Gray wedges are "
        f"shown as doses. Bars of groups −2 to 1 are scaled to the square: the thinnest are {1e3 * thinnest:.0f} µm "
        f"wide, {thinnest / targets[0].grid.pitch:.1f} pixels here. The paper's designs are {PIXELS} pixels wide."
    )
    table = Table(header, ("+.3f", "+.3f", "+.3f", ".3f", ".3f", ".4f", ".4f"), tuple(rows))
    return Picture(figure, caption, facts, table, (PAPER,))


def made(n: int) -> tuple[Target, ...]:
    """The designs at a resolution; dots at most as dense as four pixels per period, and at most the paper's 80."""
    return (dot_array(min(80, int(n * 2**0.5 / 4)), n), usaf(pixels=n), gray_wedges(8, n), BLOCKS["W1"].level(n))


def _show(axis: Axes, dose: np.ndarray, design: np.ndarray, target: Target, title: str) -> None:
    values, wanted = dose[:, :, 0], design[:, :, 0] >= 0.5
    values = values / values[wanted].max()
    if target.name.startswith("wedges"):
        style.shown(axis, values, title, cmap="gray", vmin=0, vmax=1)
        return
    axis.imshow(verdict(values >= 0.5, wanted).transpose(1, 0, 2), origin="lower", interpolation="nearest")
    axis.set_title(title)
    axis.grid(False)
    style.bare(axis)
