"""Patterns for a machine with small errors, compared with patterns for one without."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import ToleranceWarning
from vamgpu.methods import optimize
from vamgpu.methods.tolerances import CornerDoses, Tolerances, at
from vamgpu.printing.corners import prove_corners
from vamgpu.printing.pack import pack
from vamgpu.printing.pictures import EXCESS, HIT, MISSING, OUTSIDE, verdicts
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT = 0.2


def robust(
    device: Device, quick: bool = False, pitch: float = 0.3, angles: int = 120, iterations: int = 120,
    axis: float = 0.25, least: float = 0.4, most: float = 0.8,
) -> Picture:  # fmt: skip
    """The boat in straight light; the axis is off by ``axis`` pixels, and the point spread varies."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    step, steps = A.beam.pitch, 4 if quick else int(iterations)
    off = Tolerances(axis=axis * step, spread=(least * step, most * step))
    figure, axes = style.sheet("abc;def", 6.6, width_ratios=[1, 1, 1.25])
    facts, rows = [], []
    for row, (name, tolerances) in zip(("abc", "def"), (("nominal", None), ("robust", off)), strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ToleranceWarning)
            plan = optimize(A, target, iterations=steps, tolerances=tolerances, progress=False)
        shone = pack(plan)
        found = prove_corners(A, shone, target, off)
        threshold = 0.5 * (found.darkest.least + found.leakiest.leak)
        facts.append(Fact(f"{name} light, window with one threshold for all corners, proved", found.window, "", 3))
        facts.append(Fact(f"{name} light, window without errors, proved", found.nominal, "", 3))
        _printed(axes, row, A, target, shone, off, (threshold, found, name))
        _ranges(axes[row[2]], found, threshold, name)
        top = max(corner.greatest for corner in found.corners)
        rows += [(f"{name} light: {c.name}", (c.least / top, c.leak / top, c.window)) for c in found.corners]
    table = Table(("light and corner", "least dose in the part", "greatest outside", "window of the corner"),
                  (".3f", ".3f", "+.3f"), tuple(rows))  # fmt: skip
    caption = (
        "A boat printed with patterns planned without errors (nominal light) and with patterns planned for all "
        f"tolerance corners at once (robust light): an axis of rotation {axis:g} pixel off to either side, a point "
        f"spread of {least:g} or {most:g} pixel. Left: the print without errors. Middle: the print at the corner with "
        "the least dose in the part, with the same threshold. Right: the doses of part and voids at every corner; "
        "patterns print if all bars of the part lie above those of the voids. Both took the same number of iterations "
        "and are judged from their 8-bit frames, along rays traced for every corner."
    )
    return Picture(figure, caption, tuple(facts), table)


def _printed(axes: dict[str, Axes], row: str, A: Any, target: Any, shone: Any, off: Tolerances, judged: Any) -> None:
    from matplotlib.colors import ListedColormap

    threshold, found, name = judged
    colors = ["#f2f4f7", "#9fb4cc", style.RED, style.ORANGE, "white"]
    codes = dict(zip((0, HIT, MISSING, EXCESS, OUTSIDE), range(5), strict=True))
    by_name = {str(corner): corner for corner in off.corners()}
    for panel, corner in zip(row, (by_name["nominal"], by_name[found.darkest.name]), strict=False):
        dose = at(A, corner).T(shone.irradiance(A.device)).numpy()
        verdict = verdicts(target.numpy(), dose > threshold, A.grid.cylinder())
        wrong = int(((verdict == MISSING) | (verdict == EXCESS)).sum())
        coded = np.vectorize(codes.get)(scene.level(verdict, HEIGHT))
        style.shown(axes[panel], coded, f"{name} light, {corner}:\n{wrong:,} voxels wrong",
                    cmap=ListedColormap(colors), vmin=-0.5, vmax=4.5)  # fmt: skip


def _ranges(axis: Axes, found: CornerDoses, threshold: float, name: str) -> None:
    top = max(corner.greatest for corner in found.corners)
    for place, corner in enumerate(found.corners):
        least, leak, greatest = (value / top for value in (corner.least, corner.leak, corner.greatest))
        axis.barh(place + 0.19, greatest - least, 0.34, left=least, color=style.BLUE, label="part")
        axis.barh(place - 0.19, leak, 0.34, color=style.ORANGE, label="voids")
    axis.axvline(threshold / top, color=style.INK, lw=1.2, ls=(0, (4, 3)))
    axis.set_yticks(range(len(found.corners)), [c.name.replace(", ", "\n") for c in found.corners], fontsize=7.5)
    axis.set(title=f"{name} light: window {found.window:+.3f}".replace("-0", "−0"), xlim=(0, 1),
             xlabel="dose over its greatest")  # fmt: skip
    axis.invert_yaxis()
    handles, labels = axis.get_legend_handles_labels()
    axis.legend(handles[:2], labels[:2], loc="lower left", fontsize=8)
